// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/events/counted_new.h"

#include <cstdlib>
#include <new>

namespace {
thread_local int64_t allocations = 0;
}  // namespace

#if !defined(__SANITIZE_ADDRESS__)  // it has its own
void* operator new(size_t size) {
  ++allocations;
  void* memory = std::malloc(size);
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t) noexcept { std::free(memory); }
#endif

namespace stratalux::rig {

int64_t AllocationsOfThisThread() { return allocations; }

}  // namespace stratalux::rig
