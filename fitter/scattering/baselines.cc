// SPDX-License-Identifier: Apache-2.0
#include "fitter/scattering/baselines.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "fitter/mixture/line_response.h"

namespace stratalux::fit {
namespace {

constexpr double kPi = std::numbers::pi;

// Mean parameters of one channel; sigma and depth are weighted by nothing, as the paper's mean is (MeanLayers weighs
// them by light).
LayerSet PlainMean(const MixtureMap& map, int channel, std::span<const uint8_t> apart) {
  LayerSet mean;
  for (auto* v : {&mean.weight, &mean.depth_mm, &mean.sigma_mm}) v->assign(map.layers, 0.0);
  int64_t count = 0;
  for (int64_t i = channel; i < map.profiles(); i += map.channels) {
    if (!map.Fitted(i) || IsApart(apart, i)) continue;
    ++count;
    for (int l = 0; l < map.layers; ++l) {
      mean.weight[l] += map.weight[i * map.layers + l];
      mean.depth_mm[l] += map.depth_mm[i * map.layers + l];
      mean.sigma_mm[l] += map.sigma_mm[i * map.layers + l];
    }
  }
  for (auto* v : {&mean.weight, &mean.depth_mm, &mean.sigma_mm})
    for (double& x : *v) x /= static_cast<double>(std::max<int64_t>(count, 1));
  return mean;
}

double TotalWeight(const MixtureMap& map, int64_t i) {
  double sum = 0.0;
  for (int l = 0; l < map.layers; ++l) sum += map.weight[i * map.layers + l];
  return sum;
}

MixtureMap WithMeanLayers(const MixtureMap& map, std::span<const uint8_t> apart, bool keep_albedo) {
  MixtureMap out = map;
  for (int c = 0; c < map.channels; ++c) {
    const LayerSet mean = PlainMean(map, c, apart);
    double total = 0.0;
    for (double w : mean.weight) total += w;
    for (int64_t i = c; i < map.profiles(); i += map.channels) {
      if (!map.Fitted(i)) continue;
      const double scale = keep_albedo && total > 0.0 ? TotalWeight(map, i) / total : 1.0;
      for (int l = 0; l < map.layers; ++l) {
        out.weight[i * map.layers + l] = static_cast<float>(mean.weight[l] * scale);
        out.depth_mm[i * map.layers + l] = static_cast<float>(mean.depth_mm[l]);
        out.sigma_mm[i * map.layers + l] = static_cast<float>(mean.sigma_mm[l]);
      }
    }
  }
  return out;
}

// The two sources of a dipole, with what every distance needs of them.
class DipoleSources {
 public:
  explicit DipoleSources(const Dipole& dipole) {
    const double st = dipole.sigma_s_prime_per_mm + dipole.sigma_a_per_mm, eta = dipole.eta;
    const double fdr = -1.440 / (eta * eta) + 0.710 / eta + 0.668 + 0.0636 * eta;
    transport_ = std::sqrt(3.0 * dipole.sigma_a_per_mm * st);
    scale_ = dipole.sigma_s_prime_per_mm / st / (4.0 * kPi);
    real_mm_ = 1.0 / st;
    virtual_mm_ = real_mm_ * (1.0 + 4.0 / 3.0 * (1.0 + fdr) / (1.0 - fdr));
    stretch_mm_ = 0.5 / st;
  }

  [[nodiscard]] double StretchMm() const { return stretch_mm_; }
  // R_d at the squared distance r^2.
  [[nodiscard]] double At(double r2) const { return scale_ * (Source(r2, real_mm_) + Source(r2, virtual_mm_)); }

  // Integral along a line at x; y = a sinh(t) stretches the quadrature over the tail.
  [[nodiscard]] double OfLine(double x_mm) const {
    static const std::array<Node, kSteps> nodes = [] {
      std::array<Node, kSteps> made;
      for (int k = 0; k < kSteps; ++k) {
        const double t = (k + 0.5) * kEnd / kSteps;
        made[k] = {std::sinh(t) * std::sinh(t), std::cosh(t)};
      }
      return made;
    }();
    double sum = 0.0;
    for (const Node& node : nodes) sum += At(x_mm * x_mm + stretch_mm_ * stretch_mm_ * node.sinh2) * node.cosh;
    return 2.0 * sum * stretch_mm_ * kEnd / kSteps;
  }

 private:
  struct Node {
    double sinh2 = 0.0, cosh = 0.0;
  };
  static constexpr int kSteps = 48;
  static constexpr double kEnd = 6.0;

  [[nodiscard]] double Source(double r2, double z) const {
    const double d2 = r2 + z * z, d = std::sqrt(d2);
    return z * (transport_ * d + 1.0) * std::exp(-transport_ * d) / (d2 * d);
  }

