// SPDX-License-Identifier: Apache-2.0
// What a face's surface reflects, place by place: dry cheeks, an oily T-zone, fine hairs.
//
// Dry skin: slopes of root mean square 0.35, the middle of the 0.25 to 0.4 of Weyrich et al. (2006), as one lobe or two
// (plateaus of 0.18 on a quarter of the area, furrows of 0.39 on the rest), and the index 1.4 of the tissue below.
// Under a film of sebum the furrows fill: plateaus on 0.6 of the area, root mean square 0.28, and the index 1.5 that
// cheeks show where nothing but the outermost layer counts (1.51 to 1.53 in vivo: Yoshida et al. 2013). That two
// Beckmann lobes fit facial skin is Graham et al.'s (2013); the lobes and shares are ours, not their table.
#pragma once

#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/scene/surface_reflection.h"

namespace stratalux::rig {

// Sebum over that of an oily forehead at a point of the face's frame (head.h), 0 to 1: forehead, nose, chin.
[[nodiscard]] double SebumAt(double x, double y);

class FaceSurface {
 public:
  explicit FaceSurface(const SurfaceDescription& description) : description_(description) {}
  [[nodiscard]] SurfaceReflection At(double x, double y) const;

 private:
  SurfaceDescription description_;
};

}  // namespace stratalux::rig
