// SPDX-License-Identifier: Apache-2.0
#include "fitter/photometric/photometric_stereo.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

// One light at one point.
struct Source {
  Eigen::Vector3d direction;  // unit, to the light
  double intensity = 0.0;     // mean over channels of direct / E: albedo n . l
  Eigen::Vector3d per_channel = Eigen::Vector3d::Zero();
};

struct Solution {
  Eigen::Vector3d scaled_normal = Eigen::Vector3d::Zero();  // albedo n
  int used = 0;
  unsigned used_mask = 0;
  double residual = std::nan("");
  double normal_sigma_rad = std::nan("");
  PhotometricReason reason = PhotometricReason::kValid;
};

Eigen::MatrixXd Directions(const std::vector<Source>& sources) {
  Eigen::MatrixXd l(sources.size(), 3);
  for (size_t s = 0; s < sources.size(); ++s) l.row(static_cast<int>(s)) = sources[s].direction;
  return l;
}

Eigen::VectorXd Intensities(const std::vector<Source>& sources) {
  Eigen::VectorXd y(sources.size());
  for (size_t s = 0; s < sources.size(); ++s) y[static_cast<int>(s)] = sources[s].intensity;
  return y;
}

std::optional<Eigen::Vector3d> SolveTriple(const std::vector<Source>& sources, size_t left_out, double min_condition) {
  Eigen::Matrix3d l;
  Eigen::Vector3d y;
  int row = 0;
  for (size_t s = 0; s < sources.size() && row < 3; ++s) {
    if (s == left_out) continue;
    l.row(row) = sources[s].direction;
    y[row++] = sources[s].intensity;
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(l, Eigen::ComputeFullU | Eigen::ComputeFullV);
  // Of directions that are not finite it has no singular values.
  if (svd.info() != Eigen::Success) return std::nullopt;
  if (svd.singularValues()[2] < min_condition * svd.singularValues()[0]) return std::nullopt;
  return svd.solve(y);
}

class PointSolver {
 public:
  explicit PointSolver(const PhotometricOptions& options) : options_(options) {}

  // `view`: unit direction to the camera; `prior`: the triangulated normal.
  [[nodiscard]] Solution Solve(const std::vector<Source>& sources, const Eigen::Vector3d& view,
                               const Eigen::Vector3d& prior) const {
    Solution out;
    if (sources.size() < 3) {
      out.reason = PhotometricReason::kTooFewSources;
      return out;
    }
    if (sources.size() == 3) return SolveThree(sources);
    double brightest = 0.0;
    for (const Source& s : sources) brightest = std::max(brightest, s.intensity);
    return IsDependent(sources, brightest) ? SolveFour(sources, brightest)
                                           : BestTriple(sources, brightest, view, prior);
  }

 private:
  [[nodiscard]] Solution SolveThree(const std::vector<Source>& sources) const {
    Solution out;
    const auto g = SolveTriple(sources, sources.size(), options_.min_condition);
    if (!g || !(g->norm() > 0.0)) {
      out.reason = PhotometricReason::kDegenerate;
      return out;
    }
    out.scaled_normal = *g;
    out.used = 3;
    out.used_mask = 0b111;
    return out;
  }

  // The vector a with sum a_s l_s = 0, |a| = 1, annihilates the intensities of a Lambertian point: |a . y| is noise.
  [[nodiscard]] bool IsDependent(const std::vector<Source>& sources, double brightest) const {
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(Directions(sources), Eigen::ComputeFullU);
    const Eigen::VectorXd a = svd.matrixU().col(3);
    const double sigma = options_.relative_sigma * brightest;
    return std::abs(a.dot(Intensities(sources))) <= options_.dependence_sigmas * sigma;
  }

  [[nodiscard]] Solution SolveFour(const std::vector<Source>& sources, double brightest) const {
    Solution out;
    const Eigen::MatrixXd l = Directions(sources);
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(l, Eigen::ComputeThinU | Eigen::ComputeThinV);
    if (svd.singularValues()[2] < options_.min_condition * svd.singularValues()[0]) {
      out.reason = PhotometricReason::kDegenerate;
      return out;
    }
    const Eigen::VectorXd y = Intensities(sources);
    out.scaled_normal = svd.solve(y);
    out.used = 4;
    out.used_mask = 0b1111;
    const double misfit = (l * out.scaled_normal - y).norm();
    out.residual = misfit / std::sqrt(4.0) / brightest;
    // trace (L^T L)^-1 is the sum of the inverse squared singular values.
    out.normal_sigma_rad = misfit * svd.singularValues().cwiseInverse().norm() / out.scaled_normal.norm();
    return out;
  }

  // Is the left-out source, as the triple's normal predicts it, a shadow (measured dark, predicted bright or facing
  // away) or a highlight (measured brighter than predicted, near the mirror direction)?
  [[nodiscard]] bool Explains(const Source& left_out, const Eigen::Vector3d& g, double brightest,
                              const Eigen::Vector3d& view) const {
    const double margin = options_.relative_sigma * brightest;
    const double predicted = g.dot(left_out.direction);
    const bool dark = left_out.intensity < options_.shadow_fraction * brightest;
    if (dark && (predicted <= margin || predicted > left_out.intensity)) return true;
    if (left_out.intensity <= predicted + margin) return false;
    const Eigen::Vector3d half = (left_out.direction + view).normalized();
    const double angle = std::acos(std::clamp(half.dot(g.normalized()), -1.0, 1.0));
    return 2.0 * angle < RadFromDeg(options_.highlight_cone_deg);  // the mirrored ray turns by twice the angle
  }

  [[nodiscard]] Solution BestTriple(const std::vector<Source>& sources, double brightest, const Eigen::Vector3d& view,
                                    const Eigen::Vector3d& prior) const {
    Solution out;
    out.reason = PhotometricReason::kInconsistent;
    double best = -1.0;
    for (size_t e = 0; e < sources.size(); ++e) {
      const auto g = SolveTriple(sources, e, options_.min_condition);
      if (!g || !(g->norm() > 0.0) || !Explains(sources[e], *g, brightest, view)) continue;
      const Eigen::Vector3d n = g->normalized();
      const double agreement = prior.allFinite() ? n.dot(prior) : n.dot(view);
      if (n.dot(view) <= 0.0 || agreement <= best) continue;
      best = agreement;
      out.scaled_normal = *g;
      out.used = 3;
      out.used_mask = 0b1111 & ~(1U << e);
      out.reason = PhotometricReason::kValid;
    }
    return out;
  }

  const PhotometricOptions& options_;
};

class Estimator {
 public:
  Estimator(std::span<const ImageView<const float>> direct, const SurfaceMap& surface, const RigCalibration& rig,
            double exposure_ms, const PhotometricOptions& options)
      : direct_(direct), surface_(surface), rig_(rig), exposure_ms_(exposure_ms), solver_(options) {}

  void EstimateQuad(int i, int j, PhotometricMap& map) const {
    if (surface_.mask(i, j) == 0) {
      map.reason(i, j) = static_cast<uint8_t>(PhotometricReason::kNoSurface);
      return;
    }
    const Eigen::Vector3d point = surface_.Point(i, j);
    const std::vector<Source> sources = Sources(i, j, point);
    const Eigen::Vector3d view = -point.normalized();
    Solution s = solver_.Solve(sources, view, surface_.Normal(i, j));
    if (s.reason == PhotometricReason::kValid && !(s.scaled_normal.dot(view) > 0.0))
      s.reason = PhotometricReason::kInconsistent;
    map.reason(i, j) = static_cast<uint8_t>(s.reason);
    if (s.reason != PhotometricReason::kValid) return;
    const Eigen::Vector3d n = s.scaled_normal.normalized();
    for (int k = 0; k < 3; ++k) map.normal(i, j, k) = static_cast<float>(n[k]);
    map.usable(i, j) = static_cast<uint8_t>(s.used);
    map.residual(i, j) = static_cast<float>(s.residual);
    map.normal_sigma_rad(i, j) = static_cast<float>(s.normal_sigma_rad);
    WriteAlbedo(i, j, sources, s.used_mask, n, map);
  }

 private:
  [[nodiscard]] std::vector<Source> Sources(int i, int j, const Eigen::Vector3d& point) const {
    std::vector<Source> sources;
    for (size_t p = 0; p < direct_.size(); ++p) {
      const ProjectorCalibration& light = rig_.projectors[p];
      Source source;
      const Eigen::Vector3d to_light = light.CentreInCamera() - point;
      source.direction = to_light.normalized();
      bool known = true;
      const int channels = direct_[p].channels();
      for (int c = 0; c < channels; ++c) {
        // A target facing the light: its normal is the light's direction.
        const double white = light.WhiteTargetDn(point, source.direction, c, exposure_ms_);
        const double value = direct_[p](i, j, c) / white;
        known = known && white > 0.0 && std::isfinite(value);
        source.per_channel[c] = value;
        source.intensity += value / channels;
      }
      if (known) sources.push_back(source);
    }
    if (sources.size() > 4) {
      std::stable_sort(sources.begin(), sources.end(),
                       [](const Source& a, const Source& b) { return a.intensity > b.intensity; });
      sources.resize(4);
    }
    return sources;
  }

  // albedo_c = sum y_c (n . l) / sum (n . l)^2 over the used sources.
  void WriteAlbedo(int i, int j, const std::vector<Source>& sources, unsigned used, const Eigen::Vector3d& n,
                   PhotometricMap& map) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    double weight = 0.0;
    for (size_t s = 0; s < sources.size(); ++s) {
      if (((used >> s) & 1U) == 0) continue;
      const double cosine = n.dot(sources[s].direction);
      sum += cosine * sources[s].per_channel;
      weight += cosine * cosine;
    }
    for (int c = 0; c < map.albedo.channels(); ++c) map.albedo(i, j, c) = static_cast<float>(sum[c] / weight);
  }

  std::span<const ImageView<const float>> direct_;
  const SurfaceMap& surface_;
  const RigCalibration& rig_;
  double exposure_ms_;
  PointSolver solver_;
};

