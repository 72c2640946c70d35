// SPDX-License-Identifier: Apache-2.0
// ScriptedRig: line bank, camera and projectors on a clock of their own, which misbehave exactly where a test says so.
// Projectors step a real pattern memory, the camera sees a tilted scene with a blurred, partly global response.
#pragma once

#include <atomic>
#include <deque>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "firmware-host/safety/light_guard.h"
#include "firmware-host/sequence/shooter.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

enum class CameraTrouble {
  kLose,          // no frame; the driver still counts it
  kIgnore,        // no exposure at all: the driver's number stays
  kSkipNumber,    // the frame comes, but the driver dropped one before it
  kRepeat,        // the buffer is delivered twice
  kExtra,         // a second exposure nobody asked for
  kLate,          // exposed long after the trigger
  kCorrupt,       // error flag
  kDeliverAfter,  // arrives after the next trigger's frame
};
enum class ProjectorTrouble {
  kNoEdge,      // steps, but the SYNC edge is lost
  kIgnore,      // does not step, no edge
  kDoubleStep,  // steps twice, two edges
  kStuck,       // SYNC edge, but the picture stays
};

// Two projectors of 128 x 64 px, as ScriptedRig(2, 128, 64) has them: short enough to be shot a hundred times.
[[nodiscard]] PlanOptions PlanOfScriptedRig();

class ScriptedRig {
 public:
  ScriptedRig(int projectors, int projector_width, int projector_height);

  [[nodiscard]] RigDevices devices();
  // By running number of the camera trigger, and of the pulse of one projector, from 0.
  std::map<int64_t, CameraTrouble> camera_trouble;
  std::map<std::pair<int, int64_t>, ProjectorTrouble> projector_trouble;  // (projector, pulse)
  int preroll_offset = 0;  // frames by which every memory starts too late (> 0) or too early
  // By camera trigger: camera pixels by which the subject jumps to the right. Each sees one column more for every
  // eight.
  std::map<int64_t, int> jumps;
  double lamp_drift = 0.0;  // relative change of all light per camera trigger
  int64_t camera_dead_from = -1;
  ClockSource clock = ClockSource::kSimulated;
  std::map<int, int> enable_wired;  // line -> projector whose light it switches; not there: its own, -1: none
  std::map<int, int> sync_wired;    // projector -> SYNC line its edges come on; not there: its own
  bool inverted = false;            // pictures come out inverted
  std::atomic<StopReason> interlock = StopReason::kNone;
  std::chrono::nanoseconds pulse_time = std::chrono::milliseconds(1);  // that a call for a pulse takes
  std::function<void(int64_t trigger)> on_camera_trigger;
  std::function<void()> on_load;
  StopToken stop;

  // What the lines did.
  [[nodiscard]] std::set<int> lit() const;       // projectors whose light is on
  [[nodiscard]] std::set<int> ever_lit() const;  // lines that were ever switched on
  int loads = 0, rests = 0;
  int trusting_loads = 0;  // with no Doubt before
  int lit_rests = 0;       // with a light on
  int64_t camera_triggers = 0;
  int torn_exposures = 0;  // pulses of a projector while the camera exposed
  int early_triggers = 0;  // of the camera, before it had delivered the frame before (or, overlapped, exposed it)
  bool overlapped = false;
  std::map<int64_t, std::map<int, Pattern>> shown;  // by driver number: what each lit projector showed
  bool camera_running = false;

  // A SYNC edge that no pulse asked for.
  void Ring(int projector) { edges_.push_back({projector, edge_sequence_++, now()}); }
  void Advance(std::chrono::nanoseconds time) { now_ = now() + time; }
  [[nodiscard]] int64_t PulsesOf(int projector) const { return memories_[projector].pulses; }

 private:
  friend class ScriptedEnable;
  friend class ScriptedInterlock;
  friend class ScriptedClock;
  friend class ScriptedLines;
  friend class ScriptedCamera;
  friend class ScriptedProjector;
  struct Memory {
    std::vector<Pattern> sequence;
    int64_t shown = -1;  // index into the sequence
    int64_t pulses = 0;
  };
  [[nodiscard]] std::map<int, Pattern> Shown() const;
  [[nodiscard]] Image<uint16_t> Expose() const;
  void Pulse(int projector);
  void TriggerCamera(MonotonicNs time);

  int width_, height_;
  // The rig's clock, also seen by the guard's thread.
  struct Clock {
    std::atomic<int64_t> ns = 1'000'000'000;
    operator MonotonicNs() const { return {ns.load()}; }
    Clock& operator=(MonotonicNs time) {
      ns.store(time.ns);
      return *this;
    }
  };
  [[nodiscard]] MonotonicNs now() const { return now_; }
  Clock now_;
  std::vector<Memory> memories_;
  std::deque<SyncEdge> edges_;
  std::deque<CapturedFrame> frames_;
  std::deque<CapturedFrame> held_back_;
  int64_t triggers_ = 0;
  int64_t edge_sequence_ = 0;
  int64_t driver_sequence_ = 100;
  double exposure_ms_ = 0.0;
  MonotonicNs exposed_until_, read_out_until_;
  std::vector<std::unique_ptr<LightSwitch>> enables_;
  std::unique_ptr<InterlockInput> interlock_input_;
  std::unique_ptr<LeaseClock> lease_clock_;
  std::unique_ptr<LightGuard> light_;
  std::unique_ptr<LineBank> lines_;
  std::unique_ptr<FrameSource> camera_;
  std::vector<std::unique_ptr<Projector>> projectors_;
};

}  // namespace stratalux::rig
