// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/line_response.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "fitter/mixture/normal_table.h"

namespace stratalux::fit {
namespace {

double NormalDistribution(double x) { return 0.5 * std::erfc(-x / std::numbers::sqrt2); }

constexpr double kEnd = 7.0;  // beyond, responses are 0 to 1e-13

// Second antiderivative.
double Bowl(double x) {
  return 0.5 * ((x * x + 1.0) * NormalDistribution(x) + x * std::exp(-0.5 * x * x) / std::sqrt(2 * std::numbers::pi));
}

}  // namespace

double SampleSites::ReachMm() const {
  return 0.5 * (pool - 1) * (std::abs(quad_x_mm) + std::abs(quad_y_mm)) + std::abs(pair_mm) + std::abs(box_x_mm) +
         std::abs(box_y_mm);
}

double SampleSites::VarianceMm2() const {
  return (pool * pool - 1) / 12.0 * (quad_x_mm * quad_x_mm + quad_y_mm * quad_y_mm) + pair_mm * pair_mm +
         box_x_mm * box_x_mm + box_y_mm * box_y_mm;
}

double LineResponse::At(double t_mm) const {
  double response = 0.0;
  sites.ForEach([&](double site_mm, double share) { response += share * OfOneSite(t_mm + site_mm); });
  return response;
}

std::vector<double> LineResponse::OnCells(double first_mm, int count) const {
  std::vector<double> response(count, 0.0);
  if (sample_box_mm > 0.0) {
    for (int i = 0; i < count; ++i) response[i] = At(first_mm + i * cell_mm);
    return response;
  }
  const double s = std::max(blur_mm, 1e-3 * cell_mm), w = 0.5 * line_width_mm;
  sites.ForEach([&](double site_mm, double share) {
    double before = 0.0;
    for (int i = 0; i <= count; ++i) {
      const double edge = first_mm + site_mm + (i - 0.5) * cell_mm;
      const double here = s * (NormalRamp((edge + w) / s) - NormalRamp((edge - w) / s));
      if (i > 0) response[i - 1] += share * (here - before) / cell_mm;
      before = here;
    }
  });
  return response;
}

double LineResponse::OfOneSite(double t_mm) const {
  // Boxes convolved with a Gaussian are differences of its repeated antiderivatives at the boxes' corners.
  const double s = std::max(blur_mm, 1e-3 * cell_mm);
  const double w = 0.5 * line_width_mm, c = 0.5 * cell_mm, b = 0.5 * sample_box_mm;
  if (std::abs(t_mm) >= w + c + b + kEnd * s) return 0.0;
  auto ramp = [&](double t) { return s * NormalRamp(t / s); };
  auto bowl = [&](double t) { return s * s * Bowl(t / s); };
  if (b <= 0.0) return (ramp(t_mm + w + c) - ramp(t_mm + w - c) - ramp(t_mm - w + c) + ramp(t_mm - w - c)) / cell_mm;
  double sum = 0.0;
  for (int i : {-1, 1})
    for (int j : {-1, 1})
      for (int k : {-1, 1}) sum += i * j * k * bowl(t_mm + i * w + j * c + k * b);
  return sum / (cell_mm * sample_box_mm);
}

double LineResponse::Support() const {
  return 0.5 * (line_width_mm + cell_mm + sample_box_mm) + 4.8 * blur_mm + sites.ReachMm();
}

SampleSites SampleSitesOf(const SrdBatch& batch, int64_t profile) {
  const auto of_profile = [&](const std::vector<float>& field) {
    return field.empty() ? 0.0 : double{field[static_cast<size_t>(profile)]};
  };
  return {batch.pool,
          of_profile(batch.quad_x_mm),
          of_profile(batch.quad_y_mm),
          of_profile(batch.pair_mm),
          of_profile(batch.box_x_mm),
          of_profile(batch.box_y_mm)};
}

LineResponse LineResponseOf(const SrdBatch& batch, int64_t profile, double cell_mm) {
  return {batch.line_width_mm[profile], batch.blur_mm[profile], batch.sample_box * double{batch.step_mm[profile]},
          cell_mm, SampleSitesOf(batch, profile)};
}

}  // namespace stratalux::fit
