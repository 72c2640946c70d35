// SPDX-License-Identifier: Apache-2.0
// At which depth below the skin its codes are seen, told by the SRDs of the training lights (docs/math/offset.md).
// Scattering displaces the codes of all projectors alike, and with them the surface that is triangulated. A displaced
// surface moves the whole SRD of a light by the displacement times (tan theta_i - tan theta_o), in air; the layers'
// depths move what scattered alone, by refracted angles, and the light of the surface itself stays where the lines are.
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// `batch` as it would have been read on a surface that lies deeper along its normal by displacement[pixel] a mm of
// `deeper_mm`, each pixel's point being where its view meets that; `channels` profiles a pixel. To first order: angles,
// widths and irradiances stay.
void MoveSurface(SrdBatch& batch, int channels, std::span<const float> displacement, double deeper_mm);

struct SurfaceOffset {
  double code_depth_mm = 0.0;  // below the true surface; one for the whole face and all colours
  double sigma_mm = 0.0;       // its standard error, from how far parts of the face disagree
  int64_t pixels = 0;          // that told; 0: too few are lit by two projectors, and the depth is 0
  bool at_bound = false;       // no depth is best of those tried, or about the best one: it is 0
  [[nodiscard]] bool IsFound() const { return pixels > 0 && !at_bound; }
};

// `lights`: the training lights of a map `width` pixels wide of `channels` profiles each, `mm_per_pixel` apart.
// `displacement`: by pixel, how far the surface that they were read on lies too deep, per mm of code depth. `options`:
// of their fit, with all that the pixels of the session share; blind to direction or not. The same bits for any number
// of threads.
[[nodiscard]] Result<SurfaceOffset> EstimateOffset(std::span<const SrdBatch* const> lights,
                                                   const std::vector<int>& projectors, int width, int channels,
                                                   double mm_per_pixel, std::span<const float> displacement,
                                                   const EmOptions& options);

}  // namespace stratalux::fit
