// SPDX-License-Identifier: Apache-2.0
// How far codes that are seen below the skin displace the surface that is triangulated from them (docs/math/offset.md).
#pragma once

#include <span>
#include <vector>

#include "fitter/mixture/gloss_field.h"
#include "fitter/mixture/scattering_model.h"
#include "fitter/mixture/srd_samples.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// Of the light that a projector's codes are read in, the share that scattered, W / (W + R): by projector, on quads of
// `surface`. R: of model.reflection there; W: the mean over colours and the `lights` that reach the pixel of what their
// white light shows beyond theirs, of the whole face where none reaches it. 1 where no reflection is known. `grid`: of
// the lights' profiles, `pool` x `pool` quads each.
[[nodiscard]] std::vector<Image<float>> ScatteredShares(std::span<const SrdBatch* const> lights,
                                                        const ProfileGrid& grid, int pool, const SurfaceMap& surface,
                                                        const RigCalibration& rig, const ScatteringModel& model);

// Of each quad of `surface`, along its normal, per mm of the depth that the codes seem to come from; 0 outside the
// mask. What scattered is displaced by T(omega_i) - T(omega_o) a mm of that depth, what the surface itself mirrors is
// not, and a code by the mean of both (`scattered`: the share of the former, by projector, on quads). A deeper surface
// displaces it by t(omega_i) - t(omega_o) a mm: the triangulated depth is the least squares over columns and rows of
// all projectors, each weighted by what its codes weigh in the surface (`coded`: by projector, on quads; where none has
// any, all that it faces) and the square of its pixels' density on the skin. Between 0 and 1.
[[nodiscard]] Image<float> CodeDisplacement(const SurfaceMap& surface, const std::vector<Image<float>>& coded,
                                            const std::vector<Image<float>>& scattered, const RigCalibration& rig,
                                            const ScatteringModel& model);

}  // namespace stratalux::fit
