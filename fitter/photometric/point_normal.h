// SPDX-License-Identifier: Apache-2.0
// The normal of one point from what three lights or more show of it (model section 5, docs/math/photometric.md).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::fit {

// Why a normal rests on the light alone or not. Of those between kValid and kNoPoint the surface's normal is a prior;
// where it is not known, they have no normal.
enum class PhotometricReason : uint8_t {
  kValid = 0,          // from the light alone
  kNoSurface = 1,      // no normal
  kTooFewSources = 2,  // fewer than three lights surely reach the point
  kInconsistent = 3,   // shadows and highlights do not explain what the lights disagree in
  kDegenerate = 4,     // the lights lie nearly in one plane
};
inline constexpr int kPhotometricReasons = 5;
[[nodiscard]] const char* ToString(PhotometricReason reason);

struct PhotometricOptions {
  // Standard deviation of a source's normalised intensity that its captured variance does not tell: what calibration
  // and a real skin's departure from Lambert leave, relative to the brightest source (or, where a highlight outshines
  // it, to the albedo).
  double relative_sigma = 0.03;
  // Four sources: a linear dependence violated by more rejects one.
  double dependence_sigmas = 4.0;
  // Five and more: a source this far from the normal's prediction has no weight (Tukey's biweight; of Gaussian noise
  // the estimate loses 5 % of its efficiency).
  double robust_sigmas = 4.685;
  double shadow_fraction = 0.15;     // below this part of the brightness a source may be in shadow
  double highlight_cone_deg = 35.0;  // a highlight lies within this angle of mirror reflection
  double min_condition = 0.03;       // smallest over largest singular value of the light directions
  // Input further below zero than its noise is no light and masked.
  double negative_sigmas = 4.0;
  // Of each of the surface normal's two tilts, where it serves as a prior: three times what the surfaces of simulated
  // people are off by, since real skin has relief that theirs lack.
  double surface_sigma_rad = 0.03;
  [[nodiscard]] Status Validate() const;
};

// One light at one point.
struct PointSource {
  Eigen::Vector3d direction;            // unit, to the light
  double intensity = 0.0;               // mean over channels of direct / white: albedo n . l, or 0 in shadow
  double variance = 0.0;                // of its captured noise
  std::array<double, 3> per_channel{};  // direct / white
};

struct PointNormal {
  PhotometricReason reason = PhotometricReason::kValid;
  Eigen::Vector3d normal = Eigen::Vector3d::Constant(std::nan(""));  // unit
  // Standard deviation, both tilts together: E |error|^2 = sigma^2.
  double sigma_rad = std::nan("");
  double residual = std::nan("");  // rms of the used sources over the brightness; NaN where as many fix the normal
  double scatter = std::nan("");   // squared residuals over their variances, per degree of freedom; NaN likewise
  std::vector<double> weights;     // of each source, in its order: 1 / variance times robust weight; 0: not used
};

// `view`: unit, to the camera. `surface_normal`: unit; a prior where light alone does not do.
//
//   three sources     solved exactly; one that may be shadowed makes them too few
//   four              weighted least squares where their linear dependence holds within noise; else the triple whose
//                     normal explains the fourth as shadow or highlight and is nearest to the surface's [Barsky &
//                     Petrou 2003]
//   five and more     least squares iterated with Tukey's biweight, from a wide one or the best triple down to
//                     robust_sigmas; dark sources behind the normal's horizon do not count. Consistent where more than
//                     half are used or so explained
//   otherwise         the same with the surface's normal as prior: two rows t . g = 0 +- |g| surface_sigma_rad
//
// sigma_rad is sqrt(trace(T^T C T)) / |g|, C the inverse of the weighted normal matrix of g = albedo n and T the
// tangent plane, times sqrt(scatter) where that is above 1. Reentrant; of the sources' order it depends by rounding
// alone.
[[nodiscard]] PointNormal EstimatePointNormal(std::span<const PointSource> sources, const Eigen::Vector3d& view,
                                              const std::optional<Eigen::Vector3d>& surface_normal,
                                              const PhotometricOptions& options);

}  // namespace stratalux::fit
