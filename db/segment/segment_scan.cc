// SPDX-License-Identifier: Apache-2.0
#include "db/segment/segment_scan.h"

#include <algorithm>
#include <cstring>
#include <set>

namespace stratalux::db {
namespace {

int64_t EndOf(const SegmentFrame& f) {
  return f.offset + static_cast<int64_t>(sizeof(FrameHeader) + f.header.payload_bytes);
}

std::string At(int64_t offset) { return " (offset " + std::to_string(offset) + ")"; }

class Scanner {
 public:
  Scanner(const SegmentReader& reader, std::span<const KnownPlace> known) : reader_(reader), known_(known) {}

  SegmentScan Run() {
    const auto footer = reader_.Footer();
    if (footer && AgreesWith(*footer)) {
      TakeFooter(*footer);
    } else {
      Walk();
      LookAtKnown();
      CheckPayloads();
      NameAsides(footer);
      if (footer_.second == reader_.size() && scan_.findings.empty() && scan_.asides.empty())
        scan_.findings.push_back("the trailer does not say where the footer begins" + At(footer_.first));
    }
    return std::move(scan_);
  }

 private:
  // False where a whole header says otherwise than the footer: then the footer is not the one of these frames.
  bool AgreesWith(const std::vector<SegmentFrame>& footer) {
    for (const SegmentFrame& f : footer) {
      const auto header = reader_.ReadHeader(f.offset);
      if (!header.ok() || std::memcmp(&*header, &f.header, sizeof f.header) == 0) continue;
      scan_.findings.push_back("the footer disagrees with the header of frame " + std::to_string(header->frame) +
                               At(f.offset) + "; the headers were used");
      return false;
    }
    return true;
  }

  void TakeFooter(const std::vector<SegmentFrame>& footer) {
    scan_.sealed = true;
    for (const SegmentFrame& f : footer) {
      if (reader_.ReadHeader(f.offset).ok()) {
        scan_.frames.push_back(f);
        continue;
      }
      const std::string what = "the header of frame " + std::to_string(f.header.frame) + " is damaged";
      if (IsWhole(f)) {
        scan_.findings.push_back(what + At(f.offset) + "; its copy in the footer was used");
        scan_.frames.push_back(f);
        continue;
      }
      scan_.asides.push_back({f.offset, EndOf(f), what});
      scan_.lost.push_back({f.header.frame, f.header.step, what + At(f.offset)});
    }
  }

  bool IsKnown(const SegmentFrame& f) const {
    return std::any_of(known_.begin(), known_.end(), [&](const KnownPlace& k) { return IsAt(k, f); });
  }
  bool IsWhole(const SegmentFrame& f) { return reader_.ReadPayload(f.offset, f.header, buffer_).ok(); }

  void Walk() {
    int64_t offset = kSegmentStart;
    while (offset < reader_.size()) {
      if (const auto end = reader_.FooterEnd(offset)) {
        footer_ = {offset, *end};
        offset = *end;  // only what was put behind the end can follow
        continue;
      }
      if (const auto header = reader_.ReadHeader(offset); header.ok()) {
        scan_.frames.push_back({*header, offset});
        offset = EndOf(scan_.frames.back());
        continue;
      }
      // Bytes that were taken out of a payload leave the next header before the place where it is looked for.
      const bool shortened = !scan_.frames.empty() && !IsWhole(scan_.frames.back());
      const auto next =
          NextTrusted(shortened ? scan_.frames.back().offset + static_cast<int64_t>(sizeof(FrameHeader)) : offset + 1);
      if (!next) return;
      scan_.frames.push_back(*next);
      offset = EndOf(*next);
    }
  }

  // Behind damage any bytes may look like a header, a picture of one or the footer's copy: the payload must fit.
  std::optional<SegmentFrame> NextTrusted(int64_t offset) {
    while (const auto found = reader_.FindHeader(offset)) {
      // Headers made to overlap, each with a payload up to the end, must not cost the square of the file.
      searched_ += static_cast<int64_t>(found->header.payload_bytes);
      if (IsKnown(*found) || (searched_ <= kMostSearched * reader_.size() && IsWhole(*found))) return found;
      offset = found->offset + 1;
    }
    return std::nullopt;
  }

  // What an index acknowledged counts more than a header that claims its bytes.
  void LookAtKnown() {
    std::set<int64_t> there;
    for (const SegmentFrame& f : scan_.frames) there.insert(f.offset);
    for (const KnownPlace& k : known_) {
      if (there.contains(k.offset)) continue;
      const auto header = reader_.ReadHeader(k.offset);
      if (!header.ok() || !IsKnown({*header, k.offset})) continue;
      scan_.frames.push_back({*header, k.offset});
      scan_.findings.push_back("frame " + std::to_string(k.frame) + At(k.offset) +
                               " was found only by the old index: a frame before it claims its bytes");
    }
    std::sort(scan_.frames.begin(), scan_.frames.end(),
              [](const SegmentFrame& a, const SegmentFrame& b) { return a.offset < b.offset; });
  }

  // A writer that died leaves records whose bytes never came: they are at the end, and no index knows them.
  void CheckPayloads() {
    auto& frames = scan_.frames;
    while (!frames.empty() && footer_.second == 0 && !IsKnown(frames.back()) && !IsWhole(frames.back()))
      frames.pop_back();
    for (const SegmentFrame& f : frames)
      if (!IsWhole(f))
        scan_.findings.push_back("the payload of frame " + std::to_string(f.header.frame) + At(f.offset) +
                                 " does not match its hash");
  }

  void NameAsides(const std::optional<std::vector<SegmentFrame>>& disowned) {
    int64_t end = kSegmentStart;
    auto aside = [&](int64_t until, const char* what) {
      if (until > end) scan_.asides.push_back({end, until, what});
      end = std::max(end, until);
    };
    for (const SegmentFrame& f : scan_.frames) {
      aside(f.offset, "no whole frame header");
      end = std::max(end, EndOf(f));
    }
    if (footer_.second > 0) {
      aside(footer_.first, "no whole frame");
      end = footer_.second;
    }
    aside(reader_.size(), footer_.second > 0 ? "bytes after the end of the segment"
                          : disowned         ? "a footer that disagrees with its frames"
                                             : "no whole frame and no whole footer");
  }

  const SegmentReader& reader_;
  std::span<const KnownPlace> known_;
  SegmentScan scan_;
  std::pair<int64_t, int64_t> footer_{0, 0};  // of an intact one that does not end the file
  static constexpr int64_t kMostSearched = 8;
  int64_t searched_ = 0;  // bytes of payloads hashed behind damage
  std::vector<uint8_t> buffer_;
};

}  // namespace

bool IsAt(const KnownPlace& place, const SegmentFrame& frame) {
  return place.offset == frame.offset && place.frame == frame.header.frame &&
         std::equal(place.hash.begin(), place.hash.end(), std::begin(frame.header.payload_hash),
                    std::end(frame.header.payload_hash));
}

SegmentScan ScanSegment(const SegmentReader& reader, std::span<const KnownPlace> known) {
  return Scanner(reader, known).Run();
}

}  // namespace stratalux::db
