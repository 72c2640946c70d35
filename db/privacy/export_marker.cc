// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/export_marker.h"

#include <algorithm>
#include <array>
#include <set>
#include <sstream>

#include <nlohmann/json.hpp>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/paths.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/privacy/access_log.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
constexpr std::string_view kPrefix = ".stratalux-export-", kSuffix = ".json";
constexpr const char* kBeside = ".new";   // of a file while it is written
constexpr uintmax_t kOverwritten = 4096;  // bytes

Result<std::vector<std::string>> ReadMarker(const fs::path& file, const std::string& session_id) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object() || json.value("session", "") != session_id || !json.contains("files"))
    return Status::Integrity(file.string() + " is not an export marker of session " + session_id);
  std::vector<std::string> files;
  for (const Json& name : json["files"])
    if (name.is_string()) files.push_back(name.get<std::string>());
  return files;
}

// A forgetting of the other session would delete what is written there under its files' names.
Status RefuseFilesOfOthers(const fs::path& folder, const std::string& session_id, const std::vector<std::string>& files,
                           const std::vector<std::string>& together) {
  for (const std::string& other : ExportsIn(folder)) {
    if (other == session_id || std::ranges::find(together, other) != together.end()) continue;
    const auto listed = ReadMarker(ExportMarker(folder, other), other);
    if (!listed.ok()) {
      // Forgotten meanwhile, or damaged: by such a marker nothing is deleted.
      if (const StatusCode code = listed.status().code();
          code == StatusCode::kNotFound || code == StatusCode::kIntegrity)
        continue;
      return listed.status();
    }
    const std::set<std::string> theirs(listed->begin(), listed->end());
    for (const std::string& name : files)
      if (theirs.contains(name))
        return Status::Usage(folder.string() + " holds an export of session " + other + ", and " + name +
                             " is one of its files: choose another folder");
  }
  return Status::Ok();
}

// Forgotten, or withdrawn: what goes with the next purge is not handed out to others before.
Status RefuseLeaving(const fs::path& store, const std::string& session_id, ExportFor whom) {
  SLX_RETURN_IF_ERROR(RefuseForgotten(store, session_id));
  if (whom == ExportFor::kVisitor) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const auto withdrawn, SessionWithdrawnOn(store, session_id));
  if (!withdrawn) return Status::Ok();
  return Status::Usage("session " + session_id + ": the consent that it was made under was withdrawn on " +
                       ToIso8601(*withdrawn) + "; it cannot leave the store any more");
}

std::string HostName() {
  std::array<char, 256> name{};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "localhost";
}

}  // namespace

fs::path ExportMarker(const fs::path& folder, const std::string& session_id) {
  return folder / (std::string(kPrefix) + session_id + std::string(kSuffix));
}

bool IsInExport(const fs::path& file, const std::string& session_id) {
  const auto files = ReadMarker(ExportMarker(file.parent_path(), session_id), session_id);
  return files.ok() && std::ranges::find(*files, file.filename().string()) != files->end();
}

Status WriteExportMarker(const fs::path& folder, const std::string& session_id, const std::vector<std::string>& files) {
  std::set<std::string> all;
  const fs::path marker = ExportMarker(folder, session_id);
  if (const auto earlier = ReadMarker(marker, session_id); earlier.ok()) all.insert(earlier->begin(), earlier->end());
  for (const std::string& name : files) {
    if (!StaysInside(name)) return Status::Usage("export file '" + name + "' lies outside " + folder.string());
    all.insert(name);
  }
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  const Json json = {{"schema", 1},
                     {"session", session_id},
                     {"about", "files of this session; `stratalux-db forget` deletes them"},
                     {"files", all}};
  return ReplaceFile(marker, json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

Status BeginExport(const fs::path& store, const std::string& action, const std::string& session_id,
                   const fs::path& folder, const std::vector<std::string>& files,
                   const std::vector<std::string>& together, ExportFor whom) {
  SLX_RETURN_IF_ERROR(RefuseLeaving(store, session_id, whom));
  SLX_RETURN_IF_ERROR(RefuseFilesOfOthers(folder, session_id, files, together));
  SLX_RETURN_IF_ERROR(LogAccess(store, action, session_id, ExportPlace(folder)));
  // And behind the row: a forgetting that is entered later finds it, one that was entered before is seen here.
  SLX_RETURN_IF_ERROR(RefuseLeaving(store, session_id, whom));
  std::vector<std::string> with_beside = files;
  for (const std::string& name : files) with_beside.push_back(name + kBeside);
  return WriteExportMarker(folder, session_id, with_beside);
}

Status WriteExportedFile(const fs::path& file, const std::function<Status(const fs::path&)>& write) {
  const fs::path beside = file.string() + kBeside;
  Status written = write(beside);
  if (written.ok()) written = KeepFile(beside, file);
  std::error_code error;
  if (!written.ok()) fs::remove(beside, error);
  return written;
}

Status EndExport(const fs::path& store, const std::string& session_id, const fs::path& folder,
                 const std::vector<std::string>& files, ExportFor whom) {
  const Status stays = RefuseLeaving(store, session_id, whom);
  if (stays.code() != StatusCode::kUsage) return stays;
  // A forgetting may have taken the marker before the last files came.
  SLX_RETURN_IF_ERROR(WriteExportMarker(folder, session_id, files));
  SLX_RETURN_IF_ERROR(RemoveExport(ExportPlace(folder), session_id).status());
  return stays.WithContext("what was exported until then is deleted again");
}

Status WriteExport(const fs::path& store, const std::string& action, const std::string& session_id,
                   const fs::path& folder, const std::vector<std::string>& files, const std::function<Status()>& write,
                   ExportFor whom) {
  SLX_RETURN_IF_ERROR(BeginExport(store, action, session_id, folder, files, {}, whom));
  const Status written = write();
  const Status stays = EndExport(store, session_id, folder, files, whom);
  return stays.ok() ? written : stays;
}

std::vector<std::string> ExportsIn(const fs::path& folder) {
  std::vector<std::string> sessions;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder.empty() ? fs::path(".") : folder, error)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with(kPrefix) && name.ends_with(kSuffix) && name.size() > kPrefix.size() + kSuffix.size())
      sessions.push_back(name.substr(kPrefix.size(), name.size() - kPrefix.size() - kSuffix.size()));
  }
  std::sort(sessions.begin(), sessions.end());
  return sessions;
}

