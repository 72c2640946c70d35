// SPDX-License-Identifier: Apache-2.0
#include "db/segment/segment_layout.h"

#include <cstddef>
#include <cstring>

#include <xxhash.h>

namespace stratalux::db {

uint64_t HashOf(const FileHeader& h) { return XXH3_64bits(&h, offsetof(FileHeader, hash)); }
uint64_t HashOf(const FrameHeader& h) { return XXH3_64bits(&h, offsetof(FrameHeader, header_hash)); }

void PayloadHash(std::span<const uint8_t> payload, uint8_t (&out)[16]) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(payload.data(), payload.size()));
  std::memcpy(out, canonical.digest, 16);
}

}  // namespace stratalux::db
