// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/manifest.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/own_hash.h"
#include "db/catalogue/info_check.h"
#include "db/catalogue/known_word.h"
#include "db/segment/segment.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"
#include "shared/image/pixel_format.h"

namespace stratalux::db {

using Json = nlohmann::ordered_json;

namespace {

// A file name in a reason may be no UTF-8, which JSON is.
std::string TextOf(const Json& json, int indent) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

// 4: visit, attempt, findings, faults. A program of before would have lost them with the next manifest it wrote.
constexpr uint64_t kManifestSchema = 4;
constexpr uint64_t kMostFrames = 1'000'000'000'000;

// Those that lie there; a segment that is named and missing is for `verify` to find.
Json FilesOf(const std::filesystem::path& folder, std::vector<std::string> names) {
  std::error_code error;
  for (const char* name : {"truth.seg", "truth_calibration.json"})
    if (std::filesystem::exists(folder / name, error)) names.emplace_back(name);
  Json files = Json::array();
  for (const std::string& name : names) {
    const auto file = DescribeFile(folder, name);
    if (!file.ok()) continue;
    files.push_back({{"name", name}, {"bytes", file->bytes}, {"hash", file->hash.empty() ? Json() : Json(file->hash)}});
  }
  return files;
}

// Every file since schema 3 has its hash; one that has it although it says to be older was changed.
Status CheckHash(const Json& json, const std::string& text) {
  const OwnHash hash = CheckOwnHash(text);
  if (hash == OwnHash::kRight) return Status::Ok();
  const Json& schema = json.at("schema");
  if (hash == OwnHash::kNone && schema.is_number_integer() && schema < 3) return Status::Ok();
  return Status::Integrity("does not match its own hash; restore it from a copy");
}

Json JsonOf(const Consent& consent) {
  if (consent.text_version.empty()) return nullptr;
  Json scope = Json::array();
  if (consent.fit) scope.push_back("fit");
  if (consent.research) scope.push_back("research");
  if (consent.publication) scope.push_back("publication");
  return {{"text_version", consent.text_version},
          {"language", consent.language},
          {"scope", scope},
          {"given_wall_ns", consent.given_wall.ns}};
}

Consent ConsentOf(const Json& json) {
  Consent consent;
  if (json.is_string()) consent.text_version = json.get<std::string>();  // schema 1
  if (!json.is_object()) return consent;
  json.at("text_version").get_to(consent.text_version);
  json.at("language").get_to(consent.language);
  consent.given_wall.ns = WholeAt<int64_t>(json, "given_wall_ns");
  for (const Json& scope : json.at("scope")) {
    consent.fit |= scope == "fit";
    consent.research |= scope == "research";
    consent.publication |= scope == "publication";
  }
  return consent;
}

// nlohmann converts numbers silently: what is no whole number of that range would become another.
Status CheckTypes(const Json& json) {
  auto is_text = [](const Json& j) { return j.is_string(); };
  auto is_time = [](const Json& j) {
    return j.is_number_integer() && (j.is_number_unsigned() ? j.get<uint64_t>() <= uint64_t{INT64_MAX} : true);
  };
  auto is_count = [](const Json& j) { return j.is_number_unsigned() && j.get<uint64_t>() <= kMostFrames; };
  auto is_texts = [&](const Json& j) { return j.is_array() && std::all_of(j.begin(), j.end(), is_text); };
  struct Field {
    const char* key;
    bool fits;
  };
  auto value = [&](const char* key) { return json.contains(key) ? json.at(key) : Json(); };
  const Json consent = value("consent");
  const Field fields[] = {
      {"consent",
       consent.is_null() || consent.is_string() ||
           (consent.is_object() && consent.contains("given_wall_ns") && is_time(consent.at("given_wall_ns")))},
      {"session", is_text(value("session"))},
      {"kind", is_text(value("kind"))},
      {"rig", is_text(value("rig"))},
      {"visitor", is_text(value("visitor"))},
      {"status", is_text(value("status"))},
      {"program_version", is_text(value("program_version"))},
      {"simulated", value("simulated").is_boolean()},
      {"seed", value("seed").is_number_unsigned()},
      {"started_wall_ns", is_time(value("started_wall_ns"))},
      {"finished_wall_ns", !json.contains("finished_wall_ns") || is_time(value("finished_wall_ns"))},
      {"reasons", is_texts(value("reasons"))},
      {"plan", json.contains("plan") && (value("plan").is_null() || value("plan").is_object())},
      {"calibration",
       json.contains("calibration") && (value("calibration").is_null() || value("calibration").is_object())},
      {"visit", !json.contains("visit") || is_text(value("visit"))},
      {"attempt", !json.contains("attempt") || (is_count(value("attempt")) && value("attempt") <= kMostAttempts)},
      {"frames", is_count(value("frames"))},
      {"segments", is_texts(value("segments"))}};
  for (const Field& field : fields)
    if (!field.fits)
      return Status::Integrity(std::string("'") + field.key + "' has a value that a manifest cannot have there");
  return Status::Ok();
}

Status CheckSchema(const Json& json) {
  if (!json.is_object()) return Status::Integrity("not a JSON object");
  const Json& schema = json.at("schema");
  if (!schema.is_number_unsigned()) return Status::Integrity("'schema' is not a number");
  if (schema.get<uint64_t>() <= kManifestSchema) return Status::Ok();
  return Status(StatusCode::kNewerSchema,
                "schema " + schema.dump() + " is newer than this program (" + std::to_string(kManifestSchema) + ")");
}

// Members that came with schema 4; a transcode raises a manifest of before and adds none, so that its signature stays.
Status ReadFound(const Json& json, CaptureFindings& found) {
  if (json.contains("findings")) {
    SLX_ASSIGN_OR_RETURN(found.findings, FindingsFromJson(json.at("findings").dump()));
  }
  if (json.contains("faults")) {
    SLX_ASSIGN_OR_RETURN(found.faults, FaultsFromJson(json.at("faults").dump()));
  }
  return Status::Ok();
}

constexpr uint64_t kMostDevicePx = 65536;
constexpr const char* kSaturation = "saturation_dn";

template <typename Devices>
auto SizesOf(Devices& devices) {
  return std::array{
      std::pair{"camera_width", &devices.camera_width}, std::pair{"camera_height", &devices.camera_height},
      std::pair{"projector_width", &devices.projector_width}, std::pair{"projector_height", &devices.projector_height}};
}

Result<SessionInfo> InfoFrom(const Json& json) {
  SLX_RETURN_IF_ERROR(CheckTypes(json));
  SessionInfo info;
  json.at("session").get_to(info.id);
  SLX_ASSIGN_OR_RETURN(info.kind, Known(ParseSessionKind(json.at("kind").get<std::string>())));
  json.at("rig").get_to(info.rig);
  json.at("visitor").get_to(info.visitor);
  info.consent = ConsentOf(json.at("consent"));
  if (json.contains("retention")) {
    SLX_ASSIGN_OR_RETURN(info.retention, Known(ParseRetention(json.at("retention").get<std::string>())));
  }
  info.finished_wall.ns = json.value("finished_wall_ns", int64_t{0});
  json.at("simulated").get_to(info.simulated);
  json.at("seed").get_to(info.seed);
  info.started_wall.ns = json.at("started_wall_ns").get<int64_t>();
  SLX_ASSIGN_OR_RETURN(info.status, Known(ParseSessionStatus(json.at("status").get<std::string>())));
  json.at("reasons").get_to(info.reasons);
  info.visit = json.value("visit", "");
  info.attempt = json.value("attempt", 0);
  SLX_RETURN_IF_ERROR(ReadFound(json, info.found));
  if (json.contains("devices")) {
    SLX_ASSIGN_OR_RETURN(info.devices, DevicesFromJson(json.at("devices").dump()));
  }
  json.at("program_version").get_to(info.program_version);
  if (!json.at("plan").is_null()) info.plan_json = json.at("plan").dump();
  if (!json.at("calibration").is_null()) info.calibration_json = json.at("calibration").dump();
  return info;
}

}  // namespace

std::string ConsentToJson(const Consent& consent) {
  return consent.text_version.empty() ? "" : TextOf(JsonOf(consent), -1);
}

Consent ConsentFromJson(const std::string& text) {
  const Json json = Json::parse(text, nullptr, false);
  try {
    return ConsentOf(json);
  } catch (const nlohmann::json::exception&) {
    return {};
  }
}

std::string ReasonsToJson(const std::vector<std::string>& reasons) { return TextOf(Json(reasons), -1); }

std::vector<std::string> ReasonsFromJson(const std::string& text) {
  std::vector<std::string> reasons;
  const Json json = CheckNesting(text).ok() ? Json::parse(text, nullptr, false) : Json();
  if (!json.is_array()) return reasons;
  for (const Json& reason : json) reasons.push_back(reason.is_string() ? reason.get<std::string>() : reason.dump());
  return reasons;
}

CaptureFindings FoundFromJson(const std::string& findings_json, const std::string& faults_json) {
  CaptureFindings found;
  if (auto findings = FindingsFromJson(findings_json); findings.ok()) found.findings = std::move(findings).value();
  if (auto faults = FaultsFromJson(faults_json); faults.ok()) found.faults = std::move(faults).value();
  return found;
}

std::string DevicesToJson(const SessionDevices& devices) {
  Json json = Json::object();
  for (const auto& [key, value] : SizesOf(devices))
    if (*value > 0) json[key] = *value;
  if (devices.saturation_dn > 0.0) json[kSaturation] = devices.saturation_dn;
  return TextOf(json, -1);
}

Result<SessionDevices> DevicesFromJson(const std::string& text) {
  const Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return Status::Integrity("'devices' has a value that a manifest cannot have there");
  SessionDevices devices;
  for (const auto& [key, value] : SizesOf(devices)) {
    if (!json.contains(key)) continue;
    const Json& size = json.at(key);
    if (!size.is_number_unsigned() || size.get<uint64_t>() < 1 || size.get<uint64_t>() > kMostDevicePx)
      return Status::Integrity(std::string("devices: ") + key + " is not a number of pixels");
    size.get_to(*value);
  }
  if (!json.contains(kSaturation)) return devices;
  const Json& level = json.at(kSaturation);
  if (!level.is_number() || !(level.get<double>() > 0.0) || level.get<double>() > FullScaleDn(PixelFormat::kMono16))
    return Status::Integrity("devices: saturation_dn is not a raw level");
  level.get_to(devices.saturation_dn);
  return devices;
}

std::string ManifestText(const std::filesystem::path& folder, const SessionInfo& info, int64_t frames,
                         const std::vector<std::string>& segments) {
  Json json = {
      {"schema", kManifestSchema},
      {"session", info.id},
      {"kind", ToString(info.kind)},
      {"rig", info.rig},
      {"visitor", info.visitor},
      {"consent", JsonOf(info.consent)},
      {"retention", ToString(info.retention)},
      {"simulated", info.simulated},
      {"seed", info.seed},
      {"started_wall_ns", info.started_wall.ns},
      {"finished_wall_ns", info.finished_wall.ns},
      {"status", ToString(info.status)},
      {"reasons", info.reasons},
      {"visit", info.visit},
      {"attempt", info.attempt},
      {"findings", Json::parse(FindingsToJson(info.found.findings))},
      {"faults", Json::parse(FaultsToJson(info.found.faults))},
      {"program_version", info.program_version},
      {"plan", info.plan_json.empty() ? Json() : Json::parse(info.plan_json, nullptr, false)},
      {"calibration", info.calibration_json.empty() ? Json() : Json::parse(info.calibration_json, nullptr, false)},
      {"frames", frames},
      {"segments", segments},
      {"files", FilesOf(folder, segments)}};
  if (info.devices != SessionDevices{}) json["devices"] = Json::parse(DevicesToJson(info.devices));
  return WithOwnHash(TextOf(json, 1));
}

Status WriteManifest(const std::filesystem::path& folder, const SessionInfo& info, int64_t frames,
                     const std::vector<std::string>& segments) {
  return ReplaceFile(folder / "manifest.json", ManifestText(folder, info, frames, segments));
}

std::string LastingFacts(const std::string& manifest_text) {
  if (!CheckNesting(manifest_text).ok()) return "";
  Json json = Json::parse(manifest_text, nullptr, false);
  if (!json.is_object()) return "";
  for (const char* key : {"schema", "segments", "files", "hash"}) json.erase(key);
  return TextOf(json, -1);
}

Result<ManifestContents::File> DescribeFile(const std::filesystem::path& folder, const std::string& name) {
  const std::filesystem::path file = folder / name;
  std::error_code error;
  const auto bytes = std::filesystem::file_size(file, error);
  if (error) return Status::Integrity(file.string() + ": " + error.message());
  ManifestContents::File described{name, static_cast<int64_t>(bytes), ""};
  if (file.extension() == ".seg") {
    Status damage;  // of the file header, which the hash is not of
    SLX_ASSIGN_OR_RETURN(const auto reader, SegmentReader::OpenDamaged(file, &damage));
    if (const auto tail = reader.SealedTail()) described.hash = HashHex(*tail);
    return described;
  }
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  described.hash = HashHex(text);
  return described;
}

Result<ManifestContents> ReadManifestContents(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "manifest.json";
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  try {
    const Json json = Json::parse(text);
    SLX_RETURN_IF_ERROR(CheckSchema(json).WithContext(file.string()));
    SLX_RETURN_IF_ERROR(CheckHash(json, text).WithContext(file.string()));
    SLX_RETURN_IF_ERROR(CheckTypes(json).WithContext(file.string()));
    ManifestContents contents{
        json.at("frames").get<int64_t>(), json.at("segments").get<std::vector<std::string>>(), {}, 0};
    json.at("schema").get_to(contents.schema);
    if (contents.schema < 3) return contents;
    for (const Json& entry : json.at("files")) {
      const Json& hash = entry.at("hash");
      contents.files.push_back({entry.at("name").get<std::string>(), WholeAt<int64_t>(entry, "bytes"),
                                hash.is_null() ? std::string() : hash.get<std::string>()});
    }
    return contents;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

Status ReplaceSegments(const std::filesystem::path& folder, const std::vector<std::string>& segments) {
  const std::filesystem::path file = folder / "manifest.json";
  if (std::error_code error; !std::filesystem::exists(file, error)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  Json json = Json::parse(text, nullptr, false);
  if (!json.is_object()) return Status::Integrity(file.string() + ": not a JSON object");
  json["segments"] = segments;
  json.erase("hash");
  json["schema"] = kManifestSchema;  // raises an older one
  json["files"] = FilesOf(folder, segments);
  return ReplaceFile(file, WithOwnHash(TextOf(json, 1)));
}

Result<SessionInfo> ReadManifest(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "manifest.json";
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  try {
    const Json json = Json::parse(text);
    SLX_RETURN_IF_ERROR(CheckSchema(json).WithContext(file.string()));
    // Before anything is said about its words: those of a later version are right, those of damage are not.
    SLX_RETURN_IF_ERROR(CheckHash(json, text).WithContext(file.string()));
    auto info = InfoFrom(json);
    return std::move(info).WithContext(file.string());
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

}  // namespace stratalux::db
