// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_export.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdio>
#include <fstream>
#include <map>
#include <set>

#include <nlohmann/json.hpp>
#include <sodium.h>

#include "db/base/durable_file.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/interchange/crate_colmap.h"
#include "db/interchange/crate_files.h"
#include "db/interchange/crate_fits.h"
#include "db/interchange/crate_frame_files.h"
#include "db/interchange/crate_frames.h"
#include "db/interchange/crate_metadata.h"
#include "db/interchange/crate_session.h"
#include "db/interchange/crate_staging.h"
#include "db/interchange/crate_truth.h"
#include "db/interchange/export_files.h"
#include "db/privacy/access_log.h"
#include "db/privacy/export_marker.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::string RandomDigits() {
  std::array<uint8_t, 4> bytes{};
  std::array<char, 9> digits{};
  randombytes_buf(bytes.data(), bytes.size());
  return sodium_bin2hex(digits.data(), digits.size(), bytes.data(), bytes.size());
}

// The frame that shows most: the brightest reference, else the brightest of all.
const FrameRow* FrameToShow(const std::vector<FrameRow>& frames) {
  const FrameRow* best = nullptr;
  const auto worth = [](const FrameRow& f) {
    return std::pair(f.record.phase == CapturePhase::kReference, f.record.mean_dn);
  };
  for (const FrameRow& f : frames)
    if (best == nullptr || worth(f) > worth(*best)) best = &f;
  return best;
}

int ProjectorsOf(const SessionInfo& info) {
  if (const auto calibration = RigCalibration::FromJson(info.calibration_json);
      !info.calibration_json.empty() && calibration.ok())
    return static_cast<int>(calibration->projectors.size());
  const auto plan = PlanOptionsFromJson(info.plan_json);
  return !info.plan_json.empty() && plan.ok() ? plan->projectors : 0;
}

class CrateWriter {
 public:
  CrateWriter(const SessionStore& store, const CrateOptions& options, const CrateStaging& staging, CrateReport& report)
      : store_(store), options_(options), staging_(staging), report_(report) {}

  Status WriteSession(const SessionRow& row, Progress& progress) {
    SLX_ASSIGN_OR_RETURN(const auto frames, store_.ListFrames(row.info.id));
    SLX_ASSIGN_OR_RETURN(const auto fits, store_.ListFits(row.info.id));
    SLX_ASSIGN_OR_RETURN(const auto truth, CrateTruth::Open(store_.SessionFolder(row.info.id)));
    DescribedSession described;
    described.info = row.info;
    described.info.devices = store_.DevicesOf(row.info.id);
    described.info.visitor = PseudonymOf(row.info);
    described.frames = static_cast<int64_t>(frames.size());
    described.projectors = ProjectorsOf(row.info);
    prefix_ = "sessions/" + row.info.id + "/";
    if (!frames.empty()) described.thumbnail = std::string(kCratePreviewFolder) + "/" + row.info.id + ".png";
    SLX_RETURN_IF_ERROR(Announce(row.info.id, frames, fits, truth.Files()));
    SLX_RETURN_IF_ERROR(MakeFolder(staging_.folder() / prefix_));
    SLX_RETURN_IF_ERROR(WriteFrames(row.info.id, frames, described, progress));
    SLX_RETURN_IF_ERROR(WriteFacts(described, frames));
    SLX_RETURN_IF_ERROR(WriteFits(row, fits));
    SLX_RETURN_IF_ERROR(truth.Write(staging_.folder() / prefix_));
    for (const std::string& file : truth.Files()) SLX_RETURN_IF_ERROR(Count(prefix_ + file));
    report_.frames += described.frames;
    described_.push_back(std::move(described));
    return Status::Ok();
  }

