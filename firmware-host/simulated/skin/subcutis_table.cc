// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/subcutis_table.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <nlohmann/json.hpp>

#include "shared/base/formatted.h"
#include "shared/base/program_data.h"

namespace stratalux::rig {

using Subcutis = SubcutisGrid;

double SubcutisGrid::CosinesOf(double sin2_theta_in, double sin2_theta_out) {
  constexpr double kIndex2 = kSkinIndex * kSkinIndex;
  return std::sqrt(1.0 - sin2_theta_in / kIndex2) + std::sqrt(1.0 - sin2_theta_out / kIndex2) - kMeanCosines;
}

SkinParameters SubcutisGrid::WithKind(int kind, SkinParameters skin) {
  const int of_all = kind + 1, absorptions = static_cast<int>(kAbsorption.size());
  skin.skin_mm = kSkinMm[of_all / absorptions];
  skin.subcutis_absorption = static_cast<float>(kAbsorption[of_all % absorptions]);
  return skin;
}

std::array<float, SubcutisGrid::kKinds> SubcutisGrid::KindsAround(const SkinParameters& skin) {
  constexpr double kPower = 0.15;
  const double absorption = std::clamp<double>(skin.subcutis_absorption, kAbsorption[0], kAbsorption[1]);
  const double low = std::pow(kAbsorption[0], kPower), high = std::pow(kAbsorption[1], kPower);
  const double more = (std::pow(absorption, kPower) - low) / (high - low);
  const double at = std::clamp(skin.skin_mm, kSkinMm.back(), kSkinMm.front());
  std::array<float, kKinds> weights{};
  for (size_t d = 0; d < kSkinMm.size(); ++d) {
    double depth = 1.0;  // Lagrange's
    for (size_t other = 0; other < kSkinMm.size(); ++other)
      if (other != d) depth *= (at - kSkinMm[other]) / (kSkinMm[d] - kSkinMm[other]);
    if (d > 0) weights[2 * d - 1] = static_cast<float>(depth * (1.0 - more));
    weights[2 * d] = static_cast<float>(depth * more);
  }
  return weights;
}

std::string SubcutisTable::DefaultPath() { return FirstThatIsThere(SkinTable::DefaultPlaces(kFile)); }

Status SubcutisTable::Check(const SkinParameters& skin) const {
  constexpr double kRounding = 1e-6;
  const auto outside = [](double value, double least, double most) {
    return !(value >= least - kRounding && value <= most + kRounding);
  };
  const auto refused = [](const char* what, double value, double least, double most) {
    return Status::Usage(Formatted("%s = %g: the table of other subcutis knows %g .. %g", what, value, least, most));
  };
  const auto& a = Subcutis::kAbsorption;
  if (outside(skin.subcutis_absorption, a.front(), a.back()))
    return refused("subcutis_absorption", skin.subcutis_absorption, a.front(), a.back());
  const auto& depth = Subcutis::kSkinMm;
  if (outside(skin.skin_mm, depth.back(), depth.front()))
    return refused("skin_mm", skin.skin_mm, depth.back(), depth.front());
  if (outside(skin.scattering, scatterings().front(), scatterings().back()))
    return refused("scattering", skin.scattering, scatterings().front(), scatterings().back());
  return Status::Ok();
}

SubcutisTable::Rings SubcutisTable::LogRatio(int channel, const SkinParameters& skin,
                                             const SkinDirections& directions) const {
  const auto sin2 = [](float theta_rad) {
    return std::pow(std::sin(std::clamp<double>(theta_rad, 0.0, 0.5 * std::numbers::pi)), 2);
  };
  const auto cosines =
      static_cast<float>(Subcutis::CosinesOf(sin2(directions.theta_in_rad), sin2(directions.theta_out_rad)));
  const auto kinds = Subcutis::KindsAround(skin);
  const size_t nodes = scatterings().size() * SkinGrid::kNodes;
  Rings rings{};
  for (const SkinNodeWeight& n : SkinNodesAround(scatterings(), skin))
    for (int kind = 0; kind < Subcutis::kKinds; ++kind) {
      const float weight = n.weight * kinds[kind] / kCodesPerUnit;
      if (weight == 0.0F) continue;
      const int16_t* codes =
          contents_->codes.data() + ((channel * nodes + n.node) * Subcutis::kKinds + kind) * Subcutis::kKindCodes;
      for (int r = 0; r < SkinGrid::kRadii; ++r)
        rings[r] += weight * (static_cast<float>(codes[r]) + cosines * static_cast<float>(codes[SkinGrid::kRadii + r]));
    }
  return rings;
}

std::optional<uint64_t> SubcutisTable::seed() const {
  const auto made = nlohmann::ordered_json::parse(manifest(), nullptr, /*allow_exceptions=*/false);
  if (!made.is_object() || !made.contains("seed") || !made["seed"].is_number_unsigned()) return std::nullopt;
  return made["seed"].get<uint64_t>();
}

}  // namespace stratalux::rig
