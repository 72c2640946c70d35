// SPDX-License-Identifier: Apache-2.0
// Direction effects of a layer (model sections 6 and 7): the displacement T of a ray by its depth and the angular gain
// g of a light.
#pragma once

#include <cstdint>
#include <string>

#include "shared/base/result.h"

namespace stratalux::fit {

// Shift law T: tangential displacement per mm of depth of a ray with slope t (model section 6).
enum class ShiftLaw : uint8_t { kPaper, kRefracted, kRefractedSine };
[[nodiscard]] const char* ToString(ShiftLaw law);
[[nodiscard]] Result<ShiftLaw> ParseShiftLaw(const std::string& text);

// Tangential displacement along e, per mm of depth, of the ray whose outer direction has tangential slopes (along e,
// across it), |slopes| = tan(theta). paper: the straight ray itself [M 3, 5]; refracted: tan of the refracted angle;
// refracted_sine: its sine (a step of length d along the ray, Wang & Jacques 1995).
[[nodiscard]] double TangentialShift(ShiftLaw law, double slope_along, double slope_across, double eta);

// What enters of unpolarised light that meets a surface of index eta at that cosine (Fresnel).
[[nodiscard]] double FresnelTransmission(double cos_in, double eta);

// g = F(theta_i) / F(0) exp(-tau (sec theta_t - 1)): Fresnel transmission into the skin and the oblique path through
// the epidermis; 1 at normal incidence.
[[nodiscard]] double AngularGain(double cos_in, double eta, double tau);

// Its two parts: g = AngularGain(tau = 0) exp(-tau GainPath).
[[nodiscard]] double GainPath(double cos_in, double eta);

}  // namespace stratalux::fit
