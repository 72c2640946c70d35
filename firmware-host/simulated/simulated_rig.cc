// SPDX-License-Identifier: Apache-2.0
// The simulated devices: lines, projectors and camera on a clock of their own, and the faults they are told to have.
#include "firmware-host/simulated/simulated_rig.h"

#include <algorithm>
#include <atomic>
#include <deque>
#include <map>
#include <mutex>

#include "firmware-host/simulated/sensor.h"
#include "firmware-host/simulated/simulation_file.h"
#include "firmware-host/simulated/world.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr MonotonicNs kStart{1'000'000'000};
constexpr size_t kTimeline = 4;  // pictures of a projector that one exposure may see
constexpr double kDefaultLateMs = 200.0, kDefaultMoveMm = 2.0, kDefaultDrift = 0.9;

std::chrono::nanoseconds FromMs(double ms) { return std::chrono::nanoseconds(static_cast<int64_t>(ms * 1e6)); }

constexpr size_t kFramesRemembered = 65536, kFaultsRemembered = 65536;

struct ProjectorState {
  std::vector<Pattern> memory;  // from what was loaded on
  int64_t at = 0;               // where that begins in the whole memory
  int64_t shown = -1;           // index into memory; -1: nothing yet (black)
  bool enabled = false;
  std::vector<Shown> timeline = {{std::nullopt, kStart}};
};

constexpr double kWholeShare = 0.98;  // of an exposure that a picture must fill to be the one shown

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

