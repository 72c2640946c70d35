// SPDX-License-Identifier: Apache-2.0
#include "fitter/photometric/point_normal.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>

#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

constexpr int kIterations = 60;         // a start a million sigmas away takes 40
constexpr double kNarrowing = 0.7;      // of the biweight from one iteration to the next
constexpr double kSettled = 1e-7;       // relative step that ends the iteration
constexpr size_t kMostForTriples = 12;  // 220 triples
constexpr double kMostScatter = 3.0;    // more sigmas than that are no noise that was understated

double Square(double x) { return x * x; }

// Weighted least squares in g = albedo n: rows l . g = y.
struct NormalEquations {
  Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  void Add(const Eigen::Vector3d& l, double y, double weight) {
    m += weight * l * l.transpose();
    b += weight * y * l;
  }
};

// Rows that hold g to the direction of a normal: t . g = 0 +- albedo sigma for both tangents t.
class Prior {
 public:
  Prior(const Eigen::Vector3d& normal, double sigma_rad)
      : normal_(normal), tangential_(Eigen::Matrix3d::Identity() - normal * normal.transpose()), sigma_(sigma_rad) {}
  [[nodiscard]] Eigen::Matrix3d Rows(const Eigen::Vector3d& g) const {
    return tangential_ / Square(sigma_ * std::max(normal_.dot(g), 1e-3 * g.norm()));
  }
  [[nodiscard]] double SquaredResidual(const Eigen::Vector3d& g) const { return g.dot(Rows(g) * g); }
  [[nodiscard]] const Eigen::Vector3d& normal() const { return normal_; }
  [[nodiscard]] double sigma_rad() const { return std::sqrt(2.0) * sigma_; }  // both tilts

 private:
  Eigen::Vector3d normal_;
  Eigen::Matrix3d tangential_;
  double sigma_;
};

class PointSolver {
 public:
  PointSolver(std::span<const PointSource> sources, const Eigen::Vector3d& view, const std::optional<Prior>& prior,
              const PhotometricOptions& options)
      : sources_(sources), view_(view), prior_(prior), options_(options), weights_(sources.size()) {
    std::vector<double> intensities;
    for (const PointSource& s : sources) intensities.push_back(s.intensity);
    if (intensities.empty()) return;
    brightest_ = std::max(0.0, std::ranges::max(intensities));
    std::ranges::nth_element(intensities, intensities.begin() + static_cast<std::ptrdiff_t>(intensities.size() / 2));
    median_ = std::max(intensities[intensities.size() / 2], options_.shadow_fraction * brightest_);
  }

  [[nodiscard]] PointNormal Solve() {
    PointNormal out;
    out.reason = SolveFromLight();
    if (out.reason == PhotometricReason::kValid) {
      Describe(nullptr, out);
    } else if (prior_) {
      SolveWithPrior(out);
    }
    return out;
  }

 private:
  // Sets g_ and weights_.
  [[nodiscard]] PhotometricReason SolveFromLight() {
    if (sources_.size() < 3 || !(brightest_ > 0.0)) return PhotometricReason::kTooFewSources;
    PhotometricReason reason = PhotometricReason::kValid;
    if (sources_.size() == 3)
      reason = SolveThree();
    else if (sources_.size() == 4)
      reason = SolveFour();
    else
      reason = SolveMany();
    if (reason == PhotometricReason::kValid && !(g_.dot(view_) > 0.0)) return PhotometricReason::kInconsistent;
    return reason;
  }

  [[nodiscard]] PhotometricReason SolveThree() {
    if (!SolveAllBut(sources_.size())) return PhotometricReason::kDegenerate;
    // What a shadow hides is no light that fell at 90 degrees.
    return AllLit() ? PhotometricReason::kValid : PhotometricReason::kTooFewSources;
  }

  [[nodiscard]] PhotometricReason SolveFour() {
    if (!SolveAllBut(sources_.size())) return PhotometricReason::kDegenerate;
    return IsDependent() ? PhotometricReason::kValid : BestTriple();
  }

  [[nodiscard]] PhotometricReason SolveMany() {
    if (!SolveAllBut(sources_.size())) return PhotometricReason::kDegenerate;
    Iterate(nullptr);
    return JudgeMany();
  }

