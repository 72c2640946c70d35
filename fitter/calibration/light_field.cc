// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/light_field.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <string>

namespace stratalux::fit {
namespace {

constexpr int kRounds = 12;
constexpr double kHuberSigmas = 3.0;
constexpr double kModelError = 0.001;      // of tiles: lens and lamp are no polynomials
constexpr double kMaxVignettingSd = 0.02;  // at r = 1; beyond, fall-off and vignetting were not told apart

double Radius2(const Pinhole& model, const Eigen::Vector2d& at) {
  const double half_diagonal2 = 0.25 * (double(model.width) * model.width + double(model.height) * model.height);
  return (at - Eigen::Vector2d(model.cx, model.cy)).squaredNorm() / half_diagonal2;
}

// Where each unknown stands: two of the vignetting, then for each projector two of its fall-off and the logarithms of
// three scales.
class Unknowns {
 public:
  Unknowns(size_t projectors, VignettingFit vignetting)
      : first_(vignetting == VignettingFit::kFree ? 2 : 0), size_(first_ + static_cast<Eigen::Index>(5 * projectors)) {}
  [[nodiscard]] Eigen::Index size() const { return size_; }
  [[nodiscard]] bool vignetting_is_free() const { return first_ > 0; }
  [[nodiscard]] Eigen::Index Falloff(int projector) const { return first_ + 5 * projector; }
  [[nodiscard]] Eigen::Index Scale(int projector, int channel) const { return first_ + 5 * projector + 2 + channel; }

