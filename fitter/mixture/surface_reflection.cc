// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/surface_reflection.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
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
// neighbours and to lights, so that without noise, which is not, all profiles count as that many.
constexpr double kCurvePrior = 0.5, kIndependentProfiles = 1000.0;
// Of the cost, a profile: less is what the gain leaves on a surface that is GGX (docs/math/surface.md).
constexpr double kWorthwhileCurve = 0.03;
// Of the gloss, the same two; before light has told, gloss 1 is half of what facets that lie so much flatter do.
constexpr double kWorthwhileGloss = 0.01;
constexpr double kGlossPrior = 0.25;
constexpr double kGlossierBy = 0.5;
constexpr double kGlossier = 0.7;
constexpr int kGlossRounds = 4;       // of field and curves in turn
constexpr double kModelError = 0.02;  // of a light: what the gain leaves
constexpr double kOutlier = 2.0;      // standard deviations, of Cauchy's loss
constexpr double kPhaseSlope = 1.15;  // of light of few events, as Monte Carlo skins have it (docs/math/em.md)
constexpr int64_t kLeastProfiles = 100;
constexpr int64_t kMostPixels = 6000;
constexpr double kClearly = 0.5, kTold = 0.5;  // a strength that much off must cost a standard deviation

// How many facets GGX tilts so far, times pi; T: double, or Ceres' own for its derivatives.
template <typename T>
T GgxTilts(const T& roughness, double cos2_tilt) {
  const T a2 = roughness * roughness, lobe = cos2_tilt * (a2 - 1.0) + 1.0;
  return a2 / (lobe * lobe);
}

