// SPDX-License-Identifier: Apache-2.0
// What a session says of itself, as the controller hands it to the store and the fitter reads it back.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "shared/capture/finding.h"
#include "shared/capture/plan.h"
#include "shared/units/time.h"

namespace stratalux {

enum class SessionStatus { kRecording, kComplete, kDegraded, kFailed };

[[nodiscard]] const char* ToString(SessionStatus);
[[nodiscard]] Result<SessionStatus> ParseSessionStatus(const std::string& text);

// What a visitor agreed to, as it was shown to them.
struct Consent {
  std::string text_version;  // of the text; empty: none was asked for
  std::string language;      // in which it was shown, such as "de"
  bool fit = false;          // scopes: measuring and fitting for the visitor
  bool research = false;
  bool publication = false;
  WallNs given_wall;

  friend bool operator==(const Consent&, const Consent&) = default;
};

// How long a session is kept before `stratalux-db purge` removes it.
enum class Retention { kShort, kStandard, kLong, kKeep };
[[nodiscard]] const char* ToString(Retention);
[[nodiscard]] Result<Retention> ParseRetention(const std::string& text);

// Days from the end of a session; `keep` has none.
struct RetentionDays {
  int short_days = 30;       // a demonstration
  int standard_days = 365;   // a visit and its follow-up
  int long_days = 10 * 365;  // a study
};

// What was known of the devices when a session began and no frame says; 0: not known.
struct SessionDevices {
  int camera_width = 0, camera_height = 0;        // of the full frame, px, of which an import's frames may be crops
  int projector_width = 0, projector_height = 0;  // px; a plan has its own
  double saturation_dn = 0.0;                     // raw levels at or above are saturated

  friend bool operator==(const SessionDevices&, const SessionDevices&) = default;
};

struct SessionInfo {
  std::string id;  // given by the store
  SessionKind kind = SessionKind::kVisitor;
  std::string rig;      // rig name
  std::string visitor;  // pseudonym, may be empty
  Consent consent;
  Retention retention = Retention::kStandard;
  bool simulated = false;
  uint64_t seed = 0;  // simulated sessions
  WallNs started_wall;
  WallNs finished_wall;  // 0 while recording
  SessionStatus status = SessionStatus::kRecording;
  std::vector<std::string> reasons;  // why degraded or failed
  std::string visit;                 // names the visit that its attempts share; empty: not one of several
  int attempt = 0;                   // of the visit, from 1; 0: not counted
  CaptureFindings found;             // what the capture saw, as data
  SessionDevices devices;            // in the manifest; rows of the index have none (SessionStore::DevicesOf)
  std::string program_version;
  std::string plan_json;         // PlanOptionsToJson, empty for imports
  std::string calibration_json;  // RigCalibration::ToJson, empty when unknown
};

}  // namespace stratalux
