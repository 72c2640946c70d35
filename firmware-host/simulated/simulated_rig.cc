// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/simulated_rig.h"

#include <cmath>
#include <deque>
#include <limits>
#include <mutex>

#include "firmware-host/simulated/interreflection.h"
#include "firmware-host/simulated/light_transport.h"
#include "firmware-host/simulated/rig_description.h"
#include "firmware-host/simulated/sensor.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::rig {
namespace {

constexpr std::chrono::nanoseconds kSyncDelay{400'000};    // TRIGGER to light
constexpr std::chrono::nanoseconds kShutterDelay{20'000};  // TRIGGER to exposure
constexpr std::chrono::nanoseconds kReadout{8'000'000};
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

struct ProjectorState {
  std::vector<Pattern> memory;
  int64_t shown = -1;  // index into memory; -1: nothing yet (black)
  bool enabled = false;
};

struct Exposure {
  std::vector<std::optional<Pattern>> shown;  // per projector; nullopt: light off
  MonotonicNs time;
  double exposure_ms = 0.0;
  double gain = 1.0;
  int64_t number = 0;
};

class World final : public SimulatedRig, public LineBank, public FrameSource {
 public:
  World(const SimulatedRigOptions& options, Scene scene, SkinTable table, Logger& logger)
      : options_(options),
        logger_(logger),
        scene_(std::move(scene)),
        table_(std::move(table)),
        albedo_(table_),
        calibration_(DescribeSimulatedRig(options)),
        states_(calibration_.projectors.size()),
        bounces_(calibration_.projectors.size()),
        transports_(calibration_.projectors.size()) {
    for (size_t p = 0; p < states_.size(); ++p) projectors_.emplace_back(*this, p);
    FindSubject();
  }

  LineBank& lines() override { return *this; }
  FrameSource& camera() override { return *this; }
  std::vector<Projector*> projectors() override {
    std::vector<Projector*> list;
    for (MemoryProjector& p : projectors_) list.push_back(&p);
    return list;
  }
  const RigCalibration& calibration() const override { return calibration_; }
  std::vector<TruthMap> Truth(const CapturePlan& plan) override;

  // LineBank.
  Status SetEnable(int projector, bool on) override {
    const std::lock_guard lock(mutex_);
    if (projector < 0 || projector >= static_cast<int>(states_.size()))
      return Status::Usage("projector " + std::to_string(projector) + " does not exist");
    states_[projector].enabled = on;
    return Status::Ok();
  }
  Status AllOff() override {
    const std::lock_guard lock(mutex_);
    for (ProjectorState& s : states_) s.enabled = false;
    return Status::Ok();
  }
  Result<TriggerReceipt> TriggerProjector(int projector) override {
    const std::lock_guard lock(mutex_);
    const TriggerReceipt receipt{triggers_++, clock_};
    for (size_t p = 0; p < states_.size(); ++p) {
      if (projector >= 0 && p != static_cast<size_t>(projector)) continue;
      ProjectorState& s = states_[p];
      if (s.shown + 1 < static_cast<int64_t>(s.memory.size())) ++s.shown;
      edges_.push_back({static_cast<int>(p), edge_number_++, clock_ + kSyncDelay});
    }
    return receipt;
  }
  Result<TriggerReceipt> TriggerCamera() override {
    const std::lock_guard lock(mutex_);
    const TriggerReceipt receipt{triggers_++, clock_};
    Exposure exposure{{}, clock_ + kShutterDelay, exposure_ms_, gain_, frame_number_++};
    for (const ProjectorState& s : states_) {
      std::optional<Pattern> shown;
      if (s.enabled) shown = s.shown >= 0 ? s.memory[s.shown] : Pattern{};
      exposure.shown.push_back(shown);
    }
    clock_ = clock_ + std::chrono::nanoseconds(static_cast<int64_t>(exposure_ms_ * 1e6)) + kReadout;
    if (started_) exposures_.push_back(std::move(exposure));
    return receipt;
  }
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds timeout) override {
    const std::lock_guard lock(mutex_);
    if (edges_.empty()) {
      clock_ = clock_ + timeout;
      return std::optional<SyncEdge>();
    }
    const SyncEdge edge = edges_.front();
    edges_.pop_front();
    if (clock_ < edge.time) clock_ = edge.time;
    return std::optional(edge);
  }

  // FrameSource.
  Status Start() override {
    const std::lock_guard lock(mutex_);
    started_ = true;
    return Status::Ok();
  }
  Status Stop() override {
    const std::lock_guard lock(mutex_);
    started_ = false;
    exposures_.clear();
    return Status::Ok();
  }
  Status SetExposure(double exposure_ms, double gain) override {
    const std::lock_guard lock(mutex_);
    exposure_ms_ = exposure_ms;
    gain_ = gain;
    return Status::Ok();
  }
  Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds timeout) override {
    Exposure exposure;
    {
      const std::lock_guard lock(mutex_);
      if (exposures_.empty()) {
        clock_ = clock_ + timeout;
        return std::optional<CapturedFrame>();
      }
      exposure = std::move(exposures_.front());
      exposures_.pop_front();
    }
    CapturedFrame frame;
    CameraCalibration sensor = calibration_.camera;  // at the exposure's gain
    sensor.gain_e_per_dn /= exposure.gain;
    sensor.read_noise_dn *= exposure.gain;
    frame.pixels = ExposeSensor(Light(exposure), sensor, exposure.number, {options_.noise, options_.seed});
    frame.cfa = calibration_.camera.cfa;
    frame.sequence = exposure.number;
    frame.time = exposure.time;
    frame.clock = ClockSource::kSimulated;
    frame.exposure_ms = exposure.exposure_ms;
    frame.gain = exposure.gain;
    return std::optional(std::move(frame));
  }

 private:
  class MemoryProjector final : public Projector {
   public:
    MemoryProjector(World& world, size_t index) : world_(world), index_(index) {}
    int width() const override { return world_.calibration_.projectors[index_].model.width; }
    int height() const override { return world_.calibration_.projectors[index_].model.height; }
    Status Load(const std::vector<Pattern>& sequence) override {
      for (const Pattern& pattern : sequence) SLX_RETURN_IF_ERROR(pattern.Validate(width(), height()));
      const std::lock_guard lock(world_.mutex_);
      world_.states_[index_].memory = sequence;
      world_.states_[index_].shown = -1;
      return Status::Ok();
    }

   private:
    World& world_;
    size_t index_;
  };

  void FindSubject();
  Image<float> Light(const Exposure& exposure);
  const LightTransport& Transport(size_t projector);
  const Interreflection& Bounce(size_t projector);
  void AddTruthOfLights(const CapturePlan& plan, std::vector<TruthMap>& maps);
  Image<float> ToQuads(const std::vector<float>& per_pixel, double exposure_ms) const;

  SimulatedRigOptions options_;
  Logger& logger_;
  Scene scene_;
  SkinTable table_;
  SkinAlbedo albedo_;
  RigCalibration calibration_;
  std::vector<SubjectPixel> subject_;
  std::mutex mutex_;  // guards what follows
  std::vector<ProjectorState> states_;
  std::deque<MemoryProjector> projectors_;
  std::deque<SyncEdge> edges_;
  std::deque<Exposure> exposures_;
  MonotonicNs clock_{1'000'000'000};
  int64_t triggers_ = 0, edge_number_ = 0, frame_number_ = 0;
  bool started_ = false;
  double exposure_ms_ = 16.0, gain_ = 1.0;
  std::vector<std::unique_ptr<Interreflection>> bounces_;
  std::vector<std::unique_ptr<LightTransport>> transports_;  // both made on first use by the camera's thread
};

void World::FindSubject() {
  const Pinhole& camera = calibration_.camera.model;
  std::vector<std::vector<SubjectPixel>> rows(camera.height);
  ParallelFor(camera.height, 8, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const auto hit = scene_.Intersect({Eigen::Vector3d::Zero(), camera.Unproject({double(x), double(y)})});
        if (!hit) continue;
        const Eigen::Vector3d normal = scene_.Normal(*hit);
        if (normal.dot(-hit->normalized()) < 0.02) continue;
        rows[y].push_back({x, y, *hit, normal, scene_.MaterialAt(*hit)});
      }
  });
  for (const auto& row : rows) subject_.insert(subject_.end(), row.begin(), row.end());
}

