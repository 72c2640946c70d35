// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/calibration_store.h"

#include <algorithm>
#include <system_error>

#include <xxhash.h>

#include "db/catalogue/session_index.h"
#include "shared/base/read_file.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr const char* kRecordFile = "calibration.json";

Result<std::vector<CalibrationVersion>> Select(Connection& connection, const RigIdentity& rig) {
  SLX_ASSIGN_OR_RETURN(
      auto select,
      connection.Prepare("SELECT v.id, v.version, v.session_id, v.fit, v.made_wall_ns, v.valid_until_wall_ns,"
                         " coalesce(v.superseded_by, ''), c.record_json FROM calibration_versions v"
                         " JOIN calibrations c ON c.id = v.id WHERE v.rig = ?1 AND v.simulated = ?2"
                         " ORDER BY v.version DESC"));
  select.Bind(1, rig.rig).Bind(2, int64_t{rig.simulated});
  std::vector<CalibrationVersion> versions;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return versions;
    versions.push_back({select.Text(0),
                        rig,
                        static_cast<int>(select.Integer(1)),
                        select.Text(2),
                        select.Text(3),
                        {select.Integer(4)},
                        {select.Integer(5)},
                        select.Text(6),
                        select.Text(7)});
  }
}

std::string NameOf(const RigIdentity& rig) { return (rig.simulated ? "simulated rig '" : "rig '") + rig.rig + "'"; }

}  // namespace

std::string CalibrationId(const std::string& record_json) {
  uint8_t digest[16];
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(record_json.data(), record_json.size()));
  std::copy(std::begin(canonical.digest), std::end(canonical.digest), digest);
  return HashText(digest);
}

Result<std::vector<CalibrationVersion>> ListCalibrations(const fs::path& store, const RigIdentity& rig) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  return Select(index.connection(), rig);
}

Result<CalibrationVersion> FindCalibration(const fs::path& store, const RigIdentity& rig, const std::string& selector) {
  SLX_ASSIGN_OR_RETURN(const auto versions, ListCalibrations(store, rig));
  const std::string where = "calibration of " + NameOf(rig) + " in " + store.string();
  if (versions.empty())
    return Status::NotFound("no " + where +
                            ": capture board poses with `stratalux-rig capture --kind calibration`, then "
                            "`stratalux-fit calibrate`");
  if (selector == "latest") return versions.front();
  std::vector<const CalibrationVersion*> found;
  for (const CalibrationVersion& version : versions)
    if (!selector.empty() && version.id.starts_with(selector)) found.push_back(&version);
  if (found.empty())
    return Status::NotFound("no " + where + " whose id starts with '" + selector +
                            "' (`stratalux-db query calibration-age` lists them)");
  if (found.size() > 1)
    return Status::Usage("'" + selector + "' is ambiguous: " + found[0]->id + ", " + found[1]->id +
                         "; give more of the id");
  return *found[0];
}

Result<std::optional<std::string>> ReadFitCalibration(const fs::path& fit_folder) {
  const fs::path file = fit_folder / kRecordFile;
  if (std::error_code error; !fs::exists(file, error)) return std::optional<std::string>();
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  const auto record = RigCalibration::FromJson(text);
  if (record.status().code() == StatusCode::kNewerSchema) return record.status().WithContext(file.string());
  if (!record.ok()) return Status::Integrity(file.string() + ": " + record.status().message());
  // As sessions that use it will carry it.
  return std::optional(record->ToJson());
}

Status EnterCalibration(Connection& connection, int64_t session, const FitRow& fit) {
  SLX_ASSIGN_OR_RETURN(const RigCalibration record, RigCalibration::FromJson(fit.calibration_json));
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT rig, coalesce(finished_wall_ns, started_wall_ns)"
                                                       " FROM sessions WHERE number = ?1"));
  SLX_ASSIGN_OR_RETURN(const bool found, select.Bind(1, session).Step());
  if (!found) return Status::NotFound("no session number " + std::to_string(session));
  const std::string rig = select.Text(0);
  const int64_t made = record.made_wall.ns != 0 ? record.made_wall.ns : select.Integer(1);
  const int64_t valid_until = record.valid_until_wall.ns != 0
                                  ? record.valid_until_wall.ns
                                  : made + static_cast<int64_t>(kCalibrationValidDays * 86400e9);
  select.Reset();
  const std::string id = CalibrationId(fit.calibration_json);
  SLX_ASSIGN_OR_RETURN(auto insert,
                       connection.Prepare("INSERT INTO calibrations (id, record_json, rig, made_wall_ns)"
                                          " VALUES (?1, ?2, ?3, ?4) ON CONFLICT (id) DO UPDATE"
                                          " SET rig = excluded.rig, made_wall_ns = excluded.made_wall_ns"));
  SLX_RETURN_IF_ERROR(insert.Bind(1, id).Bind(2, fit.calibration_json).Bind(3, rig).Bind(4, made).Run());
  SLX_ASSIGN_OR_RETURN(
      auto accept, connection.Prepare("INSERT INTO accepted_calibrations (session, fit, calibration_id, made_wall_ns,"
                                      " valid_until_wall_ns) VALUES (?1, ?2, ?3, ?4, ?5)"));
  return accept.Bind(1, session).Bind(2, fit.id).Bind(3, id).Bind(4, made).Bind(5, valid_until).Run();
}

Result<std::vector<std::string>> CheckCalibrations(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(
      auto select, index.connection().Prepare("SELECT s.id, a.fit, a.calibration_id FROM accepted_calibrations a"
                                              " JOIN sessions s ON s.number = a.session ORDER BY a.session, a.fit"));
  std::vector<std::string> problems;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return problems;
    const fs::path folder = store / "sessions" / select.Text(0) / "fits" / select.Text(1);
    const auto record = ReadFitCalibration(folder);
    if (!record.ok()) {
      problems.push_back(record.status().message());
    } else if (!*record) {
      problems.push_back((folder / kRecordFile).string() + " of an accepted calibration is gone");
    } else if (CalibrationId(**record) != select.Text(2)) {
      problems.push_back((folder / kRecordFile).string() + " is not the record that was accepted; calibrate again");
    }
  }
}

}  // namespace stratalux::db
