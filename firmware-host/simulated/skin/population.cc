// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/population.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "firmware-host/simulated/skin/skin_table.h"
#include "shared/base/check.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

// Rotations with small partial quotients, of four fields: golden section, square roots of 2, 3 and 13.
constexpr std::array<double, 4> kRotations = {0.6180339887498949, 0.41421356237309515, 0.7320508075688772,
                                              0.30277563773199456};

double NormalQuantile(double share) {
  double low = -9.0, high = 9.0;
  for (int halving = 0; halving < 56; ++halving) {
    const double middle = 0.5 * (low + high);
    (0.5 * std::erfc(-middle / std::sqrt(2.0)) < share ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

// The `which`-th standard normal of a person.
double NormalOf(int person, uint64_t seed, size_t which) {
  const double turns = Random(seed, which).Uniform() + kRotations[which] * person;
  return NormalQuantile(turns - std::floor(turns));
}

template <typename Nodes>
float WithinNodes(double value, const Nodes& nodes) {
  return static_cast<float>(std::clamp(value, nodes.front(), nodes.back()));
}

}  // namespace

SkinParameters Person(int person, uint64_t seed, const Population& population) {
  SLX_CHECK(person >= 0 && person < kMostPeople);
  const Population& p = population;
  const double lightness = NormalOf(person, seed, 0), tie = p.scattering_by_lightness;
  const double scattering = tie * lightness + std::sqrt(1.0 - tie * tie) * NormalOf(person, seed, 1);
  const auto vary = [](double median, double spread, double normal) { return median * std::exp(spread * normal); };
  SkinParameters skin;
  skin.melanin = WithinNodes(
      SkinGrid::kMelanin.front() + p.melanin_span / (1.0 + std::exp(p.melanin_slope * (lightness + p.melanin_shift))),
      SkinGrid::kMelanin);
  skin.blood = WithinNodes(vary(p.blood_median, p.blood_spread, NormalOf(person, seed, 2)), SkinGrid::kBlood);
  skin.epidermis_mm =
      WithinNodes(vary(p.epidermis_median_mm, p.epidermis_spread, NormalOf(person, seed, 3)), SkinGrid::kEpidermisMm);
  skin.scattering = WithinNodes(vary(p.scattering_median, p.scattering_spread, scattering), kPeopleScattering);
  return skin;
}

}  // namespace stratalux::rig
