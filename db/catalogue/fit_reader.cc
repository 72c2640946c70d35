// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/fit_reader.h"

#include <cerrno>
#include <cstring>

#include <sys/mman.h>

#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_record.h"

namespace stratalux::db {

namespace fs = std::filesystem;

FileSeal SealOf(const fs::path& store, const SessionInfo& session, const std::string& key_id) {
  const bool shows_somebody = session.kind == SessionKind::kVisitor;
  return {store, session.id, shows_somebody ? key_id : ""};
}

Result<FileSeal> FindSeal(const SessionStore& store, const std::string& session_id) {
  SLX_ASSIGN_OR_RETURN(const SessionRow row, store.FindSession(session_id));
  return SealOf(store.folder(), row.info, row.key_id);
}

const std::set<std::string>& FitFilesLeftPlain() {
  static const std::set<std::string> names = {kFitRecordFile, "metrics.json"};
  return names;
}

std::string PlaceOfFit(const std::string& fit) { return "fits/" + fit; }

std::set<std::string> PlacesOfFitFile(const FitRow& fit, const std::string& name) {
  std::set<std::string> places = {PlaceOfFit(fit.id) + "/" + name};
  for (const auto& [stage, folder] : fit.artifacts) places.insert(PlaceOfArtifact(folder, name));
  return places;
}

Result<FitReader> FitReader::Open(const fs::path& folder, const std::string& session_id, FileSeal seal) {
  FitReader reader(folder, std::move(seal));
  if (!reader.sealed()) return reader;
  std::error_code error;
  if (!fs::exists(folder / kFitRecordFile, error))
    return Status::Integrity((folder / kFitRecordFile).string() +
                             " is missing: without it the files of the fit are not known; `stratalux-fit run` fits "
                             "again");
  SLX_ASSIGN_OR_RETURN(reader.fit_, ReadFitRecord(folder, session_id));
  return reader;
}

Result<ReadableFile> FitReader::Read(const std::string& name) {
  if (!sealed() || FitFilesLeftPlain().contains(name)) return ReadableFile{{}, folder_ / name};
  ReadableFile file{UniqueFd(memfd_create("stratalux", MFD_CLOEXEC)), {}};
  if (!file.memory.ok()) return Status::Failed(std::string("cannot keep a file in memory: ") + std::strerror(errno));
  file.path = "/proc/self/fd/" + std::to_string(file.memory.get());
  SLX_RETURN_IF_ERROR(seal_.Open(folder_ / name, PlacesOfFitFile(fit_, name), file.path));
  return file;
}

Result<std::string> FitReader::RecordOfCopy(const fs::path& copy) const { return FitRecordOf(copy, fit_); }

}  // namespace stratalux::db
