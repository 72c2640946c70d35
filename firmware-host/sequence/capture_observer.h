// SPDX-License-Identifier: Apache-2.0
// CaptureObserver: what a capture tells while it runs, and where it may be ended.
#pragma once

#include <vector>

#include "firmware-host/sequence/capture_report.h"
#include "shared/capture/frame_record.h"
#include "shared/capture/plan.h"
#include "shared/image/image.h"

namespace stratalux::rig {

// Called by the capturing thread, between two steps: the light waits, on a lease, until it returns. So it returns
// soon, and waits for no disk and no other program. An error ends the capture: all lights off, the session failed with
// a finding `stopped` of its message.
class CaptureObserver {
 public:
  virtual ~CaptureObserver() = default;
  // Before each shot; retry 0: the step's first.
  virtual Status BeforeShot(const PlanStep& /*step*/, int /*retry*/) { return Status::Ok(); }
  // A shot that does not count.
  virtual void OnFault(const PlanStep& /*step*/, ShotFault /*fault*/) {}
  // A step has its frame or was given up: once a step.
  virtual void OnStepDone(const PlanStep& /*step*/) {}
  // Each frame on its way to the store, its verdict in level_check; steps shot again have several.
  virtual void OnFrame(const FrameRecord& /*record*/, const Image<uint16_t>& /*pixels*/) {}
  // As it comes up: a motion white that differs at once, else of a projector after its last step, of the session at
  // its end.
  virtual Status OnFinding(const Finding& /*finding*/) { return Status::Ok(); }
  // After the last frame: why the session is worth less than its proofs say (FindingKind::kWatch).
  [[nodiscard]] virtual std::vector<Finding> Objections() const { return {}; }
};

// Several as one; all outlive it. The first error is the one that counts, all are told.
class ObserverList final : public CaptureObserver {
 public:
  explicit ObserverList(std::vector<CaptureObserver*> observers) : observers_(std::move(observers)) {}

  Status BeforeShot(const PlanStep& step, int retry) override {
    Status first;
    for (CaptureObserver* o : observers_) Keep(first, o->BeforeShot(step, retry));
    return first;
  }
  void OnFault(const PlanStep& step, ShotFault fault) override {
    for (CaptureObserver* o : observers_) o->OnFault(step, fault);
  }
  void OnStepDone(const PlanStep& step) override {
    for (CaptureObserver* o : observers_) o->OnStepDone(step);
  }
  void OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) override {
    for (CaptureObserver* o : observers_) o->OnFrame(record, pixels);
  }
  Status OnFinding(const Finding& finding) override {
    Status first;
    for (CaptureObserver* o : observers_) Keep(first, o->OnFinding(finding));
    return first;
  }
  [[nodiscard]] std::vector<Finding> Objections() const override {
    std::vector<Finding> all;
    for (const CaptureObserver* o : observers_)
      for (Finding& finding : o->Objections()) all.push_back(std::move(finding));
    return all;
  }

 private:
  static void Keep(Status& first, Status next) {
    if (first.ok()) first = std::move(next);
  }
  std::vector<CaptureObserver*> observers_;
};

}  // namespace stratalux::rig
