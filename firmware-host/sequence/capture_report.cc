// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/capture_report.h"

#include <cmath>

#include "shared/capture/retake_cause.h"

namespace stratalux::rig {

const char* ToString(ShotFault fault) {
  static constexpr std::array<const char*, kShotFaultCount> kNames = {
      "none",          "missing sync",       "extra sync",    "lost frame",    "sequence gap",
      "doubled frame", "frame out of order", "late frame",    "corrupt frame", "wrong level",
      "repeated rows", "wrong exposure",     kRetakenForAJump};
  return kNames[static_cast<size_t>(fault)];
}

CaptureFindings CaptureReport::Found() const {
  CaptureFindings found{findings, {}};
  for (Finding& finding : found.findings)
    for (double* figure : {&finding.value, &finding.limit})
      if (!std::isfinite(*figure)) *figure = 0.0;
  for (int i = 1; i < kShotFaultCount; ++i)
    if (faults[i] > 0) found.faults[ToString(static_cast<ShotFault>(i))] = faults[i];
  return found;
}

std::string CaptureReport::FaultSummary() const {
  std::string text;
  for (int i = 1; i < kShotFaultCount; ++i)
    if (faults[i] > 0)
      text += (text.empty() ? "" : ", ") + std::string(ToString(static_cast<ShotFault>(i))) + " " +
              std::to_string(faults[i]);
  return text;
}

}  // namespace stratalux::rig
