// SPDX-License-Identifier: Apache-2.0
// CaptureWatch: what the gate wants to know of a capture beside its proofs, seen while it runs.
#pragma once

#include <functional>
#include <map>
#include <optional>

#include "firmware-host/kiosk/face_look.h"
#include "firmware-host/sequence/capture_observer.h"
#include "firmware-host/session/capture_station.h"

namespace stratalux::rig {

class CaptureWatch final : public CaptureObserver {
 public:
  // `before`: what the pre-scan lit; empty where there was none, and the coverage is not looked at then. `steps`: of
  // the plan. `progress` is called by the capturing thread, once a percent.
  CaptureWatch(Foreground before, ExposureRule rule, int steps, std::function<void(int done, int of)> progress);

  void OnStepDone(const PlanStep& step) override;
  void OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) override;

  // After the capture. `taken`: the guard took the light away without being asked to.
  [[nodiscard]] CaptureFacts Facts(const CaptureReport& report, bool taken) const;

 private:
  // A projector's reference, of the nominal exposure.
  struct Reference {
    std::optional<Image<uint16_t>> white, black;
  };
  void Look(const PreScan& scan);

  const Foreground before_;
  const ExposureRule rule_;
  const int steps_;
  const std::function<void(int, int)> progress_;
  int done_ = 0;
  std::map<int, Reference> waiting_;  // for the other of its pair
  Foreground lit_;                    // by any projector
  double saturated_ = 0.0;            // largest share of a projector's lit samples
};

}  // namespace stratalux::rig