  // Brightness that the relative sigma is of: a highlight outshines the albedo, no Lambertian source does.
  [[nodiscard]] double Brightness() const { return std::min(brightest_, g_.norm()); }
  [[nodiscard]] double Variance(const PointSource& s) const {
    return s.variance + Square(options_.relative_sigma * Brightness());
  }
  [[nodiscard]] double Predicted(const PointSource& s) const { return g_.dot(s.direction); }
  [[nodiscard]] bool IsDark(const PointSource& s) const {
    return s.intensity < options_.shadow_fraction * Brightness();
  }
  // The skin itself turns away from the light: intensity is max(0, g . l), which tells nothing more of g.
  [[nodiscard]] bool IsInAttachedShadow(const PointSource& s) const { return Predicted(s) <= 0.0 && IsDark(s); }
  [[nodiscard]] bool AllLit() const {
    for (size_t s = 0; s < sources_.size(); ++s)
      if (weights_[s] > 0.0 && IsDark(sources_[s])) return false;
    return true;
  }

  // Least squares over all but one source (sources_.size(): over all), the first time with the brightest's sigma.
  [[nodiscard]] bool SolveAllBut(size_t left_out) {
    g_ = Eigen::Vector3d(0.0, 0.0, brightest_);
    for (int pass = 0; pass < 2; ++pass) {
      for (size_t s = 0; s < sources_.size(); ++s) weights_[s] = s == left_out ? 0.0 : 1.0 / Variance(sources_[s]);
      if (!DirectionsSpan() || !StepOfWeights(nullptr)) return false;
    }
    return true;
  }

  // Do the directions of the used sources span space?
  [[nodiscard]] bool DirectionsSpan() const {
    Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
    for (size_t s = 0; s < sources_.size(); ++s)
      if (weights_[s] > 0.0) m += sources_[s].direction * sources_[s].direction.transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(m, Eigen::EigenvaluesOnly);
    return eigen.eigenvalues()[0] > Square(options_.min_condition) * eigen.eigenvalues()[2];
  }

  // g of the weights; false where they leave it open, or nothing of it.
  [[nodiscard]] bool StepOfWeights(const Prior* prior) {
    NormalEquations equations;
    if (prior != nullptr) equations.m = prior->Rows(g_);
    for (size_t s = 0; s < sources_.size(); ++s)
      if (weights_[s] > 0.0) equations.Add(sources_[s].direction, sources_[s].intensity, weights_[s]);
    const Eigen::LDLT<Eigen::Matrix3d> solver(equations.m);
    const Eigen::Vector3d pivots = solver.vectorD();
    if (!(pivots.minCoeff() > 1e-12 * pivots.maxCoeff())) return false;
    const Eigen::Vector3d g = solver.solve(equations.b);
    if (!g.allFinite() || !(g.norm() > 0.0)) return false;
    g_ = g;
    return true;
  }

  // The vector a with sum a_s l_s = 0 (a cofactor each) annihilates the intensities of a Lambertian point: a . y is
  // noise.
  [[nodiscard]] bool IsDependent() const {
    double violation = 0.0, variance = 0.0;
    for (size_t s = 0; s < 4; ++s) {
      std::array<Eigen::Vector3d, 3> others;
      for (size_t k = 0; k < 3; ++k) others[k] = sources_[k < s ? k : k + 1].direction;
      const double a = (s % 2 == 0 ? 1.0 : -1.0) * others[0].dot(others[1].cross(others[2]));
      violation += a * sources_[s].intensity;
      variance += a * a * Variance(sources_[s]);
    }
    return Square(violation) <= Square(options_.dependence_sigmas) * variance;
  }

  // Is a source, as the normal predicts it, a shadow (measured dark, predicted bright or facing away) or a highlight
  // (measured brighter than predicted, near the mirror direction)?
  [[nodiscard]] bool Explains(const PointSource& left_out) const {
    const double margin = std::sqrt(Variance(left_out));
    const double predicted = Predicted(left_out);
    if (IsDark(left_out) && (predicted <= margin || predicted > left_out.intensity)) return true;
    if (left_out.intensity <= predicted + margin) return false;
    const Eigen::Vector3d half = (left_out.direction + view_).normalized();
    const double angle = std::acos(std::clamp(half.dot(g_.normalized()), -1.0, 1.0));
    return 2.0 * angle < RadFromDeg(options_.highlight_cone_deg);  // the mirrored ray turns by twice the angle
  }

  [[nodiscard]] PhotometricReason BestTriple() {
    const Eigen::Vector3d& towards = prior_ ? prior_->normal() : view_;
    size_t best = sources_.size();
    double best_agreement = -1.0;
    for (size_t e = 0; e < sources_.size(); ++e) {
      if (!SolveAllBut(e) || !AllLit() || !Explains(sources_[e])) continue;
      const Eigen::Vector3d n = g_.normalized();
      if (n.dot(view_) <= 0.0 || n.dot(towards) <= best_agreement) continue;
      best = e;
      best_agreement = n.dot(towards);
    }
    if (best == sources_.size()) return PhotometricReason::kInconsistent;
    return SolveAllBut(best) ? PhotometricReason::kValid : PhotometricReason::kInconsistent;
  }