  Status WriteDescription() {
    CrateDescription crate;
    crate.licence = options_.licence;
    crate.published = WallNow();
    crate.scope = options_.scope;
    crate.sessions = std::move(described_);
    std::set<std::string> rigs;
    Json ids = Json::array();
    for (const DescribedSession& s : crate.sessions) {
      rigs.insert(s.info.rig.empty() ? "unnamed" : s.info.rig);
      ids.push_back(s.info.id);
    }
    std::string names;
    for (const std::string& rig : rigs) names += (names.empty() ? "" : ", ") + rig;
    crate.name = options_.title.empty() ? "Sessions of " + names + ", " + ToIso8601(crate.published) : options_.title;
    crate.description = std::to_string(ids.size()) + " session(s) of the rig(s) " + names +
                        " captured under structured light with Stratalux: every frame with its proof, calibration, "
                        "plan, fits" +
                        (options_.scope == CrateScope::kNotStated
                             ? "."
                             : std::string(". Visitors' sessions are exported for ") + ToString(options_.scope) + ".");
    const Json format = {
        {"format", "stratalux-crate"}, {"version", kCrateFormatVersion}, {"written_by", kVersion}, {"sessions", ids}};
    SLX_RETURN_IF_ERROR(WriteText(kCrateFormatFile, format.dump(1) + "\n"));
    SLX_RETURN_IF_ERROR(WriteText(kCratePreviewFile, PreviewHtml(crate)));
    SLX_RETURN_IF_ERROR(WriteCrateMetadata(staging_.folder() / kCrateMetadataFile, crate, files_));
    SLX_RETURN_IF_ERROR(Count(kCrateMetadataFile));
    report_.files = static_cast<int64_t>(files_.size()) + 1;
    for (const auto& [path, sum] : files_) report_.bytes += sum.bytes;
    return ReplaceFile(staging_.folder() / kCrateManifestFile, CrateManifestText(files_));
  }

 private:
  // Before the first byte: the rows of the access log for both names, and the mark for `forget`. What is shared by all
  // sessions speaks of each, so it is in every mark.
  Status Announce(const std::string& id, const std::vector<FrameRow>& frames, const std::vector<FitRow>& fits,
                  const std::vector<std::string>& truth) {
    std::vector<std::string> names = {kCrateMetadataFile, kCratePreviewFile, kCrateManifestFile, kCrateFormatFile,
                                      std::string(kCratePreviewFolder) + "/" + id + ".png"};
    for (const char* name :
         {"session.json", "frames.csv", "plan.json", "fits.csv", "metrics.csv", "calibration/calibration.json",
          "calibration/cameras.txt", "calibration/images.txt", "calibration/points3D.txt"})
      names.push_back(prefix_ + name);
    for (const FrameRow& frame : frames) names.push_back(prefix_ + "frames/" + ExportedName(frame, options_.frames));
    for (const FitRow& fit : fits)
      for (const fs::path& file : FitFiles(store_.FitFolder(id, fit.id)))
        names.push_back(prefix_ + "fits/" + fit.id + "/" + file.string());
    for (const std::string& file : truth) names.push_back(prefix_ + file);
    SLX_RETURN_IF_ERROR(LogAccess(store_.folder(), "export", id, ExportPlace(staging_.out())));
    // The staging folder is ours alone: whoever has a mark there is in this crate.
    return BeginExport(store_.folder(), "export", id, staging_.folder(), names, ExportsIn(staging_.folder()));
  }

  Status WriteFrames(const std::string& id, const std::vector<FrameRow>& frames, DescribedSession& described,
                     Progress& progress) {
    const FrameRow* const shown = FrameToShow(frames);
    SLX_RETURN_IF_ERROR(MakeFolder(staging_.folder() / prefix_ / "frames"));
    const fs::path table = staging_.folder() / prefix_ / "frames.csv";
    std::ofstream rows(table, std::ios::binary | std::ios::trunc);
    rows << CrateFramesHeader();
    for (const FrameRow& frame : frames) {
      SLX_ASSIGN_OR_RETURN(const auto image, store_.ReadFrame(id, frame));
      const CrateFrame described_frame{frame, "frames/" + ExportedName(frame, options_.frames),
                                       CratePixelHash(frame.record.format, image)};
      const std::string path = prefix_ + described_frame.file;
      SLX_RETURN_IF_ERROR(WriteCrateFrame(staging_.folder() / path, options_.frames, image));
      SLX_RETURN_IF_ERROR(Count(path));
      rows << CrateFrameLine(described_frame);
      if (&frame == shown) SLX_RETURN_IF_ERROR(WritePicture(described.thumbnail, image));
      progress.Advance();
    }
    if (!frames.empty()) {
      static constexpr std::array kCfas = {"mono", "rggb", "bggr", "grbg", "gbrg"};
      described.cfa = kCfas[static_cast<size_t>(frames[0].record.cfa)];
      described.bit_depth = BitDepth(frames[0].record.format);
    }
    rows.close();
    if (!rows.good()) return Status::Failed("cannot write " + table.string() + "; is the disk full?");
    return Count(prefix_ + "frames.csv");
  }
  Status WritePicture(const std::string& path, const Image<uint16_t>& image) {
    SLX_RETURN_IF_ERROR(MakeFolder(staging_.folder() / kCratePreviewFolder));
    SLX_RETURN_IF_ERROR(WriteThumbnail(staging_.folder() / path, image));
    return Count(path);
  }

