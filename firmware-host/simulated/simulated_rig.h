// SPDX-License-Identifier: Apache-2.0
// The simulated rig: a scene, four projectors and a camera behind the interfaces of the real devices. Its clock is its
// own (ClockSource::kSimulated), so a capture runs as fast as the frames can be computed.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/camera/frame_source.h"
#include "firmware-host/events/rig_events.h"
#include "firmware-host/gpio/line_bank.h"
#include "firmware-host/projector/projector.h"
#include "firmware-host/safety/light_guard.h"
#include "firmware-host/simulated/device_options.h"
#include "firmware-host/simulated/fault_script.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/plan.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::rig {

struct SimulatedRigOptions {
  uint64_t seed = 1;        // another seed: another face, another skin
  int camera_width = 1392;  // mosaic pixels; the field of view does not depend on it
  int camera_height = 1042;
  int projector_width = 1024;
  int projector_height = 768;
  bool scattering = true;  // false: an opaque matt skin of the same albedo (ablation)
  bool noise = true;
  // The camera streams by itself, a frame every `devices.timing.frame_period_ms`, and answers no trigger.
  bool free_running = false;
  std::string scene = "head";  // a shape's name or a scene file (simulation_file.h)
  int board_pose = -1;         // which of the scene's poses; -1: the subject's own
  bool lens_covered = false;   // a cap on the lens, as dark sessions want it
  DeviceOptions devices;       // replaced by those of a scene file
  FaultOptions faults;         // a scene file's come on top
  std::string skin_table;      // path; empty: the shipped table
  // What each projector's pattern memory holds (MemoryLayout::Patterns): a Load takes the way there (RigTiming), and
  // kUsage where that does not hold the sequence. Empty: a memory that is filled with what is loaded, after RESET.
  std::vector<std::vector<Pattern>> memories;
  // Ends what takes long (Wait and Truth then say why); outlives the rig. Null: nothing does.
  const StopToken* stop = nullptr;
  std::filesystem::path cache_folder;  // of computed light (LightCache); empty: nothing is kept
  // Told what happens to the rig; outlives it. Null: nobody is.
  RigEvents* events = nullptr;
  // A FIFO that takes what happens from outside (ControlPipe), for whoever opens the rig; empty: none.
  std::filesystem::path control_pipe;

  [[nodiscard]] Status Validate() const;
};

// Who sits before the rig.
struct SubjectOptions {
  std::string scene = "head";  // as SimulatedRigOptions has it; of a scene file its subject alone
  uint64_t seed = 1;           // of the subject; noise and faults keep the rig's
  int board_pose = -1;
  bool lens_covered = false;
};

struct TruthMap {
  std::string name;  // names in docs/simulated-rig.md
  Image<float> map;
};

// The truth of one delivered frame, which only a simulation has: tests hold a capture's proof against it.
struct ShownFrame {
  int64_t exposure = -1;  // number of the frame whose light it shows: its own, unless the buffer is old
  bool whole = false;     // each projector showing one picture throughout
  double spoilt = 0.0;    // share of the pixels that read otherwise than that picture would, beyond all noise
  std::vector<std::optional<Pattern>> pictures;       // of each projector; nullopt: dark
  double exposure_ms = 0.0;                           // as it was, whatever the driver reports
  Eigen::Vector3d push_mm = Eigen::Vector3d::Zero();  // of the subject, by faults
  double light = 1.0;                                 // of the lamps, relative, by faults
};

// Owns the scene; the devices it hands out share it and must not outlive it. Thread-safe for one thread per device.
// Light transport is computed when a frame first needs it: creating a rig takes no longer than reading its skin table.
// A camera TRIGGER takes no time of the rig's clock: Wait passes it, until the frame is read out.
class SimulatedRig {
 public:
  static Result<std::unique_ptr<SimulatedRig>> Create(const SimulatedRigOptions& options, Logger& logger);
  virtual ~SimulatedRig() = default;

  virtual LineBank& lines() = 0;
  virtual FrameSource& camera() = 0;
  virtual std::vector<Projector*> projectors() = 0;
  // What a LightGuard holds: each projector's ENABLE, E-STOP and door (as faults have them), the clock of leases.
  virtual std::vector<LightSwitch*> switches() = 0;
  virtual InterlockInput& interlock() = 0;
  [[nodiscard]] virtual const LeaseClock& clock() const = 0;
  [[nodiscard]] virtual const RigTiming& timing() const = 0;
  // The exact calibration of the simulated devices.
  [[nodiscard]] virtual const RigCalibration& calibration() const = 0;
  // Lets the rig's own clock run: settling costs no real time.
  virtual void Sleep(std::chrono::nanoseconds time) = 0;
  // What a visitor, an operator or a cable does to it: START is pressed (kActive), the door opens, E-STOP is held, the
  // camera's or the lines' plug is drawn, and back (kRest). It acts on the devices and is told as an event.
  // Thread-safe.
  virtual void Happen(RigSignal signal, SignalLevel level) = 0;
  // The camera that went fails for ever, as a real one's handle does; plugged in, it is found again. kNotFound while it
  // is away.
  virtual Status ReopenCamera() = 0;
  // Another subject takes its place: devices, clock, calibration and all handles stay, faults that moved the subject
  // are over, and frames that nobody fetched are gone. kUsage as Create.
  virtual Status SetSubject(const SubjectOptions& subject) = 0;
  // The faults that happened so far; the newest 65,536.
  [[nodiscard]] virtual std::vector<InjectedFault> injected() const = 0;
  // Times that a projector's memory got patterns that it did not hold: never where it was filled beforehand.
  [[nodiscard]] virtual int64_t fillings() const = 0;
  // Camera triggers that came too early and that the camera passed over.
  [[nodiscard]] virtual int64_t ignored_triggers() const = 0;
  // What the frame of this driver number shows; of those delivered since the camera was started.
  [[nodiscard]] virtual ShownFrame ShownOf(int64_t sequence) const = 0;
  // Truth maps at quad resolution (width/2 x height/2), for a plan's comb frame k = 0, white and spot frames.
  virtual Result<std::vector<TruthMap>> Truth(const CapturePlan& plan) = 0;
};

// The guard of its light. `rig` and `stop` outlive it.
[[nodiscard]] Result<std::unique_ptr<LightGuard>> GuardLight(SimulatedRig& rig, StopToken& stop);

}  // namespace stratalux::rig
