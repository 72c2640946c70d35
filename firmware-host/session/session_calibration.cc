// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/session_calibration.h"

#include <cstdio>

#include "db/catalogue/calibration_store.h"
#include "shared/base/read_file.h"

namespace stratalux::rig {
namespace {

std::string SizeText(int width, int height) { return std::to_string(width) + "x" + std::to_string(height); }

Status CheckFitsRig(const RigCalibration& record, const RigConfig& config) {
  const PlanOptions& plan = config.plan;
  const Pinhole& camera = record.camera.model;
  if (camera.width != config.camera.width || camera.height != config.camera.height)
    return Status::Usage("it is for a camera of " + SizeText(camera.width, camera.height) + ", this one has " +
                         SizeText(config.camera.width, config.camera.height));
  if (static_cast<int>(record.projectors.size()) != plan.projectors)
    return Status::Usage("it has " + std::to_string(record.projectors.size()) + " projectors, the plan " +
                         std::to_string(plan.projectors));
  for (const ProjectorCalibration& p : record.projectors)
    if (p.model.width != plan.projector_width || p.model.height != plan.projector_height)
      return Status::Usage("its " + p.name + " has " + SizeText(p.model.width, p.model.height) + ", the plan " +
                           SizeText(plan.projector_width, plan.projector_height));
  return Status::Ok();
}

bool IsFile(const std::string& asked) { return asked.find('/') != std::string::npos || asked.ends_with(".json"); }

void WarnIfOld(const std::string& name, WallNs made, WallNs valid_until, Logger& logger) {
  const WallNs now = WallNow();
  if (valid_until.ns == 0 || now <= valid_until) return;
  char days[32];
  std::snprintf(days, sizeof days, "%.0f", static_cast<double>(now.ns - made.ns) / 86400e9);
  logger.Warning("calibration " + name + " was made " + (made.ns != 0 ? days + std::string(" days ago") : "long ago") +
                 " and was valid until " + ToIso8601(valid_until) +
                 ": calibrate the rig again (docs/operators-guide.md, \"Calibrating\")");
}

Result<std::string> FromFile(const std::string& file, const RigConfig& config, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  SLX_ASSIGN_OR_RETURN(const RigCalibration record, RigCalibration::FromJson(text).WithContext(file));
  SLX_RETURN_IF_ERROR(CheckFitsRig(record, config).WithContext(file));
  WarnIfOld(file, record.made_wall, record.valid_until_wall, logger);
  return record.ToJson();
}

Result<std::string> FromStore(const std::string& selector, const RigConfig& config, bool simulated, Logger& logger) {
  const db::RigIdentity rig{config.store.rig, simulated};
  SLX_ASSIGN_OR_RETURN(const auto version, db::FindCalibration(config.store.folder, rig, selector));
  const std::string name = version.id.substr(0, 8) + " (version " + std::to_string(version.version) + ")";
  SLX_ASSIGN_OR_RETURN(const RigCalibration record,
                       RigCalibration::FromJson(version.record_json).WithContext("calibration " + name));
  SLX_RETURN_IF_ERROR(CheckFitsRig(record, config).WithContext("calibration " + name));
  WarnIfOld(name, version.made_wall, version.valid_until_wall, logger);
  char age[32];
  std::snprintf(age, sizeof age, "%.1f days old", version.AgeDays(WallNow()));
  logger.Info("calibration " + name + ", " + age);
  return version.record_json;
}

}  // namespace

Result<std::string> ChooseCalibration(const std::string& asked, const RigConfig& config,
                                      const RigCalibration* simulation, Logger& logger) {
  if (asked == "none") return std::string();
  if (asked == "exact" && simulation == nullptr)
    return Status::Usage("calibration 'exact': only a simulation knows itself exactly; use latest, an id or a file");
  if (simulation != nullptr && (asked.empty() || asked == "exact")) return simulation->ToJson();
  if (!asked.empty()) {
    auto chosen =
        IsFile(asked) ? FromFile(asked, config, logger) : FromStore(asked, config, simulation != nullptr, logger);
    return chosen.ok() ? std::move(chosen) : chosen.status().WithContext("--calibration " + asked);
  }
  auto newest = FromStore("latest", config, false, logger);
  if (newest.ok()) return newest;
  if (newest.status().code() != StatusCode::kNotFound && newest.status().code() != StatusCode::kUsage) return newest;
  // Calibration sessions come first in a rig's life; a visitor who is here should not be sent home.
  logger.Warning("the session will name no calibration: " + newest.status().message());
  return std::string();
}

}  // namespace stratalux::rig
