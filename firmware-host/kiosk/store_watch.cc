// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/store_watch.h"

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "firmware-host/session/store_disk.h"
#include "shared/base/formatted.h"

namespace stratalux::rig {

StoreWatch::StoreWatch(const StationOptions& station, const VisitRules& rules, Logger& logger)
    : station_(station), rules_(rules), logger_(logger) {}

void StoreWatch::Say(const std::string& why, const std::string& key, std::string& told) {
  if (key != told && !key.empty()) logger_.Warning("closed: " + why);
  told = key;
}

event::Space StoreWatch::Space() {
  const std::string& folder = station_.config.store.folder;
  std::error_code error;
  const bool indexed = std::filesystem::exists(std::filesystem::path(folder) / "index.sqlite", error);
  // Where the folder itself is a mount point an empty one stays when its disk goes.
  const bool there = std::filesystem::is_directory(folder, error) && (indexed || !index_seen_);
  index_seen_ |= indexed;
  const bool to_be_made = !there && !store_seen_ && (!error || error == std::errc::no_such_file_or_directory);
  store_seen_ |= there;
  if (!there && !to_be_made) {
    const std::string why =
        folder + (store_seen_ ? ", which held the visits, is gone" : ": cannot find out how much space is free") +
        (error ? ": " + error.message() : std::string()) + "; check its disk";
    Say(why, why, space_told_);
    return {0};
  }
  const std::filesystem::path asked = ExistingFolder(folder);
  const auto space = std::filesystem::space(asked, error);
  if (error) {
    const std::string why = asked.string() + ": cannot find out how much space is free: " + error.message();
    Say(why, why, space_told_);
    return {0};
  }
  const auto bytes = static_cast<int64_t>(space.available);
  const std::string why = folder + " has " +
                          Formatted("%.1f GB free, the attempts of a visit may take %.1f GB",
                                    1e-9 * static_cast<double>(bytes), 1e-9 * static_cast<double>(rules_.space_bytes)) +
                          "; free some (stratalux-db purge), or move the store";
  Say(why, bytes < rules_.space_bytes ? "short" : "", space_told_);
  return {bytes};
}

event::Calibration StoreWatch::Calibration() {
  const RigConfig& config = station_.config;
  const std::string& asked = config.calibration;
  const bool simulated = station_.simulated.has_value();
  const bool by_operator = asked == "none" || asked.find('/') != std::string::npos || asked.ends_with(".json");
  if (by_operator || (simulated && (asked.empty() || asked == "exact"))) return {true, 0};
  return Judge(
      db::FindCalibration(config.store.folder, {config.store.rig, simulated}, asked.empty() ? "latest" : asked),
      WallNow());
}

event::Calibration StoreWatch::Judge(const Result<db::CalibrationVersion>& found, WallNs now) {
  if (found.status().code() == StatusCode::kBusy) return calibration_;
  std::string why;
  if (found.ok()) {
    calibration_ = {true, static_cast<int>(std::max(0.0, found->AgeDays(now)))};
    if (rules_.calibration_days > 0 && calibration_.age_days > rules_.calibration_days)
      why = "calibration " + found->id + " is " + std::to_string(calibration_.age_days) +
            " days old, kiosk.calibration_days = " + std::to_string(rules_.calibration_days) +
            "; capture board poses with `stratalux-rig capture --kind calibration`, then `stratalux-fit calibrate`";
  } else {
    calibration_ = {false, 0};
    why = found.status().message();
  }
  Say(why, why, calibration_told_);
  return calibration_;
}

}  // namespace stratalux::rig
