// SPDX-License-Identifier: Apache-2.0
// The skin of a face: melanin and blood with patches, freckles, cheeks and lips, vessels and a scar; and, where regions
// are wanted, thickness and scattering too. Another seed, another skin.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "firmware-host/simulated/scene/bump.h"
#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/scene/face_regions.h"
#include "firmware-host/simulated/skin/skin_optics.h"

namespace stratalux::rig {

class FaceSkin {
 public:
  // `regions` lie where the head's features do; what of them is felt, `description.regions` says.
  FaceSkin(const SkinDescription& description, const FaceRegions& regions, uint64_t seed);

  // At a point of the face's frame; within the skin table's range.
  [[nodiscard]] SkinParameters At(double x, double y) const;
  // Of the skin there, whatever the strength of the regions: the region, or the scar that crosses it.
  [[nodiscard]] SurfaceClass ClassAt(double x, double y) const;

 private:
  // 1 on the scar's axis, falling over a millimetre.
  [[nodiscard]] double ScarAt(double x, double y) const;

  FaceRegions regions_;
  // Logarithm of a region's factors, times the strength.
  std::array<SkinFactors, kFaceRegions> log_factors_{};
  SkinFactors log_scar_{0.0, 0.0, 0.0, 0.0};
  double strength_ = 0.0;
  SkinParameters cheek_;                           // without patches, vessels and the like
  std::vector<Bump> melanin_bumps_, blood_bumps_;  // relative: value = base (1 + sum)
  std::vector<Polyline> vessels_;
  Polyline scar_;
};

// Scattering over a face of this description. Regions keep it within 0.5 .. 1.1, or as far beyond as the cheek's lies.
struct ScatteringRange {
  double least = 1.0, most = 1.0;
};
[[nodiscard]] ScatteringRange ScatteringOf(const SkinDescription& description, uint64_t seed);

}  // namespace stratalux::rig