const LightTransport& World::Transport(size_t projector) {
  if (!transports_[projector]) {
    logger_.Debug("simulated rig: light transport of projector " + std::to_string(projector));
    transports_[projector] = std::make_unique<LightTransport>(
        scene_, table_, albedo_, calibration_, static_cast<int>(projector), subject_,
        LightTransportOptions{options_.scattering && scene_.description().skin.body == SkinBody::kTranslucent});
  }
  return *transports_[projector];
}

const Interreflection& World::Bounce(size_t projector) {
  if (!bounces_[projector])
    bounces_[projector] =
        std::make_unique<Interreflection>(scene_, albedo_, calibration_, static_cast<int>(projector), subject_);
  return *bounces_[projector];
}

Image<float> World::Light(const Exposure& exposure) {
  std::vector<float> light(subject_.size(), 0.0F);
  for (size_t p = 0; p < exposure.shown.size(); ++p) {
    if (!exposure.shown[p]) continue;
    // A projector's black still shines: b + (1 - b) pattern.
    const float black = static_cast<float>(calibration_.projectors[p].black_level);
    std::vector<float> white(subject_.size(), 0.0F), pattern(subject_.size(), 0.0F);
    const LightTransport& transport = Transport(p);
    transport.Render({.kind = PatternKind::kWhite}, white, white);
    transport.Render(*exposure.shown[p], pattern, pattern);
    if (scene_.description().interreflection) {
      Bounce(p).Render({.kind = PatternKind::kWhite}, white);
      Bounce(p).Render(*exposure.shown[p], pattern);
    }
    for (size_t i = 0; i < light.size(); ++i) light[i] += black * white[i] + (1.0F - black) * pattern[i];
  }
  const float scale = static_cast<float>(exposure.exposure_ms * exposure.gain);
  const Pinhole& camera = calibration_.camera.model;
  Image<float> image(camera.width, camera.height, 1,
                     static_cast<float>(scene_.description().ambient_dn_per_ms) * scale);
  for (size_t i = 0; i < light.size(); ++i) image(subject_[i].x, subject_[i].y) += light[i] * scale;
  return image;
}

