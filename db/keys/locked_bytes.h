// SPDX-License-Identifier: Apache-2.0
// Memory for secrets.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <new>

namespace stratalux::db {

// Of libsodium's guarded heap: zeros, in no core dump, and not swapped out where the account may lock memory. The
// second overwrites it.
[[nodiscard]] void* TakeLocked(size_t size);
void ReturnLocked(void* memory);

// `size` bytes there.
template <size_t size>
class LockedBytes {
 public:
  LockedBytes() : bytes(*new (TakeLocked(size)) std::array<uint8_t, size>{}) {}
  LockedBytes(const LockedBytes&) = delete;
  LockedBytes& operator=(const LockedBytes&) = delete;
  ~LockedBytes() { ReturnLocked(&bytes); }

  std::array<uint8_t, size>& bytes;
};

using SecretKey = LockedBytes<32>;

}  // namespace stratalux::db
