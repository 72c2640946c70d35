// SPDX-License-Identifier: Apache-2.0
#include "db/segment/segment.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstddef>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "db/base/durable_file.h"
#include "db/segment/frame_cipher.h"

namespace stratalux::db {
namespace {

static_assert(std::endian::native == std::endian::little, "segments are written as they lie in memory");

constexpr uint32_t kFrameMagic = 0x314d5246;   // "FRM1"
constexpr uint32_t kFooterMagic = 0x31544f46;  // "FOT1"
constexpr char kFileMagic[8] = {'S', 'L', 'X', 'S', 'E', 'G', '0', '1'};
constexpr char kEndMagic[8] = {'S', 'L', 'X', 'E', 'N', 'D', '0', '1'};

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

uint64_t HashOf(const FileHeader& h) { return XXH3_64bits(&h, offsetof(FileHeader, hash)); }
uint64_t HashOf(const FrameHeader& h) { return XXH3_64bits(&h, offsetof(FrameHeader, header_hash)); }
void PayloadHash(std::span<const uint8_t> payload, uint8_t (&out)[16]) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(payload.data(), payload.size()));
  std::memcpy(out, canonical.digest, 16);
}
std::string ErrnoText() { return std::strerror(errno); }

}  // namespace

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
  if (h.phase > static_cast<uint32_t>(CapturePhase::kRadiometry) || h.cfa > 4 || h.format < 1 || h.format > 4 ||
      h.level_check > 2)
    return Status::Integrity("frame " + std::to_string(h.frame) + ": header has values of no known version");
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
  if (writer.fd_ < 0) return Status::Failed("cannot create " + writer.file_ + ": " + ErrnoText());
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
  const std::string reason = sync_failed_ ? "an earlier sync failed" : ErrnoText();
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

SegmentReader::SegmentReader(SegmentReader&& o) noexcept
    : fd_(std::exchange(o.fd_, -1)), size_(o.size_), file_(std::move(o.file_)), session_id_(std::move(o.session_id_)) {}
SegmentReader::~SegmentReader() {
  if (fd_ >= 0) close(fd_);
}

Result<SegmentReader> SegmentReader::Open(const std::filesystem::path& file) {
  SegmentReader reader;
  reader.file_ = file.string();
  reader.fd_ = open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (reader.fd_ < 0) {
    const bool missing = errno == ENOENT;
    const std::string message = "cannot open segment " + reader.file_ + ": " + ErrnoText();
    return missing ? Status::Integrity(message) : Status::Failed(message);
  }
  struct stat info {};
  if (fstat(reader.fd_, &info) != 0) return Status::Failed("cannot read " + reader.file_ + ": " + ErrnoText());
  reader.size_ = info.st_size;
  FileHeader header{};
  SLX_RETURN_IF_ERROR(reader.ReadAt(0, &header, sizeof header));
  if (std::memcmp(header.magic, kFileMagic, 6) != 0) return Status::Integrity(reader.file_ + ": not a frame segment");
  if (header.version > 1)
    return Status(StatusCode::kNewerSchema, reader.file_ + ": segment version " + std::to_string(header.version) +
                                                " is newer than this program (1)");
  if (header.hash != HashOf(header)) return Status::Integrity(reader.file_ + ": file header is damaged (offset 0)");
  reader.session_id_ = std::string(header.session, strnlen(header.session, sizeof header.session));
  return reader;
}

Status SegmentReader::ReadAt(int64_t offset, void* data, size_t size) const {
  char* at = static_cast<char*>(data);
  const int64_t start = offset;
  while (size > 0) {
    const ssize_t done = pread(fd_, at, size, offset);
    if (done < 0 && errno == EINTR) continue;
    if (done < 0) return Status::Failed("cannot read " + file_ + ": " + ErrnoText());
    if (done == 0)
      return Status::Integrity(file_ + ": truncated: " + std::to_string(size_) +
                               " bytes, but a record starts at offset " + std::to_string(start));
    at += done;
    offset += done;
    size -= static_cast<size_t>(done);
  }
  return Status::Ok();
}

