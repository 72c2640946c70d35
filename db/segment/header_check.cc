// SPDX-License-Identifier: Apache-2.0
#include "db/segment/header_check.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "db/segment/frame_cipher.h"
#include "db/segment/frame_codec.h"

namespace stratalux::db {
namespace {

constexpr int64_t kHighestFrame = 1'000'000'000'000;

struct Choice {
  const char* name;
  uint32_t value, lowest, highest;
};

Status CheckChoices(const FrameHeader& h) {
  const Choice choices[] = {
      {"phase", h.phase, 0, static_cast<uint32_t>(CapturePhase::kRepeat)},
      {"clock", h.frame_clock, 0, static_cast<uint32_t>(ClockSource::kSimulated)},
      {"level check", h.level_check, 0, static_cast<uint32_t>(LevelCheck::kFailed)},
      {"format", h.format, static_cast<uint32_t>(PixelFormat::kMono8), static_cast<uint32_t>(PixelFormat::kF32)},
      {"colour filter array", h.cfa, 0, static_cast<uint32_t>(Cfa::kGbrg)},
      {"codec", h.codec, static_cast<uint32_t>(Codec::kRaw8), static_cast<uint32_t>(Codec::kDelta)},
      {"cipher", h.cipher, 0, kCipherXChaCha20Poly1305}};
  for (const Choice& c : choices) {
    if (c.value < c.lowest)
      return Status::Integrity(std::string(c.name) + " " + std::to_string(c.value) + " does not exist");
    if (c.value > c.highest)
      return Status(StatusCode::kNewerSchema, std::string(c.name) + " " + std::to_string(c.value) +
                                                  " is newer than this program; use a newer stratalux");
  }
  return Status::Ok();
}

Status CheckNumbers(const FrameHeader& h) {
  struct Lowest {
    const char* name;
    int64_t value, lowest;
  };
  const Lowest integers[] = {{"frame", h.frame, 0},
                             {"step", h.step, 0},
                             {"projector", h.projector, -1},
                             {"bracket", h.bracket, 0},
                             {"pose", h.pose, -1},
                             {"retry", h.retry, 0},
                             {"trigger number", h.trigger_number, -1},
                             {"driver's sequence number", h.driver_sequence, -1},
                             {"crop's column", h.crop_x, 0},
                             {"crop's row", h.crop_y, 0}};
  for (const Lowest& i : integers)
    if (i.value < i.lowest)
      return Status::Integrity(std::string(i.name) + " " + std::to_string(i.value) + " is out of range");
  if (h.frame > kHighestFrame) return Status::Integrity("its number is out of range");  // sums with it stay sums
  const std::pair<const char*, double> reals[] = {{"exposure", h.exposure_ms}, {"gain", h.gain}, {"mean", h.mean_dn}};
  for (const auto& [name, value] : reals)
    if (!std::isfinite(value)) return Status::Integrity(std::string(name) + " is not a finite number");
  if (h.exposure_ms < 0.0) return Status::Integrity("exposure " + std::to_string(h.exposure_ms) + " ms is negative");
  return Status::Ok();
}

// Zero-terminated, and nothing hidden behind the end.
template <size_t N>
bool IsText(const char (&text)[N]) {
  const size_t length = strnlen(text, N);
  return length < N && std::all_of(text + length, text + N, [](char c) { return c == 0; });
}

template <size_t N>
bool IsZero(const uint8_t (&bytes)[N]) {
  return std::all_of(bytes, bytes + N, [](uint8_t b) { return b == 0; });
}

Status CheckTexts(const FrameHeader& h, RecordKind kind) {
  if (!IsText(h.pattern)) return Status::Integrity("pattern is not a terminated text");
  if (!IsText(h.retake_cause)) return Status::Integrity("cause of the retake is not a terminated text");
  if (h.cipher == 0 && !(IsZero(h.key_id) && IsZero(h.nonce)))
    return Status::Integrity("a key is named, but no cipher");
  if (kind == RecordKind::kTruthMap) return Status::Ok();
  const auto pattern = Pattern::Parse(h.pattern);
  return pattern.ok() ? Status::Ok() : Status::Integrity(pattern.status().message());
}

// What the payload is before it is encrypted: delta is only taken where it is shorter than the raw codec.
Status CheckPayload(const FrameHeader& h, RecordKind kind) {
  const FrameShape shape = ShapeOf(h);
  SLX_RETURN_IF_ERROR(CheckShape(shape));
  const auto codec = static_cast<Codec>(h.codec);
  const bool is_map = kind == RecordKind::kTruthMap;
  if ((shape.format == PixelFormat::kF32) != is_map || (codec == Codec::kF32) != is_map ||
      (codec != Codec::kDelta && codec != RawCodec(shape)))
    return Status::Integrity("codec " + std::string(ToString(codec)) + " is not for format " +
                             std::to_string(h.format));
  const uint64_t tag = h.cipher == 0 ? 0 : kCipherTagBytes, raw = RawBytes(shape, RawCodec(shape));
  const uint64_t plain = h.payload_bytes - tag;
  const bool fits = h.payload_bytes >= tag && (codec == Codec::kDelta ? plain > 0 && plain < raw : plain == raw);
  if (fits) return Status::Ok();
  return Status::Integrity("a payload of " + std::to_string(h.payload_bytes) + " bytes is not one of " +
                           std::to_string(h.width) + " x " + std::to_string(h.height) + " x " +
                           std::to_string(h.channels) + " samples in codec " + ToString(codec));
}

}  // namespace

Status CheckHeader(const FrameHeader& h, RecordKind kind) {
  const std::string where = "frame " + std::to_string(h.frame);
  if (h.header_bytes > sizeof h)
    return Status(StatusCode::kNewerSchema, where + ": its header is newer than this program; use a newer stratalux");
  SLX_RETURN_IF_ERROR(CheckChoices(h).WithContext(where));
  SLX_RETURN_IF_ERROR(CheckNumbers(h).WithContext(where));
  SLX_RETURN_IF_ERROR(CheckTexts(h, kind).WithContext(where));
  return CheckPayload(h, kind).WithContext(where);
}

}  // namespace stratalux::db
