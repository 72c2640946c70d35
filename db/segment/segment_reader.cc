// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "db/segment/segment.h"
#include "db/segment/segment_layout.h"

namespace stratalux::db {
namespace {

// Its start agrees with its length.
bool IsFooter(const std::vector<uint8_t>& bytes) {
  FooterStart start{};
  if (bytes.size() < sizeof start) return false;
  std::memcpy(&start, bytes.data(), sizeof start);
  const size_t headers = bytes.size() - sizeof start;
  return start.magic == kFooterMagic && headers % sizeof(FrameHeader) == 0 &&
         start.frames == headers / sizeof(FrameHeader);
}

}  // namespace

SegmentReader::SegmentReader(SegmentReader&& o) noexcept
    : fd_(std::exchange(o.fd_, -1)), size_(o.size_), file_(std::move(o.file_)), session_id_(std::move(o.session_id_)) {}
SegmentReader::~SegmentReader() {
  if (fd_ >= 0) close(fd_);
}

Result<SegmentReader> SegmentReader::Open(const std::filesystem::path& file) {
  Status header;
  auto reader = OpenDamaged(file, &header);
  if (!reader.ok()) return reader;
  SLX_RETURN_IF_ERROR(header);
  return reader;
}

Result<SegmentReader> SegmentReader::OpenListed(const std::filesystem::path& file, const std::string& session_id) {
  Status damage;
  auto reader = OpenDamaged(file, &damage);
  if (damage.code() == StatusCode::kNewerSchema) return damage;
  if (reader.ok() && !damage.ok()) reader->session_id_ = session_id;
  return reader;
}

Result<SegmentReader> SegmentReader::OpenDamaged(const std::filesystem::path& file, Status* damage) {
  SegmentReader reader;
  reader.file_ = file.string();
  reader.fd_ = open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);  // a pipe of that name must not be waited for
  if (reader.fd_ < 0) {
    const bool missing = errno == ENOENT;
    const std::string message = "cannot open segment " + reader.file_ + ": " + std::strerror(errno);
    return missing ? Status::Integrity(message) : Status::Failed(message);
  }
  struct stat info {};
  if (fstat(reader.fd_, &info) != 0) return Status::Failed("cannot read " + reader.file_ + ": " + std::strerror(errno));
  if (!S_ISREG(info.st_mode)) return Status::Integrity(reader.file_ + " is not a regular file");
  reader.size_ = info.st_size;
  FileHeader header{};
  *damage = reader.ReadAt(0, &header, sizeof header);
  if (damage->code() == StatusCode::kFailed) return *damage;
  if (!damage->ok()) return reader;
  const bool whole = header.hash == HashOf(header);
  if (std::memcmp(header.magic, kFileMagic, 6) != 0)
    *damage = Status::Integrity(reader.file_ + ": not a frame segment");
  else if (header.version > 1)
    *damage = Status(StatusCode::kNewerSchema, reader.file_ + ": segment version " + std::to_string(header.version) +
                                                   " is newer than this program (1)");
  else if (!whole)
    *damage = Status::Integrity(reader.file_ + ": file header is damaged (offset 0)");
  if (whole && damage->code() == StatusCode::kNewerSchema) return *damage;  // said by the hash, not by damage
  if (damage->ok()) reader.session_id_ = std::string(header.session, strnlen(header.session, sizeof header.session));
  return reader;
}