  double transport_ = 0.0, scale_ = 0.0, real_mm_ = 0.0, virtual_mm_ = 0.0, stretch_mm_ = 0.0;
};

// A dipole's line spread for many x: four-point interpolation between nodes at x = a sinh(k step). Error below 1e-7 of
// its peak, where every trial of the search asks for some three thousand values.
class LineSpreadTable {
 public:
  LineSpreadTable(const Dipole& dipole, double most_mm) : stretch_mm_(DipoleSources(dipole).StretchMm()) {
    const DipoleSources sources(dipole);
    const int last = static_cast<int>(std::asinh(most_mm / stretch_mm_) / kStep) + 3;
    for (int k = -1; k <= last; ++k) values_.push_back(sources.OfLine(stretch_mm_ * std::sinh(k * kStep)));
  }

  [[nodiscard]] double At(double x_mm) const {
    const double place = std::asinh(std::abs(x_mm) / stretch_mm_) / kStep;
    const int k = std::min(static_cast<int>(place), static_cast<int>(values_.size()) - 4);
    const double t = place - k;
    const double* v = &values_[k];  // of nodes k - 1 .. k + 2
    return -t * (t - 1) * (t - 2) / 6 * v[0] + (t + 1) * (t - 1) * (t - 2) / 2 * v[1] -
           (t + 1) * t * (t - 2) / 2 * v[2] + (t + 1) * t * (t - 1) / 6 * v[3];
  }

