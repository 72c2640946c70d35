// SPDX-License-Identifier: Apache-2.0
// The prior of MAP EM for sixteen profiles at once (docs/math/em.md, "The prior"): as if N0 photons of a known pixel
// had been seen beside each profile's own. Internal to fitter/mixture; its kernels are chosen for the machine's
// instruction set at run time, like em_update.h, whose rows and sums it shares.
#pragma once

#include <array>
#include <span>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/em_update.h"

namespace stratalux::fit {

class EmPrior {
 public:
  EmPrior() = default;  // none
  // `square_shift`: as in LayerPrior; 0 where means are free and no depths. `surface_held`: it is known, and no part of
  // what the prior binds.
  EmPrior(const ParameterRows& rows, double square_shift, bool surface_held);

  [[nodiscard]] bool On() const { return !centre_.empty(); }
  [[nodiscard]] double Photons(int lane) const { return total_[lane]; }
  void Clear(int lane);
  // The known pixel of a lane is what `at` holds of it; its `photons` (N0 > 0) are shared out as the lane's lights
  // would show it, in the lane's first sweep. A lane that was cleared and not set is not held.
  void Set(int lane, double photons, const float* at);

  // In each sweep, in this order. What the model of `at` shows of each light; `weight`: of its layers, gain and
  // directions included (PlaceLayers).
  void BeginSweep();
  void AddShown(int p, const EmLight& light, const float* at, const float* weight);
  // Of lanes that were set since; AddCost does so, too. A lane whose sweeps start elsewhere than in its known pixel
  // needs it before the first of them, when `at` still is that pixel.
  void ShareOut();
  // cost[lane] += N0 times the Kullback-Leibler divergence of the known pixel's complete data from `at`.
  void AddCost(const float* at, float* cost);
  // The known pixel's photons, beside those of the M step; surface and floor go to `image` at once.
  void AddPhotons(std::span<const EmLight> lights, const float* at, MomentSums& sums, float* image) const;
  // The prior is one of shape: of the C + N0 photons in `sums` and `image` the profile's own C are shown.
  void KeepTotal(std::span<const EmLight> lights, const MomentSums& sums, float* image) const;

 private:
  void ShareOut(int lane);  // of one that was set

  ParameterRows rows_;
  float square_shift_ = 0.0F;
  bool surface_held_ = false;
  LaneRows centre_;   // [parameter row][lane]: the known pixel
  LaneRows photons_;  // [parameter row][lane]: N0 pi of each weight, surface and floor; else 0
  LaneRows shown_;    // [parameter row][lane]: photons of each weight, surface and floor in the model
  LaneRow total_;     // N0; 0: no prior
  std::array<double, kEmLanes> fresh_{};  // N0 of a lane that was just set; else 0
};

}  // namespace stratalux::fit