Status SegmentReader::ReadAt(int64_t offset, void* data, size_t size) const {
  char* at = static_cast<char*>(data);
  const int64_t start = offset;
  while (size > 0) {
    const ssize_t done = pread(fd_, at, size, offset);
    if (done < 0 && errno == EINTR) continue;
    if (done < 0) return Status::Failed("cannot read " + file_ + ": " + std::strerror(errno));
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
  const std::string where = file_ + ", offset " + std::to_string(offset);
  if (offset < kSegmentStart) return Status::Integrity(where + ": no frame can begin there");
  FrameHeader header{};
  SLX_RETURN_IF_ERROR(ReadAt(offset, &header, sizeof header));
  if (header.magic != kFrameMagic || header.header_hash != HashOf(header))
    return Status::Integrity(where + ": frame header is damaged");
  // Asked here, once: whatever a header says, sums with it stay within the file.
  if (header.payload_bytes > static_cast<uint64_t>(size_ - offset) - sizeof header)
    return Status::Integrity(where + ": truncated within frame " + std::to_string(header.frame) + ": its payload of " +
                             std::to_string(header.payload_bytes) + " bytes exceeds the file of " +
                             std::to_string(size_));
  return header;
}

Result<FrameHeader> SegmentReader::ListedHeader(int64_t offset) const {
  auto header = ReadHeader(offset);
  if (header.status().code() != StatusCode::kIntegrity) return header;
  const auto footer = Footer();
  if (!footer) return header;
  for (const SegmentFrame& frame : *footer)
    if (frame.offset == offset) return frame.header;
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
  if (offset < kSegmentStart || offset > size_ - static_cast<int64_t>(sizeof header) ||
      header.payload_bytes > static_cast<uint64_t>(size_ - offset) - sizeof header)
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
  if (end < kSegmentStart + static_cast<int64_t>(sizeof(FooterStart)) || !ReadAt(end, &trailer, sizeof trailer).ok() ||
      std::memcmp(trailer.magic, kEndMagic, sizeof kEndMagic) != 0 ||
      trailer.footer_offset < static_cast<uint64_t>(kSegmentStart) ||
      trailer.footer_offset > static_cast<uint64_t>(end) - sizeof(FooterStart))
    return std::nullopt;
  std::vector<uint8_t> footer(static_cast<size_t>(end) - trailer.footer_offset);
  if (!ReadAt(static_cast<int64_t>(trailer.footer_offset), footer.data(), footer.size()).ok() ||
      XXH3_64bits(footer.data(), footer.size()) != trailer.footer_hash || !IsFooter(footer))
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

std::optional<int64_t> SegmentReader::FooterEnd(int64_t offset) const {
  FooterStart start{};
  if (size_ - offset < static_cast<int64_t>(sizeof start + sizeof(Trailer)) ||
      !ReadAt(offset, &start, sizeof start).ok())
    return std::nullopt;
  const auto room = static_cast<uint64_t>(size_ - offset) - sizeof start - sizeof(Trailer);
  if (start.magic != kFooterMagic || start.frames > room / sizeof(FrameHeader)) return std::nullopt;
  std::vector<uint8_t> footer(sizeof start + start.frames * sizeof(FrameHeader));
  Trailer trailer{};
  const int64_t end = offset + static_cast<int64_t>(footer.size());
  if (!ReadAt(offset, footer.data(), footer.size()).ok() || !ReadAt(end, &trailer, sizeof trailer).ok() ||
      std::memcmp(trailer.magic, kEndMagic, sizeof kEndMagic) != 0 ||
      trailer.footer_hash != XXH3_64bits(footer.data(), footer.size()))
    return std::nullopt;
  return end + static_cast<int64_t>(sizeof trailer);
}

std::optional<SegmentFrame> SegmentReader::FindHeader(int64_t offset) const {
  constexpr int64_t kChunk = 1 << 20;
  const uint32_t start[2] = {kFrameMagic, sizeof(FrameHeader)};
  std::vector<char> bytes(kChunk);
  for (offset = std::max(offset, kSegmentStart); offset + static_cast<int64_t>(sizeof(FrameHeader)) <= size_;) {
    const auto size = static_cast<size_t>(std::min(kChunk, size_ - offset));
    if (!ReadAt(offset, bytes.data(), size).ok()) return std::nullopt;
    const char* at = bytes.data();
    const char* end = at + size;
    while ((at = static_cast<const char*>(memmem(at, static_cast<size_t>(end - at), start, sizeof start))) != nullptr) {
      const int64_t found = offset + (at - bytes.data());
      if (const auto header = ReadHeader(found); header.ok()) return SegmentFrame{*header, found};
      ++at;
    }
    offset += static_cast<int64_t>(size) - static_cast<int64_t>(sizeof start) + 1;
  }
  return std::nullopt;
}

std::optional<int64_t> SegmentReader::SealedFrames() const {
  const auto footer = FooterBytes();
  if (!footer) return std::nullopt;
  return static_cast<int64_t>((footer->size() - sizeof(FooterStart)) / sizeof(FrameHeader));
}

std::optional<std::vector<SegmentFrame>> SegmentReader::Footer() const {
  const auto footer = FooterBytes();
  if (!footer) return std::nullopt;
  const int64_t end = size_ - static_cast<int64_t>(footer->size() + sizeof(Trailer));
  std::vector<SegmentFrame> frames((footer->size() - sizeof(FooterStart)) / sizeof(FrameHeader));
  int64_t offset = kSegmentStart;
  for (size_t i = 0; i < frames.size(); ++i) {
    FrameHeader& header = frames[i].header;
    std::memcpy(&header, footer->data() + sizeof(FooterStart) + i * sizeof header, sizeof header);
    frames[i].offset = offset;
    if (header.header_hash != HashOf(header) || end - offset < static_cast<int64_t>(sizeof header) ||
        header.payload_bytes > static_cast<uint64_t>(end - offset) - sizeof header)
      return std::nullopt;
    offset += static_cast<int64_t>(sizeof header + header.payload_bytes);
  }
  if (offset != end) return std::nullopt;
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
    frames.push_back(frame);
  }
  return frames;
}

}  // namespace stratalux::db
