// SPDX-License-Identifier: Apache-2.0
// Whole captures on a small simulated rig with faults, held against what each frame really shows.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "firmware-host/sequence/capture_report.h"
#include "firmware-host/simulated/fault_script.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

struct SoakOptions {
  std::string scene = "bald";  // to grow a head's hair takes longer than to capture it so small
  bool scattering = false;     // opaque skin is quick
  int camera_width = 64, camera_height = 48;
  bool overlapped = false;  // the camera exposes while it reads out
  PlanOptions plan;         // SmallPlan()
  uint64_t seed = 1;
  FaultOptions faults;
  // By the deadlines that a selftest of the same rig without faults learnt.
  bool learnt = false;
  // Chance that an exposure's frame comes 10 to 80 ms late (by its own time it does not), beyond or within the
  // deadline.
  double slow_rate = 0.0;
  // Chance that the subject jumps by 1 to 6 mm sideways before an exposure.
  double jump_rate = 0.0;
};

// 64x48 projectors, 4 of them, all phases: 196 frames.
[[nodiscard]] PlanOptions SmallPlan();

struct SoakCapture {
  CaptureReport report;
  std::vector<InjectedFault> injected;
  int shots = 0;  // frames that reached the sink
  // Steps whose frame shows another picture than the plan says (another pattern, a mixture, rows out of place, another
  // exposure) on more than 6 % of the pixels that its projector lights, though the report does not list them as missing
  // and the session has not failed.
  std::vector<int> mis_associated;
  double spoilt_most = 0.0;  // largest share of spoilt pixels of a frame that counts
  // In a complete session: steps during which the subject stood > 1 mm elsewhere, or the light was > 10 % other, than
  // during the white of the projector.
  std::vector<int> changed_unsaid;
  bool learnt_held = false;  // to the end
};

[[nodiscard]] SoakCapture CaptureOnce(const SoakOptions& options);

// fault | injected | detected | survived | frames mis-associated, over many captures.
class SoakTable {
 public:
  void Add(const SoakCapture& capture);
  void Print() const;
  [[nodiscard]] int64_t frames() const { return frames_; }
  [[nodiscard]] int64_t mis_associated() const { return mis_associated_; }
  [[nodiscard]] int64_t captures() const { return captures_; }
  [[nodiscard]] int64_t complete() const { return complete_; }

 private:
  struct Row {
    int64_t injected = 0, captures = 0, detected = 0, survived = 0, mis_associated = 0, changed = 0;
  };
  std::map<FaultKind, Row> rows_;
  int64_t frames_ = 0, captures_ = 0, complete_ = 0, degraded_ = 0, failed_ = 0, mis_associated_ = 0, changed_ = 0,
          clean_ = 0, false_alarms_ = 0;
  double spoilt_most_ = 0.0;
};

}  // namespace stratalux::rig