Result<FrameHeader> SegmentReader::ReadHeader(int64_t offset) const {
  FrameHeader header{};
  SLX_RETURN_IF_ERROR(ReadAt(offset, &header, sizeof header));
  if (header.magic != kFrameMagic || header.header_hash != HashOf(header))
    return Status::Integrity(file_ + ", offset " + std::to_string(offset) + ": frame header is damaged");
  return header;
}

Result<std::vector<uint8_t>> SegmentReader::Read(int64_t offset, FrameHeader* header) const {
  SLX_ASSIGN_OR_RETURN(*header, ReadHeader(offset));
  std::vector<uint8_t> payload;
  SLX_RETURN_IF_ERROR(ReadPayload(offset, *header, payload));
  payload.resize(header->payload_bytes);
  return payload;
}

Status SegmentReader::ReadPayload(int64_t offset, const FrameHeader& header, std::vector<uint8_t>& buffer) const {
  const std::string where = file_ + ", offset " + std::to_string(offset);
  if (header.payload_bytes > static_cast<uint64_t>(size_))
    return Status::Integrity(where + ": payload of " + std::to_string(header.payload_bytes) +
                             " bytes exceeds the file");
  if (buffer.size() < header.payload_bytes) buffer.resize(header.payload_bytes);
  SLX_RETURN_IF_ERROR(ReadAt(offset + static_cast<int64_t>(sizeof header), buffer.data(), header.payload_bytes));
  uint8_t hash[16];
  PayloadHash(std::span(buffer).first(header.payload_bytes), hash);
  if (std::memcmp(hash, header.payload_hash, sizeof hash) != 0)
    return Status::Integrity(where + ": payload of frame " + std::to_string(header.frame) + " does not match its hash");
  return Status::Ok();
}

Status SegmentReader::CheckFooter(int64_t offset, const std::vector<SegmentFrame>& frames) const {
  const size_t bytes = sizeof(FooterStart) + frames.size() * sizeof(FrameHeader);
  const std::string where = file_ + ", offset " + std::to_string(offset) + ": footer";
  if (offset + static_cast<int64_t>(bytes + sizeof(Trailer)) != size_)
    return Status::Integrity(where + " has the wrong length");
  std::vector<uint8_t> footer(bytes);
  Trailer trailer{};
  SLX_RETURN_IF_ERROR(ReadAt(offset, footer.data(), bytes));
  SLX_RETURN_IF_ERROR(ReadAt(offset + static_cast<int64_t>(bytes), &trailer, sizeof trailer));
  if (std::memcmp(trailer.magic, kEndMagic, sizeof kEndMagic) != 0 ||
      trailer.footer_offset != static_cast<uint64_t>(offset) ||
      trailer.footer_hash != XXH3_64bits(footer.data(), footer.size()))
    return Status::Integrity(where + " is damaged");
  for (size_t i = 0; i < frames.size(); ++i)
    if (std::memcmp(footer.data() + sizeof(FooterStart) + i * sizeof(FrameHeader), &frames[i].header,
                    sizeof(FrameHeader)) != 0)
      return Status::Integrity(where + " disagrees with frame " + std::to_string(i));
  return Status::Ok();
}

std::optional<std::vector<uint8_t>> SegmentReader::FooterBytes() const {
  Trailer trailer{};
  const int64_t end = size_ - static_cast<int64_t>(sizeof trailer);
  if (end < kSegmentStart || !ReadAt(end, &trailer, sizeof trailer).ok() ||
      std::memcmp(trailer.magic, kEndMagic, sizeof kEndMagic) != 0 ||
      trailer.footer_offset < static_cast<uint64_t>(kSegmentStart) ||
      trailer.footer_offset + sizeof(FooterStart) > static_cast<uint64_t>(end))
    return std::nullopt;
  std::vector<uint8_t> footer(static_cast<size_t>(end) - trailer.footer_offset);
  if (!ReadAt(static_cast<int64_t>(trailer.footer_offset), footer.data(), footer.size()).ok() ||
      XXH3_64bits(footer.data(), footer.size()) != trailer.footer_hash)
    return std::nullopt;
  return footer;
}

