// SPDX-License-Identifier: Apache-2.0
// Optical properties of the simulated skin: epidermis (melanin), dermis (blood), subcutis, at 630 / 532 / 465 nm.
//
// Sources: absorption of the skin baseline and of melanosomes, and of whole blood at 150 g/l: Jacques, "Skin optics"
// (OMLC News, Jan 1998); haemoglobin extinction: Prahl's compilation; reduced scattering of skin 46 (nm/500)^-1.421 /
// cm: Jacques, Phys. Med. Biol. 58 (2013) R37, Table 2; asymmetry g = 0.62 + 0.29e-3 nm: van Gemert et al., IEEE TBME
// 36 (1989); scattering of subcutis 1.05e3 nm^-0.68 / cm: Bashkatov 2005.
#pragma once

#include <array>

#include "shared/transport/layered_monte_carlo.h"

namespace stratalux::rig {

inline constexpr int kSkinChannels = 3;  // R, G, B
inline constexpr std::array<double, kSkinChannels> kSkinWavelengthNm = {630.0, 532.0, 465.0};
inline constexpr double kSkinIndex = 1.4;
inline constexpr double kEpidermisMm = 0.08;
inline constexpr double kDermisMm = 1.9;

struct SkinParameters {
  float melanin = 0.03F;  // volume fraction of melanosomes in the epidermis
  float blood = 0.004F;   // volume fraction of blood in the dermis
};

// Absorption per mm of epidermis, dermis, subcutis.
[[nodiscard]] std::array<double, 3> SkinAbsorption(int channel, const SkinParameters& parameters);
// The three layers without absorption, for path-length re-weighting.
[[nodiscard]] Tissue ClearSkin(int channel);
// The same with absorption.
[[nodiscard]] Tissue AbsorbingSkin(int channel, const SkinParameters& parameters);

}  // namespace stratalux::rig
