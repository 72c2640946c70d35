// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/session_store.h"

#include <algorithm>
#include <cstring>
#include <map>

#include "db/base/durable_file.h"
#include "db/base/write_lock.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/fit_store.h"
#include "db/catalogue/info_check.h"
#include "db/catalogue/ledger_follow.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/recovery.h"
#include "db/catalogue/session_index.h"
#include "db/catalogue/signature.h"
#include "db/catalogue/transcode_journal.h"
#include "db/keys/key_store.h"
#include "db/keys/readers.h"
#include "db/ledger/ledger.h"
#include "db/segment/frame_cipher.h"
#include "db/segment/frame_codec.h"
#include "db/segment/header_check.h"
#include "db/segment/pixel_hash.h"
#include "db/segment/segment.h"

namespace stratalux::db {
namespace {

// Where a session's bytes are not what they were, only a copy or a new capture helps.
Status WithRemedy(const Status& status, const std::string& id) {
  if (status.code() != StatusCode::kIntegrity) return status;
  return Status::Integrity(status.message() + "; restore sessions/" + id + " from a copy or capture again");
}

PixelHash HashOf(const FrameRecord& r, std::span<const uint16_t> samples, const SecretKey* key) {
  return HashPixels(r.format, samples, key);
}
PixelHash HashOf(const FrameRecord&, std::span<const uint8_t> samples, const SecretKey* key) {
  return HashPixels(samples, key);
}

// A session that no index would take when it is built again does not begin; what is wrong came from the caller.
Status Refused(const Status& status) { return status.ok() ? status : Status::Usage(status.message()); }

FrameShape ShapeOf(const FrameRecord& r) { return {r.format, r.cfa, r.width, r.height, r.channels}; }

// Asks for the consent again. None for sessions that show nobody.
Result<std::optional<LedgerEntry>> ConsentEntry(const std::filesystem::path& store, const SessionInfo& info) {
  if (info.kind != SessionKind::kVisitor) return std::optional<LedgerEntry>();
  SLX_RETURN_IF_ERROR(ValidConsent(store, info.visitor).status());
  LedgerEntry entry;
  entry.kind = LedgerKind::kConsent;
  entry.at = info.started_wall.ns != 0 ? info.started_wall : WallNow();
  entry.sessions = {info.id};
  SLX_ASSIGN_OR_RETURN(entry.visitor_hmac, NameVisitor(store, info.visitor));
  entry.detail_json = ConsentToJson(info.consent);
  return std::optional(std::move(entry));
}

}  // namespace

struct SessionStore::Impl {
  std::filesystem::path folder;
  SessionIndex index;
  RecoveryNotes notes;
  FrameOpener opener;
  FrameDecoder decoder = {};

  Result<std::vector<FrameRow>> ListFrames(const std::string& id);
  Result<Image<uint16_t>> ReadFrame(const std::string& id, const FrameRow& frame);
};

struct SessionWriter::Impl {
  std::filesystem::path store, folder;
  SessionIndex index;
  WriteLock lock;
  SessionInfo info;
  int64_t number = 0;
  WriterOptions options;
  FrameEncoder encoder;
  std::unique_ptr<FrameSealer> sealer;  // null: stored as it is
  std::optional<SegmentWriter> segment, truth;
  int64_t segments = 0, frames = 0, acknowledged = 0, truth_maps = 0;
  bool commit_in_doubt = false;  // one failed, but may lie in SQLite's log
  // What the ledger is told before the first frame is acknowledged; nothing for sessions that show nobody.
  std::optional<LedgerEntry> consent;
  std::vector<std::pair<int64_t, SegmentFrame>> pending;
  std::chrono::steady_clock::time_point pending_since;
  Status failure;  // the first one; every later call repeats it

