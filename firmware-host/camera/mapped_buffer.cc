// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/mapped_buffer.h"

#include <utility>

#include <sys/mman.h>

namespace stratalux::rig {

MappedBuffer::MappedBuffer(MappedBuffer&& other) noexcept
    : address_(std::exchange(other.address_, MAP_FAILED)), size_(other.size_), offset_(other.offset_) {}

MappedBuffer::~MappedBuffer() {
  if (ok()) munmap(address_, size_);
}

bool MappedBuffer::ok() const { return address_ != MAP_FAILED; }

}  // namespace stratalux::rig
