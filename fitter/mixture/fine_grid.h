// SPDX-License-Identifier: Apache-2.0
// The fine grid of one light: layers as Gaussians on its cells, and the line response between cells and samples.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "fitter/mixture/profile_light.h"

namespace stratalux::fit {

// Cells of the fine grid per sample that a profile of `batch` needs, seen through `blur_mm` by the light, of those that
// it is fitted to, which blurs it least: layers are no narrower than the widest cell of any.
[[nodiscard]] int CellsPerSample(const SrdBatch& batch, int64_t profile, double blur_mm, const EmOptions& options);

// A light with its fine grid z and the line response B on it.
class FineGrid {
 public:
  // `light` must outlive it.
  explicit FineGrid(const ProfileLight& light);

  [[nodiscard]] const ProfileLight& light() const { return *light_; }
  [[nodiscard]] int cells() const { return cells_; }
  [[nodiscard]] double CellMm() const { return light_->step_mm / light_->cells_per_sample; }
  [[nodiscard]] double Coverage() const { return coverage_; }                // A of a layer inside the window
  [[nodiscard]] double SurfaceResponse(int k) const { return surface_[k]; }  // K(u_k; 0)
  [[nodiscard]] double Unseen(int cell) const { return coverage_ - seen_[cell]; }
  [[nodiscard]] double PositionMm(int cell) const {
    return light_->first_u_mm + (cell - pad_ - 0.5 * (light_->cells_per_sample - 1)) * CellMm();
  }

  // B m: what each sample sees of the light `mass` that leaves each cell.
  [[nodiscard]] std::vector<double> Project(const std::vector<double>& mass) const {
    std::vector<double> y(light_->samples(), 0.0);
    ForEachPair([&](int k, int cell, double r) { y[k] += r * mass[cell]; });
    return y;
  }
  // B^T r.
  [[nodiscard]] std::vector<double> BackProject(const std::vector<double>& ratio) const {
    std::vector<double> q(cells_, 0.0);
    ForEachPair([&](int k, int cell, double r) { q[cell] += r * ratio[k]; });
    return q;
  }

  // m_l(z) dz of a layer of unit weight; a wrapped layer reaches a cell by its nearest image and the two beside it.
  void Layer(double mean_mm, double sigma_mm, std::vector<double>& phi) const {
    std::fill(phi.begin(), phi.end(), 0.0);
    ForEachCell(mean_mm, sigma_mm, [&](int c, double /*x*/, double m) { phi[c] += m; });
  }
  // Sums over z of q phi {1, x, x^2}, x = z - mean, every image with its own x.
  [[nodiscard]] std::array<double, 3> Moments(double mean_mm, double sigma_mm, const std::vector<double>& q) const {
    std::array<double, 3> sum{};
    ForEachCell(mean_mm, sigma_mm, [&](int c, double x, double m) {
      sum[0] += q[c] * m;
      sum[1] += q[c] * m * x;
      sum[2] += q[c] * m * x * x;
    });
    return sum;
  }

  // Visits the cells a Gaussian reaches, with x = z - mean and its light there; each image of a comb by itself.
  template <typename Visit>
  void ForEachCell(double mean_mm, double sigma_mm, const Visit& visit) const {
    const double sigma = std::max(sigma_mm, 0.5 * CellMm()), reach = kReach * sigma, period = CellMm() * cells_;
    const double norm = CellMm() / (sigma * std::sqrt(2.0 * std::numbers::pi));
    auto at = [&](int c, double x) {
      if (std::abs(x) <= reach) visit(c, x, norm * std::exp(-0.5 * x * x / (sigma * sigma)));
    };
    if (light_->wrapped) {
      double nearest = std::remainder(PositionMm(0) - mean_mm, period);
      for (int c = 0; c < cells_; ++c) {
        for (int image : {-1, 0, 1}) at(c, nearest + image * period);
        nearest += CellMm();
        if (nearest > 0.5 * period) nearest -= period;
      }
      return;
    }
    const double first = (mean_mm - reach - PositionMm(0)) / CellMm(),
                 last = (mean_mm + reach - PositionMm(0)) / CellMm();
    const int end = static_cast<int>(std::min<double>(cells_, std::ceil(last) + 1.0));
    for (int c = static_cast<int>(std::max(0.0, std::floor(first))); c < end; ++c) at(c, PositionMm(c) - mean_mm);
  }

 private:
  template <typename Visit>
  void ForEachPair(const Visit& visit) const {
    for (int k = 0; k < light_->samples(); ++k)
      for (int t = 0; t < static_cast<int>(response_.size()); ++t) {
        int cell = pad_ + k * light_->cells_per_sample - before_ + t;
        if (light_->wrapped) cell = (cell % cells_ + cells_) % cells_;
        if (cell >= 0 && cell < cells_) visit(k, cell, response_[t]);
      }
  }

  static constexpr double kReach = 8.0;  // of a Gaussian, in standard deviations: 1e-14 of its peak
  const ProfileLight* light_;
  int pad_ = 0, cells_ = 0, before_ = 0;
  std::vector<double> response_, surface_, seen_;
  double coverage_ = 0.0;
};

}  // namespace stratalux::fit
