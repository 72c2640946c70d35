// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/fit_record.h"

#include <nlohmann/json.hpp>
#include <sys/stat.h>

#include "db/base/durable_file.h"
#include "shared/base/read_file.h"

namespace stratalux::db {

using Json = nlohmann::ordered_json;

Status WriteFitRecord(const std::filesystem::path& folder, const FitRow& fit) {
  SLX_RETURN_IF_ERROR(MakeFolder(folder));
  // Options and metrics as texts: the index holds them byte for byte.
  const Json json = {{"schema", 1},
                     {"fit", fit.id},
                     {"session", fit.session},
                     {"created_wall_ns", fit.created_wall.ns},
                     {"options_json", fit.options_json},
                     {"metrics_json", fit.metrics_json}};
  return ReplaceFile(folder / "fit.json", json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n");
}

namespace {

Result<FitRow> FromMetrics(const std::filesystem::path& folder, const std::string& session) {
  const auto file = folder / "metrics.json";
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
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
  const auto file = folder / "fit.json";
  if (std::error_code error; !std::filesystem::exists(file, error)) return FromMetrics(folder, session);
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  try {
    const Json json = Json::parse(text);
    FitRow fit;
    json.at("fit").get_to(fit.id);
    json.at("session").get_to(fit.session);
    json.at("created_wall_ns").get_to(fit.created_wall.ns);
    json.at("options_json").get_to(fit.options_json);
    json.at("metrics_json").get_to(fit.metrics_json);
    if (fit.id != folder.filename() || fit.session != session)
      return Status::Integrity(file.string() + " is of fit " + fit.id + " of session " + fit.session);
    return fit;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

}  // namespace stratalux::db
