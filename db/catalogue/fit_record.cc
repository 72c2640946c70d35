// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/fit_record.h"

#include <algorithm>
#include <fstream>
#include <memory>
#include <vector>

#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <xxhash.h>

#include "db/base/own_hash.h"
#include "db/base/paths.h"
#include "db/segment/segment.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::db {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

namespace {

constexpr int64_t kSchema = 2;  // 1: may lack its own hash and the list of its files

// XXH3-128 of a file's bytes, 32 hex digits.
Result<std::string> HashOf(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) return Status::Failed("cannot read " + file.string());
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(), XXH3_freeState);
  XXH3_128bits_reset(state.get());
  std::vector<char> buffer(1 << 20);
  while (in.read(buffer.data(), static_cast<std::streamsize>(buffer.size())) || in.gcount() > 0)
    XXH3_128bits_update(state.get(), buffer.data(), static_cast<size_t>(in.gcount()));
  if (in.bad()) return Status::Failed("cannot read " + file.string());
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits_digest(state.get()));
  return HashText(canonical.digest);
}

// Regular files at and below the folder, by their names within it, sorted; fit.json is not one of its own files.
Result<std::vector<std::string>> FilesOf(const fs::path& folder) {
  std::vector<std::string> names;
  std::error_code error;
  for (auto entry = fs::recursive_directory_iterator(folder, error); !error && entry != fs::end(entry);
       entry.increment(error)) {
    const std::string name = entry->path().lexically_relative(folder).string();
    if (fs::is_regular_file(entry->symlink_status(error)) && name != kFitRecordFile &&
        name != std::string(kFitRecordFile) + ".new")
      names.push_back(name);
  }
  if (error) return Status::Failed("cannot read " + folder.string() + ": " + error.message());
  std::sort(names.begin(), names.end());
  return names;
}

// No part of the name may be a link: it could lead out of the folder.
Status CheckFile(const fs::path& folder, const std::string& name, int64_t bytes, const std::string& hash) {
  if (!StaysInside(name))
    return Status::Integrity((folder / kFitRecordFile).string() + ": '" + name + "' is no file of the fit");
  const fs::path file = folder / name;
  std::error_code error;
  fs::path at = folder;
  for (const fs::path& part : fs::path(name)) {
    at /= part;
    const auto type = fs::symlink_status(at, error).type();
    if (type == fs::file_type::not_found) return Status::Integrity(file.string() + " of the fit is missing");
    if (type != fs::file_type::directory && type != fs::file_type::regular)
      return Status::Integrity(at.string() + " is a link or no regular file");
  }
  const auto size = fs::file_size(file, error);
  if (error || static_cast<int64_t>(size) != bytes)
    return Status::Integrity(file.string() + " has " + (error ? "no" : std::to_string(size)) + " bytes, " +
                             kFitRecordFile + " says " + std::to_string(bytes));
  SLX_ASSIGN_OR_RETURN(const std::string found, HashOf(file));
  if (found != hash) return Status::Integrity(file.string() + " is not the file that " + kFitRecordFile + " names");
  return Status::Ok();
}

}  // namespace

Result<std::string> FitRecordOf(const fs::path& folder, const FitRow& fit) {
  // Options and metrics as texts: the index holds them byte for byte.
  Json json = {{"schema", kSchema},
               {"fit", fit.id},
               {"session", fit.session},
               {"created_wall_ns", fit.created_wall.ns},
               {"options_json", fit.options_json},
               {"metrics_json", fit.metrics_json},
               {"files", Json::array()}};
  SLX_ASSIGN_OR_RETURN(const auto names, FilesOf(folder));
  for (const std::string& name : names) {
    std::error_code error;
    const auto bytes = fs::file_size(folder / name, error);
    if (error) return Status::Failed("cannot read " + (folder / name).string() + ": " + error.message());
    SLX_ASSIGN_OR_RETURN(const std::string hash, HashOf(folder / name));
    json["files"].push_back({{"name", name}, {"bytes", bytes}, {"xxh3_128", hash}});
  }
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
    if (schema < 1 || schema > kSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(schema) +
                                                  " is newer than this program's " + std::to_string(kSchema) +
                                                  "; use a newer stratalux");
    if (schema == kSchema && hash == OwnHash::kNone) return Status::Integrity(file.string() + " lost its own hash");
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
    if (json.at("schema") != kSchema && !json.contains("files")) return Status::Ok();
    const auto& files = json.at("files").get_ref<const Json::array_t&>();
    SLX_ASSIGN_OR_RETURN(const auto found, FilesOf(folder));
    if (files.empty() && !found.empty())
      return Status::Integrity(file.string() + " names no file, and " + folder.string() + " holds " + found.front());
    for (const Json& entry : files)
      SLX_RETURN_IF_ERROR(CheckFile(folder, entry.at("name").get<std::string>(), WholeAt<int64_t>(entry, "bytes"),
                                    entry.at("xxh3_128").get<std::string>()));
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