 private:
  Eigen::Index first_, size_;
};

double Polynomial(double c0, double c1, double r2) { return std::max(1.0 + r2 * (c0 + r2 * c1), 0.05); }

struct Row {
  double residual = 0.0;  // model over measured, logarithm
  Eigen::VectorXd gradient;
};

}  // namespace

Result<LightField> FitLightField(const std::vector<FlatSample>& samples, const RigCalibration& rig, double albedo,
                                 VignettingFit vignetting) {
  const size_t projectors = rig.projectors.size();
  const Unknowns at(projectors, vignetting);
  int poses = 0;
  std::vector<std::array<int, 3>> counts(projectors);
  for (const FlatSample& s : samples) {
    poses = std::max(poses, s.pose + 1);
    ++counts[s.projector][s.channel];
  }
  for (size_t p = 0; p < projectors; ++p)
    if (counts[p][0] + counts[p][1] + counts[p][2] < 50)
      return Status::Failed("projector " + std::to_string(p) + " lights too little of the target");
  Eigen::VectorXd x = Eigen::VectorXd::Zero(at.size());
  // Start: no fall-off, the mean scale of each projector and colour.
  for (const FlatSample& s : samples)
    x[at.Scale(s.projector, s.channel)] +=
        std::log(s.white_dn / (s.geometry * albedo)) / counts[s.projector][s.channel];
  auto row_of = [&](const FlatSample& s) {
    Row row{0.0, Eigen::VectorXd::Zero(at.size())};
    const double rp = Radius2(rig.projectors[s.projector].model, s.column_row);
    const Eigen::Index f = at.Falloff(s.projector);
    const double falloff = Polynomial(x[f], x[f + 1], rp);
    row.gradient[f] = rp / falloff;
    row.gradient[f + 1] = rp * rp / falloff;
    const double rc = Radius2(rig.camera.model, s.camera_px);
    const auto& known = rig.camera.vignetting;
    const double sensitivity =
        at.vignetting_is_free() ? Polynomial(x[0], x[1], rc) : Polynomial(known[0], known[1], rc);
    if (at.vignetting_is_free()) {
      row.gradient[0] = rc / sensitivity;
      row.gradient[1] = rc * rc / sensitivity;
    }
    row.gradient[at.Scale(s.projector, s.channel)] = 1.0;
    row.residual =
        x[at.Scale(s.projector, s.channel)] + std::log(s.geometry * albedo * falloff * sensitivity / s.white_dn);
    return row;
  };
  Eigen::MatrixXd normal;
  for (int round = 0; round < kRounds; ++round) {
    // Channels without samples (a mono camera's) and fall-off beyond what was lit stay where they are.
    normal = 1e-3 * Eigen::MatrixXd::Identity(at.size(), at.size());
    Eigen::VectorXd right = Eigen::VectorXd::Zero(at.size());
    for (const FlatSample& s : samples) {
      const Row row = row_of(s);
      const double sigma = std::hypot(s.sigma_dn / s.white_dn, kModelError);
      const double off = std::abs(row.residual) / sigma;
      const double weight = (off > kHuberSigmas ? kHuberSigmas / off : 1.0) / (sigma * sigma);
      normal += weight * row.gradient * row.gradient.transpose();
      right -= weight * row.residual * row.gradient;
    }
    x += normal.ldlt().solve(right);
  }
  if (!x.allFinite()) return Status::Failed("the light field's fit did not converge");
  LightField field;
  field.residual.assign(poses, 0.0);
  std::vector<int> in_pose(poses, 0);
  double chi2 = 0.0;
  for (const FlatSample& s : samples) {
    const double residual = row_of(s).residual, sigma = std::hypot(s.sigma_dn / s.white_dn, kModelError);
    field.residual[s.pose] += residual * residual;
    ++in_pose[s.pose];
    chi2 += std::min(residual * residual / (sigma * sigma), 25.0);
  }
  for (int k = 0; k < poses; ++k) field.residual[k] = std::sqrt(field.residual[k] / std::max(1, in_pose[k]));
  // The scatter that there is, not the one that was assumed, sets the standard deviations.
  const Eigen::MatrixXd covariance = normal.inverse() * std::max(1.0, chi2 / static_cast<double>(samples.size()));
  auto sd_at_edge = [&](Eigen::Index k) {
    return std::sqrt(std::max(0.0, covariance(k, k) + covariance(k + 1, k + 1) + 2.0 * covariance(k, k + 1)));
  };
  field.vignetting = at.vignetting_is_free() ? std::array<double, 2>{x[0], x[1]} : rig.camera.vignetting;
  if (at.vignetting_is_free()) {
    field.vignetting_sd = sd_at_edge(0);
    if (field.vignetting_sd > kMaxVignettingSd)
      return Status::Failed("vignetting and fall-off cannot be told apart (known only to " +
                            std::to_string(100.0 * field.vignetting_sd) + " % at the edge)");
  }
  for (int p = 0; p < static_cast<int>(projectors); ++p) {
    LightField::OfProjector& of = field.projectors.emplace_back();
    of.falloff = {x[at.Falloff(p)], x[at.Falloff(p) + 1]};
    of.falloff_sd = sd_at_edge(at.Falloff(p));
    double mean = 0.0;
    int channels = 0;
    for (int c = 0; c < 3; ++c) {
      if (counts[p][c] == 0) continue;
      of.white_dn_mm2_per_ms[c] = std::exp(x[at.Scale(p, c)]);
      mean += of.white_dn_mm2_per_ms[c];
      ++channels;
    }
    for (int c = 0; c < 3; ++c)
      if (counts[p][c] == 0) of.white_dn_mm2_per_ms[c] = mean / channels;
  }
  return field;
}

Result<std::vector<double>> FitBlackLevels(const std::vector<BlackSample>& samples) {
  if (samples.empty()) return Status::Failed("no place that all projectors light");
  const Eigen::Index n = samples[0].contrast_dn.size();
  if (n < 2) return Status::Failed("a single projector's black cannot be told from ambient light");
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(n);
  for (const BlackSample& s : samples)
    for (Eigen::Index q = 0; q < n; ++q) {
      Eigen::VectorXd row = s.contrast_dn;
      row[q] = 0.0;
      normal += row * row.transpose();
      right += row * (s.all_black_dn - s.black_dn[q]);
    }
  const Eigen::VectorXd beta = normal.ldlt().solve(right);
  std::vector<double> levels;
  for (Eigen::Index p = 0; p < n; ++p) {
    if (!std::isfinite(beta[p])) return Status::Failed("the projectors' black levels are not determined");
    levels.push_back(std::max(0.0, beta[p]) / (1.0 + std::max(0.0, beta[p])));
  }
  return levels;
}

}  // namespace stratalux::fit
