// SPDX-License-Identifier: Apache-2.0
// The light of a camera pixel by brute force: photons traced backwards from the pixel's footprint through layered skin
// under the scene's curved surface, connected at every collision to the projectors. An independent route to what the
// simulated rig renders: nothing of the skin table, of the near field, of the light transport and not even the stepping
// of shared/transport is used. Shared are the scene's surface and skin, the optical properties of skin_optics.h, the
// projection models and the meaning of WhiteTargetDn, the random numbers.
//
// Where it knows better than the rig: the tissue follows the curved surface (the rig lays a plane), melanin and blood
// are those of the place a photon passes (the rig takes the exit point's kernel and sqrt(albedo)), the projector's blur
// is a Gaussian of the continuous image (the rig convolves pixels).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "firmware-host/simulated/scene/scene.h"
#include "shared/capture/rig_calibration.h"
#include "shared/pattern/pattern.h"

namespace stratalux::rig {

struct BruteForceOptions {
  int64_t photons = 10000;  // a pixel
  uint64_t seed = 1;
  int threads = 0;
};

struct ProjectedLight {
  int projector = 0;
  Pattern pattern;
};

// DN above black per ms; the black level of the projector is not in it.
struct BruteForceEstimate {
  double subsurface = 0.0, subsurface_error = 0.0;  // and its standard error
  double direct = 0.0, direct_error = 0.0;          // reflected at the surface
};

// One estimate a light, of mosaic pixel (x, y). Deterministic by seed, whatever the number of threads. Preconditions:
// photons >= 100; the scene's skin scatters (skin_optics.h).
[[nodiscard]] std::vector<BruteForceEstimate> TracePixel(const Scene& scene, const RigCalibration& rig, int x, int y,
                                                         std::span<const ProjectedLight> lights,
                                                         const BruteForceOptions& options);

// Angle between normal and light or view at a surface point, degrees, for reports.
[[nodiscard]] double IncidenceDeg(const Scene& scene, const Eigen::Vector3d& point, const Eigen::Vector3d& device);

}  // namespace stratalux::rig
