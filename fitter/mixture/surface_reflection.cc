// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/surface_reflection.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include <ceres/ceres.h>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/shift_law.h"
#include "shared/base/check.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

// Light that grazes tells the surface from the layers best, and the gain is only a rough law there, which the surface
// takes for its own: by the training lights, left out in turn, 60 degrees (docs/math/surface.md).
constexpr double kLeastCos = 0.5;
constexpr double kLeastCosOfCurve = 0.2;  // a curve of its own takes nothing of the gain's: the steeper the better
// Where the light does not tell the curve, it is GGX: standard deviation from 1. What (2) leaves is common to
// neighbours and to lights, so that of the profiles' number that share counts as independent.
constexpr double kCurvePrior = 0.5, kIndependent = 1e-3;
// Of the cost, a profile: less is what the gain leaves on a surface that is GGX (docs/math/surface.md).
constexpr double kWorthwhileCurve = 0.03;
constexpr double kModelError = 0.02;  // of a light: what the gain leaves
constexpr double kOutlier = 2.0;      // standard deviations, of Cauchy's loss
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

// Where a facet's tilt lies among kFacetTiltsDeg: the share of node `first`, the rest being that of the next.
struct TiltNodes {
  size_t first = 0;
  double share = 1.0;
};
TiltNodes NodesOf(double cos_tilt) {
  const double tilt = DegFromRad(std::acos(std::clamp(cos_tilt, -1.0, 1.0)));
  const auto above = std::ranges::upper_bound(kFacetTiltsDeg, tilt);
  if (above == kFacetTiltsDeg.end()) return {kFacetTiltsDeg.size() - 2, 0.0};
  const auto first = static_cast<size_t>(above - kFacetTiltsDeg.begin()) - 1;
  return {first, (*above - tilt) / (*above - kFacetTiltsDeg[first])};
}

template <typename T>
T OnCurve(const T* curve, const TiltNodes& at) {
  return at.share * curve[at.first] + (1.0 - at.share) * curve[at.first + 1];
}

// Once scattered by a thin layer, light goes as both cosines' inverse; nearer to the horizon than any that it was
// learnt from it is held.
double HairsKernel(const ReflectionAngles& a) {
  return 1.0 / (std::max(a.normal_in, kLeastCosOfCurve) * std::max(a.normal_out, kLeastCosOfCurve));
}

// One light of a profile.
struct Shown {
  double reflectance = 0.0, sigma = 0.0;
  double fresnel = 1.0, path = 0.0;  // the gain is fresnel exp(-tau path)
  double few = 1.0;
  ReflectionAngles angles;
};

// What the lights of a profile leave, its own W taken out (variable projection). `reflected(p)`: of light p by the
// surface.
template <typename T, typename Reflected>
void ProfileResiduals(const std::vector<Shown>& lights, const T& tau, const T& narrow, const Reflected& reflected,
                      T* residuals) {
  using std::exp;
  T along(0.0), square(0.0);
  std::vector<T> gain;
  for (size_t p = 0; p < lights.size(); ++p) {
    const Shown& s = lights[p];
    gain.push_back(s.fresnel * exp(-tau * s.path) * (1.0 + narrow * (s.few - 1.0)) / s.sigma);
    residuals[p] = (s.reflectance - reflected(p)) / s.sigma;
    along += gain[p] * residuals[p];
    square += gain[p] * gain[p];
  }
  const T own = along / square;
  for (size_t p = 0; p < lights.size(); ++p) residuals[p] -= own * gain[p];
}

// With GGX of any strength and roughness.
struct GgxResiduals {
  std::vector<Shown> lights;
  double eta;

  template <typename T>
  bool operator()(const T* tau, const T* narrow, const T* strength, const T* roughness, T* residuals) const {
    const auto reflected = [&](size_t p) -> T { return *strength * Facets(*roughness, lights[p].angles, eta); };
    ProfileResiduals(lights, *tau, *narrow, reflected, residuals);
    return true;
  }
};

// With a curve over one GGX, and hairs, which are the last of `curve`.
struct CurveResiduals {
  struct Known {
    double ggx = 0.0, hairs = 0.0;  // reflectance of the one, of hairs = 1 of the others
    TiltNodes nodes;
  };
  std::vector<Shown> lights;
  std::vector<Known> known;

