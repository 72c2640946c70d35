// SPDX-License-Identifier: Apache-2.0
// All that can be read of a segment, whatever has become of the file. Writes nothing.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "db/segment/segment.h"

namespace stratalux::db {

// Where an index says that a frame lies.
struct KnownPlace {
  int64_t frame = 0, offset = 0, bytes = 0;  // bytes of the payload
  std::vector<uint8_t> hash;                 // of the payload
};

// The index speaks of this very frame.
[[nodiscard]] bool IsAt(const KnownPlace& place, const SegmentFrame& frame);

struct SegmentScan {
  // With a whole header and a payload within the file, in the file's order. A damaged payload has its row, so that
  // `verify` names it, unless it lies behind a damaged header or at the end, and no index knows it.
  std::vector<SegmentFrame> frames;
  // Bytes that belong to no such frame: damage, a record that was never finished, what stands behind the end.
  struct Aside {
    int64_t begin = 0, end = 0;
    std::string what;
  };
  std::vector<Aside> asides;
  // Frames that are known to have been here and are not among `frames`, with what can be said of them.
  struct Lost {
    int64_t frame = 0;
    int step = -1;  // -1: not known
    std::string why;
  };
  std::vector<Lost> lost;
  bool sealed = false;                // an intact footer agrees with what lies before it
  std::vector<std::string> findings;  // that the file contradicts itself, for people
};

// A sealed segment by its footer, each header compared with it; where a header is damaged and the payload fits the hash
// of the footer's copy, that copy counts; no other payload is read. Any other: header by header, each
// payload hashed; behind damage it goes on at the next whole header whose payload fits its hash, or that `known` speaks
// of. Places in `known` are looked at whatever lies before them. `file` is named in what is said.
[[nodiscard]] SegmentScan ScanSegment(const SegmentReader& reader, std::span<const KnownPlace> known);

}  // namespace stratalux::db
