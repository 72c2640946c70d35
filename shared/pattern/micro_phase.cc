// SPDX-License-Identifier: Apache-2.0
#include "shared/pattern/micro_phase.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "shared/base/check.h"
#include "shared/pattern/column_code.h"

namespace stratalux {
namespace {

constexpr double kTurn = 2.0 * std::numbers::pi;

// Waves a column of the J periods, beyond those of `about_px`: period j is about_px / (1 + detuning). By search among
// those within a quarter of it whose mean is 0 within 0.02: of all columns half a period apart and farther, among 4^J
// of a period of 4, the phases of the closest two differ as much as they can (the test says by how much).
constexpr std::array<std::array<double, 8>, 8> kDetunings = {{
    {-0.02},
    {-0.0926, 0.1325},
    {-0.1464, -0.0235, 0.1576},
    {-0.1146, -0.0997, 0.0537, 0.162},
    {-0.1327, -0.0929, 0.0046, 0.1054, 0.1123},
    {-0.1774, -0.0031, 0.0218, 0.0309, 0.0534, 0.1289},
    {-0.1412, -0.1201, -0.0376, 0.0265, 0.0389, 0.0716, 0.1859},
    {-0.1541, -0.1299, -0.0788, -0.0621, 0.0462, 0.0686, 0.0969, 0.172},
}};

}  // namespace

double Wave::Angle(double column) const { return kTurn * (column + 0.5) / period_px - phase_rad; }

Wave MicroPhaseWave(int plane, int bits, int about_px) {
  SLX_CHECK(bits >= 1 && bits <= kMaxCodeBits && plane >= 0 && plane < bits);
  const auto periods = static_cast<size_t>((bits + 1) / 2);
  const double detuning = kDetunings[periods - 1][static_cast<size_t>(plane / 2)];
  return {about_px / (1.0 + detuning), plane % 2 == 0 ? 0.0 : 0.25 * kTurn};
}

MicroPhaseSearch::MicroPhaseSearch(int count, int bits, int about_px) : count_(count), about_px_(about_px) {
  for (int plane = 0; plane < bits; ++plane) waves_.push_back(MicroPhaseWave(plane, bits, about_px));
  contrast_.assign(waves_.size(), 1.0);
  periods_ = Every(about_px);
  everywhere_ = Every(0.25 * about_px);  // a fit of one step reaches half of that from its column
}

void MicroPhaseSearch::LearnContrast(std::span<const double> squares) {
  SLX_CHECK(squares.size() == waves_.size());
  std::vector<double> contrast;
  double sum = 0.0;
  for (size_t b = 0; b < waves_.size(); ++b) {
    const size_t other = (b ^ 1U) < waves_.size() ? b ^ 1U : b;  // of the same period
    contrast.push_back(std::sqrt(std::max(0.0, 0.5 * (squares[b] + squares[other]))));
    sum += contrast.back();
  }
  if (*std::min_element(contrast.begin(), contrast.end()) <= 0.0) return;
  for (size_t b = 0; b < waves_.size(); ++b) contrast_[b] = contrast[b] * static_cast<double>(waves_.size()) / sum;
}

MicroPhaseSearch::Candidates MicroPhaseSearch::Every(double step_px) const {
  Candidates candidates{step_px, static_cast<int>(std::ceil(count_ / step_px)) + 1, {}, {}};
  for (const Wave& wave : waves_)
    for (int k = 0; k < candidates.count; ++k) {
      const double angle = kTurn * std::fmod(k * step_px / wave.period_px, 1.0);
      candidates.cosine.push_back(static_cast<float>(std::cos(angle)));
      candidates.sine.push_back(static_cast<float>(std::sin(angle)));
    }
  return candidates;
}

struct MicroPhaseSearch::Fit {
  std::vector<float> chi2, moved_px;  // by candidate
};

// Of each candidate column c the least squares in amplitude a and a small move m,
// d_b = a q_b (cos t_b - m t_b' sin t_b) with the contrast q_b and the angle t_b of plane b at c: linear in a and a m,
// of which the latter has the prior N(0, (a sigma)^2), a by the sum of squares.
MicroPhaseSearch::Fit MicroPhaseSearch::FitAll(const Candidates& candidates, double first, double sigma_px,
                                               std::span<const double> difference,
                                               std::span<const double> weight) const {
  const auto n = static_cast<size_t>(candidates.count);
  double squares = 0.0, weights = 0.0;
  for (size_t b = 0; b < waves_.size(); ++b) {
    squares += weight[b] * difference[b] * difference[b];
    weights += weight[b];
  }
  if (!(weights > 0.0) || !(squares > 0.0)) return {std::vector<float>(n, 0.0F), std::vector<float>(n, 0.0F)};
  const double amplitude2 = 2.0 * squares / weights;
  std::vector<float> cc(n, 0.0F), cs(n, 0.0F), ss(n, static_cast<float>(1.0 / (amplitude2 * sigma_px * sigma_px)));
  std::vector<float> dc(n, 0.0F), ds(n, 0.0F);
  for (size_t b = 0; b < waves_.size(); ++b) {
    if (!(weight[b] > 0.0)) continue;
    const auto scale = static_cast<float>(kTurn / waves_[b].period_px);
    const double angle = waves_[b].Angle(first);
    const auto cos_first = static_cast<float>(contrast_[b] * std::cos(angle));
    const auto sin_first = static_cast<float>(contrast_[b] * std::sin(angle));
    const auto w = static_cast<float>(weight[b]), wd = static_cast<float>(weight[b] * difference[b]);
    const float* cosine = candidates.cosine.data() + b * n;
    const float* sine = candidates.sine.data() + b * n;
    for (size_t k = 0; k < n; ++k) {
      const float c = cos_first * cosine[k] - sin_first * sine[k];
      const float s = -scale * (sin_first * cosine[k] + cos_first * sine[k]);
      cc[k] += w * c * c;
      cs[k] += w * c * s;
      ss[k] += w * s * s;
      dc[k] += wd * c;
      ds[k] += wd * s;
    }
  }
  Fit fit{std::vector<float>(n), std::vector<float>(n)};
  const auto turn = static_cast<float>(kTurn / about_px_);
  for (size_t k = 0; k < n; ++k) {
    const float det = cc[k] * ss[k] - cs[k] * cs[k];
    const float a = (dc[k] * ss[k] - ds[k] * cs[k]) / det, am = (ds[k] * cc[k] - dc[k] * cs[k]) / det;
    const bool fits = det > 0.0F && a > 0.0F;
    fit.chi2[k] = static_cast<float>(squares) - (fits ? a * dc[k] + am * ds[k] : 0.0F);
    fit.moved_px[k] = fits ? std::atan2(am * turn, a) / turn : 0.0F;  // the phases turn, all about alike
  }
  return fit;
}

MicroPhaseSearch::Found MicroPhaseSearch::Find(std::span<const double> difference, std::span<const double> weight,
                                               std::optional<Within> within) const {
  SLX_CHECK(difference.size() == waves_.size() && weight.size() == waves_.size());
  // How far phases of unlike periods may stand apart on skin, px: scattered light moves a finer one less.
  constexpr double kApart_px = 0.25;
  const Candidates& candidates = within ? periods_ : everywhere_;
  const double first = within ? within->px - 0.5 : 0.0;
  const double sigma = within ? std::hypot(within->sigma_px, kApart_px) : 0.5 * candidates.step_px;
  const Fit fit = FitAll(candidates, first, sigma, difference, weight);
  const auto best = static_cast<size_t>(std::min_element(fit.chi2.begin(), fit.chi2.end()) - fit.chi2.begin());
  const auto column = [&](size_t k) { return first + static_cast<double>(k) * candidates.step_px + fit.moved_px[k]; };
  // What the best one leaves, beyond the noise, is the noise of all. Two numbers were fitted.
  const auto planes = std::count_if(weight.begin(), weight.end(), [](double w) { return w > 0.0; });
  const double scale = std::max(1.0, fit.chi2[best] / std::max(1.0, static_cast<double>(planes) - 2.0));
  constexpr double kImpossible = 100.0;  // chi^2 beyond the best one's: e^-50
  double here = 0.0, all = 0.0;
  for (size_t k = 0; k < fit.chi2.size(); ++k) {
    const double beyond = (double(fit.chi2[k]) - fit.chi2[best]) / scale;
    if (beyond > kImpossible) continue;
    const double p = std::exp(-0.5 * beyond);
    all += p;
    if (std::abs(column(k) - column(best)) < 0.5 * about_px_) here += p;
  }
  Found found{column(best), 0.0, 1.0 - here / all, fit.chi2[best]};
  Refine(difference, weight, within, found);
  return found;
}

// Each period's phase by itself, so that their contrasts may differ: the weighted mean of the columns that they say.
void MicroPhaseSearch::Refine(std::span<const double> difference, std::span<const double> weight,
                              const std::optional<Within>& within, Found& found) const {
  struct Place {
    double px = 0.0, weight = 0.0;
  };
  std::vector<Place> places;
  for (size_t b = 0; b + 1 < waves_.size(); b += 2) {
    if (!(weight[b] > 0.0 && weight[b + 1] > 0.0)) continue;
    const double px_per_rad = waves_[b].period_px / kTurn;
    const double off = std::atan2(difference[b + 1], difference[b]) - waves_[b].Angle(found.column);
    const double power = difference[b] * difference[b] + difference[b + 1] * difference[b + 1];
    const double variance = 0.5 * (1.0 / weight[b] + 1.0 / weight[b + 1]);
    places.push_back(
        {found.column + std::remainder(off, kTurn) * px_per_rad, power / (variance * px_per_rad * px_per_rad)});
  }
  if (within) {
    const double off = std::remainder(within->px - 0.5 - found.column, about_px_);
    places.push_back({found.column + off, 1.0 / (within->sigma_px * within->sigma_px)});
  }
  double sum = 0.0, weights = 0.0, rest = 0.0;
  for (const Place& place : places) {
    sum += place.weight * place.px;
    weights += place.weight;
  }
  if (!(weights > 0.0)) {
    found.astray = 1.0;
    return;
  }
  found.column = sum / weights;
  for (const Place& place : places) rest += place.weight * (place.px - found.column) * (place.px - found.column);
  const double freedom = static_cast<double>(places.size()) - 1.0;
  found.sigma_px = std::sqrt(std::max(1.0, freedom > 0.0 ? rest / freedom : 0.0) / weights);
}

}  // namespace stratalux
