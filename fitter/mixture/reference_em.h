// SPDX-License-Identifier: Apache-2.0
// EM of the scattering layers of ONE profile in plain double precision, written to be read beside model section 7
// (docs/math/em.md has the derivation). `stratalux-fit profiles` runs it; the fast kernel is tested against it.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/directional_weights.h"
#include "fitter/mixture/em_options.h"
#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/line_response.h"
#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

// One light's samples of the profile: sample k at u = first_u + k step.
struct ReferenceLight {
  std::vector<double> y;
  double first_u_mm = 0.0, step_mm = 0.0;
  bool wrapped = false;
  LineResponse line;         // cell_mm is that of the fine grid
  int cells_per_sample = 1;  // of the fine grid
  double counts = 1.0;       // photons per unit of y
  double read_shift = 0.0;   // sigma_read^2 in units of y: added to data and model (shifted Poisson)
  double s = 0.0;            // shift per mm of depth
  double fresnel = 1.0;      // the angular gain is fresnel exp(-tau gain_path)
  double gain_path = 0.0;
  RefractedDirections directions;
  double reflected = -1.0;  // by the surface, reflectance; negative: unknown

  [[nodiscard]] int samples() const { return static_cast<int>(y.size()); }
};

// What EM is free to change beyond the layers.
enum class SharedParameters : uint8_t { kFixed, kTau, kTauAndDirectional };
enum class Acceleration : uint8_t { kNone, kSquarem };

struct ReferenceFit {
  LayerSet layers;                          // LayerSet::background is not used here
  std::vector<double> surface, background;  // by light
  double tau = 0.0;
  DirectionalWeights directional;
  double divergence = 0.0;  // Kullback-Leibler over the data's sum
  int iterations = 0;       // sweeps
};

// Light of a layer of weight 1: g_p w_lp / w_l.
[[nodiscard]] double LayerFactor(const ReferenceLight& light, const ReferenceFit& fit, double depth_mm,
                                 double sigma_mm);

// The light `batch` holds of `profile`, on the grid that FitMixture uses.
[[nodiscard]] ReferenceLight ReferenceLightOf(const SrdBatch& batch, int64_t profile, const EmOptions& options);

// Layers that EM starts from when it is given none: widths spread over all scales.
[[nodiscard]] LayerSet SpreadLayers(std::span<const ReferenceLight> lights, const EmOptions& options);

// What one standard deviation of a shared parameter's prior costs, in shares of the light: a tenth of what a wrong form
// of the directional weights costs on skin.
inline constexpr double kSharedPrior = 3e-5;

// EM from `start`. Stops when the divergence falls by less than options.tolerance of itself a sweep, or after
// options.max_iterations sweeps. SQUAREM never ends above the divergence of the plain sweeps it replaces.
[[nodiscard]] ReferenceFit FitReference(std::span<const ReferenceLight> lights, const LayerSet& start,
                                        const EmOptions& options, SharedParameters shared = SharedParameters::kFixed,
                                        Acceleration acceleration = Acceleration::kNone,
                                        double shared_prior = kSharedPrior);

// EM from a whole fit, which with options.prior.photons > 0 is also the centre of the prior (docs/math/em.md): then no
// sweep lowers the likelihood times the prior. Shared parameters stay.
[[nodiscard]] ReferenceFit RefineReference(std::span<const ReferenceLight> lights, const ReferenceFit& start,
                                           const EmOptions& options);
// What those sweeps lower: divergence and prior, over the data's sum. `centre`: the fit they started from.
[[nodiscard]] double PenalisedDivergence(std::span<const ReferenceLight> lights, const ReferenceFit& centre,
                                         const ReferenceFit& fit, const EmOptions& options);

// The fit's own samples of a light: B m + surface + background.
[[nodiscard]] std::vector<double> ReferenceModelOf(const ReferenceFit& fit, std::span<const ReferenceLight> lights,
                                                   size_t light);

}  // namespace stratalux::fit
