// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/sequence/scripted_rig.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {
constexpr int kCameraWidth = 160;
constexpr int kCameraHeight = 120;
constexpr double kBlackDn = 64.0;
constexpr double kWhiteDn = 1500.0;  // per projector, at albedo 1
constexpr double kNoiseDn = 1.0;
constexpr auto kReadOut = std::chrono::milliseconds(8);

std::chrono::nanoseconds ExposureOf(const CapturedFrame& frame) { return FromMilliseconds(frame.exposure_ms); }
}  // namespace

class ScriptedEnable final : public LightSwitch {
 public:
  explicit ScriptedEnable(int line) : name_("ENABLE" + std::to_string(line)) {}
  int Set(bool on) noexcept override {
    on_.store(on);
    if (on) ever_on_.store(true);
    return 0;
  }
  int Read(bool& on) noexcept override {
    on = on_.load();
    return 0;
  }
  [[nodiscard]] const char* name() const noexcept override { return name_.c_str(); }
  [[nodiscard]] bool on() const { return on_.load(); }
  [[nodiscard]] bool ever_on() const { return ever_on_.load(); }

 private:
  const std::string name_;
  std::atomic<bool> on_ = false, ever_on_ = false;
};

class ScriptedInterlock final : public InterlockInput {
 public:
  explicit ScriptedInterlock(ScriptedRig& rig) : rig_(rig) {}
  [[nodiscard]] int fd() const noexcept override { return -1; }
  StopReason Take() noexcept override { return rig_.interlock.load(); }

 private:
  ScriptedRig& rig_;
};

class ScriptedClock final : public LeaseClock {
 public:
  explicit ScriptedClock(const ScriptedRig& rig) : rig_(rig) {}
  [[nodiscard]] MonotonicNs Now() const noexcept override { return rig_.now(); }

 private:
  const ScriptedRig& rig_;
};

class ScriptedLines : public LineBank {
 public:
  explicit ScriptedLines(ScriptedRig& rig) : rig_(rig) {}
  Result<TriggerReceipt> TriggerProjector(int projector) override {
    rig_.now_ = rig_.now() + rig_.pulse_time;
    const TriggerReceipt receipt{rig_.triggers_++, rig_.now()};
    for (int p = 0; p < static_cast<int>(rig_.memories_.size()); ++p)
      if (projector < 0 || projector == p) rig_.Pulse(p);
    return receipt;
  }
  Result<TriggerReceipt> TriggerCamera() override {
    rig_.now_ = rig_.now() + rig_.pulse_time;
    const TriggerReceipt receipt{rig_.triggers_++, rig_.now()};
    rig_.TriggerCamera(receipt.time);
    return receipt;
  }
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds timeout) override {
    if (rig_.edges_.empty()) {
      rig_.now_ = rig_.now() + timeout;
      return std::optional<SyncEdge>();
    }
    const SyncEdge edge = rig_.edges_.front();
    rig_.edges_.pop_front();
    rig_.now_ = std::max(rig_.now(), edge.time);
    return std::optional<SyncEdge>(edge);
  }
  [[nodiscard]] std::optional<MonotonicNs> LastStrobe() override { return std::nullopt; }

 private:
  ScriptedRig& rig_;
};

class ScriptedCamera : public FrameSource {
 public:
  explicit ScriptedCamera(ScriptedRig& rig) : rig_(rig) {}
  Status Start() override {
    rig_.camera_running = true;
    return Status::Ok();
  }
  Status Stop() override {
    rig_.camera_running = false;
    return Status::Ok();
  }
  Status SetExposure(double exposure_ms, double) override {
    rig_.exposure_ms_ = exposure_ms;
    return Status::Ok();
  }
  Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds timeout) override {
    if (rig_.frames_.empty()) {
      rig_.now_ = rig_.now() + timeout;
      return std::optional<CapturedFrame>();
    }
    std::optional<CapturedFrame> frame(std::move(rig_.frames_.front()));
    rig_.frames_.pop_front();
    rig_.now_ = std::max(rig_.now(), frame->time + ExposureOf(*frame) + kReadOut);
    return frame;
  }

 private:
  ScriptedRig& rig_;
};