  Impl(SessionIndex opened, StoreCodec codec) : index(std::move(opened)), encoder(codec) {}
  Status Fail(const Status& status) {
    if (!failure.ok()) return failure;
    failure = status.WithContext("session " + info.id);
    SessionRow row;
    row.info = info;
    RecoveryNotes ignored;  // the caller hears the reason
    // Rows of a commit that failed may come back with the log at the next opening, until another commit has taken their
    // place in it. Cut before that, their bytes would be missing. Where this fails, too, the session stays `recording`
    // and the next opening ends it, by the rows it then finds.
    if (commit_in_doubt && !index.SetStatus(number, {SessionStatus::kRecording, {status.message()}, {}, {}}).ok())
      return failure;
    std::vector<std::string> doubtful;
    if (segment && segment->sync_failed()) doubtful.push_back(SegmentName(segments));
    if (truth && truth->sync_failed()) doubtful.push_back("truth.seg");
    (void)AbandonSession(index, store, row, status.message(), doubtful, ignored).ok();
    return failure;
  }
  Status Committed(const Status& status) {
    commit_in_doubt |= !status.ok();
    return status.ok() ? status : Fail(status);
  }
  [[nodiscard]] const SecretKey* key() const { return sealer ? &sealer->key() : nullptr; }
  Status NextSegment() {
    if (segment) SLX_RETURN_IF_ERROR(segment->Seal());
    SLX_ASSIGN_OR_RETURN(auto next, SegmentWriter::Create(folder / SegmentName(segments + 1), info.id, sealer.get()));
    segment = std::move(next);
    ++segments;
    return Status::Ok();
  }
  Status Flush() {
    if (!failure.ok()) return failure;
    if (pending.empty()) return Status::Ok();
    // Bytes on disk first, then the rows that speak of them, then the caller hears of it.
    if (Status s = segment->Sync(); !s.ok()) return Fail(s);
    if (consent) {
      if (Status s = AppendToLedger(store, *consent); !s.ok()) return Fail(s);
      consent.reset();
    }
    SLX_RETURN_IF_ERROR(Committed(index.InsertFrames(number, pending)));
    acknowledged += static_cast<int64_t>(pending.size());
    pending.clear();
    return Status::Ok();
  }
  Status FlushIfDue() {
    if (!failure.ok()) return failure;
    const bool due = static_cast<int>(pending.size()) >= options.group_frames ||
                     (!pending.empty() && options.now() - pending_since >= options.group_window);
    return due ? Flush() : Status::Ok();
  }
  template <typename T>
  Status Append(const FrameRecord& record, ImageView<const T> pixels) {
    if (!failure.ok()) return failure;
    const std::string name = "frame of step " + std::to_string(record.step);
    if (pixels.empty() || pixels.width() != record.width || pixels.height() != record.height ||
        pixels.channels() != record.channels)
      return Status::Usage(name + ": pixels do not have the record's size");
    const std::span<const T> samples = pixels.pixels();
    SLX_ASSIGN_OR_RETURN(const EncodedFrame encoded, encoder.Encode(ShapeOf(record), samples).WithContext(name));
    FrameHeader header = MakeFrameHeader(record, frames, record.pattern.ToString());
    header.codec = static_cast<uint16_t>(encoded.codec);
    header.payload_bytes = encoded.bytes.size();
    SLX_RETURN_IF_ERROR(Refused(CheckHeader(header)).WithContext(name));
    SetPixelHash(header, HashOf(record, samples, key()));
    return Append(header, encoded);
  }
  Status Append(const FrameHeader& header, const EncodedFrame& encoded) {
    if (!segment || segment->bytes() > options.max_segment_bytes) {
      SLX_RETURN_IF_ERROR(Flush());
      if (Status s = NextSegment(); !s.ok()) return Fail(s);
    }
    auto frame = segment->Append(header, encoded.codec, encoded.bytes);
    if (!frame.ok()) return Fail(frame.status());
    ++frames;
    if (pending.empty()) pending_since = options.now();
    pending.emplace_back(segments, *frame);
    return FlushIfDue();
  }
};

Status WriterOptions::Validate() const {
  if (group_frames < 1) return Status::Usage("group_frames " + std::to_string(group_frames) + " must be at least 1");
  if (group_window.count() < 0) return Status::Usage("group_window must not be negative");
  if (max_segment_bytes < 1)
    return Status::Usage("max_segment_bytes " + std::to_string(max_segment_bytes) + " must be at least 1");
  return Status::Ok();
}

SessionWriter::SessionWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SessionWriter::SessionWriter(SessionWriter&&) noexcept = default;
SessionWriter& SessionWriter::operator=(SessionWriter&&) noexcept = default;
SessionWriter::~SessionWriter() = default;

const SessionInfo& SessionWriter::info() const { return impl_->info; }
int64_t SessionWriter::acknowledged_frames() const { return impl_->acknowledged; }

Status SessionWriter::Append(const FrameRecord& record, ImageView<const uint16_t> pixels) {
  return impl_->Append(record, pixels);
}
Status SessionWriter::Append(const FrameRecord& record, ImageView<const uint8_t> pixels) {
  return impl_->Append(record, pixels);
}

Status SessionWriter::AppendTruth(const std::string& name, ImageView<const float> pixels) {
  if (!impl_->failure.ok()) return impl_->failure;
  if (name.empty() || name.size() > 63)
    return Status::Usage("truth map name '" + name + "' must have 1 .. 63 characters");
  if (!impl_->truth) {
    auto created = SegmentWriter::Create(impl_->folder / "truth.seg", impl_->info.id, impl_->sealer.get());
    if (!created.ok()) return impl_->Fail(created.status());
    impl_->truth = std::move(created).value();
  }
  FrameRecord record;
  record.format = PixelFormat::kF32;
  record.width = pixels.width();
  record.height = pixels.height();
  record.channels = pixels.channels();
  const auto bytes = std::span(reinterpret_cast<const uint8_t*>(pixels.data()), pixels.size() * sizeof(float));
  FrameHeader header = MakeFrameHeader(record, impl_->truth_maps, name);
  header.codec = static_cast<uint16_t>(Codec::kF32);
  header.payload_bytes = bytes.size();
  SLX_RETURN_IF_ERROR(Refused(CheckHeader(header, RecordKind::kTruthMap)).WithContext("truth map " + name));
  ++impl_->truth_maps;
  SetPixelHash(header, HashPixels(bytes, impl_->key()));
  const auto frame = impl_->truth->Append(header, Codec::kF32, bytes);
  return frame.ok() ? Status::Ok() : impl_->Fail(frame.status());
}

Status SessionWriter::KeepTruthCalibration(const std::string& record_json) {
  if (!impl_->failure.ok()) return impl_->failure;
  const Status kept = ReplaceFile(impl_->folder / "truth_calibration.json", record_json + "\n");
  return kept.ok() ? kept : impl_->Fail(kept);
}

Status SessionWriter::Flush() { return impl_->Flush(); }
Status SessionWriter::FlushIfDue() { return impl_->FlushIfDue(); }

Status SessionWriter::Finish(SessionStatus status, std::vector<std::string> reasons, CaptureFindings found) {
  SLX_RETURN_IF_ERROR(Refused(CheckFound(found)));
  SLX_RETURN_IF_ERROR(Flush());
  Impl& w = *impl_;
  if (!w.segment) {
    if (Status s = w.NextSegment(); !s.ok()) return w.Fail(s);  // a session without frames still has its segment
  }
  if (Status s = w.segment->Seal(); !s.ok()) return w.Fail(s);
  if (w.truth) {
    if (Status s = w.truth->Seal(); !s.ok()) return w.Fail(s);
  }
  w.info.status = status;
  w.info.reasons = std::move(reasons);
  w.info.found = std::move(found);
  w.info.finished_wall = WallNow();
  std::vector<std::string> names;
  for (int64_t i = 1; i <= w.segments; ++i) names.push_back(SegmentName(i));
  const auto signature = w.options.signing == Signing::kRigKey ? EndingSignature::kByRigKey : EndingSignature::kNone;
  if (Status s = WriteEnding(w.store, w.info, w.frames, names, signature); !s.ok()) return w.Fail(s);
  return w.Committed(w.index.SetStatus(w.number, EndingOf(w.info)));
}

SessionStore::SessionStore(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SessionStore::SessionStore(SessionStore&&) noexcept = default;
SessionStore& SessionStore::operator=(SessionStore&&) noexcept = default;
SessionStore::~SessionStore() = default;

Status SessionStore::Create(const std::filesystem::path& folder) {
  SLX_RETURN_IF_ERROR(SessionIndex::CreateNew(folder));
  return MakeStoreId(folder);
}

Result<SessionStore> SessionStore::Open(const std::filesystem::path& folder, AccessMode mode) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(folder, mode));
  const bool write = mode == AccessMode::kReadWrite;
  const Status ledger = write ? BringLedgerUp(index, folder) : Status::Ok();
  if (ledger.code() == StatusCode::kNewerSchema) return ledger;
  if (write) SLX_RETURN_IF_ERROR(EndInterruptedTranscode(index, folder));
  SLX_ASSIGN_OR_RETURN(auto notes, write ? RecoverSessions(index, folder) : FindUnfinished(index, folder));
  // As on a disk that cannot be written: the next opening tries again, and a capture needs the ledger before that.
  if (!ledger.ok()) notes.push_back("the ledger could not be followed: " + ledger.message());
  return SessionStore(std::unique_ptr<Impl>(new Impl{folder, std::move(index), std::move(notes), FrameOpener(folder)}));
}

