// SPDX-License-Identifier: Apache-2.0
// People: the skin of person N, drawn from a joint distribution of melanin, blood, scattering and epidermal thickness
// whose reflectance is that of people measured (docs/simulated-rig.md, "People").
//
// Measured:
// - Reflectance at 465, 532, 630 nm of the inside of 100 forearms: Cooksey, Allen, Tsai, J. Res. NIST 122:26 (2017).
// - Reduced scattering in vivo: median 3.22 per mm at 475 nm of 3,809 people (Jonasson et al., J. Biomed. Opt. 28,
//   115001, 2023), 0.65 of the formula of tissue samples (skin_optics.h); 3.16 +- 0.72 (mean, SD) of 1,734 of them
//   (J. Biomed. Opt. 23, 121608, 2018): an SD of 0.23 of the mean.
// - Cellular epidermis of forearms 0.0566 +- 0.0115 mm, of 71 people, not correlated with skin type (Sandby-Moller et
//   al., Acta Derm. Venereol. 83 (2003) 410). The horny layer's 0.018 mm hold little melanin and are left out.
// `stratalux-skin-table population --fit --people 400` finds those of the numbers below that are marked as fitted.
// Oxygenation is one for all (the table's): what differs between people is in the blood's amount.
#pragma once

#include <array>
#include <cstdint>

#include "firmware-host/simulated/skin/skin_optics.h"

namespace stratalux::rig {

inline constexpr int kMostPeople = 1000000;  // person 0 .. kMostPeople - 1
inline constexpr uint64_t kPeopleSeed = 1;   // of a scene's `person`

// What people's scattering is kept within: the shipped table's nodes.
inline constexpr std::array<double, 2> kPeopleScattering = {0.5, 1.0};

// Lightness, blood, scattering's own part and thickness are standard normal; everything is kept within the skin table's
// nodes.
struct Population {
  // melanin = the table's least + span / (1 + exp(slope (lightness + shift)))
  double melanin_span = 0.157;   // fitted
  double melanin_shift = 1.829;  // fitted
  double melanin_slope = 4.0;    // assumed: a steeper one leaves nobody between light and dark
  // Scattering and blood, thickness alike: median times exp(spread * normal).
  double scattering_median = 0.65;       // measured
  double scattering_spread = 0.29;       // fitted: to the SD that is left within the table's nodes
  double scattering_by_lightness = 0.7;  // correlation of its normal with lightness; assumed
  double blood_median = 0.0068;          // fitted
  double blood_spread = 0.25;            // fitted
  double epidermis_median_mm = 0.0566;   // measured
  double epidermis_spread = 0.2;         // measured
};

// Precondition: 0 <= person < kMostPeople. Follows from these arguments alone. The normals are rotations by irrational
// steps (van der Corput's sort of sequence), so that any run of some dozen people spans light to dark as evenly as it
// can; `seed` says where each begins.
[[nodiscard]] SkinParameters Person(int person, uint64_t seed = kPeopleSeed, const Population& population = {});

}  // namespace stratalux::rig
