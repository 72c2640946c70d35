// SPDX-License-Identifier: Apache-2.0
// What the watchers of calibration captures object to.
#pragma once

#include <string>
#include <vector>

#include "shared/capture/finding.h"

namespace stratalux::rig {

// Something that an operator can mend.
struct CaptureFault {
  std::string what, remedy;
  bool by_chance = false;  // another try with nothing changed may go well
};

[[nodiscard]] inline std::vector<Finding> FindingsOf(const std::vector<CaptureFault>& faults) {
  std::vector<Finding> findings;
  for (const CaptureFault& fault : faults)
    findings.push_back({FindingKind::kWatch, -1, -1, 0.0, 0.0, fault.what + ": " + fault.remedy});
  return findings;
}

}  // namespace stratalux::rig