std::optional<std::vector<uint8_t>> SegmentReader::SealedTail() const {
  auto tail = FooterBytes();
  if (!tail) return std::nullopt;
  const size_t footer = tail->size();
  tail->resize(footer + sizeof(Trailer));
  if (!ReadAt(size_ - static_cast<int64_t>(sizeof(Trailer)), tail->data() + footer, sizeof(Trailer)).ok())
    return std::nullopt;
  return tail;
}

std::optional<int64_t> SegmentReader::SealedFrames() const {
  const auto footer = FooterBytes();
  if (!footer) return std::nullopt;
  return static_cast<int64_t>((footer->size() - sizeof(FooterStart)) / sizeof(FrameHeader));
}

std::optional<std::vector<SegmentFrame>> SegmentReader::Footer() const {
  const auto footer = FooterBytes();
  if (!footer) return std::nullopt;
  std::vector<SegmentFrame> frames((footer->size() - sizeof(FooterStart)) / sizeof(FrameHeader));
  int64_t offset = kSegmentStart;
  for (size_t i = 0; i < frames.size(); ++i) {
    std::memcpy(&frames[i].header, footer->data() + sizeof(FooterStart) + i * sizeof(FrameHeader), sizeof(FrameHeader));
    frames[i].offset = offset;
    if (frames[i].header.payload_bytes > static_cast<uint64_t>(size_)) return std::nullopt;
    offset += static_cast<int64_t>(sizeof(FrameHeader) + frames[i].header.payload_bytes);
  }
  if (offset + static_cast<int64_t>(footer->size() + sizeof(Trailer)) != size_) return std::nullopt;
  return frames;
}

int64_t SegmentReader::frames_end() const {
  Trailer trailer{};
  const bool read = ReadAt(size_ - static_cast<int64_t>(sizeof trailer), &trailer, sizeof trailer).ok();
  return read ? static_cast<int64_t>(trailer.footer_offset) : 0;
}

int64_t SegmentReader::IntactEnd() const {
  int64_t offset = sizeof(FileHeader);
  while (offset < size_) {
    FrameHeader header{};
    if (!Read(offset, &header).ok()) break;
    offset += static_cast<int64_t>(sizeof header + header.payload_bytes);
  }
  return offset;
}

Result<std::vector<SegmentFrame>> SegmentReader::Walk(bool payloads, bool* sealed) const {
  std::vector<SegmentFrame> frames;
  int64_t offset = sizeof(FileHeader);
  *sealed = false;
  while (offset < size_) {
    uint32_t magic = 0;
    SLX_RETURN_IF_ERROR(ReadAt(offset, &magic, sizeof magic));
    if (magic == kFooterMagic) {
      SLX_RETURN_IF_ERROR(CheckFooter(offset, frames));
      *sealed = true;
      return frames;
    }
    SegmentFrame frame;
    frame.offset = offset;
    if (payloads) {
      SLX_RETURN_IF_ERROR(Read(offset, &frame.header).status());
    } else {
      SLX_ASSIGN_OR_RETURN(frame.header, ReadHeader(offset));
    }
    offset += static_cast<int64_t>(sizeof frame.header + frame.header.payload_bytes);
    if (offset > size_)
      return Status::Integrity(file_ + ": truncated within frame " + std::to_string(frame.header.frame) + " (offset " +
                               std::to_string(frame.offset) + ")");
    frames.push_back(frame);
  }
  return frames;
}

}  // namespace stratalux::db
