// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/fit_record.h"

#include <nlohmann/json.hpp>
#include <sys/stat.h>

#include "db/base/own_hash.h"
#include "db/catalogue/recorded_files.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::db {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

namespace {

constexpr int64_t kFitSchema = 2;  // 1: may lack its own hash and the list of its files

}  // namespace

Result<std::string> FitRecordOf(const fs::path& folder, const FitRow& fit) {
  // Options and metrics as texts: the index holds them byte for byte.
  Json json = {{"schema", kFitSchema},
               {"fit", fit.id},
               {"session", fit.session},
               {"created_wall_ns", fit.created_wall.ns},
               {"options_json", fit.options_json},
               {"metrics_json", fit.metrics_json}};
  if (!fit.artifacts.empty()) json["artifacts"] = fit.artifacts;
  json["files"] = Json::array();
  SLX_ASSIGN_OR_RETURN(const auto files, ListFiles(folder, kFitRecordFile));
  for (const RecordedFile& file : files)
    json["files"].push_back({{"name", file.name}, {"bytes", file.bytes}, {"xxh3_128", file.xxh3_128}});
  return WithOwnHash(json.dump(1, ' ', false, Json::error_handler_t::replace));
}

namespace {

// As it was written.
Result<Json> ReadRecord(const fs::path& file) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  const OwnHash hash = CheckOwnHash(text);
  if (hash == OwnHash::kWrong) return Status::Integrity(file.string() + " does not match its own hash");
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  try {
    Json json = Json::parse(text);
    const auto schema = WholeAt<int64_t>(json, "schema");
    if (schema < 1 || schema > kFitSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(schema) +
                                                  " is newer than this program's " + std::to_string(kFitSchema) +
                                                  "; use a newer stratalux");
    if (schema == kFitSchema && hash == OwnHash::kNone) return Status::Integrity(file.string() + " lost its own hash");
    return json;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

}  // namespace

Status CheckFitFiles(const fs::path& folder) {
  const fs::path file = folder / kFitRecordFile;
  SLX_ASSIGN_OR_RETURN(const Json json, ReadRecord(file));
  try {
    if (json.at("schema") != kFitSchema && !json.contains("files")) return Status::Ok();
    const auto& files = json.at("files").get_ref<const Json::array_t&>();
    SLX_ASSIGN_OR_RETURN(const auto found, NamesOfFiles(folder, kFitRecordFile));
    if (files.empty() && !found.empty())
      return Status::Integrity(file.string() + " names no file, and " + folder.string() + " holds " + found.front());
    for (const Json& entry : files)
      SLX_RETURN_IF_ERROR(CheckRecordedFile(folder, kFitRecordFile,
                                            {entry.at("name").get<std::string>(), WholeAt<int64_t>(entry, "bytes"),
                                             entry.at("xxh3_128").get<std::string>()},
                                            FileDepth::kHashes));
    return Status::Ok();
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

namespace {

Result<FitRow> FromMetrics(const std::filesystem::path& folder, const std::string& session) {
  const auto file = folder / "metrics.json";
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  const Json json = Json::parse(text, nullptr, false);
  struct stat info {};
  if (!json.is_object() || stat(file.c_str(), &info) != 0) return Status::Integrity(file.string() + ": no metrics");
  FitRow fit{folder.filename().string(), session, "", text, {}};
  if (json.contains("options")) fit.options_json = json["options"].dump();
  fit.created_wall.ns = int64_t{info.st_mtim.tv_sec} * 1'000'000'000 + info.st_mtim.tv_nsec;
  return fit;
}

}  // namespace

Result<FitRow> ReadFitRecord(const std::filesystem::path& folder, const std::string& session) {
  const auto file = folder / kFitRecordFile;
  if (std::error_code error; !std::filesystem::exists(file, error)) return FromMetrics(folder, session);
  SLX_ASSIGN_OR_RETURN(const Json json, ReadRecord(file));
  try {
    FitRow fit;
    json.at("fit").get_to(fit.id);
    json.at("session").get_to(fit.session);
    fit.created_wall.ns = WholeAt<int64_t>(json, "created_wall_ns");
    json.at("options_json").get_to(fit.options_json);
    json.at("metrics_json").get_to(fit.metrics_json);
    if (json.contains("artifacts")) json.at("artifacts").get_to(fit.artifacts);
    for (const std::string& text : {fit.options_json, fit.metrics_json})
      SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
    if (fit.id != folder.filename() || fit.session != session)
      return Status::Integrity(file.string() + " is of fit " + fit.id + " of session " + fit.session);
    return fit;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

}  // namespace stratalux::db
