// SPDX-License-Identifier: Apache-2.0
#include "db/care/verify_payloads.h"

#include "db/segment/frame_cipher.h"
#include "db/segment/frame_codec.h"
#include "db/segment/pixel_hash.h"
#include "shared/base/parallel.h"

namespace stratalux::db {
namespace {

// One thread's decoder and keys.
class PayloadChecker {
 public:
  PayloadChecker(const std::filesystem::path& store, const SegmentReader& reader) : reader_(reader), opener_(store) {}

  // kNotFound: its key is not here.
  Status Check(const SegmentFrame& frame) {
    const FrameHeader& header = frame.header;
    SLX_RETURN_IF_ERROR(reader_.ReadPayload(frame.offset, header, buffer_));
    std::span<const uint8_t> payload(buffer_.data(), header.payload_bytes);
    std::vector<uint8_t> opened;
    const std::string where = reader_.file() + ", offset " + std::to_string(frame.offset);
    if (header.cipher != 0) {
      SLX_ASSIGN_OR_RETURN(
          opened, opener_.Open(reader_.session_id(), header, {payload.begin(), payload.end()}).WithContext(where));
      payload = opened;
    }
    SLX_ASSIGN_OR_RETURN(const SecretKey* key, opener_.KeyOf(reader_.session_id(), header));
    return Decode(header, payload, key).WithContext(where + ", frame " + std::to_string(header.frame));
  }

 private:
  Status Decode(const FrameHeader& header, std::span<const uint8_t> payload, const SecretKey* key) {
    if (static_cast<Codec>(header.codec) != Codec::kF32) {
      SLX_ASSIGN_OR_RETURN(const auto image,
                           decoder_.Decode(ShapeOf(header), static_cast<Codec>(header.codec), payload));
      return CheckPixels(header, image, key);
    }
    // A truth map: floats as they are.
    const bool sized = header.width > 0 && header.height > 0 && header.channels > 0;
    const auto samples = static_cast<uint64_t>(header.width) * static_cast<uint64_t>(header.height);
    if (!sized || header.format != static_cast<uint16_t>(PixelFormat::kF32) ||
        payload.size() / sizeof(float) / static_cast<uint64_t>(header.channels) != samples ||
        payload.size() % (sizeof(float) * static_cast<uint64_t>(header.channels)) != 0)
      return Status::Integrity("the payload does not have the size that its header states");
    if (HasPixelHash(header) && HashPixels(payload, key) != PixelHashOf(header))
      return Status::Integrity("the map does not match its pixel hash");
    return Status::Ok();
  }

  const SegmentReader& reader_;
  FrameOpener opener_;
  FrameDecoder decoder_;
  std::vector<uint8_t> buffer_;
};

}  // namespace

void CheckPayloads(const std::filesystem::path& store, const SegmentReader& reader,
                   const std::vector<SegmentFrame>& frames, VerifyReport& report) {
  std::vector<Status> results(frames.size());
  ParallelFor(static_cast<int64_t>(frames.size()), 8, [&](int64_t begin, int64_t end) {
    PayloadChecker checker(store, reader);
    for (auto i = static_cast<size_t>(begin); i < static_cast<size_t>(end); ++i) results[i] = checker.Check(frames[i]);
  });
  int64_t without_key = 0;
  for (const Status& result : results) {
    if (result.ok()) continue;
    if (result.code() == StatusCode::kNotFound)
      ++without_key;
    else
      report.problems.push_back(result.message());
  }
  if (without_key > 0)
    report.notes.push_back(reader.file() + ": " + std::to_string(without_key) +
                           " encrypted frames were hashed, but not decoded: their key is not here");
}

}  // namespace stratalux::db
