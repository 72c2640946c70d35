// SPDX-License-Identifier: Apache-2.0
// Frame segments: append-only files that describe themselves (docs/file-formats.md). Little-endian.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "db/segment/codec.h"
#include "shared/base/result.h"
#include "shared/capture/frame_record.h"

namespace stratalux::db {

inline constexpr int64_t kSegmentStart = 64;  // the first frame follows the file header

// Frozen layout: 320 bytes in front of each payload.
struct FrameHeader {
  uint32_t magic;         // 'FRM1'
  uint32_t header_bytes;  // 320
  int64_t frame;          // 0-based in the session
  int32_t step, projector, bracket, pose, retry;
  uint32_t phase;
  int64_t trigger_number, trigger_ns, sync_ns, driver_sequence, frame_ns;
  double exposure_ms, gain, mean_dn;
  uint16_t frame_clock, level_check, format, cfa, codec, cipher;  // cipher 0: none
  int32_t width, height, channels, crop_x, crop_y;
  uint8_t key_id[16], nonce[24];  // of an encrypted payload (db/segment/frame_cipher.h), else 0
  char pattern[64];               // Pattern::ToString, or the name of a truth map; zero-padded
  uint64_t payload_bytes;
  uint8_t payload_hash[16];  // XXH3-128, canonical
  char retake_cause[32];     // zero-padded; all zero before version 0.2
  uint8_t pixel_hash[16];    // of the decoded samples (db/segment/pixel_hash.h); all zero: not recorded
  uint64_t header_hash;      // XXH3-64 of all before it
};
static_assert(sizeof(FrameHeader) == 320);

struct SegmentFrame {
  FrameHeader header;
  int64_t offset = 0;  // of the header in the file
};

[[nodiscard]] FrameHeader MakeFrameHeader(const FrameRecord& record, int64_t frame, const std::string& text);
// Refuses what CheckHeader (db/segment/header_check.h) refuses.
[[nodiscard]] Result<FrameRecord> RecordOf(const FrameHeader& header);
[[nodiscard]] FrameShape ShapeOf(const FrameHeader& header);
[[nodiscard]] std::string HashText(const uint8_t (&hash)[16]);

class FrameSealer;  // db/segment/frame_cipher.h

class SegmentWriter {
 public:
  // Fails when the file exists. Its name is on the disk when this returns, its header with the first Sync(). `sealer`
  // encrypts each payload and must outlive the writer; null: stored as they are.
  static Result<SegmentWriter> Create(const std::filesystem::path& file, const std::string& session_id,
                                      FrameSealer* sealer = nullptr);
  ~SegmentWriter();
  SegmentWriter(SegmentWriter&&) noexcept;
  SegmentWriter& operator=(SegmentWriter&&) noexcept;

  // Fills codec, payload size, payload and header hash, and what the sealer fills; returns the header's offset. Data
  // reach the disk with Sync().
  Result<SegmentFrame> Append(FrameHeader header, Codec codec, std::span<const uint8_t> payload);
  Status Sync();  // an error is final: the bytes since the last good one are lost
  // Footer with all headers, trailer, sync.
  Status Seal();
  [[nodiscard]] int64_t bytes() const { return bytes_; }
  // What memory shows of the file may then never have reached the disk.
  [[nodiscard]] bool sync_failed() const { return sync_failed_; }

 private:
  SegmentWriter() = default;
  Status Write(const void* data, size_t size);
  int fd_ = -1;
  int64_t bytes_ = 0;
  bool sync_failed_ = false;
  std::string file_;
  FrameSealer* sealer_ = nullptr;
  std::vector<FrameHeader> headers_;
};

class SegmentReader {
 public:
  static Result<SegmentReader> Open(const std::filesystem::path& file);
  // For looking at what is left of a file: a damaged file header is told in `header`, and session_id() is then empty.
  static Result<SegmentReader> OpenDamaged(const std::filesystem::path& file, Status* header);
  // For frames that an index lists and holds against its hashes: a damaged file header is read as one of `session_id`.
  static Result<SegmentReader> OpenListed(const std::filesystem::path& file, const std::string& session_id);
  ~SegmentReader();
  SegmentReader(SegmentReader&&) noexcept;
  SegmentReader& operator=(SegmentReader&&) = delete;

  // The header at `offset`, checked against its hash; its payload lies within the file.
  Result<FrameHeader> ReadHeader(int64_t offset) const;
  // Header and payload at `offset`, both checked against their hashes.
  Result<std::vector<uint8_t>> Read(int64_t offset, FrameHeader* header) const;
  // ReadHeader; where that one is damaged, its copy in an intact footer.
  Result<FrameHeader> ListedHeader(int64_t offset) const;
  // The payload behind `header` at `offset`, checked; `buffer` grows as needed, so that a loop allocates once.
  Status ReadPayload(int64_t offset, const FrameHeader& header, std::vector<uint8_t>& buffer) const;
  // Frames of an intact footer at the end of the file; nullopt where there is none.
  [[nodiscard]] std::optional<int64_t> SealedFrames() const;
  // All frames out of that footer, in one read; nullopt also where its headers are no unbroken row up to it.
  [[nodiscard]] std::optional<std::vector<SegmentFrame>> Footer() const;
  // Behind trailer, where an intact footer begins at `offset`, wherever its frames lie and whatever follows.
  [[nodiscard]] std::optional<int64_t> FooterEnd(int64_t offset) const;
  // The first whole header at or behind `offset`. Such bytes may also be a copy or a picture of one.
  [[nodiscard]] std::optional<SegmentFrame> FindHeader(int64_t offset) const;
  // Footer and trailer as they lie there, where they are intact: what the manifest's hash of a segment is of.
  [[nodiscard]] std::optional<std::vector<uint8_t>> SealedTail() const;
  // Where the records end and the footer begins; only where SealedFrames() is.
  [[nodiscard]] int64_t frames_end() const;
  // Behind the last record of an unbroken row of intact ones, from the first on.
  [[nodiscard]] int64_t IntactEnd() const;
  // All frames by walking the file; kIntegrity where a header or (with `payloads`) a payload is damaged, the file
  // truncated, or the footer of a sealed segment disagrees.
  Result<std::vector<SegmentFrame>> Walk(bool payloads, bool* sealed) const;
  [[nodiscard]] const std::string& session_id() const { return session_id_; }
  [[nodiscard]] const std::string& file() const { return file_; }
  [[nodiscard]] int64_t size() const { return size_; }

 private:
  SegmentReader() = default;
  Status ReadAt(int64_t offset, void* data, size_t size) const;
  [[nodiscard]] std::optional<std::vector<uint8_t>> FooterBytes() const;  // an intact one
  Status CheckFooter(int64_t offset, const std::vector<SegmentFrame>& frames) const;
  int fd_ = -1;
  int64_t size_ = 0;
  std::string file_, session_id_;
};

}  // namespace stratalux::db
