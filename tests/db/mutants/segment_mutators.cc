// SPDX-License-Identifier: Apache-2.0
// Changes of segments, hashes made anew up to a level.
#include <algorithm>
#include <cstddef>
#include <cstring>
#include <optional>
#include <span>

#include <xxhash.h>

#include "db/catalogue/manifest.h"
#include "db/segment/frame_codec.h"
#include "db/segment/pixel_hash.h"
#include "db/segment/segment.h"
#include "tests/db/mutants/mutation.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;

enum class Level { kNone, kHeader, kFooter, kManifest, kIndex };

constexpr size_t kFooterStart = 16, kTrailer = 24;

class SegmentFile {
 public:
  explicit SegmentFile(fs::path file) : file_(std::move(file)), bytes_(ReadBytes(file_)) {
    const auto reader = SegmentReader::Open(file_);
    bool sealed = false;
    const auto frames = reader.ok() ? reader->Walk(false, &sealed) : reader.status();
    if (frames.ok()) frames_ = *frames;
    if (sealed) footer_ = static_cast<size_t>(reader->frames_end());
  }
  [[nodiscard]] std::vector<SegmentFrame>& frames() { return frames_; }
  // A stored hash that is left behind where hashes are made anew up to `level`. One that was never sealed has no
  // footer, and its manifest none to hash.
  [[nodiscard]] bool LeavesHash(Level level) const {
    return level < Level::kHeader || (footer_ != 0 && level < Level::kManifest);
  }
  [[nodiscard]] std::span<uint8_t> PayloadOf(const SegmentFrame& frame) {
    return std::span(bytes_).subspan(static_cast<size_t>(frame.offset) + sizeof(FrameHeader),
                                     frame.header.payload_bytes);
  }
  void Write(Level level) {
    for (size_t i = 0; i < frames_.size(); ++i) {
      FrameHeader& header = frames_[i].header;
      if (level >= Level::kHeader) header.header_hash = XXH3_64bits(&header, offsetof(FrameHeader, header_hash));
      std::memcpy(bytes_.data() + frames_[i].offset, &header, sizeof header);
      if (level >= Level::kFooter && footer_ != 0)
        std::memcpy(bytes_.data() + footer_ + kFooterStart + i * sizeof header, &header, sizeof header);
    }
    if (level >= Level::kFooter && footer_ != 0) {
      const uint64_t hash = XXH3_64bits(bytes_.data() + footer_, bytes_.size() - kTrailer - footer_);
      std::memcpy(bytes_.data() + bytes_.size() - sizeof hash, &hash, sizeof hash);
    }
    WriteBytes(file_, bytes_);
  }

 private:
  fs::path file_;
  Bytes bytes_;
  std::vector<SegmentFrame> frames_;
  size_t footer_ = 0;
};

// What lies beyond the segment, up to `level`; true where nothing disagrees any more.
bool MakeAnew(const fs::path& store, const fs::path& segment, Level level) {
  const fs::path session = segment.parent_path();
  if (level < Level::kManifest) return false;
  const auto contents = ReadManifestContents(session);
  if (!contents.ok() || !ReplaceSegments(session, contents->segments).ok()) return false;
  return level == Level::kIndex && EnterAgain(store, session.filename());
}

constexpr Field kFields[] = {{"magic", 0, 4},
                             {"header_bytes", 4, 4},
                             {"frame", 8, 8},
                             {"step", 16, 4},
                             {"projector", 20, 4},
                             {"bracket", 24, 4},
                             {"pose", 28, 4},
                             {"retry", 32, 4},
                             {"phase", 36, 4},
                             {"trigger_number", 40, 8},
                             {"trigger_ns", 48, 8},
                             {"sync_ns", 56, 8},
                             {"driver_sequence", 64, 8},
                             {"frame_ns", 72, 8},
                             {"exposure_ms", 80, 8, true},
                             {"gain", 88, 8, true},
                             {"mean_dn", 96, 8, true},
                             {"frame_clock", 104, 2},
                             {"level_check", 106, 2},
                             {"format", 108, 2},
                             {"cfa", 110, 2},
                             {"codec", 112, 2},
                             {"cipher", 114, 2},
                             {"width", 116, 4},
                             {"height", 120, 4},
                             {"channels", 124, 4},
                             {"crop_x", 128, 4},
                             {"crop_y", 132, 4},
                             {"key_id", 136, 16},
                             {"nonce", 152, 24},
                             {"pattern", 176, 64},
                             {"payload_bytes", 240, 8},
                             {"payload_hash", 248, 16},
                             {"retake_cause", 264, 32},
                             {"pixel_hash", 296, 16}};

}  // namespace

