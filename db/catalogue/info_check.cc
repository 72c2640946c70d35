// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/info_check.h"

#include <utility>

#include <nlohmann/json.hpp>

#include "shared/capture/plan.h"

namespace stratalux::db {

Status CheckInfo(const SessionInfo& info) {
  for (const auto& [name, text] : {std::pair<const char*, const std::string*>{"rig", &info.rig},
                                   {"visitor", &info.visitor},
                                   {"program version", &info.program_version},
                                   {"visit", &info.visit},
                                   {"consent", &info.consent.text_version},
                                   {"language", &info.consent.language}})
    if (text->find('\0') != std::string::npos) return Status::Integrity(std::string(name) + " holds a zero byte");
  for (const auto& [name, time] : {std::pair{"start", info.started_wall.ns},
                                   {"end", info.finished_wall.ns},
                                   {"consent's time", info.consent.given_wall.ns}})
    if (time < 0) return Status::Integrity(std::string(name) + " " + std::to_string(time) + " ns lies before 1970");
  if (info.attempt < 0 || info.attempt > kMostAttempts)
    return Status::Integrity("attempt " + std::to_string(info.attempt) + " is out of range");
  SLX_RETURN_IF_ERROR(CheckFound(info.found));
  if (!info.plan_json.empty()) {
    const auto plan = PlanOptionsFromJson(info.plan_json);
    // What no version plans is damage, not somebody's wrong flag.
    if (!plan.ok() && plan.status().code() != StatusCode::kNewerSchema)
      return Status::Integrity(plan.status().message());
    SLX_RETURN_IF_ERROR(plan.status());
  }
  if (!info.calibration_json.empty() &&
      !nlohmann::ordered_json::parse(info.calibration_json, nullptr, false).is_object())
    return Status::Integrity("its calibration is not a JSON object");
  return Status::Ok();
}

Status CheckFound(const CaptureFindings& found) {
  SLX_RETURN_IF_ERROR(FindingsFromJson(FindingsToJson(found.findings)).status());
  return FaultsFromJson(FaultsToJson(found.faults)).status();
}

}  // namespace stratalux::db