std::string ExportPlace(const fs::path& folder) {
  std::error_code error;
  // Absolute first: of a relative name that is not there yet the other makes nothing whole.
  const fs::path absolute = fs::absolute(folder), whole = fs::weakly_canonical(absolute, error);
  return HostName() + ":" + (error ? absolute : whole).string();
}

std::optional<fs::path> LocalFolder(const std::string& place) {
  const std::string host = HostName() + ":";
  if (!place.starts_with(host)) return std::nullopt;
  return fs::path(place.substr(host.size()));
}

const char* ToString(ExportState state) {
  switch (state) {
    case ExportState::kDeleted:
      return "deleted";
    case ExportState::kElsewhere:
      return "on another machine";
    case ExportState::kNotThere:
      return "no export there any more";
    case ExportState::kNoFolder:
      return "its folder is not there (a disk that is not mounted?)";
    case ExportState::kKept:
      break;
  }
  return "could not be deleted";
}

std::string HiddenBy(const std::string& mountinfo, const fs::path& folder) {
  std::istringstream lines(mountinfo);
  std::string hidden_by;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string id, parent, device, root, point;
    words >> id >> parent >> device >> root >> point;
    const bool made_so =
        root.find("/systemd-private-") != std::string::npos || root.find("/inaccessible/") != std::string::npos;
    // Later mounts lie on top.
    if (!point.empty() && LiesIn(folder, point)) hidden_by = made_so ? point : "";
  }
  return hidden_by;
}

Result<bool> IsExportThere(const fs::path& folder, const std::string& session_id) {
  std::error_code error;
  const fs::path marker = ExportMarker(folder, session_id);
  const fs::file_status found = fs::symlink_status(marker, error);
  if (fs::exists(found)) return true;
  if (found.type() != fs::file_type::not_found)
    return Status::Failed("cannot check " + marker.string() + ": " + error.message());
  const auto mounts = ReadFile("/proc/self/mountinfo", kAnyFileSize);
  if (const std::string point = mounts.ok() ? HiddenBy(*mounts, folder) : ""; !point.empty())
    return Status::Failed(
        "cannot check " + marker.string() + ": " + point +
        " is hidden from this unit (PrivateTmp, ProtectHome); run `stratalux-db forget --resume` from a shell");
  return false;
}

ExportState StateWithoutMarker(const fs::path& folder) {
  std::error_code error;
  return fs::exists(folder, error) ? ExportState::kNotThere : ExportState::kNoFolder;
}

Result<ExportState> RemoveExport(const std::string& place, const std::string& session_id) {
  const auto folder = LocalFolder(place);
  if (!folder) return ExportState::kElsewhere;
  const fs::path marker = ExportMarker(*folder, session_id);
  SLX_ASSIGN_OR_RETURN(const bool there, IsExportThere(*folder, session_id));
  if (!there) return StateWithoutMarker(*folder);
  SLX_ASSIGN_OR_RETURN(const auto files, ReadMarker(marker, session_id));
  std::error_code error;
  std::set<fs::path> folders;
  for (const std::string& name : files) {
    if (!StaysInside(name)) continue;  // not ours: no marker of ours names such a file
    // And by the names that it has while it is written: an export that was killed leaves one.
    for (const char* unfinished : {"", ".new", ".part", ".part.new"}) {
      const fs::path file = (*folder / name).string() + unfinished;
      // Small files may be keys.
      if (fs::file_size(file, error) <= kOverwritten && !error) SLX_RETURN_IF_ERROR(WipeFile(file));
      fs::remove(file, error);
      if (error) return Status::Failed("cannot delete " + file.string() + ": " + error.message());
    }
    for (fs::path up = fs::path(name).parent_path(); !up.empty(); up = up.parent_path()) folders.insert(up);
  }
  for (auto sub = folders.rbegin(); sub != folders.rend(); ++sub) fs::remove(*folder / *sub, error);  // if empty
  // While the marker names them: a power cut must not bring back what nothing looks for any more.
  for (const fs::path& sub : folders)
    if (fs::is_directory(*folder / sub, error)) SLX_RETURN_IF_ERROR(SyncFolder(*folder / sub));
  SLX_RETURN_IF_ERROR(SyncFolder(*folder));
  fs::remove(marker, error);
  if (error) return Status::Failed("cannot delete " + marker.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncFolder(*folder));
  fs::remove(*folder, error);  // if empty
  return ExportState::kDeleted;
}

}  // namespace stratalux::db
