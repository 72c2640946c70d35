// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/world.h"

#include <algorithm>
#include <cmath>

#include "firmware-host/simulated/rig_description.h"
#include "shared/base/parallel.h"
#include "shared/base/random.h"
#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

constexpr Pattern kWhite = {.kind = PatternKind::kWhite};

// Integral over time of a step at 0 that is answered with time constant tau.
double StepIntegral(double t_ms, double tau_ms) {
  if (t_ms <= 0.0) return 0.0;
  return tau_ms > 0.0 ? t_ms - tau_ms * (1.0 - std::exp(-t_ms / tau_ms)) : t_ms;
}

// Of a matt surface: the mean albedo over the camera pixel's box. A board's edge sampled at pixel centres alone would
// come in stairs, and its corners up to half a pixel off.
void AverageAlbedo(const Scene& scene, const Pinhole& camera, int x, int y, Material& material) {
  constexpr int kSide = 6;  // samples a side
  if (material.kind != MaterialKind::kMatt) return;
  auto albedo_at = [&](double dx, double dy) {
    const auto hit = scene.Intersect({Eigen::Vector3d::Zero(), camera.Unproject({x + dx, y + dy})});
    const Material there = hit ? scene.MaterialAt(*hit) : material;
    return there.kind == MaterialKind::kMatt ? there.albedo : material.albedo;
  };
  bool even = true;
  for (const double dx : {-0.5, 0.5})
    for (const double dy : {-0.5, 0.5}) even = even && albedo_at(dx, dy) == material.albedo;
  if (even) return;
  std::array<float, 3> sum{};
  for (int j = 0; j < kSide; ++j)
    for (int i = 0; i < kSide; ++i) {
      const auto albedo = albedo_at((i + 0.5) / kSide - 0.5, (j + 0.5) / kSide - 0.5);
      for (size_t c = 0; c < sum.size(); ++c) sum[c] += albedo[c];
    }
  for (size_t c = 0; c < sum.size(); ++c) material.albedo[c] = sum[c] / (kSide * kSide);
}

}  // namespace

std::vector<double> ShareOfPictures(const std::vector<Shown>& timeline, MonotonicNs start, double exposure_ms,
                                    double lag_ms) {
  std::vector<double> answered(timeline.size() + 1, 0.0);  // of the step to each picture, share of the exposure
  answered[0] = 1.0;
  for (size_t k = 1; k < timeline.size(); ++k) {
    const double from = ToMilliseconds(start - timeline[k].since);
    answered[k] = (StepIntegral(from + exposure_ms, lag_ms) - StepIntegral(from, lag_ms)) / exposure_ms;
  }
  std::vector<double> shares(timeline.size());
  for (size_t k = 0; k < timeline.size(); ++k) shares[k] = answered[k] - answered[k + 1];
  return shares;
}

World::World(const SimulatedRigOptions& options, Scene scene, SkinTable table, MonotonicNs start, Logger& logger)
    : options_(options),
      logger_(logger),
      scene_(std::move(scene)),
      table_(std::move(table)),
      albedo_(table_),
      lens_covered_(options.lens_covered),
      start_(start),
      subject_start_(start),
      calibration_(DescribeSimulatedRig(options)) {
  if (!options.cache_folder.empty())
    cache_ = std::make_unique<LightCache>(options.cache_folder, LightCache::kDefaultLimitBytes, logger);
}

void World::SetSubject(Scene scene, std::optional<SkinTable> table, MonotonicNs now) {
  resting_.reset();
  moved_.reset();
  scene_ = std::move(scene);
  subject_start_ = now;
  if (!table) return;
  table_ = std::move(*table);
}

Result<World::Stage*> World::StageIn(const SubjectState& state) {
  if (!resting_) {
    SLX_ASSIGN_OR_RETURN(resting_, MakeStage({}));
  }
  if (state == resting_->state) return resting_.get();
  if (!moved_ || !(moved_->state == state)) {
    moved_.reset();
    SLX_ASSIGN_OR_RETURN(moved_, MakeStage(state));
  }
  return moved_.get();
}

