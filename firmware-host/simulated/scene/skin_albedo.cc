// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/skin_albedo.h"

#include <cmath>

namespace stratalux::rig {

float SkinAlbedo::operator()(int channel, const SkinParameters& parameters) const {
  const SkinTable::NodeAlbedos& logarithms = table_.LogAlbedos();
  float sum = 0.0F;
  for (const SkinNodeWeight& n : table_.NodesAround(parameters)) sum += n.weight * logarithms[channel][n.node];
  if (!parameters.UsualSubcutis()) sum += table_.SubcutisLogAlbedo(channel, parameters);
  return std::exp(sum);
}

}  // namespace stratalux::rig
