// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_import.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <optional>
#include <set>

#include "db/base/durable_file.h"
#include "db/care/incoming.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/session_index.h"
#include "db/interchange/crate_fits.h"
#include "db/interchange/crate_frame_files.h"
#include "db/interchange/crate_reader.h"
#include "db/interchange/crate_truth.h"
#include "db/segment/frame_codec.h"
#include "db/segment/pixel_hash.h"
#include "db/segment/segment.h"
#include "db/transfer/adopt.h"
#include "db/transfer/foreign_ledger.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

// One session of the crate into a folder as the store's own writer would have made it.
class FolderWriter {
 public:
  FolderWriter(const CrateReader& crate, const std::string& id, fs::path folder)
      : crate_(crate), id_(id), folder_(std::move(folder)) {}

  Status Write(const CrateSession& session, Progress& progress, CrateImportReport& report) {
    SLX_ASSIGN_OR_RETURN(auto table, CrateFrameReader::Open(crate_.SessionFolder(id_) / "frames.csv"));
    CrateFrame frame;
    while (true) {
      SLX_ASSIGN_OR_RETURN(const bool more, table.Next(frame));
      if (!more) break;
      SLX_RETURN_IF_ERROR(Append(frame));
      ++report.frames;
      progress.Advance();
    }
    if (!segment_) SLX_RETURN_IF_ERROR(NextSegment());  // a session without frames still has its segment
    SLX_RETURN_IF_ERROR(segment_->Seal());
    SLX_RETURN_IF_ERROR(WriteTruth());
    SLX_RETURN_IF_ERROR(WriteFits(report));
    return WriteManifest(folder_, session.info, session.frames, segments_);
  }

 private:
  Status NextSegment() {
    if (segment_) SLX_RETURN_IF_ERROR(segment_->Seal());
    const std::string name = SegmentName(static_cast<int64_t>(segments_.size()) + 1);
    SLX_ASSIGN_OR_RETURN(auto next, SegmentWriter::Create(folder_ / name, id_));
    segment_ = std::move(next);
    segments_.push_back(name);
    return Status::Ok();
  }
  Status Append(const CrateFrame& frame) {
    if (segments_.empty() || segments_.back() != frame.row.segment) SLX_RETURN_IF_ERROR(NextSegment());
    const fs::path file = crate_.SessionFolder(id_) / frame.file;
    SLX_ASSIGN_OR_RETURN(const auto image, ReadCrateFrame(file, frame));
    const FrameRecord& r = frame.row.record;
    const FrameShape shape{r.format, r.cfa, r.width, r.height, r.channels};
    FrameEncoder& encoder = frame.row.codec == ToString(Codec::kDelta) ? delta_ : raw_;
    std::vector<uint8_t> narrow;
    if (r.format == PixelFormat::kMono8) {
      narrow.resize(image.size());
      std::transform(image.pixels().begin(), image.pixels().end(), narrow.begin(),
                     [](uint16_t v) { return static_cast<uint8_t>(v); });
    }
    SLX_ASSIGN_OR_RETURN(const EncodedFrame encoded, narrow.empty()
                                                         ? encoder.Encode(shape, image.pixels())
                                                         : encoder.Encode(shape, std::span<const uint8_t>(narrow)));
    FrameHeader header = MakeFrameHeader(r, frame.row.id, r.pattern.ToString());
    SetPixelHash(header, HashPixels(r.format, image.pixels(), nullptr));
    return segment_->Append(header, encoded.codec, encoded.bytes).status();
  }
  Status WriteTruth() {
    const fs::path from = crate_.SessionFolder(id_);
    SLX_ASSIGN_OR_RETURN(const auto maps, ReadTruthMaps(from));
    std::optional<SegmentWriter> segment;
    int64_t number = 0;
    for (const CrateTruthMap& entry : maps) {
      if (!segment) {
        SLX_ASSIGN_OR_RETURN(auto made, SegmentWriter::Create(folder_ / "truth.seg", id_));
        segment = std::move(made);
      }
      SLX_ASSIGN_OR_RETURN(const auto map, ReadTruthMap(from, entry));
      FrameRecord record;
      record.format = PixelFormat::kF32;
      record.width = map.width();
      record.height = map.height();
      record.channels = map.channels();
      const auto bytes = std::span(reinterpret_cast<const uint8_t*>(map.data()), map.size() * sizeof(float));
      FrameHeader header = MakeFrameHeader(record, number++, entry.name);
      SetPixelHash(header, HashPixels(bytes, nullptr));
      SLX_RETURN_IF_ERROR(segment->Append(header, Codec::kF32, bytes).status());
    }
    if (segment) SLX_RETURN_IF_ERROR(segment->Seal());
    const auto record = ReadCrateFile(from / "truth/truth_calibration.json", int64_t{16} << 20);
    if (record.status().code() == StatusCode::kNotFound) return Status::Ok();
    if (!record.ok()) return record.status();
    return ReplaceFile(folder_ / "truth_calibration.json", *record);
  }
  Status WriteFits(CrateImportReport& report) {
    std::set<std::string> fits;
    for (const std::string& file : crate_.FitFilesOf(id_)) {
      fits.insert(file.substr(0, file.find('/')));
      SLX_RETURN_IF_ERROR(CopyFitFile(crate_.SessionFolder(id_) / "fits" / file, folder_ / "fits" / file, {}).status());
    }
    report.fits += static_cast<int64_t>(fits.size());
    return Status::Ok();
  }

