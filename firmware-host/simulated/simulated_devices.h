// SPDX-License-Identifier: Apache-2.0
// The simulated devices: lines, projectors and camera on a clock of their own, and the faults they are told to have.
// Private to this folder; everybody else holds a SimulatedRig.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <deque>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "firmware-host/simulated/sensor.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "firmware-host/simulated/world.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

inline constexpr MonotonicNs kClockStart{1'000'000'000};

struct ProjectorState {
  std::vector<Pattern> memory;  // filled beforehand: all of it; else what was loaded
  int64_t next = 0;             // index into memory: what a TRIGGER shows next
  int64_t shown = -1;           // index into memory; -1: nothing yet (black)
  // Where its driver thinks that `next` is: by RESET and the SYNC edges since; nullopt: in doubt.
  std::optional<int64_t> counted;
  bool enabled = false;
  std::vector<Shown> timeline = {{std::nullopt, kClockStart}};
};

// What becomes of a frame's pixels on their way.
enum class Picture { kSound, kShifted, kTorn, kShiftedAndFlagged };

// A frame on its way out of the camera.
struct PendingFrame {
  Exposure light;  // what it shows
  int64_t number = 0;
  MonotonicNs time;
  MonotonicNs ready;         // read out
  double exposure_ms = 0.0;  // as reported
  Picture picture = Picture::kSound;
  std::optional<Exposure> remains;  // kTorn: what its lower rows still show
  bool device_error = false;
};

class SimulatedDevices final : public SimulatedRig,
                               public LineBank,
                               public FrameSource,
                               private InterlockInput,
                               private LeaseClock {
 public:
  SimulatedDevices(const SimulatedRigOptions& options, Scene scene, SkinTable table, Logger& logger)
      : options_(options),
        faults_(options.faults),
        logger_(logger),
        world_(options, std::move(scene), std::move(table), kClockStart, logger),
        sensor_(world_.calibration().camera.model,
                {options.devices.camera, options.noise ? Noise::kOn : Noise::kOff, options.seed}),
        states_(world_.calibration().projectors.size()),
        changed_(NewEvent()) {
    for (size_t p = 0; p < states_.size(); ++p) projectors_.emplace_back(*this, p);
    for (size_t p = 0; p < std::min(states_.size(), options_.memories.size()); ++p)
      states_[p].memory = options_.memories[p];
    for (size_t p = 0; p < states_.size(); ++p) switches_.emplace_back(*this, p);
  }

  LineBank& lines() override { return *this; }
  FrameSource& camera() override { return *this; }
  std::vector<Projector*> projectors() override {
    std::vector<Projector*> list;
    for (MemoryProjector& p : projectors_) list.push_back(&p);
    return list;
  }
  std::vector<LightSwitch*> switches() override {
    std::vector<LightSwitch*> list;
    for (EnableSwitch& one : switches_) list.push_back(&one);
    return list;
  }
  InterlockInput& interlock() override { return *this; }
  const LeaseClock& clock() const override { return *this; }
  const RigTiming& timing() const override { return options_.devices.timing; }
  const RigCalibration& calibration() const override { return world_.calibration(); }
  Result<std::vector<TruthMap>> Truth(const CapturePlan& plan) override {
    const std::lock_guard lock(world_mutex_);
    return world_.Truth(plan);
  }
  Status SetSubject(const SubjectOptions& subject) override;
  void Happen(RigSignal signal, SignalLevel level) override;
  Status ReopenCamera() override;
  void Sleep(std::chrono::nanoseconds time) override {
    const Turn turn(*this);
    clock_ = clock_ + time;
  }
  std::vector<InjectedFault> injected() const override {
    const std::lock_guard lock(mutex_);
    return {injected_.begin(), injected_.end()};
  }
  int64_t fillings() const override {
    const std::lock_guard lock(mutex_);
    return fillings_;
  }
  int64_t ignored_triggers() const override {
    const std::lock_guard lock(mutex_);
    return ignored_triggers_;
  }

  ShownFrame ShownOf(int64_t sequence) const override {
    const std::lock_guard lock(mutex_);
    const auto found = shown_.find(sequence);
    return found == shown_.end() ? ShownFrame() : found->second;
  }

  // LineBank.
  Result<TriggerReceipt> TriggerProjector(int projector) override;
  Result<TriggerReceipt> TriggerCamera() override;
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds timeout) override;
  [[nodiscard]] std::optional<MonotonicNs> LastStrobe() override { return std::nullopt; }

  // FrameSource.
  [[nodiscard]] bool follows_trigger() const override { return !options_.free_running; }
  Status Start() override {
    const Turn turn(*this);
    SLX_RETURN_IF_ERROR(CheckCamera());
    started_ = true;
    shown_.clear();  // of the capture before
    next_frame_ = clock_;
    free_from_ = clock_;
    last_start_.reset();
    return Status::Ok();
  }
  Status Stop() override {
    const Turn turn(*this);
    started_ = false;
    pending_.clear();
    return Status::Ok();
  }
  Status SetExposure(double exposure_ms, double gain) override {
    const Turn turn(*this);
    last_exposure_ms_ = exposure_ms_;
    exposure_ms_ = exposure_ms;
    gain_ = gain;
    return Status::Ok();
  }
  Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds timeout) override;

 private:
  class MemoryProjector final : public Projector {
   public:
    MemoryProjector(SimulatedDevices& devices, size_t index) : devices_(devices), index_(index) {}
    int width() const override { return devices_.calibration().projectors[index_].model.width; }
    int height() const override { return devices_.calibration().projectors[index_].model.height; }
    Status Load(const std::vector<Pattern>& sequence) override {
      for (const Pattern& pattern : sequence) SLX_RETURN_IF_ERROR(pattern.Validate(width(), height()));
      const Turn turn(devices_);
      return devices_.StepTo(index_, sequence);
    }
    void Doubt() override {
      const Turn turn(devices_);
      devices_.states_[index_].counted.reset();
    }
    Status Rest() override {
      const Turn turn(devices_);
      devices_.Rewind(index_);
      return Status::Ok();
    }

   private:
    SimulatedDevices& devices_;
    size_t index_;
  };

  // Lock-free, as the guard and signal handlers need it: the rig takes it over when it is next used.
  class EnableSwitch final : public LightSwitch {
   public:
    EnableSwitch(SimulatedDevices& devices, size_t index)
        : devices_(devices), name_("simulated ENABLE of projector " + std::to_string(index)) {}
    int Set(bool on) noexcept override {
      changed_ns_.store(devices_.published_ns_.load());
      on_.store(on);
      return 0;
    }
    int Read(bool& on) noexcept override {
      on = on_.load();
      return 0;
    }
    [[nodiscard]] const char* name() const noexcept override { return name_.c_str(); }
    [[nodiscard]] bool on() const { return on_.load(); }
    [[nodiscard]] MonotonicNs changed() const { return {changed_ns_.load()}; }

   private:
    SimulatedDevices& devices_;
    const std::string name_;
    std::atomic<bool> on_ = false;
    std::atomic<int64_t> changed_ns_ = kClockStart.ns;
  };

  // InterlockInput and LeaseClock.
  [[nodiscard]] int fd() const noexcept override { return changed_.get(); }
  StopReason Take() noexcept override;
  [[nodiscard]] MonotonicNs Now() const noexcept override { return {published_ns_.load()}; }

  // One use of the devices: what was switched meanwhile counts from now on, and afterwards others see the clock.
  class Turn {
   public:
    explicit Turn(SimulatedDevices& devices) : devices_(devices), lock_(devices.mutex_) { devices_.TakeSwitches(); }
    ~Turn() { devices_.published_ns_.store(devices_.clock_.ns); }
    Turn(const Turn&) = delete;
    Turn& operator=(const Turn&) = delete;

   private:
    SimulatedDevices& devices_;
    const std::lock_guard<std::mutex> lock_;
  };

  void Tell(RigSignal signal, SignalLevel level) noexcept {
    if (options_.events != nullptr) options_.events->Tell(signal, level, MonotonicNow());
  }
  static UniqueFd NewEvent();
  // For a moment, by a fault.
  void Open(StopReason reason) noexcept;
  [[nodiscard]] Status CheckCamera() const;

  // All with mutex_ held.
  void TakeSwitches();
  void Show(size_t projector, MonotonicNs since);
  // A pattern memory that was filled beforehand, not with what is loaded.
  [[nodiscard]] bool IsFilled(size_t projector) const { return projector < options_.memories.size(); }
  // The pattern memory goes to where `sequence` stands, as far as its driver knows.
  Status StepTo(size_t projector, const std::vector<Pattern>& sequence);
  void Rewind(size_t projector);
  void StepOn(ProjectorState& state, int64_t steps) const;
  std::chrono::nanoseconds Jittered(double ms);
  void Log(const Fault& fault, int64_t number);
  [[nodiscard]] PendingFrame Expose();
  [[nodiscard]] PendingFrame ExtraFrame(const PendingFrame& frame);
  void Deliver(PendingFrame frame);
  [[nodiscard]] bool TakesTrigger() const;
  // Time passes to the next frame's end, or by `timeout`.
  void PassTime(std::chrono::nanoseconds timeout);
  // What it shows; true where its number had not come before: a stale buffer brings an old picture again.
  bool Remember(const PendingFrame& frame);
  // One exposure with the faults that its number has.
  void ExposeWithFaults();
  // Free-running: exposes what the camera took since it was last asked, up to `until`.
  void StreamUntil(MonotonicNs until);
  // Start of the stream's next exposure.
  [[nodiscard]] MonotonicNs NextOfStream();
  [[nodiscard]] ShownFrame TruthOf(const PendingFrame& frame) const;
  [[nodiscard]] Result<Image<uint16_t>> Develop(const Exposure& light);
  // Pixels more than six standard deviations of their noise apart.
  [[nodiscard]] double ShareChanged(const Image<uint16_t>& a, const Image<uint16_t>& b) const;

  SimulatedRigOptions options_;
  FaultScript faults_;
  Logger& logger_;
  std::mutex world_mutex_;  // taken after mutex_ where both are
  World world_;
  Sensor sensor_;
  mutable std::mutex mutex_;  // guards what follows
  std::vector<ProjectorState> states_;
  std::deque<MemoryProjector> projectors_;
  std::deque<EnableSwitch> switches_;
  std::atomic<int64_t> published_ns_ = kClockStart.ns;
  std::atomic<StopReason> opened_ = StopReason::kNone;  // by a fault, until somebody looks
  // As they are now.
  std::atomic<bool> door_open_ = false, emergency_stop_ = false, lines_gone_ = false, camera_gone_ = false;
  std::atomic<bool> camera_broken_ = false;  // its handle, since it was unplugged
  UniqueFd changed_;                         // readable when the interlock may have changed
  std::deque<SyncEdge> edges_;
  std::deque<PendingFrame> pending_;
  std::optional<PendingFrame> last_;
  MonotonicNs clock_ = kClockStart;
  int64_t triggers_ = 0, pulses_ = 0, exposures_ = 0, edge_number_ = 0, frame_number_ = 0, jitters_ = 0;
  int64_t ignored_triggers_ = 0, fillings_ = 0;
  bool started_ = false;
  // Triggered: end of the last exposure and of its read-out, its start.
  MonotonicNs exposed_ = kClockStart, free_from_ = kClockStart;
  std::optional<MonotonicNs> last_start_;
  MonotonicNs next_frame_ = kClockStart;  // free-running: start of the next exposure
  int64_t stall_looked_at_ = -1;          // free-running: the exposure whose lateness next_frame_ has
  std::map<int64_t, ShownFrame> shown_;   // by driver number
  double exposure_ms_ = 16.0, last_exposure_ms_ = 16.0, gain_ = 1.0;
  Eigen::Vector3d push_mm_ = Eigen::Vector3d::Zero();
  double light_ = 1.0;
  std::deque<InjectedFault> injected_;
};

}  // namespace stratalux::rig