Image<float> World::ToQuads(const std::vector<float>& per_pixel, double exposure_ms) const {
  const Pinhole& camera = calibration_.camera.model;
  Image<float> quads(camera.width / 2, camera.height / 2, 3);
  for (size_t i = 0; i < subject_.size(); ++i) {
    const SubjectPixel& s = subject_[i];
    if (s.x / 2 >= quads.width() || s.y / 2 >= quads.height()) continue;
    const int colour = CfaColour(calibration_.camera.cfa, s.x, s.y);
    quads(s.x / 2, s.y / 2, colour) += static_cast<float>(exposure_ms) * per_pixel[i] * (colour == 1 ? 0.5F : 1.0F);
  }
  return quads;
}

std::vector<TruthMap> World::Truth(const CapturePlan& plan) {
  const Pinhole& camera = calibration_.camera.model;
  const int width = camera.width / 2, height = camera.height / 2;
  TruthMap depth{"depth", Image<float>(width, height, 1, kNaN)}, normal{"normal", Image<float>(width, height, 3, kNaN)};
  TruthMap material{"material", Image<float>(width, height)};
  TruthMap mask{"mask", Image<float>(width, height)}, optics{"optics", Image<float>(width, height, 2, kNaN)};
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < width; ++i) {
        const auto hit = scene_.Intersect({Eigen::Vector3d::Zero(), camera.Unproject(QuadCentre(Cfa::kRggb, i, j))});
        if (!hit) continue;
        const Eigen::Vector3d n = scene_.Normal(*hit);
        const Material here = scene_.MaterialAt(*hit);
        mask.map(i, j) = 1.0F;
        material.map(i, j) = static_cast<float>(here.kind);
        depth.map(i, j) = static_cast<float>(hit->z());
        for (int k = 0; k < 3; ++k) normal.map(i, j, k) = static_cast<float>(n[k]);
        if (here.kind != MaterialKind::kSkin) continue;
        optics.map(i, j, 0) = here.skin.melanin;
        optics.map(i, j, 1) = here.skin.blood;
      }
  });
  std::vector<TruthMap> maps = {std::move(depth), std::move(normal), std::move(mask), std::move(optics),
                                std::move(material)};
  AddTruthOfLights(plan, maps);
  return maps;
}

void World::AddTruthOfLights(const CapturePlan& plan, std::vector<TruthMap>& maps) {
  const PlanOptions& o = plan.options;
  const std::vector<std::pair<std::string, Pattern>> lights = {
      {"white", {.kind = PatternKind::kWhite}},
      {"stripe", {.kind = PatternKind::kComb, .period = o.comb_period, .width = o.comb_width, .shift = 0}},
      {"spot", {.kind = PatternKind::kSpots, .period = o.spot_pitch, .width = o.spot_radius}}};
  for (size_t p = 0; p < transports_.size() && p < static_cast<size_t>(o.projectors); ++p) {
    const float open = 1.0F - static_cast<float>(calibration_.projectors[p].black_level);
    const std::string suffix = " " + std::to_string(p);
    for (const auto& [name, pattern] : lights) {
      if (name == "spot" && o.spot_radius == 0) continue;
      std::vector<float> subsurface(subject_.size(), 0.0F), direct(subject_.size(), 0.0F);
      Transport(p).Render(pattern, subsurface, direct);
      for (float& v : subsurface) v *= open;  // what a frame minus its black frame holds
      for (float& v : direct) v *= open;
      maps.push_back({"subsurface " + name + suffix, ToQuads(subsurface, o.exposure_ms)});
      maps.push_back({"direct " + name + suffix, ToQuads(direct, o.exposure_ms)});
      if (!scene_.description().interreflection) continue;
      std::vector<float> indirect(subject_.size(), 0.0F);
      Bounce(p).Render(pattern, indirect);
      for (float& v : indirect) v *= open;
      maps.push_back({"interreflection " + name + suffix, ToQuads(indirect, o.exposure_ms)});
    }
    TruthMap at{"column" + suffix,
                Image<float>(calibration_.camera.model.width, calibration_.camera.model.height, 2, kNaN)};
    for (size_t i = 0; i < subject_.size(); ++i)
      for (int k = 0; k < 2; ++k) at.map(subject_[i].x, subject_[i].y, k) = Transport(p).ColumnRow(i)[k];
    maps.push_back(std::move(at));
  }
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

Result<std::unique_ptr<SimulatedRig>> SimulatedRig::Create(const SimulatedRigOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(auto scene, Scene::Create(options.scene, options.seed));
  SLX_ASSIGN_OR_RETURN(auto table,
                       SkinTable::Load(options.skin_table.empty() ? SkinTable::DefaultPath() : options.skin_table));
  return std::unique_ptr<SimulatedRig>(new World(options, std::move(scene), std::move(table), logger));
}

}  // namespace stratalux::rig