  static constexpr int kParameters = static_cast<int>(kFacetTiltsDeg.size()) + 1;

  CurveResiduals(std::vector<Shown> of, const SurfaceReflection& ggx, double eta) : lights(std::move(of)) {
    for (const Shown& s : lights)
      known.push_back(
          {ggx.strength * Facets(ggx.roughness, s.angles, eta), HairsKernel(s.angles), NodesOf(s.angles.normal_half)});
  }

  template <typename T>
  bool operator()(const T* tau, const T* narrow, const T* curve, T* residuals) const {
    const auto reflected = [&](size_t p) -> T {
      return known[p].ggx * OnCurve(curve, known[p].nodes) + known[p].hairs * curve[kParameters - 1];
    };
    ProfileResiduals(lights, *tau, *narrow, reflected, residuals);
    return true;
  }
};

struct CurvePrior {
  template <typename T>
  bool operator()(const T* curve, T* residuals) const {
    for (size_t j = 0; j < kFacetTiltsDeg.size(); ++j) residuals[j] = (curve[j] - 1.0) / kCurvePrior;
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

std::vector<Shown> ShownBy(std::span<const SrdBatch* const> lights, int64_t i, double eta, double least_cos) {
  std::vector<Shown> shown;
  double mean = 0.0;
  for (const SrdBatch* batch : lights) {
    if (!batch->Shares(i) || !(batch->cos_in[i] > least_cos) || !(batch->cos_out[i] > least_cos)) continue;
    const WhiteReflectance white = WhiteReflectanceOf(*batch, i);
    if (!std::isfinite(white.value) || !std::isfinite(white.variance) || !(white.value > 0.0)) continue;
    Shown s;
    s.angles = ReflectionAngles::Of(*batch, i);
    if (!std::isfinite(s.angles.normal_half) || Repeats(shown, s.angles)) continue;
    s.reflectance = white.value;
    s.sigma = std::sqrt(std::max(white.variance, 0.0));
    s.fresnel = AngularGain(batch->cos_in[i], eta, 0.0);
    s.path = GainPath(batch->cos_in[i], eta);
    const RefractedDirections directions = DirectionsOf(*batch, i, eta);
    s.few = directions.sec_in * directions.sec_out * std::exp(kPhaseSlope * (1.0 + directions.cos_scatter));
    mean += white.value;
    shown.push_back(s);
  }
  mean /= static_cast<double>(std::max<size_t>(shown.size(), 1));
  for (Shown& s : shown) s.sigma = std::hypot(s.sigma, kModelError * mean);
  return shown;
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

// What all profiles share beside the surface.
struct SharedGain {
  double tau = 0.2;
  std::vector<double> narrow;  // by colour

  void BoundIn(ceres::Problem& problem) {
    Bound(problem, tau, -1.0, 3.0);
    for (double& share : narrow)
      if (problem.HasParameterBlock(&share)) Bound(problem, share, 0.0, 0.6);
  }
};

// One profile in `one_in` pixels that two lights or more show within `least_cos`: add(shown, colour).
template <typename Add>
void ForEachSampled(std::span<const SrdBatch* const> lights, int channels, int64_t one_in, double eta, double least_cos,
                    const Add& add) {
  for (int64_t i = 0; i < lights[0]->profiles(); ++i) {
    if (i / channels % one_in != 0) continue;
    auto shown = ShownBy(lights, i, eta, least_cos);
    if (shown.size() >= 2) add(std::move(shown), i % channels);
  }
}

std::optional<SurfaceReflection> EstimateGgx(std::span<const SrdBatch* const> lights, int channels, int64_t one_in,
                                             double eta, SharedGain& gain) {
  SurfaceReflection ggx{0.5, 0.3};
  ceres::Problem problem;
  ForEachSampled(lights, channels, one_in, eta, kLeastCos, [&](std::vector<Shown> shown, int64_t colour) {
    const auto count = static_cast<int>(shown.size());
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<GgxResiduals, ceres::DYNAMIC, 1, 1, 1, 1>(
                                 new GgxResiduals{std::move(shown), eta}, count),
                             new ceres::CauchyLoss(kOutlier), &gain.tau, &gain.narrow[colour], &ggx.strength,
                             &ggx.roughness);
  });
  if (problem.NumResidualBlocks() < kLeastProfiles) return std::nullopt;
  gain.BoundIn(problem);
  Bound(problem, ggx.strength, 0.0, 5.0);
  Bound(problem, ggx.roughness, 0.15, 0.7);
  const auto solved = Solve(problem);
  if (!solved) return std::nullopt;
  const SurfaceReflection found = ggx;
  const SharedGain found_gain = gain;
  // Does another strength explain the lights as well?
  ggx.strength = ggx.strength < 1.0 ? ggx.strength + kClearly : ggx.strength - kClearly;
  problem.SetParameterBlockConstant(&ggx.strength);
  const auto other = Solve(problem);
  gain = found_gain;
  return other && *other - *solved > kTold ? std::optional(found) : std::nullopt;
}

// The curve over `ggx` and the hairs; GGX alone where they explain little that it does not, or no solution is found.
SurfaceReflection EstimateCurve(std::span<const SrdBatch* const> lights, int channels, int64_t one_in, double eta,
                                const SurfaceReflection& ggx, SharedGain gain) {
  std::array<double, CurveResiduals::kParameters> curve;
  curve.fill(1.0);
  curve.back() = 0.0;
  ceres::Problem problem;
  ForEachSampled(lights, channels, one_in, eta, kLeastCosOfCurve, [&](std::vector<Shown> shown, int64_t colour) {
    const auto count = static_cast<int>(shown.size());
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<CurveResiduals, ceres::DYNAMIC, 1, 1, CurveResiduals::kParameters>(
            new CurveResiduals(std::move(shown), ggx, eta), count),
        new ceres::CauchyLoss(kOutlier), &gain.tau, &gain.narrow[colour], curve.data());
  });
  problem.AddResidualBlock(
      new ceres::AutoDiffCostFunction<CurvePrior, int{kFacetTiltsDeg.size()}, CurveResiduals::kParameters>(
          new CurvePrior),
      new ceres::ScaledLoss(nullptr, kIndependent * problem.NumResidualBlocks(), ceres::TAKE_OWNERSHIP), curve.data());
  gain.BoundIn(problem);
  for (int j = 0; j < CurveResiduals::kParameters; ++j) problem.SetParameterLowerBound(curve.data(), j, 0.0);
  problem.SetParameterBlockConstant(curve.data());
  const auto straight = Solve(problem);
  problem.SetParameterBlockVariable(curve.data());
  const auto curved = Solve(problem);
  if (!straight || !curved || *straight - *curved < kWorthwhileCurve * problem.NumResidualBlocks()) return ggx;
  SurfaceReflection found = ggx;
  std::copy_n(curve.begin(), found.over_ggx.size(), found.over_ggx.begin());
  found.hairs = curve.back();
  return found;
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
  return surface.strength * Facets(surface.roughness, angles, eta) *
             OnCurve(surface.over_ggx.data(), NodesOf(angles.normal_half)) +
         surface.hairs * HairsKernel(angles);
}

double ReflectedBy(const SurfaceReflection& surface, const SrdBatch& batch, int64_t profile, double eta) {
  return ReflectanceOf(surface, ReflectionAngles::Of(batch, profile), eta);
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

double HeldReflection(const SurfaceReflection& surface, const SrdBatch& batch, int64_t profile, double eta) {
  if (!surface.Known()) return -1.0;
  const double most = kMostSurface * std::max(WhiteReflectanceOf(batch, profile).value, 0.0);
  return std::min(ReflectedBy(surface, batch, profile, eta), most);
}

SurfaceReflection EstimateSurfaceReflection(std::span<const SrdBatch* const> lights, int channels, double eta,
                                            int every) {
  SLX_CHECK(every >= 1 && channels >= 1);
  if (lights.empty()) return {};
  int64_t lit = 0;  // pixels
  for (int64_t i = 0; i < lights[0]->profiles(); i += channels)
    lit += std::ranges::any_of(lights, [i](const SrdBatch* batch) { return batch->Shares(i); }) ? 1 : 0;
  const int64_t one_in = std::max<int64_t>(every, (lit + kMostPixels - 1) / kMostPixels);
  SharedGain gain{.narrow = std::vector<double>(channels, 0.0)};
  const auto ggx = EstimateGgx(lights, channels, one_in, eta, gain);
  if (!ggx) return {};
  return EstimateCurve(lights, channels, one_in, eta, *ggx, gain);
}

}  // namespace stratalux::fit
