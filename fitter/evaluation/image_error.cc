// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/image_error.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

constexpr int kRadius = 5;  // 11 x 11 windows
constexpr double kSigma = 1.5;

using Window = std::array<double, 2 * kRadius + 1>;

Window GaussianWindow() {
  Window g{};
  double norm = 0.0;
  for (int k = -kRadius; k <= kRadius; ++k) norm += g[k + kRadius] = std::exp(-0.5 * k * k / (kSigma * kSigma));
  for (double& v : g) v /= norm;
  return g;
}

// Weighted sums over a window of a, b, their squares and their product, and how many of its pixels are valid.
struct Moments {
  double a = 0.0, b = 0.0, aa = 0.0, bb = 0.0, ab = 0.0;
  int valid = 0;
};

// Along rows, of one channel: Gaussian windows fall apart into rows and columns.
std::vector<Moments> RowMoments(ImageView<const float> a, ImageView<const float> b, const Image<uint8_t>& valid,
                                int channel, int y, const Window& g) {
  std::vector<Moments> row(static_cast<size_t>(a.width()));
  for (int x = 0; x < a.width(); ++x) {
    if (valid(x, y) == 0) continue;
    const double p = a(x, y, channel), q = b(x, y, channel);
    for (int at = std::max(0, x - kRadius); at <= std::min(a.width() - 1, x + kRadius); ++at) {
      const double w = g[x - at + kRadius];
      Moments& m = row[at];
      m.a += w * p;
      m.b += w * q;
      m.aa += w * p * p;
      m.bb += w * q * q;
      m.ab += w * p * q;
      ++m.valid;
    }
  }
  return row;
}

// Wang et al. 2004, mean over windows wholly inside the mask; NaN when there is none.
double StructuralSimilarity(ImageView<const float> a, ImageView<const float> b, const Image<uint8_t>& valid,
                            int channel, double peak) {
  constexpr int kSide = 2 * kRadius + 1;
  const Window g = GaussianWindow();
  const double c1 = std::pow(0.01 * peak, 2), c2 = std::pow(0.03 * peak, 2);
  double sum = 0.0;
  int64_t count = 0;
  std::array<std::vector<Moments>, kSide> rows;  // the last so many, in turn
  for (int y = 0; y < a.height(); ++y) {
    rows[y % kSide] = RowMoments(a, b, valid, channel, y, g);
    if (y < kSide - 1) continue;
    for (int x = kRadius; x < a.width() - kRadius; ++x) {
      Moments m;
      for (int j = 0; j < kSide; ++j) {
        const Moments& row = rows[(y + 1 + j) % kSide][x];  // the oldest first
        m.a += g[j] * row.a;
        m.b += g[j] * row.b;
        m.aa += g[j] * row.aa;
        m.bb += g[j] * row.bb;
        m.ab += g[j] * row.ab;
        m.valid += row.valid;
      }
      if (m.valid < kSide * kSide) continue;
      const double va = m.aa - m.a * m.a, vb = m.bb - m.b * m.b, cov = m.ab - m.a * m.b;
      sum += (2 * m.a * m.b + c1) * (2 * cov + c2) / ((m.a * m.a + m.b * m.b + c1) * (va + vb + c2));
      ++count;
    }
  }
  return count > 0 ? sum / static_cast<double>(count) : std::nan("");
}

}  // namespace

ImageError CompareImages(ImageView<const float> reference, ImageView<const float> estimate,
                         ImageView<const uint8_t> mask) {
  const int channels = reference.channels();
  Image<uint8_t> valid(reference.width(), reference.height());
  std::vector<float> values;
  std::array<double, 3> error{}, power{};
  double sum_of_errors = 0.0, sum = 0.0;
  ImageError result;
  for (int y = 0; y < reference.height(); ++y)
    for (int x = 0; x < reference.width(); ++x) {
      bool finite = mask(x, y) != 0;
      for (int c = 0; c < channels; ++c)
        finite = finite && std::isfinite(reference(x, y, c)) && std::isfinite(estimate(x, y, c));
      if (!finite) continue;
      valid(x, y) = 1;
      ++result.pixels;
      for (int c = 0; c < channels; ++c) {
        const double r = reference(x, y, c), d = double(estimate(x, y, c)) - r;
        error[c] += d * d;
        power[c] += r * r;
        sum_of_errors += d;
        sum += r;
        values.push_back(reference(x, y, c));
      }
    }
  if (values.empty()) {
    const double nan = std::nan("");
    return {nan, {nan, nan, nan}, nan, nan, nan, 0};
  }
  double all_error = 0.0, all_power = 0.0;
  for (int c = 0; c < channels; ++c) {
    result.nrmse_channel[c] = power[c] > 0.0 ? std::sqrt(error[c] / power[c]) : 0.0;
    all_error += error[c];
    all_power += power[c];
  }
  result.nrmse = all_power > 0.0 ? std::sqrt(all_error / all_power) : 0.0;
  result.bias = sum > 0.0 ? sum_of_errors / sum : 0.0;
  const size_t rank = std::min(values.size() - 1, static_cast<size_t>(0.999 * static_cast<double>(values.size())));
  std::nth_element(values.begin(), values.begin() + static_cast<int64_t>(rank), values.end());
  const double peak = values[rank];
  const double mse = all_error / static_cast<double>(values.size());
  result.psnr_db = mse > 0.0 && peak <= 0.0 ? 0.0 : mse > 0.0 ? 10.0 * std::log10(peak * peak / mse) : 200.0;
  for (int c = 0; c < channels; ++c)
    result.ssim += StructuralSimilarity(reference, estimate, valid, c, peak) / channels;
  if (!std::isfinite(result.ssim)) result.ssim = 0.0;
  return result;
}

double NoiseFloor(ImageView<const float> reference, ImageView<const float> variance, ImageView<const uint8_t> mask) {
  double noise = 0.0, power = 0.0;
  for (int y = 0; y < reference.height(); ++y)
    for (int x = 0; x < reference.width(); ++x) {
      bool finite = mask(x, y) != 0;
      for (int c = 0; c < reference.channels(); ++c)
        finite = finite && std::isfinite(reference(x, y, c)) && std::isfinite(variance(x, y, c));
      if (!finite) continue;
      for (int c = 0; c < reference.channels(); ++c) {
        const double r = reference(x, y, c), v = variance(x, y, c);
        noise += v;
        power += r * r;
      }
    }
  return power > 0.0 ? std::sqrt(noise / power) : std::nan("");
}

double MaskOverlap::IntersectionOverUnion() const {
  const int64_t either = both + only_estimate + only_reference;
  return either == 0 ? std::nan("") : static_cast<double>(both) / static_cast<double>(either);
}

MaskOverlap CompareMasks(ImageView<const uint8_t> reference, ImageView<const uint8_t> estimate,
                         ImageView<const uint8_t> where) {
  SLX_CHECK(reference.size() == estimate.size() && reference.size() == where.size());
  MaskOverlap overlap;
  for (size_t i = 0; i < where.size(); ++i) {
    if (where.pixels()[i] == 0) continue;
    const bool is = reference.pixels()[i] != 0, said = estimate.pixels()[i] != 0;
    overlap.both += is && said ? 1 : 0;
    overlap.only_estimate += said && !is ? 1 : 0;
    overlap.only_reference += is && !said ? 1 : 0;
  }
  return overlap;
}

}  // namespace stratalux::fit
