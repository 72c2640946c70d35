// SPDX-License-Identifier: Apache-2.0
// StoreWatch: whether the store's disk and the rig's calibration let visitors in. Why not is logged, once at each
// change.
#pragma once

#include <optional>
#include <string>

#include "db/catalogue/calibration_store.h"
#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/kiosk/visit_rules.h"
#include "firmware-host/session/capture_station.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class StoreWatch {
 public:
  // All outlive the watch.
  StoreWatch(const StationOptions& station, const VisitRules& rules, Logger& logger);

  // What is free. None where the system does not say, or where the store's folder was seen and is gone.
  [[nodiscard]] event::Space Space();
  // That captures would name. One that is a file, or not wanted, was chosen by the operator.
  [[nodiscard]] event::Calibration Calibration();
  // The same of what db::FindCalibration said. While another program writes the index, what was said before holds.
  [[nodiscard]] event::Calibration Judge(const Result<db::CalibrationVersion>& found, WallNs now);

 private:
  // Empty: nothing speaks against it. `told` is what was said last.
  void Say(const std::string& why, const std::string& key, std::string& told);

  const StationOptions& station_;
  const VisitRules& rules_;
  Logger& logger_;
  bool store_seen_ = false, index_seen_ = false;
  std::string space_told_, calibration_told_;
  event::Calibration calibration_{false, 0};
};

}  // namespace stratalux::rig
