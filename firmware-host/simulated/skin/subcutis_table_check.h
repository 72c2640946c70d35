// SPDX-License-Identifier: Apache-2.0
// How far the table of other subcutis is from fresh Monte Carlo: at its nodes, and half-way between all of them.
#pragma once

#include <cstdint>
#include <vector>

#include "firmware-host/simulated/skin/skin_table_check.h"
#include "firmware-host/simulated/skin/subcutis_table.h"

namespace stratalux::rig {

enum class SubcutisPlaces { kNodes, kBetween };

struct SubcutisCheckOptions {
  int64_t photons = 100000;  // a channel, incidence and depth
  uint64_t seed = 1001;
  int threads = 0;
  std::vector<double> theta_in_deg = {4.0, 35.0, 62.0};
  std::vector<int> channels = {0, 1, 2};
  // kNodes: skin and every kind of subcutis at nodes. kBetween: melanin, blood, thickness, scattering, depth and
  // absorption half-way between them (of the last two also each alone).
  SubcutisPlaces places = SubcutisPlaces::kNodes;
};

// Samples of each skin with each subcutis. Their `table`: light of photons in the skin table's subcutis, times the
// ratio that the table says; `standard_error`: of how the two compare. Both know the same light where it stayed above
// the least depth. Scattering is the table's second node of it, or lies half-way to it from the first; precondition: it
// has two.
[[nodiscard]] std::vector<InterpolationSample> CheckSubcutis(const SubcutisTable& table,
                                                             const SubcutisCheckOptions& options);

}  // namespace stratalux::rig