Status CheckInput(std::span<const ImageView<const float>> direct, const SurfaceMap& surface,
                  const RigCalibration& rig) {
  if (direct.size() != rig.projectors.size() || direct.size() < 3)
    return Status::Usage("photometric: " + std::to_string(direct.size()) + " direct images for " +
                         std::to_string(rig.projectors.size()) + " projectors; needs one each, three at least");
  const int channels = QuadChannels(rig.camera.cfa);
  for (const auto& image : direct)
    if (image.width() != surface.width() || image.height() != surface.height() || image.channels() != channels)
      return Status::Usage("photometric: a direct image is " + std::to_string(image.width()) + "x" +
                           std::to_string(image.height()) + "x" + std::to_string(image.channels()) + ", the surface " +
                           std::to_string(surface.width()) + "x" + std::to_string(surface.height()) + " with " +
                           std::to_string(channels) + " channels");
  return Status::Ok();
}

}  // namespace

const char* ToString(PhotometricReason reason) {
  constexpr std::array<const char*, kPhotometricReasons> kNames = {"valid", "no surface", "too few sources",
                                                                   "inconsistent", "degenerate"};
  return kNames[static_cast<size_t>(reason)];
}

Status PhotometricOptions::Validate() const {
  if (!(relative_sigma > 0.0) || !(dependence_sigmas > 0.0) || !(min_condition > 0.0))
    return Status::Usage("photometric: sigmas and min_condition must be positive");
  if (!(shadow_fraction >= 0.0) || !(shadow_fraction < 1.0))
    return Status::Usage("photometric: shadow_fraction must lie in 0 .. below 1");
  return Status::Ok();
}

Result<PhotometricMap> EstimateNormals(std::span<const ImageView<const float>> direct, const SurfaceMap& surface,
                                       const RigCalibration& rig, double exposure_ms,
                                       const PhotometricOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckInput(direct, surface, rig));
  if (!(exposure_ms > 0.0)) return Status::Usage("photometric: the exposure must be positive");
  const int width = surface.width(), height = surface.height();
  const float nan = std::nanf("");
  PhotometricMap map{Image<float>(width, height, 3, nan),
                     Image<float>(width, height, QuadChannels(rig.camera.cfa), nan),
                     Image<float>(width, height, 1, nan),
                     Image<float>(width, height, 1, nan),
                     Image<uint8_t>(width, height),
                     Image<uint8_t>(width, height),
                     {}};
  const Estimator estimator(direct, surface, rig, exposure_ms, options);
  ParallelFor(height, 4, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j)
      for (int i = 0; i < width; ++i) estimator.EstimateQuad(i, static_cast<int>(j), map);
  });
  for (uint8_t reason : map.reason.pixels()) ++map.counts[reason];
  return map;
}

}  // namespace stratalux::fit
