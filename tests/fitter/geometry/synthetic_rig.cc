// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/geometry/synthetic_rig.h"

#include <algorithm>
#include <cmath>

#include "shared/base/random.h"
#include "shared/pattern/micro_phase.h"

namespace stratalux::fit {
namespace {

constexpr double kDistanceMm = 600.0;

// Profile of a one-dimensional pattern, blurred, at a sub-pixel position (linear between projector pixels).
class BlurredProfile {
 public:
  BlurredProfile(const Pattern& pattern, int count, double blur_px) : values_(static_cast<size_t>(count)) {
    const std::vector<float> sharp = pattern.Profile(count);
    const int reach = static_cast<int>(std::ceil(4.0 * blur_px));
    for (int c = 0; c < count; ++c) {
      double sum = 0.0, weight = 0.0;
      for (int k = -reach; k <= reach; ++k) {
        const double w = blur_px > 0.0 ? std::exp(-0.5 * k * k / (blur_px * blur_px)) : 1.0;
        sum += w * sharp[static_cast<size_t>(std::clamp(c + k, 0, count - 1))];
        weight += w;
      }
      values_[static_cast<size_t>(c)] = sum / weight;
    }
    pattern_ = pattern;
    blur_px_ = blur_px;
  }
  [[nodiscard]] double At(double position) const {
    if (pattern_.kind == PatternKind::kSinusoid) {  // exact: interpolation would bend the phase
      const double turns = (position + 0.5) / pattern_.period - static_cast<double>(pattern_.shift) / pattern_.shifts;
      const double k = 2.0 * M_PI * blur_px_ / pattern_.period;
      return 0.5 + 0.5 * std::exp(-0.5 * k * k) * std::cos(2.0 * M_PI * turns);
    }
    if (pattern_.HasLevels()) {
      const Wave wave = MicroPhaseWave(pattern_.bit, pattern_.bits, pattern_.period);
      const double k = 2.0 * M_PI * blur_px_ / wave.period_px;
      return 0.5 + (pattern_.inverse ? -0.5 : 0.5) * std::exp(-0.5 * k * k) * std::cos(wave.Angle(position));
    }
    const double clamped = std::clamp(position, 0.0, static_cast<double>(values_.size()) - 1.001);
    const auto i = static_cast<size_t>(clamped);
    const double f = clamped - static_cast<double>(i);
    return (1.0 - f) * values_[i] + f * values_[i + 1];
  }

 private:
  std::vector<double> values_;
  Pattern pattern_;
  double blur_px_ = 0.0;
};

int WavesOf(ColumnCode code) { return IsOfStripes(code) ? 0 : kPeriodPx; }

std::vector<Pattern> Patterns(const ProjectorCalibration& projector, ColumnCode code) {
  std::vector<Pattern> patterns = {{.kind = PatternKind::kWhite}, {.kind = PatternKind::kBlack}};
  for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    const int bits = GrayBits(axis == PatternAxis::kColumns ? projector.model.width : projector.model.height);
    for (int bit = 0; bit < bits; ++bit)
      for (bool inverse : {false, true})
        patterns.push_back({.kind = PatternKind::kGray,
                            .axis = axis,
                            .bit = bit,
                            .bits = bits,
                            .inverse = inverse,
                            .code = code,
                            .period = WavesOf(code)});
    for (int shift = 0; shift < kShifts; ++shift)
      patterns.push_back(
          {.kind = PatternKind::kSinusoid, .axis = axis, .period = kPeriodPx, .shift = shift, .shifts = kShifts});
  }
  return patterns;
}

AxisCode CodeOf(const Frames& frames, PatternAxis axis, int count, int period_px) {
  AxisCode code{.count = count,
                .bits = {},
                .shifts = {},
                .period_px = period_px,
                .code = frames.code,
                .waves_px = WavesOf(frames.code)};
  const int bits = GrayBits(count);
  for (int bit = 0; bit < bits; ++bit) {
    const Pattern positive{.kind = PatternKind::kGray,
                           .axis = axis,
                           .bit = bit,
                           .bits = bits,
                           .code = frames.code,
                           .period = WavesOf(frames.code)};
    Pattern inverse = positive;
    inverse.inverse = true;
    code.bits.push_back({frames.View(positive), frames.View(inverse)});
  }
  for (int shift = 0; period_px > 0 && shift < kShifts; ++shift)
    code.shifts.push_back(frames.View(
        {.kind = PatternKind::kSinusoid, .axis = axis, .period = period_px, .shift = shift, .shifts = kShifts}));
  return code;
}

// White level of every site, dn, 0 where the projector does not reach; fills the true coordinates.
Image<double> LightOf(const RigCalibration& rig, int projector, const Surface& surface, const Shot& shot, Frames& out) {
  const Pinhole& camera = rig.camera.model;
  const ProjectorCalibration& light = rig.projectors[projector];
  Image<double> white(camera.width, camera.height);
  out.true_column = out.true_row = Image<double>(camera.width, camera.height, 1, std::nan(""));
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto hit = surface(camera.Unproject(Eigen::Vector2d(x, y)));
      if (!hit) continue;
      const auto at = light.ProjectFromCamera(hit->point);
      const Eigen::Vector3d to_light = light.CentreInCamera() - hit->point;
      const double cosine = hit->normal.dot(to_light.normalized());
      if (!at || !light.model.Contains(*at) || cosine <= 0.0) continue;
      white(x, y) = shot.white_dn * shot.albedo * cosine * kDistanceMm * kDistanceMm / to_light.squaredNorm();
      out.true_column(x, y) = at->x();
      out.true_row(x, y) = at->y();
    }
  return white;
}

}  // namespace