  const CrateReader& crate_;
  const std::string& id_;
  const fs::path folder_;
  FrameEncoder raw_{StoreCodec::kRaw12}, delta_{StoreCodec::kDelta};
  std::optional<SegmentWriter> segment_;
  std::vector<std::string> segments_;
};

Result<bool> IsListed(const fs::path& store, const std::string& id) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  const auto number = index.NumberOf(id);
  if (number.ok()) return true;
  return number.status().code() == StatusCode::kNotFound ? Result<bool>(false) : Result<bool>(number.status());
}

Status Take(const fs::path& store, const CrateReader& crate, const CrateSession& session, const std::string& from,
            Progress& progress, CrateImportReport& report) {
  const std::string& id = session.info.id;
  std::error_code error;
  if (fs::exists(store / "sessions" / id, error)) return ListAdopted(store, id, from);  // moved, then cut off
  const fs::path incoming = IncomingFolder(store, id);
  SLX_RETURN_IF_ERROR(WipeFolder(incoming));
  SLX_RETURN_IF_ERROR(MakeFolder(incoming));
  Status taken = FolderWriter(crate, id, incoming).Write(session, progress, report);
  if (taken.ok()) taken = CheckFolder(incoming).status();
  if (taken.ok()) taken = AdoptFolder(store, incoming, from);
  if (taken.ok()) return taken;
  (void)WipeFolder(incoming).ok();  // the reason is worth more than what is left
  return taken.WithContext("session " + id);
}

}  // namespace

Result<CrateImportReport> ImportCrate(const SessionStore& store, const fs::path& crate_folder, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto lock, IncomingLock::Take(store.folder()));
  SLX_ASSIGN_OR_RETURN(const CrateReader crate, CrateReader::Open(crate_folder, logger));
  CrateImportReport report;
  std::vector<CrateSession> wanted;
  int64_t frames = 0;
  for (const std::string& id : crate.sessions()) {
    SLX_ASSIGN_OR_RETURN(CrateSession session, crate.ReadSession(id));
    SLX_ASSIGN_OR_RETURN(const bool forgotten, IsForgotten(store.folder(), id));
    SLX_ASSIGN_OR_RETURN(const bool listed, IsListed(store.folder(), id));
    if (forgotten) {
      report.forgotten.push_back(id);
    } else if (listed) {
      report.present.push_back(id);
    } else {
      frames += session.frames;
      wanted.push_back(std::move(session));
    }
  }
  const std::string from = "crate " + fs::absolute(crate_folder).lexically_normal().string();
  Progress progress(logger, "import", frames);
  for (const CrateSession& session : wanted) {
    SLX_RETURN_IF_ERROR(Take(store.folder(), crate, session, from, progress, report));
    report.sessions.push_back(session.info.id);
  }
  // A crate may be older than the withdrawal of what it holds.
  SLX_RETURN_IF_ERROR(ApplyWithdrawals(store.folder()).status());
  return report;
}

}  // namespace stratalux::db
