// SPDX-License-Identifier: Apache-2.0
// The M step of model section 7 and its acceleration, for sixteen profiles at once; chosen for the machine's
// instruction set at run time, like em_kernel.h. Parameters are rows [row][lane] of one array: weights, depths, widths
// (mm) of all layers, then surface and background of each light.
#pragma once

#include <vector>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/em_light.h"

namespace stratalux::fit {

struct ParameterRows {
  int layers = 0, lights = 0;
  [[nodiscard]] int weight(int layer) const { return layer; }
  [[nodiscard]] int depth(int layer) const { return layers + layer; }
  [[nodiscard]] int sigma(int layer) const { return 2 * layers + layer; }
  [[nodiscard]] int surface(int light) const { return 3 * layers + 2 * light; }
  [[nodiscard]] int background(int light) const { return 3 * layers + 2 * light + 1; }
  [[nodiscard]] int size() const { return 3 * layers + 2 * lights; }
};

struct LayerBounds {
  float least_depth_mm = 0.0F, most_depth_mm = 0.0F;
  LaneRow least_sigma_mm, most_sigma_mm;
  bool fixed_depth = false;
};

// Sums over lights of counts x {c, c s (z - mean), c s^2, c (z - mean)^2, gain x factor x full coverage}, in mm:
// [layer][lane].
struct MomentSums {
  LaneRows photons, moved, leverage, spread, exposure;
};

// w_lp / w_l of every layer under `light`, [layer][lane] (DirectionalFactor).
void DirectionalFactors(const ParameterRows& rows, const DirectionalWeights& weights, const float* at,
                        const EmLight& light, float* factor);

// Layers of the parameters `at` on the grid of `light`, in cells. `factor`: as above; null: 1.
void PlaceLayers(const ParameterRows& rows, const float* at, const EmLight& light, const float* factor, float* weight,
                 float* mean, float* sigma);

// All sums but the exposure's; the exposure's.
void AddMoments(int layers, const EmLight& light, const float* moments, MomentSums& sums);
void AddExposure(int layers, const EmLight& light, const float* factor, MomentSums& sums);

// d = sum n s c z / sum n s^2 c, sigma^2 = sum n c (z - d s)^2 / sum n c.
void UpdateShapes(const ParameterRows& rows, const LayerBounds& bounds, const MomentSums& sums, const float* at,
                  float* image);
// w = sum n c / sum n g A.
void UpdateWeights(const ParameterRows& rows, const MomentSums& sums, float* image);

// Where the next sweep of each lane starts (Nesterov): from `image`, the last sweep's result, go on by `momentum` of
// the way from the result before it (`last`); weights, widths, surface and background in their logarithm. step[lane]:
// kAdvance; kReturn: start from `last` again; kStay: leave `at` as it is.
enum LaneStep : int { kStay = 0, kAdvance = 1, kReturn = 2 };
void Advance(const ParameterRows& rows, const LayerBounds& bounds, const int* step, const float* momentum,
             const float* image, float* last, float* at);

}  // namespace stratalux::fit
