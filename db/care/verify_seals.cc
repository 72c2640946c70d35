// SPDX-License-Identifier: Apache-2.0
#include "db/care/verify_seals.h"

#include <filesystem>

#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

void CheckArtifact(const fs::path& folder, const FileSeal& seal, const std::string& session, VerifyReport& report) {
  const auto record = ReadArtifactRecord(folder);
  if (!record.ok()) return;  // damaged: who reads all bytes says so
  const std::string name = folder.filename().string();
  if (record->identity.seal != seal.key_id())
    return report.problems.push_back(folder.string() +
                                     ": plain artifact of an encrypted session, made by an older program; "
                                     "`stratalux-fit clean " +
                                     session + "` removes it");
  for (const RecordedFile& file : record->files) {
    const Status sealed = seal.CheckHeader(folder / file.name, {PlaceOfArtifact(name, file.name)});
    if (sealed.ok()) continue;
    return report.problems.push_back(sealed.message() + " (`stratalux-fit clean " + session +
                                     " --damaged` removes the artifact; it is made again)");
  }
}

void CheckFit(const fs::path& folder, const FileSeal& seal, const std::string& session, VerifyReport& report) {
  const auto names = NamesOfFiles(folder, kFitRecordFile);
  const auto fit = ReadFitRecord(folder, session);
  if (!names.ok() || !fit.ok()) return;  // as above
  for (const std::string& name : *names) {
    if (FitFilesLeftPlain().contains(name)) continue;
    const auto header = ReadSealedHeader(folder / name);
    if (header.ok() && !*header)
      return report.problems.push_back(folder.string() + ": plain fit of an encrypted session (" + name +
                                       "), made by an older program; `stratalux-fit clean " + session + "` seals it");
    if (const Status sealed = seal.CheckHeader(folder / name, PlacesOfFitFile(*fit, name)); !sealed.ok())
      report.problems.push_back(sealed.message());
  }
}

}  // namespace

void CheckSeals(const SessionStore& store, const SessionRow& session, VerifyReport& report) {
  const FileSeal seal = SealOf(store.folder(), session.info, session.key_id);
  if (!seal.active()) return;
  std::error_code error;
  const std::string& id = session.info.id;
  for (const auto& entry : fs::directory_iterator(store.SessionFolder(id) / kArtifactsFolder, error))
    if (!entry.path().filename().string().starts_with(".")) CheckArtifact(entry.path(), seal, id, report);
  const auto fits = store.ListFits(id);
  if (!fits.ok()) return report.problems.push_back(fits.status().message());
  for (const FitRow& fit : *fits)
    if (fs::exists(store.FitFolder(id, fit.id), error)) CheckFit(store.FitFolder(id, fit.id), seal, id, report);
}

}  // namespace stratalux::db