const std::filesystem::path& SessionStore::folder() const { return impl_->folder; }
const std::vector<std::string>& SessionStore::notes() const { return impl_->notes; }
std::filesystem::path SessionStore::SessionFolder(const std::string& id) const {
  return impl_->folder / "sessions" / id;
}
std::filesystem::path SessionStore::FitFolder(const std::string& id, const std::string& fit) const {
  return SessionFolder(id) / "fits" / fit;
}

Result<SessionWriter> SessionStore::BeginSession(SessionInfo info, const WriterOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  // Before the rig moves: a session that was to be signed and cannot be has failed.
  if (options.signing == Signing::kRigKey) SLX_RETURN_IF_ERROR(RigKey::Read(impl_->folder).status());
  SLX_ASSIGN_OR_RETURN(auto lock, WriteLock::Take(impl_->folder));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(impl_->folder, AccessMode::kReadWrite));
  info.id.clear();
  SLX_RETURN_IF_ERROR(Refused(CheckInfo(info)));
  SLX_RETURN_IF_ERROR(RequireConsent(impl_->folder, info));
  info.status = SessionStatus::kRecording;
  info.found = {};  // told by Finish()
  SLX_ASSIGN_OR_RETURN(const int64_t number, index.InsertSession(info));
  const auto folder = SessionFolder(info.id);
  const auto fail = [&](Status status) {
    (void)index.SetStatus(number, {SessionStatus::kFailed, {status.message()}, WallNow(), {}}).ok();
    return status;
  };
  if (const Status made = MakeFolder(folder); !made.ok()) return fail(made);
  // Withdrawn while the session began: the withdrawal did not see it, so that this must see the withdrawal.
  auto consent = ConsentEntry(impl_->folder, info);
  if (!consent.ok()) return fail(consent.status());
  std::unique_ptr<FrameSealer> sealer;
  if (options.encryption == Encryption::kPerSession) {
    auto key = CreateKey(impl_->folder);
    if (!key.ok()) return fail(key.status());
    if (Status status = index.SetKeyId(number, key->id); !status.ok()) return fail(status);
    if (Status status = SealToReaders(impl_->folder, info.id, *key); !status.ok()) return fail(status);
    sealer = std::make_unique<FrameSealer>(info.id, std::move(key).value());
  }
  // What the index knows of an unfinished session, for `reindex`.
  if (const Status begun = WriteManifest(folder, info, 0, {}); !begun.ok()) {
    (void)index.SetStatus(number, {SessionStatus::kFailed, {begun.message()}, WallNow(), {}}).ok();
    return begun;
  }
  auto writer = std::make_unique<SessionWriter::Impl>(std::move(index), options.codec);
  writer->store = impl_->folder;
  writer->folder = folder;
  writer->lock = std::move(lock);
  writer->info = std::move(info);
  writer->number = number;
  writer->options = options;
  writer->sealer = std::move(sealer);
  writer->consent = std::move(consent).value();
  return SessionWriter(std::move(writer));
}

