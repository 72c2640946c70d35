// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/session_fits.h"

#include <algorithm>
#include <set>

#include "db/base/durable_file.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/privacy/export_marker.h"
#include "fitter/pipeline/interruption.h"
#include "fitter/pipeline/publish.h"
#include "fitter/session/choose_session.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

Result<bool> HoldsPlainFiles(const fs::path& fit) {
  SLX_ASSIGN_OR_RETURN(const auto names, db::NamesOfFiles(fit, db::kFitRecordFile));
  for (const std::string& name : names) {
    if (db::FitFilesLeftPlain().contains(name)) continue;
    SLX_ASSIGN_OR_RETURN(const auto header, db::ReadSealedHeader(fit / name));
    if (!header) return true;
  }
  return false;
}

// The sealed fit takes the place of the plain one in one step. The index says the same of both.
Status SealFit(const SessionFrames& frames, ArtifactStore& artifacts, const std::string& fit) {
  const fs::path place = frames.store().FitFolder(frames.info().id, fit), partial = place.string() + ".partial";
  SLX_ASSIGN_OR_RETURN(const KeyLock lock, artifacts.Lock(LockOfFit(fit), "enters the fit " + fit));
  SLX_RETURN_IF_ERROR(db::CheckFitFiles(place));
  SLX_ASSIGN_OR_RETURN(const db::FitRow row, db::ReadFitRecord(place, frames.info().id));
  const RemovedOnSignal guard(partial);
  std::error_code error;
  fs::remove_all(partial, error);
  {
    const NotInterrupted whole;
    fs::create_directory(partial, error);
  }
  const auto make = [&]() -> Status {
    if (error) return Status::Failed("cannot create " + partial.string() + ": " + error.message());
    SLX_RETURN_IF_ERROR(artifacts.files().SealFiles(place, partial, db::PlaceOfFit(fit), db::FitFilesLeftPlain()));
    fs::copy_file(place / "metrics.json", partial / "metrics.json", error);
    if (error) return Status::Failed("cannot copy to " + partial.string() + ": " + error.message());
    SLX_ASSIGN_OR_RETURN(const std::string record, db::FitRecordOf(partial, row));
    SLX_RETURN_IF_ERROR(db::ReplaceFile(partial / db::kFitRecordFile, record));
    SLX_RETURN_IF_ERROR(db::SyncTree(partial));
    SLX_RETURN_IF_ERROR(PutInPlace(partial, place));
    return db::SyncFolder(place.parent_path());
  };
  const Status made = make();
  if (!made.ok()) fs::remove_all(partial, error);
  return made;
}

}  // namespace

Result<CleanReport> CleanArtifacts(const std::string& store, const std::string& session, const CleanOptions& options,
                                   Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(store, session, SessionUse::kVisitor, logger));
  SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(store, chosen));
  SLX_ASSIGN_OR_RETURN(const db::FileSeal seal, db::FindSeal(frames.store(), frames.info().id));
  SLX_ASSIGN_OR_RETURN(auto artifacts, ArtifactStore::Open(frames.folder(), PlainFiles(seal), logger));
  std::set<std::string> plain;
  const auto wanted_by_fits = [&]() -> Result<std::set<std::string>> {
    std::set<std::string> wanted;
    SLX_ASSIGN_OR_RETURN(const auto fits, frames.store().ListFits(frames.info().id));
    for (const db::FitRow& fit : fits) {
      const fs::path folder = frames.store().FitFolder(frames.info().id, fit.id);
      const auto row = db::ReadFitRecord(folder, frames.info().id);
      if (!row.ok()) {
        logger.Warning(row.status().message() + "; the artifacts that it was made of are taken to be unused");
        continue;
      }
      for (const auto& [stage, name] : row->artifacts) wanted.insert(name);
      if (!seal.active()) continue;
      SLX_ASSIGN_OR_RETURN(const bool holds_plain, HoldsPlainFiles(folder));
      if (holds_plain) plain.insert(fit.id);
    }
    return wanted;
  };
  SLX_ASSIGN_OR_RETURN(auto report, artifacts.Clean(wanted_by_fits, options));
  for (const std::string& fit : plain) {
    if (!options.dry_run) SLX_RETURN_IF_ERROR(SealFit(frames, artifacts, fit));
    report.sealed.push_back(fit);
  }
  return report;
}

