// SPDX-License-Identifier: Apache-2.0
// CaptureStation: a rig and a store, opened once, that serve one visit after another.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "firmware-host/config/rig_config.h"
#include "firmware-host/sequence/capture_observer.h"
#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/sequence/visit_time.h"
#include "firmware-host/session/exposure_choice.h"
#include "firmware-host/session/learnt_deadlines.h"
#include "firmware-host/session/open_rig.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/session.h"

namespace stratalux::rig {

struct StationOptions {
  RigConfig config;  // store, devices, deadlines, queue; `plan` and `memory`: what the memories hold
  std::optional<SimulatedRigOptions> simulated;  // in place of the devices of `config`
  CameraAtStart camera_at_start = CameraAtStart::kNeeded;

  // kUsage: no devices and no simulation, a camera of too few pixels to tell patterns apart.
  [[nodiscard]] Status Validate() const;
};

// One capture.
struct CaptureRequest {
  PlanOptions plan;
  std::string visitor;  // pseudonym
  // Recorded for the visitor before the capture; without one, the store must hold a consent already.
  std::optional<Consent> consent;
  Retention retention = Retention::kStandard;
  int board_pose = -1;      // calibration: number of the board's pose; -1: none
  std::string calibration;  // that the session names: ChooseCalibration
  std::string visit;        // names the visit that its attempts share; empty: not one of several
  int attempt = 0;          // of the visit, from 1; 0: not counted
  // Of the pre-scan: stored with the session, no reason against it.
  std::vector<Finding> prescan = {};

  // kUsage: a pseudonym that not every list and JSON file can show, a consent without a visitor or without the scope
  // fit, a pose of a plan that has none.
  [[nodiscard]] Status Validate() const;
};

struct CaptureOutcome {
  std::string session;
  CaptureReport report;
  std::vector<Finding> prescan;         // of the request: stored beside the report's, no reason against the session
  std::vector<InjectedFault> injected;  // simulation: of this capture
  double seconds = 0.0;
};

// A white and a black of each projector, before a capture. Never stored.
struct PreScanTaken {
  std::vector<Shot> shots;               // white, black of projector 0, then of 1, ...
  double exposure_ms = 0.0;              // of them
  std::optional<ExposureChoice> choice;  // nullopt: no projector lights anything
};

// Used by one thread. When it goes, all lights are off and the pattern memories at rest.
class CaptureStation {
 public:
  // Opens the rig; the store only with the first capture, which makes a new one where there is none. kUsage where the
  // plan does not fit the devices or their pattern memories. `stop` and `logger` outlive the station.
  static Result<std::unique_ptr<CaptureStation>> Open(const StationOptions& options, StopToken& stop, Logger& logger);
  ~CaptureStation();

  // Whether a capture could begin, before the visitor is asked for anything and the rig moves: request, what the
  // pattern memories hold, consent, disk. Needs no open station.
  [[nodiscard]] static Status MayBegin(const StationOptions& options, const CaptureRequest& request);

  // A whole capture, stored; a simulated one with its truth maps. `observer` may be null; it sees all and may end the
  // capture, and what it objects to makes a complete session a degraded one. Fails where no session came to be (a bad
  // plan, no such store, a visitor without consent: kUsage with the command that records it, a station that was
  // stopped); a session that went wrong is an outcome whose report says why. After a stop: light().Reset().
  Result<CaptureOutcome> Capture(const CaptureRequest& request, CaptureObserver* observer = nullptr);

  // What visitor, operator and cables do: START, door, E-STOP, an unplugged camera. While a capture runs, START is no
  // event: its presses are counted and said. A camera that goes ends the capture (StopReason::kCameraGone).
  [[nodiscard]] RigEvents& events() const { return *rig_.events; }
  // After the camera was unplugged and is back: the next capture has it, and where its going was what stopped the
  // station, the station goes on. kNotFound: it is away still. Not while a capture runs.
  Status ReopenCamera();
  // Since it was opened last: what it was opened as is dead, whether it is back or not, and whatever stopped the
  // station meanwhile.
  [[nodiscard]] bool CameraWent() const { return events().camera_losses() != losses_mended_; }

  // Simulation: who sits before the rig from now on. kUsage on a real one.
  Status SetSubject(const SubjectOptions& subject);

  // The pre-scan: a white and a black of each projector, again at half the exposure while they saturate. One exposure
  // for all, such that the plan takes `longest_visit` at most. Nothing is stored.
  Result<PreScanTaken> TakePreScan(const PlanOptions& plan, const VisitTiming& timing,
                                   std::chrono::nanoseconds longest_visit);
  // Its choice alone; kFailed where nobody is there.
  Result<ExposureChoice> ChooseExposure(const PlanOptions& plan, const VisitTiming& timing,
                                        std::chrono::nanoseconds longest_visit);

  // A frame without a pattern step, of whatever is on show, and the room's light: a preview. Nothing is stored.
  Result<Shot> Snap(double exposure_ms);
  // The same with this projector alone showing a pattern that its memory holds; dark again when it returns.
  Result<Shot> SnapPattern(int projector, const Pattern& pattern, double exposure_ms);
  // As SnapPattern, but it stays lit, for Snap: under a lease that lasts `hold` longer than a frame may take, and by
  // light().Renew() as long as a light may be on at a stretch ([capture] max_on_time_s). light().Off ends it, and any
  // failure.
  Result<Shot> ShowPattern(int projector, const Pattern& pattern, double exposure_ms, std::chrono::nanoseconds hold);

  // The pattern memories go to where they wait between captures, so that the next begins at once: after opening, a
  // capture and a pre-scan of its own accord. What goes wrong is logged.
  void Rest();

  [[nodiscard]] const OpenedRig& rig() const { return rig_; }
  [[nodiscard]] LightGuard& light() const { return *rig_.light; }
  // What sessions are to name, as CaptureRequest::calibration asks for it. kNotFound: none.
  [[nodiscard]] Result<RigCalibration> Calibration(const std::string& asked) const;
  // What an exposure is chosen by, of this camera.
  [[nodiscard]] ExposureRule RuleOfCamera() const;
  // What captures go by: as learnt until one of them finds the rig slower.
  [[nodiscard]] const RigDeadlines& deadlines() const { return deadlines_; }

 private:
  CaptureStation(StationOptions options, OpenedRig rig, StopToken& stop, Logger& logger);
  Status OpenStore();
  [[nodiscard]] SequencerOptions SequencerOptionsFor() const;
  // As configured, and no more than a format that is named can hold.
  [[nodiscard]] double SaturationDn() const;
  [[nodiscard]] SessionInfo Describe(const CaptureRequest& request, std::string calibration_json) const;
  // Sequencer, recorder and archive over one session.
  CaptureReport Record(const CapturePlan& plan, db::SessionWriter writer, const CaptureRequest& request,
                       CaptureObserver& observer);
  enum class Afterwards { kDark, kLit };
  Result<Shot> ShootPattern(int projector, const Pattern& pattern, double exposure_ms, std::chrono::nanoseconds hold,
                            Afterwards afterwards);
  // With the camera running; what a second try may heal is tried again.
  Result<Shot> Shoot(const PlanStep& step, const std::function<Result<Shot>(Shooter&)>& take);

  StationOptions options_;
  OpenedRig rig_;
  RigDeadlines deadlines_;
  int64_t losses_mended_ = 0;  // of the camera's, those that it was opened after
  StopToken& stop_;
  Logger& logger_;
  std::optional<db::SessionStore> store_;  // once a capture began
  bool moved_ = false;                     // a memory, since they were sent to rest
};

}  // namespace stratalux::rig
