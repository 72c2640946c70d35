// SPDX-License-Identifier: Apache-2.0
// The calibrations that the fitter accepted, as versions of their rig (docs/file-formats.md, "Calibrations of a rig").
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

class Connection;

// Whose calibrations: simulated rigs and real ones are never mixed.
struct RigIdentity {
  std::string rig;
  bool simulated = false;
};

struct CalibrationVersion {
  std::string id;  // XXH3-128 of the record, 32 hex digits
  RigIdentity rig;
  int version = 0;           // of this rig, from 1
  std::string session, fit;  // that hold its files
  WallNs made_wall, valid_until_wall;
  std::string superseded_by;  // id of the next version; empty: the newest
  std::string record_json;    // RigCalibration::ToJson

  [[nodiscard]] double AgeDays(WallNs now) const { return static_cast<double>(now.ns - made_wall.ns) / 86400e9; }
  [[nodiscard]] bool IsValidAt(WallNs time) const { return time <= valid_until_wall; }
};

// Id of a record as sessions and the index know it; of the text, byte for byte.
[[nodiscard]] std::string CalibrationId(const std::string& record_json);

// Of one rig, newest version first.
[[nodiscard]] Result<std::vector<CalibrationVersion>> ListCalibrations(const std::filesystem::path& store,
                                                                       const RigIdentity& rig);
// `selector`: "latest", or an id's unique prefix. kNotFound with the remedy; kUsage where the prefix is ambiguous.
[[nodiscard]] Result<CalibrationVersion> FindCalibration(const std::filesystem::path& store, const RigIdentity& rig,
                                                         const std::string& selector);

// The record of a fit's folder as the index keeps it; nullopt where the fit is no calibration. kIntegrity: damaged.
[[nodiscard]] Result<std::optional<std::string>> ReadFitCalibration(const std::filesystem::path& fit_folder);
// Enters the record of a fit that has its row already; a part of the caller's transaction. A record that does not say
// when it was made or how long it is valid: from the session's end, for kCalibrationValidDays.
Status EnterCalibration(Connection& connection, int64_t session, const FitRow& fit);

// What is wrong with the records of all accepted calibrations: lost, damaged, or not the one that was accepted.
[[nodiscard]] Result<std::vector<std::string>> CheckCalibrations(const std::filesystem::path& store);

}  // namespace stratalux::db