  Status WriteFacts(const DescribedSession& described, const std::vector<FrameRow>& frames) {
    const SessionInfo& info = described.info;
    SLX_RETURN_IF_ERROR(WriteText(prefix_ + "session.json", CrateSessionText(info, described.frames, options_.scope)));
    if (!info.plan_json.empty()) SLX_RETURN_IF_ERROR(WriteText(prefix_ + "plan.json", info.plan_json));
    if (info.calibration_json.empty()) return Status::Ok();
    // Byte for byte: its hash is the calibration's id.
    SLX_RETURN_IF_ERROR(WriteText(prefix_ + "calibration/calibration.json", info.calibration_json));
    const auto calibration = RigCalibration::FromJson(info.calibration_json);
    if (!calibration.ok()) {
      report_.notes.push_back("session " + info.id +
                              ": no COLMAP files, its calibration cannot be read: " + calibration.status().message());
      return Status::Ok();
    }
    const FrameRow* const shown = FrameToShow(frames);
    const ColmapText text =
        ColmapTextOf(*calibration, shown == nullptr ? "camera" : ExportedName(*shown, options_.frames));
    SLX_RETURN_IF_ERROR(WriteText(prefix_ + "calibration/cameras.txt", text.cameras));
    SLX_RETURN_IF_ERROR(WriteText(prefix_ + "calibration/images.txt", text.images));
    return WriteText(prefix_ + "calibration/points3D.txt", text.points);
  }

  Status WriteFits(const SessionRow& session, const std::vector<FitRow>& fits) {
    const SessionInfo& info = session.info;
    if (fits.empty()) return Status::Ok();
    SLX_RETURN_IF_ERROR(WriteText(prefix_ + "fits.csv", FitsCsv(fits)));
    SLX_RETURN_IF_ERROR(WriteText(prefix_ + "metrics.csv", MetricsCsv(fits)));
    const PseudonymChange change{info.visitor, PseudonymOf(info)};
    const FileSeal seal = SealOf(store_.folder(), info, session.key_id);
    for (const FitRow& fit : fits) SLX_RETURN_IF_ERROR(WriteFit(info.id, fit.id, seal, change));
    return Status::Ok();
  }
  // Of an encrypted visit unsealed, with a record of the plain files.
  Status WriteFit(const std::string& session, const std::string& fit, const FileSeal& seal,
                  const PseudonymChange& change) {
    const fs::path folder = store_.FitFolder(session, fit);
    const std::string prefix = prefix_ + "fits/" + fit + "/";
    SLX_ASSIGN_OR_RETURN(auto reader, FitReader::Open(folder, session, seal));
    for (const fs::path& file : FitFiles(folder)) {
      if (reader.sealed() && file == kFitRecordFile) continue;
      const std::string path = prefix + file.string();
      SLX_ASSIGN_OR_RETURN(const auto plain, reader.Read(file.string()));
      SLX_ASSIGN_OR_RETURN(const CopiedFit copied, CopyFitFile(plain.path, staging_.folder() / path, change));
      if (copied == CopiedFit::kCopied) {
        SLX_RETURN_IF_ERROR(Count(path));
      } else {
        report_.notes.push_back(path + " is left out: it may name the visitor by the store's pseudonym");
      }
    }
    if (!reader.sealed()) return Status::Ok();
    SLX_ASSIGN_OR_RETURN(const std::string record, reader.RecordOfCopy(staging_.folder() / prefix));
    return WriteText(prefix + kFitRecordFile, record);
  }

