// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/skin_table_check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <numbers>

namespace stratalux::rig {
namespace {

using G = SkinGrid;
constexpr double kPi = std::numbers::pi;
constexpr size_t kRings = kCheckRingsMm.size() - 1;

// Depths of the thickness nodes and halfway (in the logarithm) between them: the layers of the run.
std::array<double, 5> Borders() {
  const auto& e = G::kEpidermisMm;
  return {e[0], std::sqrt(e[0] * e[1]), e[1], std::sqrt(e[1] * e[2]), e[2]};
}

struct CheckedSkin {
  SkinParameters parameters;
  size_t borders = 0;  // layers of the run that are epidermis
  std::array<double, 3> absorption{};
};

std::vector<double> Values(std::span<const double> nodes, InterpolationAxes axes) {
  return axes == InterpolationAxes::kAngles ? std::vector<double>(nodes.begin(), nodes.end()) : MiddlesOf(nodes);
}

std::vector<CheckedSkin> Skins(int channel, InterpolationAxes axes, double scattering) {
  const auto borders = Borders();
  std::vector<CheckedSkin> skins;
  for (const double m : Values(G::kMelanin, axes))
    for (const double b : Values(G::kBlood, axes))
      for (const double e : Values(G::kEpidermisMm, axes)) {
        CheckedSkin s{{static_cast<float>(m), static_cast<float>(b), static_cast<float>(e)}, 0, {}};
        s.parameters.scattering = static_cast<float>(scattering);
        while (s.borders < borders.size() && borders[s.borders] < e * 1.001) ++s.borders;
        s.absorption = SkinAbsorption(channel, s.parameters);
        skins.push_back(s);
      }
  return skins;
}

// Sums of weights and squares: [skin][ring, then total].
struct Tally {
  std::vector<double> sum, squares;
};

Tally Photons(int channel, double theta_deg, const std::vector<CheckedSkin>& skins,
              const InterpolationCheckOptions& options) {
  const auto borders = Borders();
  const double sine = std::sin(theta_deg * kPi / 180.0), sin2_last = std::pow(std::sin(85.0 * kPi / 180.0), 2);
  MonteCarloOptions run;
  run.photons = options.photons;
  run.seed = options.seed * 7919 + channel * 101 + std::lround(10.0 * theta_deg);
  run.sin2_theta_low = run.sin2_theta_high = sine * sine;
  run.max_path_mm = 200.0;
  run.max_radius_mm = 40.0;
  run.threads = options.threads;
  Tally tally{std::vector<double>(skins.size() * (kRings + 1)), std::vector<double>(skins.size() * (kRings + 1))};
  std::mutex mutex;
  const Tissue clear = ClearSkin(channel, borders, options.scattering);
  TraceLayeredTissue(clear, run, [&](int64_t, std::span<const EscapedPhoton> list) {
    const std::lock_guard lock(mutex);
    for (const EscapedPhoton& e : list) {
      const double r = std::hypot(e.x_mm, e.y_mm);
      if (1.0 - double(e.uz) * e.uz >= sin2_last || r >= G::kMaxRadiusMm) continue;
      // Beyond the last ring a photon counts in the total only.
      const size_t found = std::upper_bound(kCheckRingsMm.begin(), kCheckRingsMm.end(), r) - kCheckRingsMm.begin() - 1;
      const size_t ring = found < kRings ? found : kRings + 1;
      for (size_t s = 0; s < skins.size(); ++s) {
        double above = 0.0, below = 0.0;
        for (size_t l = 0; l <= borders.size(); ++l) (l < skins[s].borders ? above : below) += e.path_mm[l];
        const auto& a = skins[s].absorption;
        const double w = e.weight * std::exp(-a[0] * above - a[1] * below - a[2] * e.path_mm[borders.size() + 1]);
        for (const size_t k : {ring, kRings}) {  // its ring and the total
          if (k > kRings) continue;
          tally.sum[s * (kRings + 1) + k] += w;
          tally.squares[s * (kRings + 1) + k] += w * w;
        }
      }
    }
  });
  return tally;
}

// The table's light by ring: quadrature over exit angles (even in projected solid angle), azimuth and plane.
std::array<double, kRings + 1> TableShares(const SkinTable& table, int channel, double theta_deg,
                                           const SkinParameters& skin) {
  constexpr int kThetas = 10, kAzimuths = 8, kRadii = 8, kPsis = 16;
  const double sin2_last = std::pow(std::sin(85.0 * kPi / 180.0), 2);
  std::array<double, kRings + 1> shares{};
  SkinKernel kernel;
  for (int t = 0; t < kThetas; ++t)
    for (int a = 0; a < kAzimuths; ++a) {
      const double theta = std::asin(std::sqrt((t + 0.5) / kThetas * sin2_last));
      table.Interpolate(channel, skin,
                        {static_cast<float>(theta_deg * kPi / 180.0), static_cast<float>(theta),
                         static_cast<float>((a + 0.5) * kPi / kAzimuths)},
                        kernel);
      const double projected = kPi * sin2_last / (kThetas * kAzimuths);
      shares[kRings] += kernel.Integral() * projected;
      for (size_t ring = 0; ring < kRings; ++ring) {
        const double low = std::max(kCheckRingsMm[ring], 0.002), ratio = kCheckRingsMm[ring + 1] / low;
        for (int i = 0; i < kRadii; ++i) {
          const double inner = i == 0 ? kCheckRingsMm[ring] : low * std::pow(ratio, double(i) / kRadii);
          const double outer = low * std::pow(ratio, (i + 1.0) / kRadii);
          const double r = inner > 0.0 ? std::sqrt(inner * outer) : 0.7 * outer;
          const double area = kPi * (outer * outer - inner * inner) / kPsis;
          for (int k = 0; k < kPsis; ++k) {
            const double psi = 2.0 * kPi * (k + 0.5) / kPsis;
            shares[ring] +=
                projected * area * kernel(static_cast<float>(r * std::cos(psi)), static_cast<float>(r * std::sin(psi)));
          }
        }
      }
    }
  return shares;
}

}  // namespace

std::vector<double> MiddlesOf(std::span<const double> nodes) {
  std::vector<double> middles;
  for (size_t i = 0; i + 1 < nodes.size(); ++i) middles.push_back(std::sqrt(nodes[i] * nodes[i + 1]));
  return middles;
}

std::vector<InterpolationSample> CheckInterpolation(const SkinTable& table, const InterpolationCheckOptions& options) {
  std::vector<InterpolationSample> samples;
  for (const int channel : options.channels) {
    const std::vector<CheckedSkin> skins = Skins(channel, options.axes, options.scattering);
    for (const double theta : options.theta_in_deg) {
      const Tally tally = Photons(channel, theta, skins, options);
      for (size_t s = 0; s < skins.size(); ++s) {
        InterpolationSample sample{channel, theta, skins[s].parameters, {}, {}};
        const auto shares = TableShares(table, channel, theta, skins[s].parameters);
        const double scale = 1.0 / static_cast<double>(options.photons);
        for (size_t k = 0; k <= kRings; ++k) {
          const size_t at = s * (kRings + 1) + k;
          const InterpolationSample::Share share{shares[k], tally.sum[at] * scale,
                                                 std::sqrt(tally.squares[at]) * scale};
          if (k < kRings) {
            sample.rings.push_back(share);
          } else {
            sample.total = share;
          }
        }
        samples.push_back(sample);
      }
    }
  }
  return samples;
}

InterpolationSummary Summarise(const std::vector<InterpolationSample>& samples, int channel, int ring,
                               double most_melanin) {
  InterpolationSummary summary;
  double squares = 0.0;
  for (const InterpolationSample& s : samples) {
    if (s.channel != channel || s.skin.melanin > most_melanin) continue;
    const InterpolationSample::Share& share = ring < 0 ? s.total : s.rings[static_cast<size_t>(ring)];
    const double noise = share.standard_error / share.monte_carlo;
    if (!(noise < 0.02)) continue;
    ++summary.samples;
    const double d = share.Deviation();
    if (!(std::abs(d) <= std::abs(summary.largest))) summary.largest = d;  // also what is no number
    squares += d * d - noise * noise;
  }
  if (summary.samples > 0) summary.rms = std::sqrt(std::max(0.0, squares / summary.samples));
  return summary;
}

}  // namespace stratalux::rig
