// SPDX-License-Identifier: Apache-2.0
// Four-source photometric stereo with near lights, shadows and highlights [Barsky & Petrou 2003]
// (model section 5, docs/math/photometric.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

enum class PhotometricReason : uint8_t {
  kValid = 0,
  kNoSurface = 1,
  kTooFewSources = 2,  // fewer than three lights reach the point
  kInconsistent = 3,   // no triple explains the fourth light as shadow or highlight
  kDegenerate = 4,     // the lights lie nearly in one plane
};
inline constexpr int kPhotometricReasons = 5;
[[nodiscard]] const char* ToString(PhotometricReason reason);

struct PhotometricOptions {
  // Standard deviation of a source's normalised intensity: what direct images, calibration and a real skin's departure
  // from Lambert leave, relative to the brightest source.
  double relative_sigma = 0.03;
  double dependence_sigmas = 4.0;    // a linear dependence violated by more rejects a source
  double shadow_fraction = 0.15;     // below this part of the brightest source a source may be shadowed
  double highlight_cone_deg = 35.0;  // a highlight lies within this angle of mirror reflection
  double min_condition = 0.03;       // smallest over largest singular value of the light directions
  [[nodiscard]] Status Validate() const;
};

// Maps on quads.
struct PhotometricMap {
  Image<float> normal;    // W x H x 3, unit, out of the skin; NaN where invalid
  Image<float> albedo;    // W x H x C of the direct light; NaN where invalid
  Image<float> residual;  // W x H, rms of the used sources over the brightest; NaN with three sources
  // W x H, rad: standard deviation of the normal (both tilts together) if the residual is noise,
  //   sigma_y sqrt(trace (L^T L)^-1) / albedo,  sigma_y^2 = sum of squared residuals (one degree of freedom);
  // noisy itself, to be averaged over neighbours. NaN with three sources.
  Image<float> normal_sigma_rad;
  Image<uint8_t> usable;  // W x H, number of sources used
  Image<uint8_t> reason;  // W x H, PhotometricReason
  std::array<int64_t, kPhotometricReasons> counts{};
};

// `direct[p]`: W x H x C direct images of projector p, digital numbers above black, NaN where unknown; their exposure
// is `exposure_ms`. With E_p the irradiance of a facing white target at the point, y_p = direct / E_p = albedo n . l_p,
// l_p the true direction to the projector's centre. Any four such values of one point are linearly dependent; when they
// are not, the triple is taken whose normal explains the fourth as shadow or highlight and lies nearest to the surface
// normal. More than four projectors: the four brightest at each point. kUsage: sizes differ, fewer than three
// projectors. Reentrant, thread-count independent.
[[nodiscard]] Result<PhotometricMap> EstimateNormals(std::span<const ImageView<const float>> direct,
                                                     const SurfaceMap& surface, const RigCalibration& rig,
                                                     double exposure_ms, const PhotometricOptions& options = {});

}  // namespace stratalux::fit
