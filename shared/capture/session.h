// SPDX-License-Identifier: Apache-2.0
// What a session says of itself, as the controller hands it to the store and the fitter reads it back.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "shared/capture/plan.h"
#include "shared/units/time.h"

namespace stratalux {

enum class SessionStatus { kRecording, kComplete, kDegraded, kFailed };

[[nodiscard]] const char* ToString(SessionStatus);
[[nodiscard]] Result<SessionStatus> ParseSessionStatus(const std::string& text);

struct SessionInfo {
  std::string id;  // given by the store
  SessionKind kind = SessionKind::kVisitor;
  std::string rig;      // rig name
  std::string visitor;  // pseudonym, may be empty
  std::string consent;  // text version of the consent given, may be empty (STORE makes it binding)
  bool simulated = false;
  uint64_t seed = 0;  // simulated sessions
  WallNs started_wall;
  SessionStatus status = SessionStatus::kRecording;
  std::vector<std::string> reasons;  // why degraded or failed
  std::string program_version;
  std::string plan_json;         // PlanOptionsToJson, empty for imports
  std::string calibration_json;  // RigCalibration::ToJson, empty when unknown
};

}  // namespace stratalux
