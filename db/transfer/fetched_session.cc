// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/fetched_session.h"

#include <algorithm>

#include "db/base/durable_file.h"
#include "db/care/verify.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/fit_store.h"
#include "db/catalogue/manifest.h"
#include "db/keys/sealed_key.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

std::vector<fs::path> Sorted(const fs::path& folder) {
  std::vector<fs::path> paths;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) paths.push_back(entry.path());
  std::sort(paths.begin(), paths.end());
  return paths;
}

Status Remove(const fs::path& path) {
  std::error_code error;
  fs::remove_all(path, error);
  return error ? Status::Failed("cannot delete " + path.string() + ": " + error.message()) : Status::Ok();
}

Status LeaveOutSegments(const fs::path& folder, LeftOut& out) {
  const auto contents = ReadManifestContents(folder);
  if (!contents.ok()) return Status::Ok();  // the check of the folder speaks of it
  for (const fs::path& file : Sorted(folder)) {
    const std::string name = file.filename().string();
    const auto& named = contents->segments;
    if (!name.starts_with("frames-") || !name.ends_with(".seg") ||
        std::find(named.begin(), named.end(), name) != named.end())
      continue;
    SLX_RETURN_IF_ERROR(Remove(file));
    out.notes.push_back("session " + folder.filename().string() + ": " + name +
                        " was left out: the manifest does not name it");
  }
  return Status::Ok();
}

Status LeaveOutFits(const fs::path& folder, LeftOut& out) {
  const std::string session = folder.filename().string();
  for (const fs::path& fit : Sorted(folder / "fits")) {
    std::error_code error;
    if (!fs::exists(fit / kFitRecordFile, error)) {
      if (ReadFitRecord(fit, session).ok()) continue;  // of an older program, which wrote no record
      SLX_RETURN_IF_ERROR(Remove(fit));
      out.notes.push_back("fit " + session + "/" + fit.filename().string() + " was not fetched: it has no " +
                          kFitRecordFile + " yet, or has lost it");
      continue;
    }
    const auto proven = ReadProvenFit(fit, session);
    if (proven.ok()) continue;
    SLX_RETURN_IF_ERROR(Remove(fit));
    out.problems.push_back("fit " + session + "/" + fit.filename().string() +
                           " was not fetched: " + proven.status().message());
  }
  return Status::Ok();
}

// `key share` at the source seals them anew.
Status LeaveOutKeys(const fs::path& folder, LeftOut& out) {
  const std::string session = folder.filename().string();
  for (const fs::path& file : ListSealedKeys(folder)) {
    const auto header = ReadSealedKeyHeader(file);
    if (header.status().code() == StatusCode::kNewerSchema) continue;  // a later program will know
    if (header.ok() && header->session == session && SealedKeyFile(folder, header->reader) == file) continue;
    SLX_RETURN_IF_ERROR(WipeFile(file));
    out.problems.push_back(
        "session " + session + ": a sealed key was not fetched: " +
        (header.ok() ? file.string() + " is of another session or reader" : header.status().message()));
  }
  return Status::Ok();
}

}  // namespace

Result<LeftOut> LeaveOutUnproven(const fs::path& folder) {
  LeftOut out;
  SLX_RETURN_IF_ERROR(LeaveOutSegments(folder, out));
  SLX_RETURN_IF_ERROR(LeaveOutFits(folder, out));
  SLX_RETURN_IF_ERROR(LeaveOutKeys(folder, out));
  return out;
}

Result<std::vector<std::string>> DoubtsAbout(const fs::path& store_folder, const std::string& session_id) {
  SLX_ASSIGN_OR_RETURN(const auto store, SessionStore::Open(store_folder, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const SessionRow row, store.FindSession(session_id));
  SLX_ASSIGN_OR_RETURN(const VerifyReport report, VerifySession(store, row, {VerifyDepth::kHeaders}));
  return report.problems;
}

}  // namespace stratalux::db