  // Distance of a source from its prediction, in standard deviations.
  [[nodiscard]] double Distance(const PointSource& s) const {
    return (s.intensity - Predicted(s)) / std::sqrt(Variance(s));
  }

  // Tukey's biweight (1 - (r / reach)^2)^2 over the variance.
  void Reweigh(double reach) {
    for (size_t s = 0; s < sources_.size(); ++s) {
      const double u = Distance(sources_[s]) / reach;
      const bool counts = std::abs(u) < 1.0 && !IsInAttachedShadow(sources_[s]);
      weights_[s] = counts ? Square(1.0 - u * u) / Variance(sources_[s]) : 0.0;
    }
  }

  // From g_ down to robust_sigmas: the wide weight has one minimum, and the narrower ones begin near their own. Then,
  // so that understated sigmas throw nothing away, to the same of the sigmas that are found.
  void Iterate(const Prior* prior) {
    double reach = 0.0;
    for (const PointSource& s : sources_)
      if (!IsInAttachedShadow(s)) reach = std::max(reach, 2.0 * std::abs(Distance(s)));
    bool settled = Narrow(prior, reach, options_.robust_sigmas);
    if (prior == nullptr && sources_.size() <= kMostForTriples && TripleIsBetter())
      settled = Narrow(prior, options_.robust_sigmas, options_.robust_sigmas);
    if (!settled) return;
    const double scattered = options_.robust_sigmas * RobustScatter();
    Narrow(prior, scattered, scattered);
  }

  // Among few sources an outlier draws the wide start to itself, but triples are few: g_ of the one with the least
  // cost, if that is less than g_'s own.
  [[nodiscard]] bool TripleIsBetter() {
    const Eigen::Vector3d before = g_;
    Eigen::Vector3d best = g_;
    double least = Cost();
    const auto n = sources_.size();
    for (size_t a = 0; a < n; ++a)
      for (size_t b = a + 1; b < n; ++b)
        for (size_t c = b + 1; c < n; ++c) {
          if (!SolveTriple(sources_[a], sources_[b], sources_[c]) || !(g_.dot(view_) > 0.0)) continue;
          if (const double cost = Cost(); cost < least) least = cost, best = g_;
        }
    g_ = best;
    return g_ != before;
  }

  // By the columns of the inverse: cross products over the determinant.
  [[nodiscard]] bool SolveTriple(const PointSource& a, const PointSource& b, const PointSource& c) {
    const Eigen::Vector3d bc = b.direction.cross(c.direction);
    const double determinant = a.direction.dot(bc);
    if (!(std::abs(determinant) > Square(options_.min_condition))) return false;
    g_ = (a.intensity * bc + b.intensity * c.direction.cross(a.direction) +
          c.intensity * a.direction.cross(b.direction)) /
         determinant;
    return g_.norm() > 0.0;
  }

  // Tukey's bounded loss of all sources, 1 for each beyond reach, by sigmas of one brightness: their median.
  [[nodiscard]] double Cost() const {
    double cost = 0.0;
    for (const PointSource& s : sources_) {
      if (IsInAttachedShadow(s)) continue;
      const double variance = s.variance + Square(options_.relative_sigma * median_);
      const double u2 = Square(s.intensity - Predicted(s)) / (variance * Square(options_.robust_sigmas));
      cost += u2 < 1.0 ? 1.0 - std::pow(1.0 - u2, 3) : 1.0;
    }
    return cost;
  }

  bool Narrow(const Prior* prior, double reach, double least) {
    reach = std::max(reach, least);
    for (int i = 0; i < kIterations; ++i) {
      Reweigh(reach);
      const Eigen::Vector3d before = g_;
      if (!StepOfWeights(prior)) return false;
      if (reach == least && (g_ - before).norm() <= kSettled * g_.norm()) break;
      reach = std::max(least, kNarrowing * reach);
    }
    Reweigh(least);
    return true;
  }

  // Median of the distances but the two that three parameters leave the least of, as a Gaussian's standard deviation
  // (0.6745 of it lies within the median); at least the 1 that is stated.
  [[nodiscard]] double RobustScatter() const {
    std::vector<double> distances;
    for (const PointSource& s : sources_)
      if (!IsInAttachedShadow(s)) distances.push_back(std::abs(Distance(s)));
    if (distances.size() < 5) return 1.0;
    const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(2 + (distances.size() - 3) / 2);
    std::ranges::nth_element(distances, middle);
    return std::clamp(*middle / 0.6745, 1.0, kMostScatter);
  }

