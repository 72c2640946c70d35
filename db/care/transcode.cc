// SPDX-License-Identifier: Apache-2.0
#include "db/care/transcode.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <optional>

#include "db/base/durable_file.h"
#include "db/base/write_lock.h"
#include "db/catalogue/session_index.h"
#include "db/catalogue/transcode_journal.h"
#include "db/segment/frame_codec.h"
#include "db/segment/pixel_hash.h"
#include "db/segment/segment.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

// Frames by their place, whatever segment they lie in.
class FrameSource {
 public:
  explicit FrameSource(fs::path folder) : folder_(std::move(folder)) {}

  Result<FrameHeader> ReadHeader(int64_t segment, int64_t offset) {
    SLX_ASSIGN_OR_RETURN(const SegmentReader* reader, Segment(segment));
    return reader->ReadHeader(offset);
  }
  Result<Image<uint16_t>> Read(int64_t segment, int64_t offset, FrameHeader* header) {
    SLX_ASSIGN_OR_RETURN(const SegmentReader* reader, Segment(segment));
    SLX_ASSIGN_OR_RETURN(const auto payload, reader->Read(offset, header));
    const std::string where = (folder_ / SegmentName(segment)).string() + ", offset " + std::to_string(offset);
    SLX_ASSIGN_OR_RETURN(
        auto image, decoder_.Decode(ShapeOf(*header), static_cast<Codec>(header->codec), payload).WithContext(where));
    SLX_RETURN_IF_ERROR(CheckPixels(*header, image, nullptr).WithContext(where));
    return image;
  }

 private:
  Result<const SegmentReader*> Segment(int64_t number) {
    auto reader = readers_.find(number);
    if (reader == readers_.end()) {
      SLX_ASSIGN_OR_RETURN(auto opened, SegmentReader::Open(folder_ / SegmentName(number)));
      reader = readers_.emplace(number, std::move(opened)).first;
    }
    return &reader->second;
  }
  fs::path folder_;
  FrameDecoder decoder_;
  std::map<int64_t, SegmentReader> readers_;
};

PixelHash HashOf(const FrameHeader& header, const Image<uint16_t>& image) {
  return HashPixels(static_cast<PixelFormat>(header.format), image.pixels(), nullptr);
}

// True where the headers tell the same of the frame, however it is coded. `was` may be of before the pixel hash.
bool SameProof(FrameHeader was, FrameHeader is) {
  if (!HasPixelHash(was)) SetPixelHash(was, PixelHashOf(is));
  for (FrameHeader* h : {&was, &is}) {
    h->codec = 0;
    h->payload_bytes = h->header_hash = 0;
    std::memset(h->payload_hash, 0, sizeof h->payload_hash);
  }
  return std::memcmp(&was, &is, sizeof was) == 0;
}

class Transcoder {
 public:
  Transcoder(SessionIndex index, fs::path store, std::string id, const TranscodeOptions& options, Progress& progress)
      : index_(std::move(index)),
        store_(std::move(store)),
        folder_(store_ / "sessions" / id),
        id_(std::move(id)),
        options_(options),
        progress_(progress),
        source_(folder_),
        encoder_(options.codec) {}

  Result<TranscodeReport> Run() {
    SLX_ASSIGN_OR_RETURN(number_, index_.NumberOf(id_));
    SLX_ASSIGN_OR_RETURN(places_, index_.Places(number_));
    SLX_ASSIGN_OR_RETURN(const bool wanted, LookAtFrames());
    if (!wanted) {
      progress_.Advance(report_.frames);
      return report_;
    }
    SLX_ASSIGN_OR_RETURN(const auto segments, SegmentNumbers(folder_));
    const TranscodeJournal journal{id_, segments.back() + 1};
    SLX_RETURN_IF_ERROR(WriteTranscodeJournal(store_, journal));
    Done(TranscodeStep::kJournalWritten);
    const Status rewritten = Rewrite(journal);
    // After an error this goes back to the old segments; should that fail, too, the next opening does it.
    const Status settled = SettleTranscode(index_, store_, journal);
    SLX_RETURN_IF_ERROR(rewritten);
    SLX_RETURN_IF_ERROR(settled);
    Done(TranscodeStep::kSettled);
    return report_;
  }

