// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/line_profile.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace stratalux::fit {
namespace {

constexpr double kMaxCameraVarianceSd = 0.05;  // px^2; less certain, camera and projector were not told apart

// Share of white at distance u from the middle of a line.
double Profile(double u, double width, double sigma) {
  const double scale = 1.0 / (std::sqrt(2.0) * std::max(sigma, 1e-3));
  return 0.5 * (std::erf((u + 0.5 * width) * scale) - std::erf((u - 0.5 * width) * scale));
}

double SquaredError(const LineSamples& samples, const LineShape& shape) {
  double sum = 0.0;
  for (size_t k = 0; k < samples.bins().size(); ++k) {
    const auto& bin = samples.bins()[k];
    const double d = bin.sum / static_cast<double>(bin.count) -
                     Profile(samples.OffsetOf(k) - shape.centre_px, shape.width_px, shape.sigma_px);
    sum += d * d;
  }
  return sum;
}

}  // namespace

LineSamples::LineSamples(int width_px, int period_px)
    : width_px_(width_px), period_px_(period_px), bins_(static_cast<size_t>(period_px) * kBinsPerColumn) {}

double LineSamples::OffsetOf(size_t k) const {
  return (static_cast<double>(k) + 0.5) / kBinsPerColumn - 0.5 * period_px_;
}

void LineSamples::Add(double column, int shift, double share_of_white, double columns_per_px2) {
  // Distance of the place from the line's centre, wrapped into the period.
  double u = column - (shift + 0.5 * (width_px_ - 1)) + 0.5 * period_px_;
  u -= period_px_ * std::floor(u / period_px_);
  const auto k = std::min(static_cast<size_t>(u * kBinsPerColumn), bins_.size() - 1);
  bins_[k].sum += share_of_white;
  ++bins_[k].count;
  columns_per_px2_ += columns_per_px2;
  ++count_;
}

void LineSamples::Merge(const LineSamples& other) {
  for (size_t k = 0; k < bins_.size(); ++k) {
    bins_[k].sum += other.bins_[k].sum;
    bins_[k].count += other.bins_[k].count;
  }
  columns_per_px2_ += other.columns_per_px2_;
  count_ += other.count_;
}

double LineSamples::MeanColumnsPerPx2() const {
  return count_ > 0 ? columns_per_px2_ / static_cast<double>(count_) : 0.0;
}

Result<LineShape> FitLine(const LineSamples& samples) {
  LineShape shape;
  for (const LineSamples::Bin& bin : samples.bins()) {
    if (bin.count < 10) return Status::Failed("the profile of the lines has gaps: too little of the target is lit");
    shape.width_px += bin.sum / static_cast<double>(bin.count);
  }
  shape.width_px *= samples.period_px() / static_cast<double>(samples.bins().size());
  if (!(shape.width_px > 0.2 * samples.width_px()) || shape.width_px > 0.9 * samples.period_px())
    return Status::Failed("the lines carry the light of " + std::to_string(shape.width_px) + " columns, not of " +
                          std::to_string(samples.width_px()));
  // Two unknowns, a smooth valley: a search that halves its steps.
  shape.sigma_px = 0.5;
  double best = SquaredError(samples, shape);
  for (double step = 0.5; step > 1e-4;) {
    bool better = false;
    for (const auto& [centre, sigma] : {std::pair{step, 0.0}, {-step, 0.0}, {0.0, step}, {0.0, -step}}) {
      LineShape other = shape;
      other.centre_px += centre;
      other.sigma_px = std::max(0.01, other.sigma_px + sigma);
      if (const double error = SquaredError(samples, other); error < best) {
        best = error;
        shape = other;
        better = true;
      }
    }
    if (!better) step *= 0.5;
  }
  return shape;
}

LineBlur SplitBlur(const std::vector<BlurSample>& samples, size_t projectors, double known_camera_px) {
  const auto n = static_cast<Eigen::Index>(projectors);
  LineBlur blur;
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(n + 1, n + 1);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(n + 1);
  auto row_of = [&](const BlurSample& s) {
    Eigen::VectorXd row = Eigen::VectorXd::Zero(n + 1);
    row[s.projector] = 1.0;
    row[n] = s.columns_per_px2;
    return row;
  };
  auto variance_of = [](const BlurSample& s) { return s.sigma_px * s.sigma_px - s.columns_per_px2 / 12.0; };
  for (const BlurSample& s : samples) {
    normal += row_of(s) * row_of(s).transpose();
    right += row_of(s) * variance_of(s);
  }
  normal.diagonal().array() += 1e-9;
  const Eigen::VectorXd x = normal.ldlt().solve(right);
  double rest = 0.0;
  for (const BlurSample& s : samples) rest += std::pow(variance_of(s) - row_of(s).dot(x), 2);
  const double freedom = std::max(1.0, static_cast<double>(samples.size()) - static_cast<double>(n) - 1.0);
  // What the model leaves out (a footprint that lies askew) is a few per cent of the footprint's variance.
  double footprint = 0.0;
  for (const BlurSample& s : samples) footprint += s.columns_per_px2 / static_cast<double>(samples.size());
  const double scatter2 = rest / freedom + std::pow(0.03 * footprint / 12.0, 2);
  const double sd = std::sqrt(scatter2 * std::max(0.0, normal.inverse()(n, n)));
  const bool told_apart = samples.size() > projectors + 1 && sd < kMaxCameraVarianceSd && x.allFinite();
  const double camera2 = told_apart ? std::max(0.0, x[n]) : known_camera_px * known_camera_px;
  if (told_apart) blur.camera_px = std::sqrt(camera2);
  std::vector<double> sum(projectors, 0.0);
  std::vector<int> count(projectors, 0);
  for (const BlurSample& s : samples) {
    sum[s.projector] += variance_of(s) - camera2 * s.columns_per_px2;
    ++count[s.projector];
  }
  for (size_t p = 0; p < projectors; ++p)
    blur.projector_px.push_back(count[p] > 0 ? std::sqrt(std::max(0.0, sum[p] / count[p])) : 0.0);
  return blur;
}

double FullWidthAtHalf(double width, double sigma) {
  const double half = 0.5 * Profile(0.0, width, sigma);
  double low = 0.0, high = width + 5.0 * sigma;
  for (int k = 0; k < 60; ++k) {
    const double middle = 0.5 * (low + high);
    (Profile(middle, width, sigma) > half ? low : high) = middle;
  }
  return low + high;
}

}  // namespace stratalux::fit
