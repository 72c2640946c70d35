// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/surface_reflection.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include <ceres/ceres.h>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/shift_law.h"
#include "shared/base/check.h"

namespace stratalux::fit {
namespace {

// Light that grazes tells the surface from the layers best, and the gain is only a rough law there, which the surface
// takes for its own: by the training lights, left out in turn, 60 degrees (docs/math/surface.md).
constexpr double kLeastCos = 0.5;
constexpr double kModelError = 0.02;  // of a light: what the gain leaves
constexpr double kPhaseSlope = 1.15;  // of light of few events, as Monte Carlo skins have it (docs/math/em.md)
constexpr int64_t kLeastProfiles = 100;
constexpr int64_t kMostPixels = 6000;
constexpr double kClearly = 0.5, kTold = 0.5;  // a strength that much off must cost a standard deviation

// pi f_r of strength 1; T: double, or Ceres' own for its derivatives.
template <typename T>
T Facets(const T& roughness, const ReflectionAngles& a, double eta) {
  using std::sqrt;
  const T a2 = roughness * roughness;
  const T lobe = a.normal_half * a.normal_half * (a2 - 1.0) + 1.0;
  const auto smith = [&a2](double c) -> T { return 2.0 * c / (c + sqrt(a2 + (1.0 - a2) * c * c)); };
  const double f0 = std::pow((eta - 1.0) / (eta + 1.0), 2);
  const double fresnel = f0 + (1.0 - f0) * std::pow(1.0 - std::clamp(a.half_in, 0.0, 1.0), 5);
  return a2 / (lobe * lobe) * smith(a.normal_in) * smith(a.normal_out) * (fresnel / (4.0 * a.normal_in * a.normal_out));
}

// One light of a profile.
struct Shown {
  double reflectance = 0.0, sigma = 0.0;
  double fresnel = 1.0, path = 0.0;  // the gain is fresnel exp(-tau path)
  double few = 1.0;
  ReflectionAngles angles;
};

// Of a profile, its own W taken out (variable projection).
struct ProfileResiduals {
  std::vector<Shown> lights;
  double eta;

