// SPDX-License-Identifier: Apache-2.0
// Optical properties of the simulated skin: epidermis (melanin), dermis (blood), subcutis, at 630 / 532 / 465 nm.
//
// Sources: absorption of the skin baseline and of melanosomes, and of whole blood at 150 g/l: Jacques, "Skin optics"
// (OMLC News, Jan 1998); haemoglobin extinction: Prahl's compilation; reduced scattering of skin 46 (nm/500)^-1.421 /
// cm: Jacques, Phys. Med. Biol. 58 (2013) R37, Table 2; asymmetry g = 0.62 + 0.29e-3 nm: van Gemert et al., IEEE TBME
// 36 (1989); living skin's scattering beside the samples': Jonasson et al., J. Biomed. Opt. 2023; scattering of
// subcutis 1.05e3 nm^-0.68 / cm: Bashkatov 2005. Subcutis absorbs as the skin baseline does, times the factor below.
#pragma once

#include <array>
#include <span>

#include "shared/transport/layered_monte_carlo.h"

namespace stratalux::rig {

inline constexpr int kSkinChannels = 3;  // R, G, B
inline constexpr std::array<double, kSkinChannels> kSkinWavelengthNm = {630.0, 532.0, 465.0};
inline constexpr double kSkinIndex = 1.4;
inline constexpr double kEpidermisMm = 0.08;  // where nothing else is said
inline constexpr double kSkinMm = 1.98;       // epidermis and dermis, alike: a thicker epidermis leaves less dermis

struct SkinParameters {
  float melanin = 0.03F;  // volume fraction of melanosomes in the epidermis
  float blood = 0.004F;   // volume fraction of blood in the dermis
  float epidermis_mm = static_cast<float>(kEpidermisMm);
  float scattering = 1.0F;  // of epidermis and dermis, over that of tissue samples (living skin: 0.6 to 0.7)
  // Of the subcutis, over the skin baseline's (0.03 / mm at 630 nm; adipose tissue in vitro: near 4).
  float subcutis_absorption = 1.0F;
  double skin_mm = kSkinMm;  // where the subcutis begins

  // As the skin table has it.
  [[nodiscard]] bool UsualSubcutis() const { return subcutis_absorption == 1.0F && skin_mm == kSkinMm; }
};

// A slab of translucent wax, the test object without layers: reduced scattering 1.1 / 1.3 / 1.5 per mm, absorption
// 0.002 / 0.004 / 0.007 per mm (chosen between candle wax and marble; no measured piece), g 0.7, the index of skin.
inline constexpr double kWaxSlabMm = 20.0;
[[nodiscard]] Tissue WaxSlab(int channel);

// Absorption per mm of epidermis, dermis, subcutis.
[[nodiscard]] std::array<double, 3> SkinAbsorption(int channel, const SkinParameters& parameters);
// Skin and subcutis without absorption, for path-length re-weighting. Epidermis and dermis scatter and refract alike
// (one formula serves both), so the border between them is a border of absorption only: `borders_mm` (rising depths
// within the skin) split the skin into layers whose paths can be given to either. `scattering`: as of SkinParameters.
// `skin_mm`: where the subcutis begins.
[[nodiscard]] Tissue ClearSkin(int channel, std::span<const double> borders_mm, double scattering = 1.0,
                               double skin_mm = kSkinMm);
// Epidermis, dermis and subcutis with absorption. Precondition: 0 < epidermis_mm < skin_mm.
[[nodiscard]] Tissue AbsorbingSkin(int channel, const SkinParameters& parameters);

}  // namespace stratalux::rig