  Status WriteText(const std::string& path, const std::string& text) {
    SLX_RETURN_IF_ERROR(MakeFolder((staging_.folder() / path).parent_path()));
    SLX_RETURN_IF_ERROR(ReplaceFile(staging_.folder() / path, text));
    return Count(path);
  }
  Status Count(const std::string& path) {
    SLX_ASSIGN_OR_RETURN(files_[path], ChecksumOf(staging_.folder() / path));
    return Status::Ok();
  }

  // The visitor of all simulated captures is nobody, and keeps the name.
  std::string PseudonymOf(const SessionInfo& info) {
    const bool nobody = info.simulated && info.visitor == kSimulatedVisitor;
    if (info.visitor.empty() || nobody || options_.pseudonyms == CratePseudonyms::kKept) return info.visitor;
    const auto [known, fresh] = pseudonyms_.try_emplace(info.visitor);
    if (fresh) known->second = "p-" + RandomDigits();
    return known->second;
  }

  const SessionStore& store_;
  const CrateOptions& options_;
  const CrateStaging& staging_;
  CrateReport& report_;
  std::string prefix_;  // of the session at hand
  CrateFiles files_;
  std::map<std::string, std::string> pseudonyms_;
  std::vector<DescribedSession> described_;
};

// Who was forgotten or withdrew while the crate was written does not leave with it.
Status RefuseChanged(const fs::path& store, const std::vector<const SessionRow*>& chosen, CrateScope scope) {
  for (const SessionRow* row : chosen) {
    SLX_RETURN_IF_ERROR(RefuseForgotten(store, row->info.id).WithContext("while the crate was written"));
    SLX_RETURN_IF_ERROR(MayLeave(store, row->info, scope).WithContext("while the crate was written"));
  }
  return Status::Ok();
}

}  // namespace

const char* ToString(CrateScope scope) {
  switch (scope) {
    case CrateScope::kResearch:
      return "research";
    case CrateScope::kPublication:
      return "publication";
    case CrateScope::kNotStated:
      break;
  }
  return "";
}

Status CrateOptions::Validate() const {
  if (out.empty()) return Status::Usage("--crate needs the name of a new folder");
  const auto plain = [](unsigned char c) { return std::isalnum(c) != 0 || c == '.' || c == '-' || c == '+'; };
  if (licence.size() > 64 || !std::all_of(licence.begin(), licence.end(), plain))
    return Status::Usage("--licence '" + licence.substr(0, 64) +
                         "' is not an SPDX identifier, such as CC-BY-4.0 (https://spdx.org/licenses)");
  return Status::Ok();
}

Result<CrateReport> ExportCrate(const SessionStore& store, const std::vector<SessionRow>& sessions,
                                const CrateOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  CrateReport report;
  std::vector<const SessionRow*> chosen;
  int64_t frames = 0;
  for (const SessionRow& row : sessions) {
    const Status may = MayLeave(store.folder(), row.info, options.scope);
    if (!may.ok() && may.code() != StatusCode::kUsage) return may;
    if (!may.ok()) {
      report.refused.push_back({row.info.id, may.message()});
    } else if (std::none_of(chosen.begin(), chosen.end(), [&](auto* c) { return c->info.id == row.info.id; })) {
      chosen.push_back(&row);
      frames += row.frames;
    }
  }
  if (chosen.empty()) return report;
  // As they were captured, whatever order they were named in: an import numbers them so.
  std::sort(chosen.begin(), chosen.end(), [](auto* a, auto* b) { return a->info.id < b->info.id; });
  SLX_ASSIGN_OR_RETURN(CrateStaging staging, CrateStaging::Take(options.out));
  CrateWriter writer(store, options, staging, report);
  {
    Progress progress(logger, "export", frames);
    for (const SessionRow* row : chosen) SLX_RETURN_IF_ERROR(writer.WriteSession(*row, progress));
  }
  SLX_RETURN_IF_ERROR(writer.WriteDescription());
  SLX_RETURN_IF_ERROR(RefuseChanged(store.folder(), chosen, options.scope));
  SLX_RETURN_IF_ERROR(staging.Keep());
  for (const SessionRow* row : chosen) report.sessions.push_back(row->info.id);
  return report;
}

}  // namespace stratalux::db