  [[nodiscard]] int Used() const {
    return static_cast<int>(std::count_if(weights_.begin(), weights_.end(), [](double w) { return w > 0.0; }));
  }

  [[nodiscard]] PhotometricReason JudgeMany() const {
    const int used = Used();
    int shadowed = 0;
    for (size_t s = 0; s < sources_.size(); ++s) shadowed += weights_[s] <= 0.0 && IsInAttachedShadow(sources_[s]);
    const int all = static_cast<int>(sources_.size());
    if (used < 3) return used + shadowed == all ? PhotometricReason::kTooFewSources : PhotometricReason::kInconsistent;
    // Three always agree with each other: nothing may be left that they do not explain.
    const bool agreed = used > 3 || used + shadowed == all;
    if (!agreed || 2 * (used + shadowed) <= all) return PhotometricReason::kInconsistent;
    return DirectionsSpan() ? PhotometricReason::kValid : PhotometricReason::kDegenerate;
  }

  // The surface's normal and an albedo that fits it, then as with many sources.
  void SolveWithPrior(PointNormal& out) {
    double sum = 0.0, weight = 0.0;
    for (const PointSource& s : sources_) {
      const double cosine = std::max(0.0, prior_->normal().dot(s.direction));
      sum += s.intensity * cosine;
      weight += cosine * cosine;
    }
    std::fill(weights_.begin(), weights_.end(), 0.0);
    if (sum > 0.0) {
      g_ = sum / weight * prior_->normal();
      Iterate(&*prior_);
    }
    if (Used() > 0 && g_.dot(view_) > 0.0) {
      Describe(&*prior_, out);
      return;
    }
    out.normal = prior_->normal();
    out.sigma_rad = prior_->sigma_rad();
    out.weights.assign(sources_.size(), 0.0);
  }

  void Describe(const Prior* prior, PointNormal& out) const {
    Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
    double squares = 0.0, squared_distances = prior != nullptr ? prior->SquaredResidual(g_) : 0.0;
    for (size_t s = 0; s < sources_.size(); ++s) {
      if (weights_[s] <= 0.0) continue;
      m += weights_[s] * sources_[s].direction * sources_[s].direction.transpose();
      squares += Square(sources_[s].intensity - Predicted(sources_[s]));
      squared_distances += Square(Distance(sources_[s]));
    }
    const int used = Used();
    const int freedom = used + (prior != nullptr ? 2 : 0) - 3;
    if (freedom > 0) {
      out.scatter = squared_distances / freedom;
      out.residual = std::sqrt(squares / used) / Brightness();
      m /= std::max(1.0, out.scatter);
    }
    if (prior != nullptr) m += prior->Rows(g_);
    const Eigen::Matrix3d covariance = m.inverse();
    out.normal = g_.normalized();
    out.weights = weights_;
    out.sigma_rad = std::sqrt(covariance.trace() - out.normal.dot(covariance * out.normal)) / g_.norm();
  }

  std::span<const PointSource> sources_;
  Eigen::Vector3d view_;
  const std::optional<Prior>& prior_;
  const PhotometricOptions& options_;
  double brightest_ = 0.0, median_ = 0.0;
  Eigen::Vector3d g_ = Eigen::Vector3d::Zero();  // albedo n
  std::vector<double> weights_;
};

}  // namespace

const char* ToString(PhotometricReason reason) {
  constexpr std::array<const char*, kPhotometricReasons> kNames = {"valid", "no surface", "too few sources",
                                                                   "inconsistent", "degenerate"};
  return kNames[static_cast<size_t>(reason)];
}

Status PhotometricOptions::Validate() const {
  for (const double positive : {relative_sigma, dependence_sigmas, robust_sigmas, min_condition, negative_sigmas})
    if (!(positive > 0.0)) return Status::Usage("photometric: sigmas and min_condition must be positive");
  if (!(shadow_fraction >= 0.0) || !(shadow_fraction < 1.0))
    return Status::Usage("photometric: shadow_fraction must lie in 0 .. below 1");
  if (!(surface_sigma_rad > 0.0) || !(surface_sigma_rad < 1.0))
    return Status::Usage("photometric: surface_sigma_rad must lie in above 0 .. below 1");
  return Status::Ok();
}

PointNormal EstimatePointNormal(std::span<const PointSource> sources, const Eigen::Vector3d& view,
                                const std::optional<Eigen::Vector3d>& surface_normal,
                                const PhotometricOptions& options) {
  std::optional<Prior> prior;
  if (surface_normal) prior.emplace(*surface_normal, options.surface_sigma_rad);
  return PointSolver(sources, view, prior, options).Solve();
}

}  // namespace stratalux::fit
