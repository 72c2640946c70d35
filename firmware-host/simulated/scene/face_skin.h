// SPDX-License-Identifier: Apache-2.0
// Melanin and blood over a face: patches, freckles, cheeks and lips, vessels, a scar. Another seed, another skin.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "firmware-host/simulated/scene/bump.h"
#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/skin/skin_optics.h"

namespace stratalux::rig {

class FaceSkin {
 public:
  FaceSkin(const SkinDescription& description, uint64_t seed);
  // The same skin everywhere.
  explicit FaceSkin(const SkinParameters& skin)
      : melanin_(skin.melanin), blood_(skin.blood), epidermis_mm_(skin.epidermis_mm) {}

  // At a point of the face's frame; within the skin table's range.
  [[nodiscard]] SkinParameters At(double x, double y) const;

 private:
  double melanin_ = 0.03, blood_ = 0.004, epidermis_mm_ = kEpidermisMm;
  std::vector<Bump> melanin_bumps_, blood_bumps_;  // relative: value = base (1 + sum)
  std::vector<Polyline> vessels_;
  Polyline scar_;
};

}  // namespace stratalux::rig
