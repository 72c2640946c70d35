// SPDX-License-Identifier: Apache-2.0
// Shooter: one planned step = one projector pulse, one SYNC edge, one frame, each by its deadline.
//
//   triggered      TRIGGER -> SYNC -> settle -> camera TRIGGER -> its frame, by number and time
//   free_running   TRIGGER -> SYNC -> settle -> the first whole exposure that the streaming camera takes after that;
//                  frames before it are the transition: looked at, counted and dropped
//
// The parts of a step can be called one by one, so that the next step goes on show while a frame is still read out:
//
//   Show(1) Expose(1) | AwaitEnd(1) Show(2) [Collect(1)] Expose(2) [or Collect(1)] | AwaitEnd(2) Show(3) ...
#pragma once

#include <chrono>
#include <deque>
#include <functional>
#include <optional>
#include <vector>

#include "firmware-host/camera/camera_timing.h"
#include "firmware-host/camera/frame_source.h"
#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/projector/projector.h"
#include "firmware-host/safety/light_guard.h"
#include "firmware-host/sequence/capture_report.h"
#include "firmware-host/sequence/deadlines.h"
#include "firmware-host/sequence/frame_pairing.h"
#include "firmware-host/sequence/row_memory.h"
#include "shared/capture/frame_record.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

inline constexpr std::chrono::nanoseconds kLongestUnasked =
    std::chrono::milliseconds(20);  // of waits: then safety is asked

struct RigDevices {
  LightGuard& light;
  LineBank& lines;
  FrameSource& camera;
  std::vector<Projector*> projectors;
};

struct ShooterOptions {
  // From SYNC to the camera trigger: the projector's light source and the camera's own trigger delay.
  std::chrono::nanoseconds settle = std::chrono::milliseconds(2);
  CameraTiming camera;
  // From TRIGGER to SYNC; from the planned end of an exposure to its frame (free running: from two exposures after the
  // light has settled).
  std::chrono::nanoseconds sync_deadline = std::chrono::milliseconds(100);
  std::chrono::nanoseconds frame_deadline = std::chrono::milliseconds(500);
  // Shorter ones, where a selftest learnt them, for as long as they hold (AnswerWatch).
  std::optional<LearntDeadlines> learnt;
  std::chrono::nanoseconds frame_slack = std::chrono::milliseconds(20);  // of the frame's time after its trigger
  double gain = 1.0;
  // Reported exposure and gain may differ from those set by this share (cameras count in lines).
  double exposure_tolerance = 0.02;
  // Rows that repeat an earlier frame's bit by bit spoil a shot beyond this share. 1: never; the sequencer takes that
  // for a camera of WitnessOptions::read_noise_dn 0.
  double max_repeated_rows = 0.01;
  // How `settle` passes; empty: in real time. Set only for rigs with a clock of their own, such as the simulated one.
  std::function<void(std::chrono::nanoseconds)> wait;
};

// A step on show; once exposed, its frame is still to come.
struct StepExposure {
  const PlanStep* step = nullptr;
  int retry = 0;
  Patience patience = Patience::kConfigured;  // with its frame
  TriggerReceipt pulse;                       // of the projector
  MonotonicNs sync;                           // its answer
  TriggerReceipt camera;                      // triggered: the camera's pulse, of the bank's numbers
  int64_t number = 0;                         // of camera triggers
};

// A frame and its proof; `fault` says why it does not count.
struct Shot {
  ShotFault fault = ShotFault::kNone;
  FrameRecord record;
  Image<uint16_t> pixels;
};

class Shooter {
 public:
  // `safe` is asked before each shot and every 20 ms of waiting; its error ends the shot.
  Shooter(RigDevices devices, ShooterOptions options, SyncMode mode, std::function<Status()> safe);