class ScriptedProjector : public Projector {
 public:
  ScriptedProjector(ScriptedRig& rig, int number) : rig_(rig), number_(number) {}
  [[nodiscard]] int width() const override { return rig_.width_; }
  [[nodiscard]] int height() const override { return rig_.height_; }
  Status Load(const std::vector<Pattern>& sequence) override {
    ScriptedRig::Memory& memory = rig_.memories_[number_];
    memory.sequence = sequence;
    memory.shown = -1 - rig_.preroll_offset;
    ++rig_.loads;
    rig_.trusting_loads += !std::exchange(doubted_, false);
    if (rig_.on_load) rig_.on_load();
    return Status::Ok();
  }
  void Doubt() override { doubted_ = true; }
  Status Rest() override {
    ++rig_.rests;
    rig_.lit_rests += !rig_.lit().empty();
    return Status::Ok();
  }

 private:
  ScriptedRig& rig_;
  int number_;
  bool doubted_ = false;
};

PlanOptions PlanOfScriptedRig() {
  PlanOptions options;
  options.projectors = 2;
  options.projector_width = 128;
  options.projector_height = 64;
  options.comb_period = 32;
  options.spot_pitch = 32;
  options.spot_radius = 2;
  return options;
}

ScriptedRig::ScriptedRig(int projectors, int projector_width, int projector_height)
    : width_(projector_width),
      height_(projector_height),
      memories_(projectors),
      lines_(std::make_unique<ScriptedLines>(*this)),
      camera_(std::make_unique<ScriptedCamera>(*this)) {
  std::vector<std::vector<LightSwitch*>> lights;
  for (int p = 0; p < projectors; ++p) {
    projectors_.push_back(std::make_unique<ScriptedProjector>(*this, p));
    enables_.push_back(std::make_unique<ScriptedEnable>(p));
    lights.push_back({enables_.back().get()});
  }
  interlock_input_ = std::make_unique<ScriptedInterlock>(*this);
  lease_clock_ = std::make_unique<ScriptedClock>(*this);
  light_ = LightGuard::Start(std::move(lights), interlock_input_.get(), stop, {.clock = lease_clock_.get()}).value();
}

std::set<int> ScriptedRig::lit() const {
  std::set<int> lit;
  for (int line = 0; line < static_cast<int>(enables_.size()); ++line) {
    const auto wired = enable_wired.find(line);
    const int projector = wired == enable_wired.end() ? line : wired->second;
    if (projector >= 0 && static_cast<const ScriptedEnable&>(*enables_[line]).on()) lit.insert(projector);
  }
  return lit;
}

std::set<int> ScriptedRig::ever_lit() const {
  std::set<int> lines;
  for (int line = 0; line < static_cast<int>(enables_.size()); ++line)
    if (static_cast<const ScriptedEnable&>(*enables_[line]).ever_on()) lines.insert(line);
  return lines;
}

RigDevices ScriptedRig::devices() {
  std::vector<Projector*> all;
  for (const auto& projector : projectors_) all.push_back(projector.get());
  return {*light_, *lines_, *camera_, all};
}

void ScriptedRig::Pulse(int projector) {
  Memory& memory = memories_[projector];
  torn_exposures += now() < exposed_until_;
  const auto found = projector_trouble.find({projector, memory.pulses++});
  const bool troubled = found != projector_trouble.end();
  const auto is = [&](ProjectorTrouble kind) { return troubled && found->second == kind; };
  if (is(ProjectorTrouble::kIgnore)) return;
  if (!is(ProjectorTrouble::kStuck)) ++memory.shown;
  if (is(ProjectorTrouble::kDoubleStep)) ++memory.shown;
  const MonotonicNs edge = now() + std::chrono::microseconds(500);
  if (is(ProjectorTrouble::kNoEdge)) return;
  const auto wired = sync_wired.find(projector);
  edges_.push_back({wired == sync_wired.end() ? projector : wired->second, edge_sequence_++, edge});
  if (is(ProjectorTrouble::kDoubleStep))
    edges_.push_back({projector, edge_sequence_++, edge + std::chrono::milliseconds(1)});
}

std::map<int, Pattern> ScriptedRig::Shown() const {
  std::map<int, Pattern> patterns;
  for (const int p : lit()) {
    const Memory& memory = memories_[p];
    if (memory.shown >= 0 && memory.shown < static_cast<int64_t>(memory.sequence.size()))
      patterns[p] = memory.sequence[memory.shown];
  }
  return patterns;
}