Result<std::vector<SessionSummary>> SessionStore::ListSessions() const { return impl_->index.Sessions(); }
Result<std::vector<SessionSummary>> SessionStore::ListSessionsOf(const std::string& visitor) const {
  return impl_->index.SessionsOf(visitor);
}

Result<SessionRow> SessionStore::FindSession(const std::string& selector) const {
  SLX_ASSIGN_OR_RETURN(const auto numbers, impl_->index.Select(selector));
  if (numbers.empty()) {
    const auto forgotten = FindForgotten(impl_->folder, selector);
    return Status::NotFound(
        forgotten.ok() && !forgotten->empty()
            ? "session " + *forgotten + " was forgotten; `stratalux-db deletions` has its certificate"
            : "no session '" + selector + "' in " + impl_->folder.string() + " (`stratalux-db ls` lists them)");
  }
  SLX_ASSIGN_OR_RETURN(SessionRow first, impl_->index.Session(numbers[0]));
  if (numbers.size() == 1) return first;
  SLX_ASSIGN_OR_RETURN(const SessionRow second, impl_->index.Session(numbers[1]));
  return Status::Usage("'" + selector + "' is ambiguous: " + first.info.id + ", " + second.info.id +
                       (numbers.size() > 2 ? ", ..." : "") + "; give more of the id");
}

SessionDevices SessionStore::DevicesOf(const std::string& id) const {
  const auto manifest = ReadManifest(SessionFolder(id));
  return manifest.ok() ? manifest->devices : SessionDevices{};
}

