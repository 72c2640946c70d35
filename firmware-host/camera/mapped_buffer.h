// SPDX-License-Identifier: Apache-2.0
// One buffer of a driver, mapped into memory; unmapped when it goes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace stratalux::rig {

class MappedBuffer {
 public:
  // What mmap gave for `size` bytes, MAP_FAILED included; the pixels begin at `offset`.
  MappedBuffer(void* address, size_t size, size_t offset = 0) : address_(address), size_(size), offset_(offset) {}
  MappedBuffer(MappedBuffer&& other) noexcept;
  MappedBuffer& operator=(MappedBuffer&&) = delete;
  ~MappedBuffer();
  [[nodiscard]] bool ok() const;
  [[nodiscard]] std::span<const uint8_t> bytes() const {
    return std::span(static_cast<const uint8_t*>(address_), size_).subspan(offset_);
  }

 private:
  void* address_;
  size_t size_, offset_;
};

}  // namespace stratalux::rig
