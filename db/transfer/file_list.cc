// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/file_list.h"

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/own_hash.h"
#include "db/base/paths.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;
constexpr int kListSchema = 2;

Json JsonOf(const std::string& path, const ListedFile& file) {
  return {{"path", path},
          {"bytes", file.bytes},
          {"source_mtime_ns", file.source_mtime_ns},
          {"xxh3_128", file.hash},
          {"checked_wall_ns", file.checked_wall.ns}};
}

// Throws nlohmann's exceptions.
std::pair<std::string, ListedFile> FileOf(const Json& entry) {
  ListedFile file{WholeAt<int64_t>(entry, "bytes"),
                  WholeAt<int64_t>(entry, "source_mtime_ns"),
                  entry.at("xxh3_128").get<std::string>(),
                  {WholeOr<int64_t>(entry, "checked_wall_ns", 0)}};
  return {entry.at("path").get<std::string>(), std::move(file)};
}

}  // namespace

Status WriteFileList(const std::filesystem::path& folder, const FileList& list) {
  Json files = Json::array();
  for (const auto& [path, file] : list.files) files.push_back(JsonOf(path, file));
  const Json json = {
      {"schema", kListSchema},         {"made_wall_ns", list.made_wall.ns}, {"program_version", list.program_version},
      {"scrub_runs", list.scrub_runs}, {"problems", list.problems},         {"files", files}};
  return ReplaceFile(folder / "backup.json", WithOwnHash(json.dump(1, ' ', false, Json::error_handler_t::replace)));
}

Result<FileList> ReadFileList(const std::filesystem::path& folder) {
  const auto file = folder / "backup.json";
  std::error_code error;
  if (!std::filesystem::exists(file, error))
    return Status::NotFound(std::filesystem::exists(folder / kBackupJournal, error)
                                ? folder.string() +
                                      " holds a backup that was never finished; run `stratalux-db backup"
                                      " --to` once more"
                                : folder.string() + " is not a backup (it has no backup.json)");
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file, kAnyFileSize));  // a line a file of the store
  try {
    const Json json = Json::parse(text);
    if (WholeAt<int64_t>(json, "schema") > kListSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + json.at("schema").dump() +
                                                  " is newer than this program's; use a newer stratalux");
    FileList list;
    list.intact = CheckOwnHash(text) != OwnHash::kWrong;
    list.made_wall.ns = WholeAt<int64_t>(json, "made_wall_ns");
    json.at("program_version").get_to(list.program_version);
    list.scrub_runs = WholeOr<int64_t>(json, "scrub_runs", 0);
    list.problems = json.value("problems", std::vector<std::string>());
    for (const Json& entry : json.at("files")) {
      auto [path, listed] = FileOf(entry);
      if (!StaysInside(path)) return Status::Integrity(file.string() + ": path '" + path + "' leaves the backup");
      list.files[path] = std::move(listed);
    }
    return list;
  } catch (const nlohmann::json::exception& damage) {
    return Status::Integrity(file.string() + ": " + damage.what());
  }
}

std::string ListedFileLine(const std::string& path, const ListedFile& file) {
  return JsonOf(path, file).dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::optional<std::pair<std::string, ListedFile>> ParseListedFileLine(const std::string& line) {
  try {
    auto parsed = FileOf(Json::parse(line));
    if (StaysInside(parsed.first)) return parsed;
  } catch (const nlohmann::json::exception&) {  // torn, or no line of ours: that file is copied again
  }
  return std::nullopt;
}

std::string SessionOfPath(const std::string& path) {
  constexpr std::string_view kSessions = "sessions/";
  if (!path.starts_with(kSessions)) return {};
  const size_t slash = path.find('/', kSessions.size());
  return slash == std::string::npos ? std::string() : path.substr(kSessions.size(), slash - kSessions.size());
}

}  // namespace stratalux::db
