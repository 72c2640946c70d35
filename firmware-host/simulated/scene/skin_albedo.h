// SPDX-License-Identifier: Apache-2.0
// Diffuse albedo of the table's skin for light at 30 degrees: the matt skin of the "scattering off" ablation, and the
// weight sqrt(albedo) of a point where light enters. Known at the table's nodes; its logarithm is interpolated between
// them as the table's is.
#pragma once

#include "firmware-host/simulated/scene/material.h"
#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {

class SkinAlbedo {
 public:
  // Keeps a reference; the table may be replaced by another one.
  explicit SkinAlbedo(const SkinTable& table) : table_(table) {}
  [[nodiscard]] float operator()(int channel, const SkinParameters& parameters) const;
  // Diffuse albedo of any material.
  [[nodiscard]] float Of(int channel, const Material& material) const {
    return material.Translucent() ? (*this)(channel, material.skin) : material.albedo[channel];
  }

 private:
  const SkinTable& table_;
};

}  // namespace stratalux::rig