RigCalibration SyntheticRig() {
  RigCalibration rig;
  rig.id = rig.source = "synthetic";
  rig.camera.model = {.width = 120, .height = 96, .fx = 400, .fy = 400, .cx = 59.5, .cy = 47.5};
  rig.camera.cfa = Cfa::kMono;
  rig.camera.black_level_dn = 64.0;
  rig.camera.gain_e_per_dn = 4.0;
  rig.camera.read_noise_dn = 3.0;
  const Eigen::Vector3d target(0.0, 0.0, kDistanceMm);
  for (const Eigen::Vector3d& centre : {Eigen::Vector3d(-350, -60, 40), Eigen::Vector3d(-120, 160, -20),
                                        Eigen::Vector3d(150, -170, 0), Eigen::Vector3d(340, 80, 60)}) {
    ProjectorCalibration p;
    p.name = "P" + std::to_string(rig.projectors.size());
    p.model = {.width = 512, .height = 384, .fx = 1300, .fy = 1300, .cx = 255.5, .cy = 191.5};
    p.camera_from_projector = LookAt(centre, target);
    p.white_dn_mm2_per_ms = {1e8, 1e8, 1e8};
    rig.projectors.push_back(p);
  }
  return rig;
}

Surface Sphere(const Eigen::Vector3d& centre, double radius_mm) {
  return [=](const Eigen::Vector3d& ray) -> std::optional<Hit> {
    const double along = ray.dot(centre);
    const double inside = along * along - centre.squaredNorm() + radius_mm * radius_mm;
    if (inside <= 0.0) return std::nullopt;
    const Eigen::Vector3d point = ray * (along - std::sqrt(inside));
    return Hit{point, (point - centre).normalized()};
  };
}

Surface Plane(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
  return [=](const Eigen::Vector3d& ray) -> std::optional<Hit> {
    const Eigen::Vector3d hit = ray * (normal.dot(point) / normal.dot(ray));
    return Hit{hit, normal.normalized()};
  };
}

Frames Shoot(const RigCalibration& rig, int projector, const Surface& surface, const Shot& shot) {
  const ProjectorCalibration& light = rig.projectors[projector];
  Frames frames;
  frames.code = shot.code;
  const Image<double> white = LightOf(rig, projector, surface, shot, frames);
  Random random(shot.seed, static_cast<uint64_t>(projector));
  for (const Pattern& pattern : Patterns(light, shot.code)) {
    const bool columns = pattern.axis == PatternAxis::kColumns;
    const BlurredProfile profile(pattern, columns ? light.model.width : light.model.height, shot.blur_px);
    const double mean = pattern.kind == PatternKind::kWhite ? 1.0 : pattern.kind == PatternKind::kBlack ? 0.0 : 0.5;
    Image<uint16_t> frame(white.width(), white.height());
    for (int y = 0; y < white.height(); ++y)
      for (int x = 0; x < white.width(); ++x) {
        double signal = shot.ambient_dn;
        if (white(x, y) > 0.0)
          signal += white(x, y) *
                    (profile.At(columns ? frames.true_column(x, y) : frames.true_row(x, y)) + shot.global * mean);
        double raw = rig.camera.black_level_dn + signal;
        if (shot.noise)
          raw += random.Normal() * std::hypot(rig.camera.read_noise_dn, std::sqrt(signal / rig.camera.gain_e_per_dn));
        frame(x, y) = static_cast<uint16_t>(std::clamp(std::lround(raw), 0L, 4095L));
      }
    frames.by_pattern.emplace(pattern.ToString(), std::move(frame));
  }
  const auto black = frames.View({.kind = PatternKind::kBlack});
  frames.black = Image<float>(white.width(), white.height());
  std::copy(black.pixels().begin(), black.pixels().end(), frames.black.pixels().begin());
  return frames;
}

DecodeInput Frames::Decode(const ProjectorCalibration& projector, int period_px) const {
  return {View({.kind = PatternKind::kWhite}), black,
          CodeOf(*this, PatternAxis::kColumns, projector.model.width, period_px),
          CodeOf(*this, PatternAxis::kRows, projector.model.height, period_px)};
}

SeparationFrames Frames::Separate(int period_px) const {
  SeparationFrames out{.white = View({.kind = PatternKind::kWhite}), .black = black};
  for (int shift = 0; shift < kShifts; ++shift) {
    Pattern pattern{.kind = PatternKind::kSinusoid, .period = period_px, .shift = shift, .shifts = kShifts};
    out.column_shifts.push_back(View(pattern));
    pattern.axis = PatternAxis::kRows;
    out.row_shifts.push_back(View(pattern));
  }
  return out;
}

SurfaceMap TrueSurface(const RigCalibration& rig, const Surface& surface) {
  const int width = rig.camera.model.width, height = rig.camera.model.height;
  const float nan = std::nanf("");
  SurfaceMap map{Image<float>(width, height, 3, nan), Image<float>(width, height, 3, nan),
                 Image<float>(width, height, 1, nan), Image<uint8_t>(width, height)};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const auto hit = surface(rig.camera.model.Unproject(Eigen::Vector2d(x, y)));
      if (!hit) continue;
      for (int k = 0; k < 3; ++k) {
        map.point_mm(x, y, k) = static_cast<float>(hit->point[k]);
        map.normal(x, y, k) = static_cast<float>(hit->normal[k]);
      }
      map.depth_sigma_mm(x, y) = 0.0F;
      map.mask(x, y) = 1;
    }
  return map;
}

}  // namespace stratalux::fit