Result<std::unique_ptr<World::Stage>> World::MakeStage(const SubjectState& state) const {
  WorkWatch watch = Watch("what the camera sees of the subject");
  auto stage = std::make_unique<Stage>(Stage{state, scene_.In(state), {}, {}, {}, {}, {}});
  const Pinhole& camera = calibration_.camera.model;
  std::vector<std::vector<SubjectPixel>> rows(camera.height);
  watch.Expect(camera.height);
  const bool whole = WatchedParallelFor(&watch, camera.height, 8, 1, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const auto hit = stage->scene.Intersect({Eigen::Vector3d::Zero(), camera.Unproject({double(x), double(y)})});
        if (!hit) continue;
        const Eigen::Vector3d normal = stage->scene.Normal(*hit);
        if (normal.dot(-hit->normalized()) < 0.02) continue;
        Material material = stage->scene.MaterialAt(*hit);
        AverageAlbedo(stage->scene, camera, x, y, material);
        rows[y].push_back({x, y, *hit, normal, material});
      }
  });
  if (!whole) return watch.Check();
  for (const auto& row : rows) stage->pixels.insert(stage->pixels.end(), row.begin(), row.end());
  stage->transports.resize(calibration_.projectors.size());
  stage->bounces.resize(calibration_.projectors.size());
  stage->pictures.resize(calibration_.projectors.size());
  stage->white.resize(calibration_.projectors.size());
  return stage;
}

Result<const LightTransport*> World::Transport(Stage& stage, size_t projector) const {
  auto& transport = stage.transports[projector];
  if (transport) return transport.get();
  WorkWatch watch = Watch("light of projector " + std::to_string(projector));
  LightTransportOptions options;
  options.scattering = Scatters();
  options.optics = options_.devices.ForProjector(projector);
  // A subject that moves passes through many places once: they would drive out what is needed again.
  if (stage.state == SubjectState{}) options.cache = cache_.get();
  auto made = std::make_unique<LightTransport>(stage.scene, table_, albedo_, calibration_, static_cast<int>(projector),
                                               stage.pixels, options, &watch);
  SLX_RETURN_IF_ERROR(watch.Check());
  transport = std::move(made);
  return transport.get();
}

Result<const Interreflection*> World::Bounce(Stage& stage, size_t projector) const {
  auto& bounce = stage.bounces[projector];
  if (bounce) return bounce.get();
  WorkWatch watch = Watch("interreflection of projector " + std::to_string(projector));
  auto made = std::make_unique<Interreflection>(stage.scene, albedo_, calibration_, static_cast<int>(projector),
                                                options_.devices.ForProjector(projector).gamma, stage.pixels, &watch);
  SLX_RETURN_IF_ERROR(watch.Check());
  bounce = std::move(made);
  return bounce.get();
}

Status World::RenderTransport(Stage& stage, size_t projector, const Pattern& pattern, std::vector<float>& subsurface,
                              std::vector<float>& direct) const {
  SLX_ASSIGN_OR_RETURN(const LightTransport* transport, Transport(stage, projector));
  if (pattern.IsOneDimensional()) {
    transport->Render(pattern, subsurface, direct);
    return Status::Ok();
  }
  auto& kept = stage.pictures[projector];
  if (!kept || kept->pattern != pattern) {
    kept.reset();
    WorkWatch watch = Watch("picture of projector " + std::to_string(projector));
    Stage::Picture made{pattern, std::vector<float>(stage.pixels.size(), 0.0F),
                        std::vector<float>(stage.pixels.size(), 0.0F)};
    transport->Render(pattern, made.subsurface, made.direct, &watch);
    SLX_RETURN_IF_ERROR(watch.Check());
    kept = std::move(made);
  }
  for (size_t i = 0; i < subsurface.size(); ++i) subsurface[i] += kept->subsurface[i];
  for (size_t i = 0; i < direct.size(); ++i) direct[i] += kept->direct[i];
  return Status::Ok();
}

Result<const std::vector<float>*> World::White(Stage& stage, size_t projector) const {
  auto& white = stage.white[projector];
  if (white.empty()) {
    std::vector<float> light(stage.pixels.size(), 0.0F);
    SLX_RETURN_IF_ERROR(RenderTransport(stage, projector, kWhite, light, light));
    if (scene_.description().interreflection) {
      SLX_ASSIGN_OR_RETURN(const Interreflection* bounce, Bounce(stage, projector));
      bounce->Render(kWhite, light);
    }
    white = std::move(light);
  }
  return &white;
}

