// SPDX-License-Identifier: Apache-2.0
#include "db/keys/locked_bytes.h"

#include <sodium.h>

namespace stratalux::db {

void* TakeLocked(size_t size) {
  // The guarded heap checks itself by a number that is drawn then: nothing may be taken before.
  void* memory = sodium_init() < 0 ? nullptr : sodium_malloc(size);
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}

void ReturnLocked(void* memory) { sodium_free(memory); }

}  // namespace stratalux::db
