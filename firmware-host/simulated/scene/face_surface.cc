// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/face_surface.h"

#include <array>
#include <cmath>

#include "firmware-host/simulated/scene/bump.h"
#include "firmware-host/simulated/skin/skin_optics.h"

namespace stratalux::rig {
namespace {

constexpr double kPlateaus = 0.18, kFurrows = 0.39;       // slopes
constexpr double kDryFurrows = 0.75, kOilyFurrows = 0.4;  // share of the area
constexpr double kDryIndex = kSkinIndex, kOilyIndex = 1.5;
// GGX in their place: the fitter's own form, of the same slopes and the same reflection at normal incidence.
constexpr double kDryGgx = 0.35;
// Optical depth of fine hairs: hairs per area times the mean shadow of a thin cylinder that lies anyhow, pi/4 of its
// length times its diameter, 439 hairs/cm^2 (forehead: Blume et al. 1991, abstract) of 0.016 mm x 0.45 mm (assumed, of
// "less than 0.03 mm and 2 mm"); times 1 - g = 0.4, as clear fibres send most of the light on (assumed, too), which
// makes isotropic scatterers of them.
constexpr double kFuzzDepth = 0.01;

double Mix(double dry, double oily, double oil) { return dry + oil * (oily - dry); }

// Of the slopes, root mean square.
double Roughness(double furrows) {
  return std::sqrt(furrows * kFurrows * kFurrows + (1.0 - furrows) * kPlateaus * kPlateaus);
}

double NormalReflection(double index) { return std::pow((index - 1.0) / (index + 1.0), 2); }

}  // namespace

double SebumAt(double x, double y) {
  static constexpr std::array<Bump, 4> kTZone = {{{0, -64, 42, 20, 1.0},   // forehead
                                                  {0, -8, 11, 22, 0.9},    // bridge
                                                  {0, 19, 17, 14, 1.0},    // tip and wings
                                                  {0, 79, 18, 13, 0.9}}};  // chin
  double dry = 1.0;
  for (const Bump& bump : kTZone) dry *= 1.0 - bump.At(x, y);
  return 1.0 - dry;
}

SurfaceReflection FaceSurface::At(double x, double y) const {
  const double oil = description_.oiliness > 0.0 ? description_.oiliness * SebumAt(x, y) : 0.0;
  const double furrows = Mix(kDryFurrows, kOilyFurrows, oil), index = Mix(kDryIndex, kOilyIndex, oil);
  SurfaceReflection surface;
  surface.fuzz_depth = static_cast<float>(description_.fuzz * kFuzzDepth);
  if (description_.form == SkinSurface::kGgx) {
    surface.strength = static_cast<float>(NormalReflection(index) / NormalReflection(kDryIndex));
    surface.roughness = static_cast<float>(kDryGgx * (Roughness(furrows) / Roughness(kDryFurrows)));
    return surface;
  }
  surface.form = FacetForm::kBeckmann;
  surface.index = static_cast<float>(index);
  if (description_.form == SkinSurface::kBeckmann) {
    surface.roughness = static_cast<float>(Roughness(furrows));
    return surface;
  }
  surface.roughness = static_cast<float>(kPlateaus);
  surface.wide_roughness = static_cast<float>(kFurrows);
  surface.wide_share = static_cast<float>(furrows);
  return surface;
}

}  // namespace stratalux::rig
