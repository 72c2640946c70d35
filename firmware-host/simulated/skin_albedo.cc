// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin_albedo.h"

#include <cmath>

#include "shared/units/angle.h"

namespace stratalux::rig {

void SkinAlbedo::Retabulate() {
  for (int c = 0; c < kSkinChannels; ++c)
    for (int node = 0; node < table_.nodes(); ++node)
      log_albedo_[c][node] =
          static_cast<float>(std::log(table_.Albedo(c, SkinGrid::NodeParameters(node), RadFromDeg(30))));
}

float SkinAlbedo::operator()(int channel, const SkinParameters& parameters) const {
  float sum = 0.0F;
  for (const SkinNodeWeight& n : table_.NodesAround(parameters)) sum += n.weight * log_albedo_[channel][n.node];
  return std::exp(sum);
}

}  // namespace stratalux::rig
