// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/file_list.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;
constexpr int kListSchema = 1;

bool StaysInside(const std::filesystem::path& path) {
  return !path.empty() && path.is_relative() &&
         std::none_of(path.begin(), path.end(), [](const auto& part) { return part == ".."; });
}

}  // namespace

Status WriteFileList(const std::filesystem::path& folder, const FileList& list) {
  Json files = Json::array();
  for (const auto& [path, file] : list.files)
    files.push_back(
        {{"path", path}, {"bytes", file.bytes}, {"source_mtime_ns", file.source_mtime_ns}, {"xxh3_128", file.hash}});
  const Json json = {{"schema", kListSchema},
                     {"made_wall_ns", list.made_wall.ns},
                     {"program_version", list.program_version},
                     {"files", files}};
  return ReplaceFile(folder / "backup.json", json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

Result<FileList> ReadFileList(const std::filesystem::path& folder) {
  const auto file = folder / "backup.json";
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file, kAnyFileSize));  // a line a file of the store
  try {
    const Json json = Json::parse(text);
    if (json.at("schema").get<int>() > kListSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + json.at("schema").dump() +
                                                  " is newer than this program's; use a newer stratalux");
    FileList list;
    json.at("made_wall_ns").get_to(list.made_wall.ns);
    json.at("program_version").get_to(list.program_version);
    for (const Json& entry : json.at("files")) {
      const auto path = entry.at("path").get<std::string>();
      if (!StaysInside(path)) return Status::Integrity(file.string() + ": path '" + path + "' leaves the backup");
      list.files[path] = {entry.at("bytes").get<int64_t>(), entry.at("source_mtime_ns").get<int64_t>(),
                          entry.at("xxh3_128").get<std::string>()};
    }
    return list;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

}  // namespace stratalux::db