 private:
  static constexpr double kStep = 0.02;
  double stretch_mm_ = 1.0;
  std::vector<double> values_;
};

// Mean profile of a channel over the lights in bins of u.
struct MeanProfile {
  double step = 0.3;
  std::vector<double> u, y, count;  // mean offset and radiance of each bin
  double line_width = 0.58, blur = 0.2;
};

MeanProfile MeanProfileOf(std::span<const SrdBatch* const> lights, int channel, int channels) {
  constexpr int kHalf = 40;
  MeanProfile mean;
  mean.y.assign(2 * kHalf + 1, 0.0);
  mean.u = mean.count = mean.y;
  double width = 0.0, blur = 0.0, n = 0.0;
  for (const SrdBatch* b : lights)
    for (int64_t i = channel; i < b->profiles(); i += channels) {
      if (!b->Shares(i)) continue;
      width += b->line_width_mm[i];
      blur += std::sqrt(b->blur_mm[i] * b->blur_mm[i] + SampleSitesOf(*b, i).VarianceMm2());
      n += 1.0;
      const double step = b->step_mm[i], period = step * b->samples,
                   first = std::remainder(double(b->first_u_mm[i]), period);
      const auto y = b->Samples(i);
      for (int k = 0; k < b->samples; ++k) {
        const double from_line = first + k * step, u = from_line > 0.5 * period ? from_line - period : from_line;
        const long bin = std::lround(u / mean.step) + kHalf;
        if (bin < 0 || bin > 2 * kHalf) continue;
        mean.u[bin] += u;
        mean.y[bin] += y[k];
        mean.count[bin] += 1.0;
      }
    }
  for (size_t k = 0; k < mean.y.size(); ++k) {
    mean.u[k] /= std::max(mean.count[k], 1.0);
    mean.y[k] /= std::max(mean.count[k], 1.0);
  }
  if (n > 0.0) {
    mean.line_width = width / n;
    mean.blur = blur / n;
  }
  return mean;
}

// Line spread through the line's box and blur, by quadrature.
double Measured(const LineSpreadTable& spread, double u, double width, double blur) {
  double sum = 0.0, weights = 0.0;
  for (int i = -3; i <= 3; ++i) {
    const double g = std::exp(-0.5 * i * i * 0.64);
    for (int k = 0; k < 5; ++k) {
      sum += g * spread.At(u + 0.8 * i * blur + width * ((k + 0.5) / 5 - 0.5));
      weights += g;
    }
  }
  return sum / weights * width;
}

// Share of a point's blurred light that lies on the line: what a surface of reflectance 1 gives.
double SurfaceLine(double u, double width, double blur) {
  const double scale = 1.0 / (std::numbers::sqrt2 * blur);
  return 0.5 * (std::erf((u + 0.5 * width) * scale) - std::erf((u - 0.5 * width) * scale));
}

double Misfit(const Dipole& dipole, const MeanProfile& mean) {
  double most_mm = 0.0, error = 0.0;
  for (const double u : mean.u) most_mm = std::max(most_mm, std::abs(u));
  const LineSpreadTable spread(dipole, most_mm + 2.4 * mean.blur + 0.5 * mean.line_width);
  for (size_t k = 0; k < mean.y.size(); ++k) {
    if (!(mean.count[k] > 0.0)) continue;
    const double d = Measured(spread, mean.u[k], mean.line_width, mean.blur) - mean.y[k];
    error += d * d;
  }
  return error;
}

}  // namespace

MixtureMap Homogeneous(const MixtureMap& map, std::span<const uint8_t> apart) {
  return WithMeanLayers(map, apart, false);
}
MixtureMap HomogeneousLocalAlbedo(const MixtureMap& map, std::span<const uint8_t> apart) {
  return WithMeanLayers(map, apart, true);
}

double Dipole::RadialReflectance(double r_mm) const { return DipoleSources(*this).At(r_mm * r_mm); }

double Dipole::LineSpread(double x_mm) const { return DipoleSources(*this).OfLine(x_mm); }

double Dipole::TotalReflectance() const {
  const double alpha = sigma_s_prime_per_mm / (sigma_s_prime_per_mm + sigma_a_per_mm);
  const double fdr = -1.440 / (eta * eta) + 0.710 / eta + 0.668 + 0.0636 * eta;
  const double a = (1.0 + fdr) / (1.0 - fdr), root = std::sqrt(3.0 * (1.0 - alpha));
  return alpha / 2.0 * (1.0 + std::exp(-4.0 / 3.0 * a * root)) * std::exp(-root);
}

double MeanSurfaceReflectance(const MixtureMap& map, int channel, std::span<const uint8_t> apart) {
  double sum = 0.0, count = 0.0;
  for (int64_t i = channel; i < map.profiles(); i += map.channels) {
    if (!map.Fitted(i) || IsApart(apart, i)) continue;
    sum += MeanOfLights(map, i).surface;
    count += 1.0;
  }
  return count > 0.0 ? sum / count : 0.0;
}

Dipole FitDipole(std::span<const SrdBatch* const> lights, int channel, int channels, double eta, double surface) {
  MeanProfile mean = MeanProfileOf(lights, channel, channels);
  for (size_t k = 0; k < mean.y.size(); ++k) mean.y[k] -= surface * SurfaceLine(mean.u[k], mean.line_width, mean.blur);
  // Pattern search in the logarithms of both coefficients.
  double log_s = std::log(1.5), log_a = std::log(0.05), step = 0.8;
  auto dipole = [&](double s, double a) { return Dipole{std::exp(s), std::exp(a), eta}; };
  double best = Misfit(dipole(log_s, log_a), mean);
  while (step > 0.01) {
    bool improved = false;
    for (const auto& [ds, da] : {std::pair(step, 0.0), {-step, 0.0}, {0.0, step}, {0.0, -step}}) {
      const double s = std::clamp(log_s + ds, -4.0, 4.0), a = std::clamp(log_a + da, -8.0, 4.0);
      const double error = Misfit(dipole(s, a), mean);
      if (error < best) {
        best = error;
        log_s = s;
        log_a = a;
        improved = true;
      }
    }
    if (!improved) step *= 0.5;
  }
  return dipole(log_s, log_a);
}

Result<MixtureMap> DipoleMap(const MixtureMap& map, std::span<const Dipole> dipoles) {
  constexpr float kStep = 0.1F;
  SrdBatch b;  // one profile a colour
  b.samples = 400;
  b.wrapped = false;
  b.sample_box = 1.0F;
  const size_t colours = dipoles.size();
  b.step_mm.assign(colours, kStep);
  b.first_u_mm.assign(colours, -0.5F * kStep * 399);
  b.line_width_mm.assign(colours, 0.05F);
  b.valid.assign(colours, 1);
  for (auto* v : {&b.blur_mm, &b.slope_in, &b.slope_out, &b.slope_in_across, &b.slope_out_across})
    v->assign(colours, 0.0F);
  b.noise_floor.assign(colours, 1e-12F);
  b.noise_slope.assign(colours, 1e-4F);
  b.cos_in.assign(colours, 1.0F);
  b.cos_out = b.cos_in;
  for (const Dipole& dipole : dipoles)
    for (int k = 0; k < b.samples; ++k) {
      const double y = 0.05 * dipole.LineSpread(double(b.first_u_mm[0]) + k * double(kStep));
      b.y.push_back(static_cast<float>(y));
    }
  EmOptions options;
  options.layers = map.layers;
  options.direction_blind = true;
  options.surface_term = options.background_term = false;
  options.max_iterations = 400;
  const SrdBatch* light = &b;
  SLX_ASSIGN_OR_RETURN(const MixtureMap fitted,
                       FitMixture(std::span(&light, 1), {0}, 1, 1, static_cast<int>(colours), options));
  MixtureMap out = map;
  for (int64_t i = 0; i < map.profiles(); ++i) {
    if (!map.Fitted(i)) continue;
    const int64_t colour = i % map.channels;
    const double total = TotalWeight(fitted, colour), scale = total > 0.0 ? TotalWeight(map, i) / total : 0.0;
    for (int l = 0; l < map.layers; ++l) {
      const int64_t to = i * map.layers + l, from = colour * map.layers + l;
      out.weight[to] = static_cast<float>(fitted.weight[from] * scale);
      out.depth_mm[to] = 0.0F;
      out.sigma_mm[to] = fitted.sigma_mm[from];
    }
  }
  return out;
}

}  // namespace stratalux::fit
