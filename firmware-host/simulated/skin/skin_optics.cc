// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/skin_optics.h"

#include <cmath>

namespace stratalux::rig {
namespace {

constexpr double kOxygenSaturation = 0.75;
// Molar extinction of haemoglobin, 1 / (cm M): 630 and 465 nm from the table, 532 nm between 530 and 535 nm.
constexpr std::array<double, 3> kOxy = {610.0, 39960.0 + 0.4 * (48335.0 - 39960.0), 38440.0};
constexpr std::array<double, 3> kDeoxy = {5149.0, 39040.0 + 0.4 * (42840.0 - 39040.0), 18700.0};

double BaselinePerCm(double nm) { return 0.244 + 85.3 * std::exp(-(nm - 154.0) / 66.2); }
double MelanosomePerCm(double nm) { return 6.6e11 * std::pow(nm, -3.33); }
double BloodPerCm(int channel) {
  const double extinction = kOxygenSaturation * kOxy[channel] + (1.0 - kOxygenSaturation) * kDeoxy[channel];
  return 2.303 * 150.0 / 64500.0 * extinction;
}

}  // namespace

std::array<double, 3> SkinAbsorption(int channel, const SkinParameters& parameters) {
  const double nm = kSkinWavelengthNm[channel];
  const double baseline = BaselinePerCm(nm);
  const double m = parameters.melanin, b = parameters.blood;
  return {0.1 * (m * MelanosomePerCm(nm) + (1.0 - m) * baseline),
          0.1 * (b * BloodPerCm(channel) + (1.0 - b) * baseline), parameters.subcutis_absorption * (0.1 * baseline)};
}

Tissue ClearSkin(int channel, std::span<const double> borders_mm, double scattering, double skin_mm) {
  const double nm = kSkinWavelengthNm[channel];
  const double g = 0.62 + 0.29e-3 * nm;
  const double skin = scattering * 0.1 * 46.0 * std::pow(nm / 500.0, -1.421) / (1.0 - g);
  const double subcutis = 0.1 * 1.05e3 * std::pow(nm, -0.68) / (1.0 - g);
  Tissue tissue;
  double top = 0.0;
  for (const double border : borders_mm) {
    tissue.layers.push_back({kSkinIndex, 0.0, skin, g, border - top});
    top = border;
  }
  tissue.layers.push_back({kSkinIndex, 0.0, skin, g, skin_mm - top});
  tissue.layers.push_back({kSkinIndex, 0.0, subcutis, g, std::numeric_limits<double>::infinity()});
  return tissue;
}

Tissue AbsorbingSkin(int channel, const SkinParameters& parameters) {
  const std::array<double, 1> border = {parameters.epidermis_mm};
  Tissue tissue = ClearSkin(channel, border, parameters.scattering, parameters.skin_mm);
  const auto absorption = SkinAbsorption(channel, parameters);
  for (size_t l = 0; l < tissue.layers.size(); ++l) tissue.layers[l].mu_a_per_mm = absorption[l];
  return tissue;
}

Tissue WaxSlab(int channel) {
  constexpr std::array<double, kSkinChannels> kReducedScattering = {1.1, 1.3, 1.5}, kAbsorption = {0.002, 0.004, 0.007};
  constexpr double kG = 0.7;
  Tissue slab;
  slab.layers = {{kSkinIndex, kAbsorption[channel], kReducedScattering[channel] / (1.0 - kG), kG, kWaxSlabMm}};
  return slab;
}

}  // namespace stratalux::rig
