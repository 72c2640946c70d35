// SPDX-License-Identifier: Apache-2.0
#include "db/segment/segment.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <unistd.h>
#include <xxhash.h>

#include "db/base/durable_file.h"
#include "db/segment/frame_cipher.h"
#include "db/segment/header_check.h"
#include "db/segment/segment_layout.h"

namespace stratalux::db {
namespace {}  // namespace

std::string HashText(const uint8_t (&hash)[16]) {
  constexpr const char* kHex = "0123456789abcdef";
  std::string text;
  for (uint8_t b : hash) {
    text += kHex[b >> 4];
    text += kHex[b & 15U];
  }
  return text;
}

FrameHeader MakeFrameHeader(const FrameRecord& r, int64_t frame, const std::string& text) {
  FrameHeader h{};
  h.magic = kFrameMagic;
  h.header_bytes = sizeof h;
  h.frame = frame;
  h.step = r.step;
  h.projector = r.projector;
  h.bracket = r.bracket;
  h.pose = r.pose;
  h.retry = r.retry;
  h.phase = static_cast<uint32_t>(r.phase);
  h.trigger_number = r.trigger_number;
  h.trigger_ns = r.trigger_time.ns;
  h.sync_ns = r.sync_time.ns;
  h.driver_sequence = r.driver_sequence;
  h.frame_ns = r.frame_time.ns;
  h.exposure_ms = r.exposure_ms;
  h.gain = r.gain;
  h.mean_dn = r.mean_dn;
  h.frame_clock = static_cast<uint16_t>(r.frame_clock);
  h.level_check = static_cast<uint16_t>(r.level_check);
  h.format = static_cast<uint16_t>(r.format);
  h.cfa = static_cast<uint16_t>(r.cfa);
  h.width = r.width;
  h.height = r.height;
  h.channels = r.channels;
  h.crop_x = r.crop_x;
  h.crop_y = r.crop_y;
  std::memcpy(h.retake_cause, r.retake_cause.data(), std::min(r.retake_cause.size(), sizeof h.retake_cause - 1));
  std::memcpy(h.pattern, text.data(), std::min(text.size(), sizeof h.pattern - 1));
  return h;
}

Result<FrameRecord> RecordOf(const FrameHeader& h) {
  SLX_RETURN_IF_ERROR(CheckHeader(h));
  FrameRecord r;
  SLX_ASSIGN_OR_RETURN(r.pattern, Pattern::Parse(std::string(h.pattern, strnlen(h.pattern, sizeof h.pattern)))
                                      .WithContext("frame " + std::to_string(h.frame)));
  r.step = h.step;
  r.projector = h.projector;
  r.phase = static_cast<CapturePhase>(h.phase);
  r.bracket = h.bracket;
  r.pose = h.pose;
  r.retry = h.retry;
  r.retake_cause.assign(h.retake_cause, strnlen(h.retake_cause, sizeof h.retake_cause));
  r.trigger_number = h.trigger_number;
  r.trigger_time = {h.trigger_ns};
  r.sync_time = {h.sync_ns};
  r.driver_sequence = h.driver_sequence;
  r.frame_time = {h.frame_ns};
  r.frame_clock = static_cast<ClockSource>(h.frame_clock);
  r.exposure_ms = h.exposure_ms;
  r.gain = h.gain;
  r.mean_dn = h.mean_dn;
  r.level_check = static_cast<LevelCheck>(h.level_check);
  r.format = static_cast<PixelFormat>(h.format);
  r.cfa = static_cast<Cfa>(h.cfa);
  r.width = h.width;
  r.height = h.height;
  r.channels = h.channels;
  r.crop_x = h.crop_x;
  r.crop_y = h.crop_y;
  return r;
}

FrameShape ShapeOf(const FrameHeader& h) {
  return {static_cast<PixelFormat>(h.format), static_cast<Cfa>(h.cfa), h.width, h.height, h.channels};
}

SegmentWriter::SegmentWriter(SegmentWriter&& o) noexcept
    : fd_(std::exchange(o.fd_, -1)),
      bytes_(o.bytes_),
      sync_failed_(o.sync_failed_),
      file_(std::move(o.file_)),
      sealer_(o.sealer_),
      headers_(std::move(o.headers_)) {}
SegmentWriter& SegmentWriter::operator=(SegmentWriter&& o) noexcept {
  if (fd_ >= 0) close(fd_);
  fd_ = std::exchange(o.fd_, -1);
  bytes_ = o.bytes_;
  sync_failed_ = o.sync_failed_;
  file_ = std::move(o.file_);
  sealer_ = o.sealer_;
  headers_ = std::move(o.headers_);
  return *this;
}
SegmentWriter::~SegmentWriter() {
  if (fd_ >= 0) close(fd_);
}

Result<SegmentWriter> SegmentWriter::Create(const std::filesystem::path& file, const std::string& session_id,
                                            FrameSealer* sealer) {
  SegmentWriter writer;
  writer.sealer_ = sealer;
  writer.file_ = file.string();
  writer.fd_ = open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0640);
  if (writer.fd_ < 0) return Status::Failed("cannot create " + writer.file_ + ": " + std::strerror(errno));
  FileHeader header{};
  std::memcpy(header.magic, kFileMagic, sizeof kFileMagic);
  header.version = 1;
  header.header_bytes = sizeof header;
  std::memcpy(header.session, session_id.data(), std::min(session_id.size(), sizeof header.session - 1));
  header.hash = HashOf(header);
  Status made = writer.Write(&header, sizeof header);
  if (made.ok()) made = SyncFolder(file.parent_path());
  if (made.ok()) return writer;
  unlink(file.c_str());
  return made;
}