Result<std::vector<std::string>> SessionsWithArtifacts(const std::string& folder) {
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto sessions, store.ListSessions());
  std::vector<std::string> with;
  for (auto session = sessions.rbegin(); session != sessions.rend(); ++session) {
    std::error_code error;
    const fs::path artifacts = store.SessionFolder(session->info.id) / db::kArtifactsFolder;
    if (fs::is_directory(artifacts, error) && !fs::is_empty(artifacts, error)) with.push_back(session->info.id);
  }
  return with;
}

Result<StoredFit> NewestFit(const std::string& store_folder, const std::string& session, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(store_folder, session, SessionUse::kFit, logger));
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(store_folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto row, store.FindSession(chosen));
  SLX_ASSIGN_OR_RETURN(const auto fits, store.ListFits(row.info.id));
  if (fits.empty())
    return Status::NotFound("session " + row.info.id + " has no complete fit (`stratalux-fit run " + row.info.id +
                            "`)");
  return StoredFit{row.info.id, fits[0].id, store.FitFolder(row.info.id, fits[0].id),
                   db::SealOf(store.folder(), row.info, row.key_id)};
}

Result<StoredFit> NamedFit(const std::string& store_folder, const std::string& session, const std::string& fit,
                           Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(store_folder, session, SessionUse::kFit, logger));
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(store_folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto row, store.FindSession(chosen));
  SLX_ASSIGN_OR_RETURN(const auto fits, store.ListFits(row.info.id));
  if (std::none_of(fits.begin(), fits.end(), [&](const db::FitRow& one) { return one.id == fit; }))
    return Status::NotFound("session " + row.info.id + " has no fit " + fit + " (`stratalux-db show` lists them)");
  return StoredFit{row.info.id, fit, store.FitFolder(row.info.id, fit),
                   db::SealOf(store.folder(), row.info, row.key_id)};
}

Status ReadFit(const StoredFit& fit, const UseOfFolder& read) {
  if (std::error_code error; fs::exists(fit.folder / db::kFitRecordFile, error))
    SLX_RETURN_IF_ERROR(db::CheckFitFiles(fit.folder));
  db::FitRow row;
  if (fit.seal.active()) {
    SLX_ASSIGN_OR_RETURN(row, db::ReadFitRecord(fit.folder, fit.session));
  }
  const auto places = [&](const std::string& name) { return db::PlacesOfFitFile(row, name); };
  return PlainFiles(fit.seal).Read(fit.folder, places, db::FitFilesLeftPlain(), read);
}

Status CopyFit(const std::string& store, const StoredFit& fit, const std::string& action, const fs::path& out) {
  SLX_ASSIGN_OR_RETURN(auto reader, db::FitReader::Open(fit.folder, fit.session, fit.seal));
  SLX_ASSIGN_OR_RETURN(const auto names, db::NamesOfFiles(fit.folder, db::kFitRecordFile));
  // Opened before anything is written: without the key nothing is.
  if (!names.empty()) SLX_RETURN_IF_ERROR(reader.Read(names.front()).status());
  return db::WriteExport(store, action, fit.session, out, names, [&]() -> Status {
    for (const std::string& name : names) {
      SLX_ASSIGN_OR_RETURN(const auto plain, reader.Read(name));
      SLX_RETURN_IF_ERROR(db::MakeFolder((out / name).parent_path()));
      SLX_RETURN_IF_ERROR(db::WriteExportedFile(out / name, [&](const fs::path& beside) -> Status {
        std::error_code error;
        fs::remove(beside, error);  // of a killed copy: as read-only as the fit's
        fs::copy_file(plain.path, beside, error);
        return error ? Status::Failed("cannot write " + beside.string() + ": " + error.message()) : Status::Ok();
      }));
    }
    return Status::Ok();
  });
}

}  // namespace stratalux::fit
