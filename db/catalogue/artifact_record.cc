// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/artifact_record.h"

#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

using SortedJson = nlohmann::json;  // members sorted: canonical

constexpr int kArtifactSchema = 1;

SortedJson IdentityJson(const ArtifactIdentity& identity) {
  SortedJson json = {{"stage", identity.stage},
                     {"version", identity.version},
                     {"options", SortedJson::parse(identity.options_json)},
                     {"inputs", identity.inputs},
                     {"isa", identity.isa}};
  if (!identity.seal.empty()) json["seal"] = identity.seal;
  return json;
}

}  // namespace

std::string ArtifactIdentity::Key() const { return HashHex(IdentityJson(*this).dump()); }

std::string ToJson(const ArtifactRecord& record) {
  nlohmann::ordered_json json = {{"schema", kArtifactSchema}};
  const SortedJson identity = IdentityJson(record.identity);
  for (const auto& [name, value] : identity.items()) json[name] = value;
  json["seconds"] = record.seconds;
  json["cpu_seconds"] = record.cpu_seconds;
  json["peak_rss_bytes"] = record.peak_rss_bytes;
  json["program"] = record.program;
  json["finished_wall_ns"] = record.finished_wall.ns;
  json["files"] = SortedJson::array();
  for (const RecordedFile& file : record.files)
    json["files"].push_back({{"name", file.name}, {"bytes", file.bytes}, {"xxh3_128", file.xxh3_128}});
  return WithOwnHash(json.dump(1));
}

Result<ArtifactRecord> ReadArtifactRecord(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / kArtifactRecordFile;
  if (std::error_code error; !std::filesystem::exists(file, error))
    return Status::NotFound(file.string() + " is missing");
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  if (CheckOwnHash(text) != OwnHash::kRight) return Status::Integrity(file.string() + " does not match its own hash");
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  try {
    const SortedJson json = SortedJson::parse(text);
    if (const auto schema = WholeAt<int64_t>(json, "schema"); schema != kArtifactSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(schema) +
                                                  ", this program reads " + std::to_string(kArtifactSchema) +
                                                  "; use a newer stratalux");
    ArtifactRecord record;
    json.at("stage").get_to(record.identity.stage);
    record.identity.version = WholeAt<int>(json, "version");
    record.identity.options_json = json.at("options").dump();
    json.at("inputs").get_to(record.identity.inputs);
    json.at("isa").get_to(record.identity.isa);
    if (json.contains("seal")) json.at("seal").get_to(record.identity.seal);
    json.at("seconds").get_to(record.seconds);
    json.at("cpu_seconds").get_to(record.cpu_seconds);
    record.peak_rss_bytes = WholeAt<int64_t>(json, "peak_rss_bytes");
    json.at("program").get_to(record.program);
    record.finished_wall.ns = WholeAt<int64_t>(json, "finished_wall_ns");
    for (const SortedJson& entry : json.at("files"))
      record.files.push_back({entry.at("name"), WholeAt<int64_t>(entry, "bytes"), entry.at("xxh3_128")});
    if (record.identity.FolderName() != folder.filename().string())
      return Status::Integrity(file.string() + " is of " + record.identity.FolderName());
    return record;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

std::string PlaceOfArtifact(const std::string& folder_name, const std::string& file) {
  return std::string(kArtifactsFolder) + "/" + folder_name + "/" + file;
}

Status CheckArtifactFiles(const std::filesystem::path& folder, const ArtifactRecord& record, FileDepth depth) {
  for (const RecordedFile& file : record.files)
    SLX_RETURN_IF_ERROR(CheckRecordedFile(folder, kArtifactRecordFile, file, depth));
  return Status::Ok();
}

}  // namespace stratalux::db