Status World::Render(Stage& stage, size_t projector, const Pattern& pattern, std::vector<float>& light) const {
  if (pattern.kind == PatternKind::kWhite) {
    SLX_ASSIGN_OR_RETURN(const std::vector<float>* white, White(stage, projector));
    for (size_t i = 0; i < light.size(); ++i) light[i] += (*white)[i];
    return Status::Ok();
  }
  SLX_RETURN_IF_ERROR(RenderTransport(stage, projector, pattern, light, light));
  if (!scene_.description().interreflection) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const Interreflection* bounce, Bounce(stage, projector));
  bounce->Render(pattern, light);
  return Status::Ok();
}

Status World::AddProjector(Stage& stage, size_t projector, const Exposure& exposure, std::vector<float>& light) const {
  const std::vector<Shown>& timeline = exposure.timeline[projector];
  const ProjectorOptics& optics = options_.devices.ForProjector(projector);
  const CameraElectronics& camera = options_.devices.camera;
  const double line_ms = camera.shutter == Shutter::kRolling ? 1e-3 * camera.line_time_us : 0.0;
  double factor = exposure.light * (1.0 + optics.drift_per_minute * ToMilliseconds(exposure.start - start_) / 60000.0);
  if (optics.flicker > 0.0)
    factor *= 1.0 + optics.flicker *
                        Random(options_.seed, (static_cast<uint64_t>(exposure.number) << 8) + 64 + projector).Normal();
  // [row][picture]; one row stands for all of a global shutter's.
  std::vector<std::vector<double>> shares(line_ms > 0.0 ? calibration_.camera.model.height : 1);
  for (size_t y = 0; y < shares.size(); ++y)
    shares[y] = ShareOfPictures(timeline, exposure.start + FromMilliseconds(line_ms * static_cast<double>(y)),
                                exposure.exposure_ms, optics.lag_ms);
  // A projector's black still shines: b + (1 - b) pattern.
  const double black = optics.black_level;
  for (size_t k = 0; k < timeline.size(); ++k) {
    const bool seen = std::any_of(shares.begin(), shares.end(), [k](const auto& row) { return row[k] > 1e-6; });
    if (!timeline[k].pattern || !seen) continue;
    std::vector<float> pattern;
    if (timeline[k].pattern->kind != PatternKind::kBlack) {
      pattern.assign(stage.pixels.size(), 0.0F);
      SLX_RETURN_IF_ERROR(Render(stage, projector, *timeline[k].pattern, pattern));
    }
    SLX_ASSIGN_OR_RETURN(const std::vector<float>* white, White(stage, projector));
    std::vector<std::array<float, 2>> weights;  // of black and of the picture, by row
    for (const auto& row : shares)
      weights.push_back(
          {static_cast<float>(row[k] * factor * black), static_cast<float>(row[k] * factor * (1.0 - black))});
    if (pattern.empty()) pattern.assign(light.size(), 0.0F);
    ParallelFor(static_cast<int64_t>(light.size()), 16384, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        const auto& [dark, open] = weights[weights.size() == 1 ? 0 : stage.pixels[i].y];
        light[i] += dark * (*white)[i] + open * pattern[i];
      }
    });
  }
  return Status::Ok();
}

Result<Image<float>> World::Light(const Exposure& exposure) {
  const Pinhole& camera = calibration_.camera.model;
  if (lens_covered_) return Image<float>(camera.width, camera.height);
  SubjectState state = scene_.StateAt(1e-3 * ToMilliseconds(exposure.start - subject_start_));
  state.offset_mm += exposure.push_mm;
  SLX_ASSIGN_OR_RETURN(Stage * stage, StageIn(state));
  std::vector<float> light(stage->pixels.size(), 0.0F);
  for (size_t p = 0; p < exposure.timeline.size(); ++p) SLX_RETURN_IF_ERROR(AddProjector(*stage, p, exposure, light));
  const auto scale = static_cast<float>(exposure.exposure_ms * exposure.gain);
  Image<float> image(camera.width, camera.height, 1,
                     static_cast<float>(scene_.description().ambient_dn_per_ms) * scale);
  for (size_t i = 0; i < light.size(); ++i) image(stage->pixels[i].x, stage->pixels[i].y) += light[i] * scale;
  return image;
}

}  // namespace stratalux::rig
