// SPDX-License-Identifier: Apache-2.0
// Diffuse albedo of the table's skin on a fine grid of melanin and blood, for light at 30 degrees: the matt skin of the
// "scattering off" ablation, and the weight sqrt(albedo) of a point where light enters.
#pragma once

#include <array>
#include <vector>

#include "firmware-host/simulated/scene/material.h"
#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {

class SkinAlbedo {
 public:
  explicit SkinAlbedo(const SkinTable& table);
  [[nodiscard]] float operator()(int channel, const SkinParameters& parameters) const;
  // Diffuse albedo of any material.
  [[nodiscard]] float Of(int channel, const Material& material) const {
    return material.Translucent() ? (*this)(channel, material.skin) : material.albedo[channel];
  }

 private:
  static constexpr int kSteps = 24;
  std::array<std::array<float, (kSteps + 1) * (kSteps + 1)>, kSkinChannels> values_{};
};

}  // namespace stratalux::rig
