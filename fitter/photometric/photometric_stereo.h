// SPDX-License-Identifier: Apache-2.0
// Photometric stereo by any number of near and far lights, with shadows and highlights (model section 5,
// docs/math/photometric.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "fitter/photometric/photometric_light.h"
#include "fitter/photometric/point_normal.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// What the camera saw of one light.
struct LitImage {
  PhotometricLight light;
  ImageView<const float> direct;    // W x H x C, linear digital numbers above black and ambient; NaN where unknown
  ImageView<const float> variance;  // W x H x C, of the noise of `direct`; empty: not known, relative_sigma alone
};

// Maps on quads.
struct PhotometricMap {
  Image<float> normal;    // W x H x 3, unit, out of the skin; NaN where none is known
  Image<float> albedo;    // W x H x C of the direct light; NaN where no source tells it
  Image<float> residual;  // W x H, rms of the used sources over the brightness; NaN where as many fix the normal
  // W x H, rad: standard deviation of the normal, both tilts together (E |error|^2 = sigma^2), finite wherever the
  // normal is; a priori from variances and relative_sigma, widened by scatter where that is above 1.
  Image<float> normal_sigma_rad;
  Image<float> scatter;   // W x H, squared residuals over their variances, per degree of freedom; NaN as residual
  Image<uint8_t> usable;  // W x H, number of sources that have weight
  Image<uint8_t> reason;  // W x H, PhotometricReason
  std::array<int64_t, kPhotometricReasons> counts{};
  // Quads times lights on the surface, left out: of the direct image or its variance not finite, below zero by more
  // than negative_sigmas (the variance: at all). A light that does not reach a quad counts in neither.
  int64_t masked_not_finite = 0;
  int64_t masked_negative = 0;
};

// Of each quad of the surface y_p = direct_p / white_p = albedo n . l_p, mean over channels, with light p's direction
// and white there, and from these EstimatePointNormal(). The surface gives points and, where light alone does not do,
// its normal as prior. Of fewer than three lights all quads are kTooFewSources. kUsage: sizes or channels (1 or 3)
// differ, a light is not valid, no or more than 255 lights. Reentrant; same input, same bits, whatever the number of
// threads.
[[nodiscard]] Result<PhotometricMap> EstimateNormals(std::span<const LitImage> images, const SurfaceMap& surface,
                                                     const PhotometricOptions& options = {});

}  // namespace stratalux::fit