// pi f_r of strength 1.
template <typename T>
T Facets(const T& roughness, const ReflectionAngles& a, double eta) {
  using std::sqrt;
  const T a2 = roughness * roughness;
  const auto smith = [&a2](double c) -> T { return 2.0 * c / (c + sqrt(a2 + (1.0 - a2) * c * c)); };
  const double fresnel = 1.0 - FresnelTransmission(std::clamp(a.half_in, 0.0, 1.0), eta);
  return GgxTilts(roughness, a.normal_half * a.normal_half) * smith(a.normal_in) * smith(a.normal_out) *
         (fresnel / (4.0 * a.normal_in * a.normal_out));
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
  double of_model = 1.0;             // share of sigma^2 that is no noise
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

// A profile with a curve over one GGX, hairs, and a gloss of its place.
struct CurvedProfile {
  struct Known {
    double ggx = 0.0, hairs = 0.0;  // reflectance of the one, of hairs = 1 of the others
    TiltNodes nodes;
  };
  int64_t place = 0;
  std::vector<Shown> lights;
  std::vector<Known> known;
  double gloss = 0.0;

  CurvedProfile(int64_t where, std::vector<Shown> of, const SurfaceReflection& ggx, double eta)
      : place(where), lights(std::move(of)) {
    for (const Shown& s : lights)
      known.push_back(
          {ggx.strength * Facets(ggx.roughness, s.angles, eta), HairsKernel(s.angles), NodesOf(s.angles.normal_half)});
  }
};

constexpr int kTilts = static_cast<int>(kFacetTiltsDeg.size());

// The curve's hairs are behind its last tilt.
struct CurveResiduals {
  const CurvedProfile* profile;

  static constexpr int kParameters = kTilts + 1;

  template <typename T>
  bool operator()(const T* tau, const T* narrow, const T* curve, const T* by_gloss, T* residuals) const {
    const auto reflected = [&](size_t p) -> T {
      const CurvedProfile::Known& at = profile->known[p];
      const T over = OnCurve(curve, at.nodes) + profile->gloss * OnCurve(by_gloss, at.nodes);
      return at.hairs * curve[kTilts] + (over > 0.0 ? at.ggx * over : T(0.0));
    };
    ProfileResiduals(profile->lights, *tau, *narrow, reflected, residuals);
    return true;
  }
};

// Of the first tilts of a curve.
struct CurvePrior {
  FacetCurve expected;
  double sigma;

  template <typename T>
  bool operator()(const T* curve, T* residuals) const {
    for (int j = 0; j < kTilts; ++j) residuals[j] = (curve[j] - expected[j]) / sigma;
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
  for (Shown& s : shown) {
    const double of_model = kModelError * mean;
    s.sigma = std::hypot(s.sigma, of_model);
    s.of_model = of_model * of_model / (s.sigma * s.sigma);
  }
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

// One profile in `one_in` pixels that two lights or more show within `least_cos`: add(profile, shown).
template <typename Add>
void ForEachSampled(std::span<const SrdBatch* const> lights, int channels, int64_t one_in, double eta, double least_cos,
                    const Add& add) {
  for (int64_t i = 0; i < lights[0]->profiles(); ++i) {
    if (i / channels % one_in != 0) continue;
    auto shown = ShownBy(lights, i, eta, least_cos);
    if (shown.size() >= 2) add(i, std::move(shown));
  }
}

std::optional<SurfaceReflection> EstimateGgx(std::span<const SrdBatch* const> lights, int channels, int64_t one_in,
                                             double eta, SharedGain& gain) {
  SurfaceReflection ggx{0.5, 0.3};
  ceres::Problem problem;
  ForEachSampled(lights, channels, one_in, eta, kLeastCos, [&](int64_t profile, std::vector<Shown> shown) {
    const auto count = static_cast<int>(shown.size());
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<GgxResiduals, ceres::DYNAMIC, 1, 1, 1, 1>(
                                 new GgxResiduals{std::move(shown), eta}, count),
                             new ceres::CauchyLoss(kOutlier), &gain.tau, &gain.narrow[profile % channels],
                             &ggx.strength, &ggx.roughness);
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

// Of skin of gloss 1 before the light has told: GGX of facets that lie so much flatter.
FacetCurve ExpectedByGloss(double roughness) {
  FacetCurve more{};
  for (size_t j = 0; j < more.size(); ++j) {
    const double cos2 = std::pow(std::cos(RadFromDeg(kFacetTiltsDeg[j])), 2);
    more[j] = kGlossierBy * (GgxTilts(kGlossier * roughness, cos2) / GgxTilts(roughness, cos2) - 1.0);
  }
  return more;
}

// (3) of docs/math/surface.md: the curve over a GGX and the hairs, then the gloss.
class CurveFit {
 public:
  CurveFit(std::span<const SrdBatch* const> lights, int channels, int64_t one_in, double eta,
           const SurfaceReflection& ggx, SharedGain gain)
      : channels_(channels), found_(ggx), gain_(std::move(gain)), by_gloss_(ExpectedByGloss(ggx.roughness)) {
    curve_.fill(1.0);
    curve_[kTilts] = 0.0;
    ForEachSampled(lights, channels, one_in, eta, kLeastCosOfCurve, [&](int64_t profile, std::vector<Shown> shown) {
      profiles_.emplace_back(lights[0]->PlaceOf(profile), std::move(shown), ggx, eta);
    });
    for (const CurvedProfile& profile : profiles_)
      problem_.AddResidualBlock(
          new ceres::AutoDiffCostFunction<CurveResiduals, ceres::DYNAMIC, 1, 1, CurveResiduals::kParameters, kTilts>(
              new CurveResiduals{&profile}, static_cast<int>(profile.lights.size())),
          new ceres::CauchyLoss(kOutlier), &gain_.tau, NarrowOf(profile), curve_.data(), by_gloss_.data());
    AddPrior<CurveResiduals::kParameters>(SurfaceReflection{}.over_ggx, kCurvePrior, curve_.data());
    AddPrior<kTilts>(by_gloss_, kGlossPrior, by_gloss_.data());
    gain_.BoundIn(problem_);
    for (int j = 0; j < CurveResiduals::kParameters; ++j) problem_.SetParameterLowerBound(curve_.data(), j, 0.0);
  }
  CurveFit(const CurveFit&) = delete;  // the problem points into it

  // GGX alone where a curve explains little that it does not, or no solution is found; of one gloss likewise.
  SurfaceReflection Found(const ProfileGrid& grid) {
    problem_.SetParameterBlockConstant(by_gloss_.data());
    problem_.SetParameterBlockConstant(curve_.data());
    const auto straight = Solve(problem_);
    problem_.SetParameterBlockVariable(curve_.data());
    const auto curved = Solve(problem_);
    if (!straight || !curved || *straight - *curved < Worthwhile(kWorthwhileCurve)) return found_;
    TakeCurve();
    GlossField gloss = FlatGloss(grid);
    if (gloss.nodes.empty()) return found_;
    problem_.SetParameterBlockVariable(by_gloss_.data());
    std::optional<double> glossy;
    for (int round = 0; round < kGlossRounds; ++round) {
      Spread(gloss);
      glossy = Solve(problem_);
      if (!glossy) return found_;
    }
    if (*curved - *glossy < Worthwhile(kWorthwhileGloss)) return found_;
    TakeCurve();
    found_.by_gloss = by_gloss_;
    found_.gloss = std::move(gloss);
    return found_;
  }

 private:
  double* NarrowOf(const CurvedProfile& profile) { return &gain_.narrow[profile.place % channels_]; }
  [[nodiscard]] double Worthwhile(double a_profile) const { return a_profile * static_cast<double>(profiles_.size()); }

  // How many profiles count as one: of N whose errors have a share r in common N0 at a time, 1 + (N / N0 - 1) r.
  [[nodiscard]] double Together() const {
    double common = 0.0, lights = 0.0;
    for (const CurvedProfile& profile : profiles_)
      for (const Shown& s : profile.lights) {
        common += s.of_model;
        lights += 1.0;
      }
    const double cells = static_cast<double>(profiles_.size()) / kIndependentProfiles;
    return 1.0 + std::max(cells - 1.0, 0.0) * common / std::max(lights, 1.0);
  }

  template <int kBlock>
  void AddPrior(const FacetCurve& expected, double sigma, double* curve) {
    problem_.AddResidualBlock(
        new ceres::AutoDiffCostFunction<CurvePrior, kTilts, kBlock>(new CurvePrior{expected, sigma}),
        new ceres::ScaledLoss(nullptr, Together(), ceres::TAKE_OWNERSHIP), curve);
  }

  void TakeCurve() {
    std::copy_n(curve_.begin(), kTilts, found_.over_ggx.begin());
    found_.hairs = curve_[kTilts];
  }

  // The field by the curves and the gain as they are, and each profile's gloss by the field.
  void Spread(GlossField& gloss) {
    std::vector<GlossWitness> witnesses;
    witnesses.reserve(profiles_.size());
    for (const CurvedProfile& profile : profiles_) witnesses.push_back(WitnessOf(profile));
    SolveGloss(witnesses, gloss);
    for (CurvedProfile& profile : profiles_) profile.gloss = gloss.At(profile.place);
  }

  [[nodiscard]] GlossWitness WitnessOf(const CurvedProfile& profile) {
    const auto& lights = profile.lights;
    std::vector<double> plain(lights.size()), glossier(lights.size());
    const auto without = [&](size_t p) {
      const CurvedProfile::Known& at = profile.known[p];
      return at.ggx * OnCurve(curve_.data(), at.nodes) + at.hairs * curve_[kTilts];
    };
    const auto with = [&](size_t p) {
      const CurvedProfile::Known& at = profile.known[p];
      return without(p) + at.ggx * OnCurve(by_gloss_.data(), at.nodes);
    };
    ProfileResiduals(lights, gain_.tau, *NarrowOf(profile), without, plain.data());
    ProfileResiduals(lights, gain_.tau, *NarrowOf(profile), with, glossier.data());
    GlossWitness says{.profile = profile.place};
    double square = 0.0;
    for (size_t p = 0; p < lights.size(); ++p) {
      const double effect = plain[p] - glossier[p], left = plain[p] - profile.gloss * effect;
      says.along += plain[p] * effect;
      says.square += effect * effect;
      square += left * left;
    }
    const double trust = 1.0 / (1.0 + square / (kOutlier * kOutlier));  // Cauchy's
    says.along *= trust;
    says.square *= trust;
    return says;
  }

  int channels_;
  SurfaceReflection found_;
  SharedGain gain_;
  std::array<double, CurveResiduals::kParameters> curve_{};
  FacetCurve by_gloss_;
  std::deque<CurvedProfile> profiles_;
  ceres::Problem problem_;
};

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

double ReflectanceOf(const SurfaceReflection& surface, const ReflectionAngles& angles, double eta, double gloss) {
  if (!surface.Known() || !(angles.normal_in > 0.0) || !(angles.normal_out > 0.0)) return 0.0;
  const TiltNodes tilt = NodesOf(angles.normal_half);
  const double over = OnCurve(surface.over_ggx.data(), tilt) + gloss * OnCurve(surface.by_gloss.data(), tilt);
  return surface.strength * Facets(surface.roughness, angles, eta) * std::max(over, 0.0) +
         surface.hairs * HairsKernel(angles);
}

double ReflectedBy(const SurfaceReflection& surface, const SrdBatch& batch, int64_t profile, double eta) {
  return ReflectanceOf(surface, ReflectionAngles::Of(batch, profile), eta, surface.gloss.At(batch.PlaceOf(profile)));
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

SurfaceReflection EstimateSurfaceReflection(std::span<const SrdBatch* const> lights, const ProfileGrid& grid,
                                            double eta, int every) {
  const int channels = grid.channels;
  SLX_CHECK(every >= 1 && channels >= 1);
  if (lights.empty()) return {};
  int64_t lit = 0;  // pixels
  for (int64_t i = 0; i < lights[0]->profiles(); i += channels)
    lit += std::ranges::any_of(lights, [i](const SrdBatch* batch) { return batch->Shares(i); }) ? 1 : 0;
  const int64_t one_in = std::max<int64_t>(every, (lit + kMostPixels - 1) / kMostPixels);
  SharedGain gain{.narrow = std::vector<double>(channels, 0.0)};
  const auto ggx = EstimateGgx(lights, channels, one_in, eta, gain);
  if (!ggx) return {};
  return CurveFit(lights, channels, one_in, eta, *ggx, gain).Found(grid);
}

}  // namespace stratalux::fit