Status SegmentWriter::Write(const void* data, size_t size) {
  SLX_RETURN_IF_ERROR(WriteAll(fd_, data, size, file_));
  bytes_ += static_cast<int64_t>(size);
  return Status::Ok();
}

Result<SegmentFrame> SegmentWriter::Append(FrameHeader header, Codec codec, std::span<const uint8_t> payload) {
  header.codec = static_cast<uint16_t>(codec);
  std::vector<uint8_t> sealed;
  if (sealer_ != nullptr) {
    SLX_ASSIGN_OR_RETURN(sealed, sealer_->Seal(header, payload));
    payload = sealed;
  }
  header.payload_bytes = payload.size();
  PayloadHash(payload, header.payload_hash);
  header.header_hash = HashOf(header);
  const int64_t offset = bytes_;
  SLX_RETURN_IF_ERROR(Write(&header, sizeof header));
  SLX_RETURN_IF_ERROR(Write(payload.data(), payload.size()));
  headers_.push_back(header);
  return SegmentFrame{header, offset};
}

Status SegmentWriter::Sync() {
  // The kernel reports lost pages once: a second sync would say ok about a file that has holes.
  if (!sync_failed_ && fdatasync(fd_) == 0) return Status::Ok();
  const std::string reason = sync_failed_ ? "an earlier sync failed" : std::strerror(errno);
  sync_failed_ = true;
  return Status::Failed("cannot sync " + file_ + ": " + reason);
}

Status SegmentWriter::Seal() {
  std::vector<uint8_t> footer(sizeof(FooterStart) + headers_.size() * sizeof(FrameHeader));
  const FooterStart start{kFooterMagic, 0, headers_.size()};
  std::memcpy(footer.data(), &start, sizeof start);
  if (!headers_.empty())
    std::memcpy(footer.data() + sizeof start, headers_.data(), headers_.size() * sizeof(FrameHeader));
  Trailer trailer{{}, static_cast<uint64_t>(bytes_), XXH3_64bits(footer.data(), footer.size())};
  std::memcpy(trailer.magic, kEndMagic, sizeof kEndMagic);
  SLX_RETURN_IF_ERROR(Write(footer.data(), footer.size()));
  SLX_RETURN_IF_ERROR(Write(&trailer, sizeof trailer));
  return Sync();
}

}  // namespace stratalux::db