 private:
  // Counts what is there; true where a frame may get another codec. `delta` tries raw frames again: should none shrink,
  // nothing changes in the end.
  Result<bool> LookAtFrames() {
    bool wanted = false;
    for (const auto& p : places_) {
      SLX_ASSIGN_OR_RETURN(const FrameHeader header, source_.ReadHeader(p.segment, p.offset));
      if (header.cipher != 0)
        return Status::Usage("session " + id_ + " is encrypted: its codec is chosen when it is captured");
      const bool is_delta = static_cast<Codec>(header.codec) == Codec::kDelta;
      wanted |= is_delta != (options_.codec == StoreCodec::kDelta);
      ++report_.frames;
      report_.bytes_before += p.bytes;
    }
    report_.bytes_after = report_.bytes_before;
    return wanted;
  }

  Status Rewrite(const TranscodeJournal& journal) {
    SLX_RETURN_IF_ERROR(WriteSegments(journal.first_new));
    Done(TranscodeStep::kSegmentsSynced);
    if (changed_ == 0) return Status::Ok();  // the new segments would say the same
    SLX_RETURN_IF_ERROR(Compare());
    Done(TranscodeStep::kCompared);
    SLX_RETURN_IF_ERROR(index_.MoveFrames(number_, moved_));
    Done(TranscodeStep::kCommitted);
    report_.changed = changed_;
    report_.bytes_after = 0;
    for (const auto& [segment, frame] : moved_) report_.bytes_after += static_cast<int64_t>(frame.header.payload_bytes);
    return Status::Ok();
  }

  Status WriteSegments(int64_t first) {
    std::optional<SegmentWriter> writer;
    int64_t segment = first - 1;
    for (const auto& p : places_) {
      if (!writer || writer->bytes() > options_.max_segment_bytes) {
        if (writer) SLX_RETURN_IF_ERROR(writer->Seal());
        SLX_ASSIGN_OR_RETURN(auto next, SegmentWriter::Create(folder_ / SegmentName(++segment), id_));
        writer = std::move(next);
      }
      FrameHeader header{};
      SLX_ASSIGN_OR_RETURN(const auto image, source_.Read(p.segment, p.offset, &header));
      SLX_ASSIGN_OR_RETURN(const auto encoded, encoder_.Encode(ShapeOf(header), image.pixels()));
      if (!HasPixelHash(header)) SetPixelHash(header, HashOf(header, image));
      changed_ += encoded.codec != static_cast<Codec>(header.codec) ? 1 : 0;
      SLX_ASSIGN_OR_RETURN(const SegmentFrame frame, writer->Append(header, encoded.codec, encoded.bytes));
      moved_.emplace_back(segment, frame);
      progress_.Advance();
      Done(TranscodeStep::kFrameWritten);
    }
    SLX_RETURN_IF_ERROR(writer->Seal());
    return SyncFolder(folder_);
  }

  // What a reader will find, against what it finds now: nothing in memory is trusted.
  Status Compare() {
    for (size_t i = 0; i < places_.size(); ++i) {
      FrameHeader was{}, is{};
      SLX_ASSIGN_OR_RETURN(const auto before, source_.Read(places_[i].segment, places_[i].offset, &was));
      SLX_ASSIGN_OR_RETURN(const auto after, source_.Read(moved_[i].first, moved_[i].second.offset, &is));
      if (!SameProof(was, is) ||
          !std::equal(before.pixels().begin(), before.pixels().end(), after.pixels().begin(), after.pixels().end()))
        return Status::Integrity("session " + id_ + ": frame " + std::to_string(was.frame) +
                                 " does not come back from its new segment as it is; nothing was changed");
      progress_.Advance();
    }
    return Status::Ok();
  }

  void Done(TranscodeStep step) const {
    if (options_.on_step) options_.on_step(step);
  }

  SessionIndex index_;
  fs::path store_, folder_;
  std::string id_;
  const TranscodeOptions& options_;
  Progress& progress_;
  FrameSource source_;
  FrameEncoder encoder_;
  int64_t number_ = 0;
  std::vector<SessionIndex::Place> places_;
  std::vector<std::pair<int64_t, SegmentFrame>> moved_;
  int64_t changed_ = 0;
  TranscodeReport report_;
};

}  // namespace

Result<TranscodeReport> TranscodeSession(const SessionStore& store, const SessionRow& session,
                                         const TranscodeOptions& options, Progress& progress) {
  if (session.info.status == SessionStatus::kRecording)
    return Status::Busy("session " + session.info.id + " is being recorded; transcode it when it is finished");
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store.folder()));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store.folder(), AccessMode::kReadWrite));
  return Transcoder(std::move(index), store.folder(), session.info.id, options, progress).Run();
}

}  // namespace stratalux::db