// Pixel (x, y) looks at column 0.8 .. of the projector, slightly sheared; what it sees is 60 % the spot itself,
// blurred over three columns and rows, and 40 % light from the whole picture.
Image<uint16_t> ScriptedRig::Expose() const {
  Image<float> sum(kCameraWidth, kCameraHeight, 1, 0.0F);
  int moved = 0;
  for (const auto& [trigger, pixels] : jumps)
    if (camera_triggers > trigger) moved += pixels;
  const double lamp = 1.0 + lamp_drift * static_cast<double>(camera_triggers);
  std::array<double, kCameraWidth> across{};
  std::array<double, kCameraHeight> down{};
  for (int x = 0; x < kCameraWidth; ++x) across[x] = std::sin(0.05 * (x - moved));
  for (int y = 0; y < kCameraHeight; ++y) down[y] = std::cos(0.07 * y);
  for (const auto& [p, pattern] : Shown()) {
    Image<float> picture = pattern.Render(width_, height_);
    if (inverted)
      for (float& value : picture.pixels()) value = 1.0F - value;
    double mean = 0.0;
    for (float value : picture.pixels()) mean += value;
    mean /= static_cast<double>(picture.size());
    for (int y = 0; y < kCameraHeight; ++y)
      for (int x = 0; x < kCameraWidth; ++x) {
        const int column = static_cast<int>((x + 0.05 * y) * 0.9 * width_ / kCameraWidth) + p + moved / 8;
        const int row = static_cast<int>((y + 0.03 * x) * 0.9 * height_ / kCameraHeight);
        double near = 0.0;
        for (int dy = -1; dy <= 1; ++dy)
          for (int dx = -1; dx <= 1; ++dx)
            near += picture(std::clamp(column + dx, 0, width_ - 1), std::clamp(row + dy, 0, height_ - 1)) / 9.0;
        const double albedo = 0.6 + 0.3 * across[x] * down[y];
        sum(x, y) += static_cast<float>(lamp * kWhiteDn * albedo * (0.6 * near + 0.4 * mean));
      }
  }
  Image<uint16_t> frame(kCameraWidth, kCameraHeight);
  Random noise(7, static_cast<uint64_t>(camera_triggers));
  for (size_t i = 0; i < frame.size(); ++i)
    frame.data()[i] = static_cast<uint16_t>(
        std::clamp(std::round(kBlackDn + sum.data()[i] + kNoiseDn * noise.Normal()), 0.0, 4095.0));
  return frame;
}

void ScriptedRig::TriggerCamera(MonotonicNs time) {
  const int64_t trigger = camera_triggers++;
  if (on_camera_trigger) on_camera_trigger(trigger);
  if (camera_dead_from >= 0 && trigger >= camera_dead_from) return;
  const auto found = camera_trouble.find(trigger);
  const bool troubled = found != camera_trouble.end();
  const auto is = [&](CameraTrouble kind) { return troubled && found->second == kind; };
  if (is(CameraTrouble::kIgnore)) return;
  if (is(CameraTrouble::kSkipNumber)) ++driver_sequence_;
  CapturedFrame frame;
  frame.pixels = Expose();
  frame.cfa = Cfa::kMono;
  frame.sequence = driver_sequence_++;
  shown[frame.sequence] = Shown();
  frame.time = time + std::chrono::microseconds(50);
  if (is(CameraTrouble::kLate)) frame.time = time + std::chrono::milliseconds(90);
  frame.clock = clock;
  frame.exposure_ms = exposure_ms_;
  frame.corrupt = is(CameraTrouble::kCorrupt);
  early_triggers += time < (overlapped ? exposed_until_ : read_out_until_);
  exposed_until_ = frame.time + ExposureOf(frame);
  read_out_until_ = exposed_until_ + kReadOut;
  if (is(CameraTrouble::kLose)) return;
  if (is(CameraTrouble::kDeliverAfter)) {
    held_back_.push_back(std::move(frame));
    return;
  }
  frames_.push_back(frame);
  if (is(CameraTrouble::kRepeat)) frames_.push_back(frame);
  if (is(CameraTrouble::kExtra)) {
    frame.sequence = driver_sequence_++;
    frame.time = frame.time + std::chrono::milliseconds(17);
    frames_.push_back(std::move(frame));
  }
  for (CapturedFrame& late : held_back_) frames_.push_back(std::move(late));
  held_back_.clear();
}

}  // namespace stratalux::rig