Mutant ChangeHeader(const fs::path& folder, Random& random) {
  const auto segments = FilesOf(folder, ".seg");
  const fs::path file = OneOf(segments, random);
  SegmentFile segment(file);
  if (segment.frames().empty()) return ChangeBytes(folder, random);
  const size_t which = Below(random, segment.frames().size());
  FrameHeader& header = segment.frames()[which].header;
  const FrameHeader before = header;
  const Field& field = kFields[Below(random, std::size(kFields))];
  ChangeField(field, reinterpret_cast<uint8_t*>(&header) + field.offset, random);
  const auto level = static_cast<Level>(Below(random, 5));
  const bool changed = std::memcmp(&before, &header, sizeof header) != 0;
  segment.Write(level);
  const bool consistent = changed && MakeAnew(folder, file, level);
  return {std::string(field.name) + " of record " + std::to_string(which) + " in " + Short(folder, file) +
              ", hashes made anew to level " + std::to_string(static_cast<int>(level)),
          Short(folder, file), changed && segment.LeavesHash(level), consistent};
}

namespace {

std::optional<PixelHash> PixelsOf(const FrameHeader& header, std::span<const uint8_t> payload) {
  FrameDecoder decoder;
  if (header.cipher != 0 || header.width < 1 || header.width > 64 || header.height < 1 || header.height > 64) return {};
  const auto image = decoder.Decode(ShapeOf(header), static_cast<Codec>(header.codec), payload);
  if (!image.ok()) return {};
  return HashPixels(static_cast<PixelFormat>(header.format), std::as_const(*image).pixels(), nullptr);
}

}  // namespace

// Other pixels, or none that can be decoded; some bits of a compressed payload mean nothing.
Mutant ChangePayload(const fs::path& folder, Random& random) {
  const fs::path file = OneOf(FilesOf(folder, ".seg"), random);
  SegmentFile segment(file);
  if (segment.frames().empty()) return ChangeBytes(folder, random);
  const size_t which = Below(random, segment.frames().size());
  SegmentFrame& frame = segment.frames()[which];
  const auto payload = segment.PayloadOf(frame);
  if (payload.empty()) return ChangeBytes(folder, random);
  const Bytes before(payload.begin(), payload.end());
  switch (Below(random, 3)) {
    case 0:
      payload[Below(random, payload.size())] ^= static_cast<uint8_t>(1 + Below(random, 255));
      break;
    case 1:
      std::generate(payload.begin(), payload.end(), [&] { return static_cast<uint8_t>(random()); });
      break;
    default:
      std::fill(payload.begin(), payload.end(), uint8_t{0});
  }
  const bool changed = !std::equal(before.begin(), before.end(), payload.begin());
  const auto level = static_cast<Level>(Below(random, 5));
  const bool pixels = Below(random, 2) == 0;
  FrameHeader& header = frame.header;
  const PixelHash hash = PixelHashOf(header);
  const auto decoded = PixelsOf(header, payload);
  if (level >= Level::kHeader) {
    XXH128_canonical_t canonical;
    XXH128_canonicalFromHash(&canonical, XXH3_128bits(payload.data(), payload.size()));
    std::memcpy(header.payload_hash, canonical.digest, sizeof header.payload_hash);
    if (pixels && decoded) SetPixelHash(header, *decoded);
  }
  const bool told = PixelHashOf(header) != hash;
  const bool fits = decoded == PixelHashOf(header);
  segment.Write(level);
  const bool anew = changed && MakeAnew(folder, file, level);
  return {"payload of record " + std::to_string(which) + " in " + Short(folder, file) + ", hashes made anew to level " +
              std::to_string(static_cast<int>(level)) + (told ? ", and that of the pixels" : ""),
          Short(folder, file), changed && (segment.LeavesHash(level) || !fits), anew && fits};
}

}  // namespace stratalux::db