class Devices final : public SimulatedRig,
                      public LineBank,
                      public FrameSource,
                      private InterlockInput,
                      private LeaseClock {
 public:
  Devices(const SimulatedRigOptions& options, Scene scene, SkinTable table, Logger& logger)
      : options_(options),
        faults_(options.faults),
        world_(options, std::move(scene), std::move(table), kStart, logger),
        sensor_(world_.calibration().camera.model,
                {options.devices.camera, options.noise ? Noise::kOn : Noise::kOff, options.seed}),
        states_(world_.calibration().projectors.size()) {
    for (size_t p = 0; p < states_.size(); ++p) projectors_.emplace_back(*this, p);
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
  void Sleep(std::chrono::nanoseconds time) override {
    const Turn turn(*this);
    clock_ = clock_ + time;
  }
  std::vector<InjectedFault> injected() const override {
    const std::lock_guard lock(mutex_);
    return {injected_.begin(), injected_.end()};
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
  Result<std::optional<MonotonicNs>> WaitStart(std::chrono::nanoseconds) override {
    return std::optional<MonotonicNs>();
  }
  [[nodiscard]] std::optional<MonotonicNs> LastStrobe() override { return std::nullopt; }

  // FrameSource.
  [[nodiscard]] bool follows_trigger() const override { return !options_.free_running; }
  Status Start() override {
    const Turn turn(*this);
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
    MemoryProjector(Devices& devices, size_t index) : devices_(devices), index_(index) {}
    int width() const override { return devices_.calibration().projectors[index_].model.width; }
    int height() const override { return devices_.calibration().projectors[index_].model.height; }
    Status Load(const std::vector<Pattern>& sequence) override {
      for (const Pattern& pattern : sequence) SLX_RETURN_IF_ERROR(pattern.Validate(width(), height()));
      const Turn turn(devices_);
      devices_.StepTo(index_, sequence);
      return Status::Ok();
    }

   private:
    Devices& devices_;
    size_t index_;
  };

  // Lock-free, as the guard and signal handlers need it: the rig takes it over when it is next used.
  class EnableSwitch final : public LightSwitch {
   public:
    EnableSwitch(Devices& devices, size_t index)
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
    Devices& devices_;
    const std::string name_;
    std::atomic<bool> on_ = false;
    std::atomic<int64_t> changed_ns_ = kStart.ns;
  };

  // InterlockInput and LeaseClock.
  [[nodiscard]] int fd() const noexcept override { return -1; }
  StopReason Take() noexcept override { return opened_.exchange(StopReason::kNone); }
  [[nodiscard]] MonotonicNs Now() const noexcept override { return {published_ns_.load()}; }

  // One use of the devices: what was switched meanwhile counts from now on, and afterwards others see the clock.
  class Turn {
   public:
    explicit Turn(Devices& devices) : devices_(devices), lock_(devices.mutex_) { devices_.TakeSwitches(); }
    ~Turn() { devices_.published_ns_.store(devices_.clock_.ns); }
    Turn(const Turn&) = delete;
    Turn& operator=(const Turn&) = delete;

   private:
    Devices& devices_;
    const std::lock_guard<std::mutex> lock_;
  };

  // All with mutex_ held.
  void TakeSwitches();
  void Show(size_t projector, MonotonicNs since);
  // The pattern memory goes to where `sequence` stands.
  void StepTo(size_t projector, const std::vector<Pattern>& sequence);
  std::chrono::nanoseconds Jittered(double ms);
  void Log(const Fault& fault, int64_t number);
  [[nodiscard]] PendingFrame Expose();
  [[nodiscard]] PendingFrame ExtraFrame(const PendingFrame& frame);
  void Deliver(PendingFrame frame);
  [[nodiscard]] bool TakesTrigger() const;
  // Time passes to the next frame's end, or by `timeout`.
  void PassTime(std::chrono::nanoseconds timeout);
  void Remember(const PendingFrame& frame);
  // One exposure with the faults that its number has.
  void ExposeWithFaults();
  // Free-running: exposes what the camera took since it was last asked, up to `until`.
  void StreamUntil(MonotonicNs until);
  [[nodiscard]] ShownFrame TruthOf(const PendingFrame& frame) const;
  [[nodiscard]] Result<Image<uint16_t>> Develop(const Exposure& light);
  // Pixels more than six standard deviations of their noise apart.
  [[nodiscard]] double ShareChanged(const Image<uint16_t>& a, const Image<uint16_t>& b) const;

  SimulatedRigOptions options_;
  FaultScript faults_;
  std::mutex world_mutex_;  // taken after mutex_ where both are
  World world_;
  Sensor sensor_;
  mutable std::mutex mutex_;  // guards what follows
  std::vector<ProjectorState> states_;
  std::deque<MemoryProjector> projectors_;
  std::deque<EnableSwitch> switches_;
  std::atomic<int64_t> published_ns_ = kStart.ns;
  std::atomic<StopReason> opened_ = StopReason::kNone;  // by a fault, until somebody looks
  std::deque<SyncEdge> edges_;
  std::deque<PendingFrame> pending_;
  std::optional<PendingFrame> last_;
  MonotonicNs clock_ = kStart;
  int64_t triggers_ = 0, pulses_ = 0, exposures_ = 0, edge_number_ = 0, frame_number_ = 0, jitters_ = 0;
  int64_t ignored_triggers_ = 0;
  bool started_ = false;
  // Triggered: end of the last exposure and of its read-out, its start.
  MonotonicNs exposed_ = kStart, free_from_ = kStart;
  std::optional<MonotonicNs> last_start_;
  MonotonicNs next_frame_ = kStart;      // free-running: start of the next exposure
  std::map<int64_t, ShownFrame> shown_;  // by driver number
  double exposure_ms_ = 16.0, last_exposure_ms_ = 16.0, gain_ = 1.0;
  Eigen::Vector3d push_mm_ = Eigen::Vector3d::Zero();
  double light_ = 1.0;
  std::deque<InjectedFault> injected_;
};

void Devices::Show(size_t projector, MonotonicNs since) {
  ProjectorState& state = states_[projector];
  std::optional<Pattern> picture;
  if (state.enabled) picture = state.shown >= 0 ? state.memory[state.shown] : Pattern{};
  state.timeline.push_back({picture, since});
  if (state.timeline.size() > kTimeline) state.timeline.erase(state.timeline.begin());
  if (options_.free_running) return;  // its frames are exposed when they are asked for
  // Exposures under way see it, too. A rolling shutter's last row ends later.
  const CameraElectronics& camera = options_.devices.camera;
  const double rows_ms =
      camera.shutter == Shutter::kRolling ? 1e-3 * camera.line_time_us * calibration().camera.model.height : 0.0;
  auto add_to = [&](PendingFrame& frame) {
    if (since < frame.light.start + FromMs(frame.light.exposure_ms + rows_ms))
      frame.light.timeline[projector].push_back({picture, since});
  };
  for (PendingFrame& frame : pending_) add_to(frame);
  if (last_) add_to(*last_);
}

void Devices::StepTo(size_t projector, const std::vector<Pattern>& sequence) {
  ProjectorState& state = states_[projector];
  int64_t target = 0;
  if (projector < options_.memories.size()) {
    const std::vector<Pattern>& memory = options_.memories[projector];
    // What is reloaded mostly runs to the end of the memory.
    const auto found = std::find_end(memory.begin(), memory.end(), sequence.begin(), sequence.end());
    if (found != memory.end()) target = found - memory.begin();
  }
  const int64_t next = state.at + state.shown + 1;
  const RigTiming& timing = options_.devices.timing;
  const bool behind = state.memory.empty() || target < next;
  clock_ = clock_ + FromMs((behind ? timing.memory_reset_ms : 0.0) +
                           static_cast<double>(target - (behind ? 0 : next)) * timing.memory_step_ms);
  state.memory = sequence;
  state.at = target;
  state.shown = -1;
  Show(projector, clock_);
}

std::chrono::nanoseconds Devices::Jittered(double ms) {
  const double jitter_us = options_.devices.timing.jitter_us;
  if (jitter_us <= 0.0) return FromMs(ms);
  Random random(options_.seed, (uint64_t{1} << 48) + static_cast<uint64_t>(jitters_++));
  return FromMs(std::max(0.0, ms + 1e-3 * jitter_us * random.Normal()));
}

void Devices::Log(const Fault& fault, int64_t number) {
  if (injected_.size() == kFaultsRemembered) injected_.pop_front();
  injected_.push_back({fault.kind, number, 1e-9 * static_cast<double>((clock_ - kStart).count())});
}

void Devices::TakeSwitches() {
  for (size_t p = 0; p < states_.size(); ++p) {
    const bool on = switches_[p].on();
    if (states_[p].enabled == on) continue;
    states_[p].enabled = on;
    Show(p, switches_[p].changed());
  }
}

Result<TriggerReceipt> Devices::TriggerProjector(int projector) {
  const Turn turn(*this);
  const TriggerReceipt receipt{triggers_++, clock_};
  const int64_t pulse = pulses_++;
  int edges = 1, advance = 1;
  for (const Fault& fault : faults_.AtPulse(pulse)) {
    Log(fault, pulse);
    if (fault.kind == FaultKind::kLinesGone) return Status::Failed("simulated lines: the chip is gone (ENODEV)");
    if (fault.kind == FaultKind::kEdgeLost || fault.kind == FaultKind::kSyncStuck) edges = 0;
    if (fault.kind == FaultKind::kEdgeDoubled) edges = 2;
    if (fault.kind == FaultKind::kProjectorLag) advance = 0;
    if (fault.kind == FaultKind::kProjectorSkip) advance = 2;
    if (fault.kind == FaultKind::kEmergencyStop) opened_.store(StopReason::kEmergencyStop);
    if (fault.kind == FaultKind::kDoorOpen) opened_.store(StopReason::kDoorOpen);
  }
  for (size_t p = 0; p < states_.size(); ++p) {
    if (projector >= 0 && p != static_cast<size_t>(projector)) continue;
    ProjectorState& s = states_[p];
    s.shown = std::min(s.shown + advance, static_cast<int64_t>(s.memory.size()) - 1);
    const MonotonicNs light = clock_ + Jittered(options_.devices.timing.sync_delay_ms);
    Show(p, light);
    for (int k = 0; k < edges; ++k) edges_.push_back({static_cast<int>(p), edge_number_++, light});
    if (edges == 0) ++edge_number_;  // the kernel counted it
  }
  return receipt;
}

PendingFrame Devices::Expose() {
  PendingFrame frame;
  frame.number = frame_number_++;
  frame.time = clock_ + Jittered(options_.devices.timing.shutter_delay_ms);
  frame.exposure_ms = exposure_ms_;
  frame.light = {frame.time, exposure_ms_, gain_, frame.number, {}, push_mm_, light_};
  for (const ProjectorState& s : states_) frame.light.timeline.push_back(s.timeline);
  last_start_ = frame.time;
  exposed_ = frame.time + FromMs(exposure_ms_);
  free_from_ = exposed_ + Jittered(options_.devices.timing.readout_ms);
  frame.ready = free_from_;
  return frame;
}

// One more than was asked for, of the same light: the driver hands out both.
PendingFrame Devices::ExtraFrame(const PendingFrame& frame) {
  PendingFrame extra = frame;
  extra.number = frame_number_++;
  extra.light.number = extra.number;
  extra.time = frame.ready;
  // A stream's frame was exposed when it says so: whoever goes by its time may take it.
  if (options_.free_running) extra.light.start = extra.time;
  extra.picture = Picture::kSound;
  extra.device_error = false;
  return extra;
}

// An exposure's charge needs a place to go when it ends: the frame before must have been read out by then.
bool Devices::TakesTrigger() const {
  const RigTiming& timing = options_.devices.timing;
  if (!last_start_) return true;
  const MonotonicNs start = clock_ + FromMs(timing.shutter_delay_ms);
  if (start < *last_start_ + FromMs(timing.min_frame_period_ms)) return false;
  if (!timing.overlapped_readout) return clock_ >= free_from_;
  return clock_ >= exposed_ && start + FromMs(exposure_ms_) >= free_from_;
}

ShownFrame Devices::TruthOf(const PendingFrame& frame) const {
  ShownFrame truth;
  truth.exposure = frame.light.number;
  truth.whole = true;
  truth.exposure_ms = frame.light.exposure_ms;
  truth.push_mm = frame.light.push_mm;
  truth.light = frame.light.light;
  for (size_t p = 0; p < frame.light.timeline.size(); ++p) {
    const std::vector<Shown>& timeline = frame.light.timeline[p];
    const std::vector<double> shares =
        ShareOfPictures(timeline, frame.light.start, frame.light.exposure_ms, options_.devices.ForProjector(p).lag_ms);
    const size_t most = std::max_element(shares.begin(), shares.end()) - shares.begin();
    double share = 0.0;  // the same picture may have been switched on twice
    for (size_t k = 0; k < shares.size(); ++k)
      if (timeline[k].pattern == timeline[most].pattern) share += shares[k];
    truth.whole = truth.whole && share >= kWholeShare;
    truth.pictures.push_back(timeline[most].pattern);
  }
  return truth;
}

void Devices::Deliver(PendingFrame frame) {
  last_ = frame;
  if (started_) pending_.push_back(std::move(frame));
}

Result<TriggerReceipt> Devices::TriggerCamera() {
  const Turn turn(*this);
  const TriggerReceipt receipt{triggers_++, clock_};
  if (options_.free_running) return receipt;
  if (TakesTrigger())
    ExposeWithFaults();
  else
    ++ignored_triggers_;
  return receipt;
}

void Devices::Remember(const PendingFrame& frame) {
  // A driver number that comes again (a stale buffer) brings the picture it brought before.
  shown_.try_emplace(frame.number, TruthOf(frame));
  if (shown_.size() > kFramesRemembered) shown_.erase(shown_.begin());
}

void Devices::ExposeWithFaults() {
  const int64_t number = exposures_++;
  const std::vector<Fault> faults = faults_.AtExposure(number);
  for (const Fault& fault : faults) {  // what changes the scene comes first
    if (fault.kind == FaultKind::kSubjectMoved && number == fault.at)
      push_mm_.x() += fault.value != 0.0 ? fault.value : kDefaultMoveMm;
    if (fault.kind == FaultKind::kLampDrift) light_ *= fault.value != 0.0 ? fault.value : kDefaultDrift;
  }
  const std::optional<PendingFrame> before = last_;
  PendingFrame frame = Expose();
  int copies = 1;
  bool extra = false;
  for (const Fault& fault : faults) {
    Log(fault, number);
    if (fault.kind == FaultKind::kFrameLost) copies = 0;
    if (fault.kind == FaultKind::kFrameDoubled) copies = 2;
    if (fault.kind == FaultKind::kFrameExtra) extra = true;
    if (fault.kind == FaultKind::kFrameLate)
      frame.time = frame.time + FromMs(fault.value != 0.0 ? fault.value : kDefaultLateMs);
    if (fault.kind == FaultKind::kFrameStale && before) {
      const MonotonicNs ready = frame.ready;
      frame = *before;
      frame.ready = ready;
    }
    if (fault.kind == FaultKind::kFrameFrozen && before) frame.light = before->light;
    if (fault.kind == FaultKind::kFrameCorrupt) frame.picture = Picture::kShiftedAndFlagged;
    if (fault.kind == FaultKind::kFrameGarbled) frame.picture = Picture::kShifted;
    if (fault.kind == FaultKind::kFrameTorn && before) {
      frame.picture = Picture::kTorn;
      frame.remains = before->light;
    }
    if (fault.kind == FaultKind::kExposureLatch) frame.light.exposure_ms = last_exposure_ms_;
    if (fault.kind == FaultKind::kCameraGone) frame.device_error = true;
  }
  for (int k = 0; k < copies; ++k) Deliver(frame);
  if (copies == 0) last_ = frame;
  if (extra) Deliver(ExtraFrame(frame));
}

void Devices::StreamUntil(MonotonicNs until) {
  const MonotonicNs now = clock_;
  const double busy_ms = exposure_ms_ + options_.devices.timing.readout_ms;
  const auto period = FromMs(std::max(options_.devices.timing.frame_period_ms, busy_ms));
  while (next_frame_ + FromMs(busy_ms) <= until) {
    clock_ = next_frame_;
    next_frame_ = next_frame_ + period;
    ExposeWithFaults();
  }
  clock_ = now;
}

Result<std::optional<SyncEdge>> Devices::WaitSync(std::chrono::nanoseconds timeout) {
  const Turn turn(*this);
  if (edges_.empty()) {
    clock_ = clock_ + timeout;
    return std::optional<SyncEdge>();
  }
  const SyncEdge edge = edges_.front();
  edges_.pop_front();
  if (clock_ < edge.time) clock_ = edge.time;
  return std::optional(edge);
}

// Row from which on a spoilt picture is wrong.
int FirstSpoiltRow(int64_t number, int height) {
  return static_cast<int>(Random(0x7ea2, static_cast<uint64_t>(number)).Uniform(0.2, 0.8) * height);
}

// Bytes of a line went missing: what follows stands elsewhere.
void ShiftRows(Image<uint16_t>& pixels, int64_t number) {
  const double share = Random(0x7ea2, static_cast<uint64_t>(number) ^ (uint64_t{1} << 40)).Uniform(0.1, 0.4);
  const int shift = 2 * static_cast<int>(share * pixels.width());
  for (int y = FirstSpoiltRow(number, pixels.height()); y < pixels.height(); ++y)
    std::rotate(pixels.row(y), pixels.row(y) + shift % pixels.width(), pixels.row(y) + pixels.width());
}

Result<Image<uint16_t>> Devices::Develop(const Exposure& light) {
  const std::lock_guard lock(world_mutex_);
  SLX_ASSIGN_OR_RETURN(Image<float> perfect, world_.Light(light));
  return sensor_.Expose(std::move(perfect), {light.exposure_ms, light.gain, light.number});
}

double Devices::ShareChanged(const Image<uint16_t>& a, const Image<uint16_t>& b) const {
  const CameraElectronics& e = options_.devices.camera;
  int64_t changed = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const double x = a.data()[i], y = b.data()[i];
    const double variance = (x + y) / e.gain_e_per_dn + 2.0 * e.read_noise_dn * e.read_noise_dn;
    changed += (x - y) * (x - y) > 36.0 * variance;
  }
  return static_cast<double>(changed) / static_cast<double>(a.size());
}

void Devices::PassTime(std::chrono::nanoseconds timeout) {
  const MonotonicNs deadline = clock_ + timeout;
  if (options_.free_running && started_ && pending_.empty()) {
    const MonotonicNs ready = next_frame_ + FromMs(exposure_ms_ + options_.devices.timing.readout_ms);
    const MonotonicNs until = std::max(clock_, std::min(ready, deadline));
    StreamUntil(until);
    clock_ = until;
    return;
  }
  clock_ = pending_.empty() ? deadline : std::max(clock_, std::min(pending_.front().ready, deadline));
}

Result<std::optional<CapturedFrame>> Devices::Wait(std::chrono::nanoseconds timeout) {
  PendingFrame pending;
  {
    const Turn turn(*this);
    PassTime(timeout);
    if (pending_.empty() || clock_ < pending_.front().ready) return std::optional<CapturedFrame>();
    pending = std::move(pending_.front());
    pending_.pop_front();
    Remember(pending);
  }
  if (pending.device_error) return Status::Failed("simulated camera: the device is gone (ENODEV)");
  CapturedFrame frame;
  SLX_ASSIGN_OR_RETURN(frame.pixels, Develop(pending.light));
  const Image<uint16_t> sound = pending.picture != Picture::kSound ? frame.pixels : Image<uint16_t>();
  if (pending.picture == Picture::kTorn) {
    SLX_ASSIGN_OR_RETURN(const Image<uint16_t> old, Develop(*pending.remains));
    const int first = FirstSpoiltRow(pending.number, old.height());
    std::copy(old.row(first), old.row(0) + old.size(), frame.pixels.row(first));
  } else if (pending.picture != Picture::kSound) {
    ShiftRows(frame.pixels, pending.number);
  }
  if (!sound.empty()) {
    const std::lock_guard lock(mutex_);
    const auto found = shown_.find(pending.number);
    if (found != shown_.end()) found->second.spoilt = ShareChanged(sound, frame.pixels);
  }
  frame.cfa = calibration().camera.cfa;
  frame.sequence = pending.number;
  frame.time = pending.time;
  frame.clock = ClockSource::kSimulated;
  frame.exposure_ms = pending.exposure_ms;
  frame.gain = pending.light.gain;
  frame.corrupt = pending.picture == Picture::kShiftedAndFlagged;
  return std::optional(std::move(frame));
}

bool IsWax(const Scene& scene) { return scene.description().shape == ShapeKind::kSlab; }

Result<Scene> SubjectOf(const SubjectOptions& options, SceneDescription description) {
  SLX_RETURN_IF_ERROR(description.TakePose(options.board_pose).WithContext(options.scene));
  return Scene::Create(description, options.seed);
}

Result<SkinTable> TableFor(const SimulatedRigOptions& options, const Scene& scene) {
  const bool wax = IsWax(scene);
  const std::string shipped = wax ? SkinTable::DefaultWaxPath() : SkinTable::DefaultPath();
  Result<SkinTable> loaded = SkinTable::Load(options.skin_table.empty() ? shipped : options.skin_table);
  if (loaded.status().code() == StatusCode::kNotFound && options.skin_table.empty()) {
    std::string places;
    for (const std::string& place : SkinTable::DefaultPlaces(wax ? SkinTable::kWaxFile : SkinTable::kSkinFile))
      places += (places.empty() ? "" : ", ") + place;
    return Status::NotFound("no skin table; looked for " + places + " (STRATALUX_SKIN_TABLE names another place)");
  }
  SLX_ASSIGN_OR_RETURN(SkinTable table, std::move(loaded));
  if ((table.nodes() == 1) != wax)
    return Status::Usage("skin table " + options.skin_table + ": of " +
                         (wax ? "skin, the scene is a slab of wax" : "wax, the scene is of skin"));
  return table;
}

Status Devices::SetSubject(const SubjectOptions& subject) {
  SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(subject.scene));
  SLX_ASSIGN_OR_RETURN(Scene scene, SubjectOf(subject, simulation.scene));
  const Turn turn(*this);
  const std::lock_guard lock(world_mutex_);
  std::optional<SkinTable> table;
  if (IsWax(scene) != (world_.table().nodes() == 1)) {
    SLX_ASSIGN_OR_RETURN(table, TableFor(options_, scene));
  }
  world_.SetSubject(std::move(scene), std::move(table), clock_);
  pending_.clear();
  last_.reset();
  push_mm_.setZero();
  return Status::Ok();
}

}  // namespace