  // Each fails only where going on is pointless (a device error, not safe, a frame of an unknown clock or of another
  // size); what a second try may heal is a fault.
  //
  // The whole step, nothing else being exposed.
  Result<Shot> Take(const PlanStep& step, int retry);
  // A frame of what is on show, no projector moved on. Of `like` count exposure and what the record repeats.
  Result<Shot> Snap(const PlanStep& like);
  // Moves the projector on; nullopt: no SYNC edge. Another exposure time than the last step's is set here: nothing may
  // be exposed then. `step` outlives its exposure.
  Result<std::optional<StepExposure>> Show(const PlanStep& step, int retry);
  // Lets the light settle and triggers the camera, not before it can.
  Status Expose(StepExposure& exposure);
  // Lets the exposure pass: now the projector may move on.
  Status AwaitEnd(const StepExposure& exposure);
  // The frame. One whose exposure had not ended when a projector moved on is kLateFrame.
  Result<Shot> Collect(const StepExposure& exposure);
  // Numbers and triggers are known to go together, so that a frame of two that are under way can be told by its number.
  [[nodiscard]] bool CountsFrames() const { return pairing_.KnowsNumbers(); }
  // No exposure was begun after it.
  [[nodiscard]] bool IsLast(const StepExposure& exposure) const { return last_trigger_ <= exposure.camera.time; }
  // Read away what came unasked since the last shot, which it spoils: kExtraSync; kDoubledFrame or kOutOfOrder.
  Result<ShotFault> DrainEdges();
  Result<ShotFault> DrainFrames();
  // Both.
  Result<ShotFault> Drain();
  // Camera triggers; free running: frames asked for.
  [[nodiscard]] int64_t camera_triggers() const { return camera_triggers_; }
  [[nodiscard]] int64_t transition_frames() const { return transition_frames_; }
  [[nodiscard]] int64_t transition_lost() const { return pairing_.lost_in_transition(); }
  [[nodiscard]] const AnswerWatch& answers() const { return watch_; }

 private:
  // Lets time pass on the rig's clock, looking at safety.
  Status Pass(std::chrono::nanoseconds time);
  // Waits for the SYNC edges of `projector` (-1: one of each); nullopt at the deadline.
  Result<std::optional<MonotonicNs>> AwaitSync(int projector, const TriggerReceipt& trigger, Patience patience);
  // `match` says whose a frame is; kOutOfOrder and kDoubledFrame keep waiting. A frame of the `next` trigger, if there
  // was one, is kept for that exposure: this one's was lost. `due`: from when on RigDelays::frame counts.
  // A frame that was given up before, and comes before this one, harms nothing.
  Result<Shot> AwaitFrame(const StepExposure& exposure, MonotonicNs due, const std::optional<TriggerReceipt>& next,
                          const std::function<ShotFault(const CapturedFrame&)>& match);
  // The next one, if it comes by then. `came`: when it did, where that was seen; else it was here before.
  Result<std::optional<CapturedFrame>> NextFrame(MonotonicNs until, std::optional<MonotonicNs>& came);
  // Whether it is that of an exposure that was given up at its deadline; asked once of each.
  bool WasGivenUp(const CapturedFrame& frame);
  Result<Shot> CollectTriggered(const StepExposure& exposure);
  // Brings the camera to the step's exposure; nothing may be exposed then. kConfigured where that is another one than
  // before: a stream shows it some frames later.
  Result<Patience> Prepare(const PlanStep& step);
  // Reads away the frames of a stream that wait already: they are older than the shot.
  Status PassOverStream();
  Result<Shot> CollectFromStream(const StepExposure& exposure);
  Status CheckFrame(const CapturedFrame& frame);
  // As the camera reports it.
  [[nodiscard]] bool HasExposure(const PlanStep& step, const CapturedFrame& frame) const;

  RigDevices devices_;
  ShooterOptions options_;
  SyncMode mode_;
  std::function<Status()> safe_;
  FramePairing pairing_;
  AnswerWatch watch_;
  std::deque<StepExposure> given_up_;  // triggered: without a frame at their deadline, the last few
  RowMemory rows_;
  double exposure_ms_ = -1.0;           // as last set
  MonotonicNs last_pulse_;              // of a projector
  std::optional<CapturedFrame> early_;  // of the exposure that is collected next
  MonotonicNs last_trigger_;
  int64_t camera_triggers_ = 0;
  int64_t transition_frames_ = 0;
  std::optional<CapturedFrame> first_;  // without pixels: size, format and clock every later frame must share
  int first_width_ = 0;
  int first_height_ = 0;
};

}  // namespace stratalux::rig
