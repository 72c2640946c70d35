// SPDX-License-Identifier: Apache-2.0
// Bytes of a segment around its frames, for writer and reader (docs/file-formats.md). Internal to db/segment.
#pragma once

#include <bit>
#include <cstdint>
#include <span>

#include "db/segment/segment.h"

namespace stratalux::db {

static_assert(std::endian::native == std::endian::little, "segments are written as they lie in memory");

inline constexpr uint32_t kFrameMagic = 0x314d5246;   // "FRM1"
inline constexpr uint32_t kFooterMagic = 0x31544f46;  // "FOT1"
inline constexpr char kFileMagic[8] = {'S', 'L', 'X', 'S', 'E', 'G', '0', '1'};
inline constexpr char kEndMagic[8] = {'S', 'L', 'X', 'E', 'N', 'D', '0', '1'};

struct FileHeader {
  char magic[8];
  uint32_t version, header_bytes;
  char session[40];
  uint64_t hash;  // XXH3-64 of all before it
};
static_assert(sizeof(FileHeader) == kSegmentStart);

struct FooterStart {
  uint32_t magic, reserved;
  uint64_t frames;
};
struct Trailer {
  char magic[8];
  uint64_t footer_offset, footer_hash;
};

// XXH3-64 of all before the header's own hash.
[[nodiscard]] uint64_t HashOf(const FileHeader& header);
[[nodiscard]] uint64_t HashOf(const FrameHeader& header);
// XXH3-128, canonical.
void PayloadHash(std::span<const uint8_t> payload, uint8_t (&out)[16]);

}  // namespace stratalux::db
