// SPDX-License-Identifier: Apache-2.0
// How far the table is from fresh Monte Carlo between its nodes: incidence angles, melanin, blood and thickness in the
// middle of their intervals, where interpolation is worst.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {

// Light leaving in all directions, by distance from the entry.
inline constexpr std::array<double, 6> kCheckRingsMm = {0.0, 0.1, 0.3, 1.0, 3.0, 10.0};

// One skin at one incidence, one channel: shares of the incident light.
struct InterpolationSample {
  int channel = 0;
  double theta_in_deg = 0.0;
  SkinParameters skin;
  struct Share {
    double table = 0.0, monte_carlo = 0.0, standard_error = 0.0;
    [[nodiscard]] double Deviation() const { return table / monte_carlo - 1.0; }
  };
  Share total;               // to 30 mm, 85 degrees of exit
  std::vector<Share> rings;  // between kCheckRingsMm
};

enum class InterpolationAxes { kAngles, kAnglesAndOptics };

struct InterpolationCheckOptions {
  int64_t photons = 200000;  // a channel and incidence
  uint64_t seed = 11;
  int threads = 0;
  std::vector<double> theta_in_deg = {4.0, 20.0, 35.0, 50.0, 62.0, 74.0};
  std::vector<int> channels = {0, 1, 2};
  double scattering = 1.0;
  // kAngles: optics at nodes; only what the angles' interpolation adds.
  InterpolationAxes axes = InterpolationAxes::kAnglesAndOptics;
};
[[nodiscard]] std::vector<InterpolationSample> CheckInterpolation(const SkinTable& table,
                                                                  const InterpolationCheckOptions& options);

// Largest and root mean square deviation (the photons' own error taken out of the latter) of samples whose Monte Carlo
// is better than 2 %.
struct InterpolationSummary {
  int samples = 0;
  double largest = 0.0, rms = 0.0;
};
// `ring` < 0: the total. Skins with at most `most_melanin`.
[[nodiscard]] InterpolationSummary Summarise(const std::vector<InterpolationSample>& samples, int channel, int ring,
                                             double most_melanin);

// Half-way between nodes of the optics, on the scale of their logarithm.
[[nodiscard]] std::vector<double> MiddlesOf(std::span<const double> nodes);

}  // namespace stratalux::rig