Result<std::vector<FrameRow>> SessionStore::ListFrames(const std::string& id) const {
  auto rows = impl_->ListFrames(id);
  return rows.ok() ? std::move(rows) : WithRemedy(rows.status(), id);
}

Result<std::vector<FrameRow>> SessionStore::Impl::ListFrames(const std::string& id) {
  SLX_ASSIGN_OR_RETURN(const int64_t number, index.NumberOf(id));
  SLX_ASSIGN_OR_RETURN(const auto places, index.Places(number));
  // Only what the index speaks of: behind it a live or failed writer may have left half a record.
  std::map<int64_t, SegmentReader> segments;
  std::vector<FrameRow> rows;
  for (const auto& p : places) {
    auto reader = segments.find(p.segment);
    if (reader == segments.end()) {
      const auto file = folder / "sessions" / id / SegmentName(p.segment);
      SLX_ASSIGN_OR_RETURN(auto opened, SegmentReader::OpenListed(file, id));
      reader = segments.emplace(p.segment, std::move(opened)).first;
    }
    SLX_ASSIGN_OR_RETURN(const FrameHeader header, reader->second.ListedHeader(p.offset).WithContext("session " + id));
    if (!std::equal(p.hash.begin(), p.hash.end(), std::begin(header.payload_hash), std::end(header.payload_hash)))
      return Status::Integrity("session " + id + ": index and " + SegmentName(p.segment) + " disagree on frame " +
                               std::to_string(p.frame) + " (offset " + std::to_string(p.offset) + ")");
    FrameRow row;
    row.id = p.frame;
    SLX_ASSIGN_OR_RETURN(row.record, RecordOf(header).WithContext("session " + id));
    if (p.failed) row.record.level_check = LevelCheck::kFailed;
    row.codec = ToString(static_cast<Codec>(header.codec));
    row.segment = SegmentName(p.segment);
    row.offset = p.offset;
    row.stored_bytes = p.bytes;
    row.hash = HashText(header.payload_hash);
    if (HasPixelHash(header)) row.pixel_hash = HashText(header.pixel_hash);
    rows.push_back(std::move(row));
  }
  return rows;
}

Result<Image<uint16_t>> SessionStore::ReadFrame(const std::string& id, const FrameRow& frame) const {
  auto image = impl_->ReadFrame(id, frame);
  return image.ok() ? std::move(image) : WithRemedy(image.status(), id);
}

Result<Image<uint16_t>> SessionStore::Impl::ReadFrame(const std::string& id, const FrameRow& frame) {
  SLX_ASSIGN_OR_RETURN(const auto reader, SegmentReader::OpenListed(folder / "sessions" / id / frame.segment, id));
  const std::string where = "session " + id + ", " + frame.segment + ", offset " + std::to_string(frame.offset);
  SLX_ASSIGN_OR_RETURN(const FrameHeader header, reader.ListedHeader(frame.offset).WithContext("session " + id));
  if (HashText(header.payload_hash) != frame.hash)
    return Status::Integrity(where + ": index and segment disagree on frame " + std::to_string(frame.id));
  std::vector<uint8_t> stored;
  SLX_RETURN_IF_ERROR(reader.ReadPayload(frame.offset, header, stored).WithContext("session " + id));
  stored.resize(header.payload_bytes);
  if (header.cipher == 0) {
    SLX_ASSIGN_OR_RETURN(const bool encrypted, index.IsEncrypted(id));
    if (encrypted)
      return Status::Integrity(where + ": a plain frame in an encrypted session was put there by someone else");
  }
  SLX_ASSIGN_OR_RETURN(const auto bytes,
                       opener.Open(reader.session_id(), header, std::move(stored)).WithContext(where));
  SLX_ASSIGN_OR_RETURN(
      auto image,
      decoder.Decode(stratalux::db::ShapeOf(header), static_cast<Codec>(header.codec), bytes).WithContext(where));
  SLX_ASSIGN_OR_RETURN(const SecretKey* key, opener.KeyOf(reader.session_id(), header));
  SLX_RETURN_IF_ERROR(CheckPixels(header, image, key).WithContext(where));
  return image;
}

Status SessionStore::RegisterFit(const FitRow& fit, const RegisterOptions& options) {
  return stratalux::db::RegisterFit(impl_->folder, fit, options);
}

Result<std::vector<FitRow>> SessionStore::ListFits(const std::string& id) const {
  SLX_ASSIGN_OR_RETURN(const int64_t number, impl_->index.NumberOf(id));
  return impl_->index.Fits(number, id);
}

}  // namespace stratalux::db