Status SimulatedRigOptions::Validate() const {
  auto even = [](const char* name, int v, int low, int high) {
    if (v >= low && v <= high && v % 2 == 0) return Status::Ok();
    return Status::Usage(std::string("simulated rig: ") + name + " = " + std::to_string(v) + ", allowed: even, " +
                         std::to_string(low) + " .. " + std::to_string(high));
  };
  SLX_RETURN_IF_ERROR(even("camera width", camera_width, 64, 4096));
  SLX_RETURN_IF_ERROR(even("camera height", camera_height, 48, 4096));
  SLX_RETURN_IF_ERROR(even("projector width", projector_width, 64, 4096));
  SLX_RETURN_IF_ERROR(even("projector height", projector_height, 48, 4096));
  return Status::Ok();
}

Result<std::unique_ptr<SimulatedRig>> SimulatedRig::Create(const SimulatedRigOptions& given, Logger& logger) {
  SLX_RETURN_IF_ERROR(given.Validate());
  SLX_ASSIGN_OR_RETURN(Simulation simulation, LoadSimulation(given.scene));
  SimulatedRigOptions options = given;
  if (given.scene.ends_with(".toml")) {
    options.devices = simulation.devices;
    options.faults = simulation.faults;
    options.faults.script.insert(options.faults.script.end(), given.faults.script.begin(), given.faults.script.end());
    if (given.faults.rate > 0.0) {
      options.faults.rate = given.faults.rate;
      options.faults.seed = given.faults.seed;
      options.faults.kinds = given.faults.kinds;
    }
  }
  SLX_ASSIGN_OR_RETURN(Scene scene, SubjectOf({given.scene, given.seed, given.board_pose}, simulation.scene));
  SLX_ASSIGN_OR_RETURN(SkinTable table, TableFor(options, scene));
  return std::unique_ptr<SimulatedRig>(new Devices(options, std::move(scene), std::move(table), logger));
}

Result<std::unique_ptr<LightGuard>> GuardLight(SimulatedRig& rig, StopToken& stop) {
  std::vector<std::vector<LightSwitch*>> projectors;
  for (LightSwitch* one : rig.switches()) projectors.push_back({one});
  return LightGuard::Start(std::move(projectors), &rig.interlock(), stop, {.clock = &rig.clock()});
}

}  // namespace stratalux::rig