  template <typename T>
  bool operator()(const T* tau, const T* strength, const T* roughness, const T* narrow, T* residuals) const {
    using std::exp;
    T along(0.0), square(0.0);
    std::vector<T> gain;
    for (size_t p = 0; p < lights.size(); ++p) {
      const Shown& s = lights[p];
      gain.push_back(s.fresnel * exp(-*tau * s.path) * (1.0 + *narrow * (s.few - 1.0)) / s.sigma);
      residuals[p] = (s.reflectance - *strength * Facets(*roughness, s.angles, eta)) / s.sigma;
      along += gain[p] * residuals[p];
      square += gain[p] * gain[p];
    }
    const T own = along / square;
    for (size_t p = 0; p < lights.size(); ++p) residuals[p] -= own * gain[p];
    return true;
  }
};

// A light that stands to the surface as one of `lights` does, such as the row sweep of the same lamp, tells nothing
// more.
bool Repeats(const std::vector<Shown>& lights, const ReflectionAngles& angles) {
  constexpr double kAlike = 1e-3;
  return std::any_of(lights.begin(), lights.end(), [&](const Shown& s) {
    return std::abs(s.angles.normal_in - angles.normal_in) < kAlike &&
           std::abs(s.angles.half_in - angles.half_in) < kAlike;
  });
}

std::unique_ptr<ProfileResiduals> ResidualsOf(std::span<const SrdBatch* const> lights, int64_t i, double eta) {
  auto profile = std::make_unique<ProfileResiduals>(ProfileResiduals{{}, eta});
  double mean = 0.0;
  for (const SrdBatch* batch : lights) {
    if (!batch->Shares(i) || !(batch->cos_in[i] > kLeastCos) || !(batch->cos_out[i] > kLeastCos)) continue;
    const WhiteReflectance white = WhiteReflectanceOf(*batch, i);
    if (!std::isfinite(white.value) || !std::isfinite(white.variance) || !(white.value > 0.0)) continue;
    Shown s;
    s.angles = ReflectionAngles::Of(*batch, i);
    if (!std::isfinite(s.angles.normal_half) || Repeats(profile->lights, s.angles)) continue;
    s.reflectance = white.value;
    s.sigma = std::sqrt(std::max(white.variance, 0.0));
    s.fresnel = AngularGain(batch->cos_in[i], eta, 0.0);
    s.path = GainPath(batch->cos_in[i], eta);
    const RefractedDirections directions = DirectionsOf(*batch, i, eta);
    s.few = directions.sec_in * directions.sec_out * std::exp(kPhaseSlope * (1.0 + directions.cos_scatter));
    mean += white.value;
    profile->lights.push_back(s);
  }
  mean /= static_cast<double>(std::max<size_t>(profile->lights.size(), 1));
  for (Shown& s : profile->lights) s.sigma = std::hypot(s.sigma, kModelError * mean);
  return profile;
}

// The cost at the optimum; none where no solution was found.
std::optional<double> Solve(ceres::Problem& problem) {
  ceres::Solver::Options options;
  options.num_threads = 1;  // sums in one order
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return std::nullopt;
  return summary.final_cost;
}

void Bound(ceres::Problem& problem, double& parameter, double least, double most) {
  problem.SetParameterLowerBound(&parameter, 0, least);
  problem.SetParameterUpperBound(&parameter, 0, most);
}

}  // namespace

ReflectionAngles ReflectionAngles::Between(const Eigen::Vector3d& to_lamp, const Eigen::Vector3d& to_eye,
                                           const Eigen::Vector3d& normal) {
  const Eigen::Vector3d half = (to_lamp + to_eye).normalized();
  return {normal.dot(to_lamp), normal.dot(to_eye), normal.dot(half), half.dot(to_lamp)};
}

ReflectionAngles ReflectionAngles::Of(const SrdBatch& batch, int64_t i) {
  return Between(Eigen::Vector3d(batch.slope_in[i], batch.slope_in_across[i], 1.0).normalized(),
                 Eigen::Vector3d(batch.slope_out[i], batch.slope_out_across[i], 1.0).normalized(),
                 Eigen::Vector3d::UnitZ());
}

double ReflectanceOf(const SurfaceReflection& surface, const ReflectionAngles& angles, double eta) {
  if (!surface.Known() || !(angles.normal_in > 0.0) || !(angles.normal_out > 0.0)) return 0.0;
  return surface.strength * Facets(surface.roughness, angles, eta);
}

WhiteReflectance WhiteReflectanceOf(const SrdBatch& batch, int64_t i) {
  // A comb's frames add up to width / step whites.
  const double whites = batch.line_width_mm[i] / batch.step_mm[i];
  if (!batch.white.empty() && batch.white_variance[i] > 0.0F)
    return {batch.white[i] / whites, batch.white_variance[i] / (whites * whites)};
  WhiteReflectance sum;
  for (const float y : batch.Samples(i)) sum.value += y / whites;
  sum.variance = batch.VarianceOfSum(i) / (whites * whites);
  return sum;
}

SurfaceReflection EstimateSurfaceReflection(std::span<const SrdBatch* const> lights, int channels, double eta,
                                            int every) {
  SLX_CHECK(every >= 1 && channels >= 1);
  if (lights.empty()) return {};
  double tau = 0.2, strength = 0.5, roughness = 0.3;
  std::vector<double> narrow(channels, 0.0);
  ceres::Problem problem;
  int64_t lit = 0;  // pixels
  for (int64_t i = 0; i < lights[0]->profiles(); i += channels)
    lit += std::ranges::any_of(lights, [i](const SrdBatch* batch) { return batch->Shares(i); }) ? 1 : 0;
  const int64_t one_in = std::max<int64_t>(every, (lit + kMostPixels - 1) / kMostPixels);
  for (int64_t i = 0; i < lights[0]->profiles(); ++i) {
    if (i / channels % one_in != 0) continue;
    auto profile = ResidualsOf(lights, i, eta);
    const int count = static_cast<int>(profile->lights.size());
    if (count < 2) continue;
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<ProfileResiduals, ceres::DYNAMIC, 1, 1, 1, 1>(profile.release(), count),
        new ceres::CauchyLoss(2.0), &tau, &strength, &roughness, &narrow[i % channels]);
  }
  if (problem.NumResidualBlocks() < kLeastProfiles) return {};
  Bound(problem, tau, 0.0, 3.0);
  Bound(problem, strength, 0.0, 5.0);
  Bound(problem, roughness, 0.15, 0.7);
  for (double& share : narrow)
    if (problem.HasParameterBlock(&share)) Bound(problem, share, 0.0, 0.6);
  const auto solved = Solve(problem);
  if (!solved) return {};
  const SurfaceReflection found{strength, roughness};
  // Does another strength explain the lights as well?
  strength = strength < 1.0 ? strength + kClearly : strength - kClearly;
  problem.SetParameterBlockConstant(&strength);
  const auto other = Solve(problem);
  return other && *other - *solved > kTold ? found : SurfaceReflection{};
}

}  // namespace stratalux::fit
