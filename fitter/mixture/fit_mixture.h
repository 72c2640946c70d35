// SPDX-License-Identifier: Apache-2.0
// EM of the scattering layers of many profiles [M 6], tied over lights or free; model section 7.
#pragma once

#include <functional>
#include <limits>
#include <span>
#include <vector>

#include "fitter/mixture/em_options.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/mixture/neighbour_layers.h"
#include "fitter/mixture/srd_samples.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Map of `width` x `height` x `channels` profiles from one batch a training light (all with as many profiles). Profiles
// that cannot be fitted get zero weights and a reason, never NaN. `start`: the layers that EM starts from, scaled
// to each profile's own light (MeanLayers, NeighbourLayers), and the centre of options.prior; empty: widths
// spread over all scales. `progress` (may be empty) receives numbers of finished profiles. Same input, same bits,
// whatever the number of threads.
Result<MixtureMap> FitMixture(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                              int height, int channels, const EmOptions& options, const StartLayers& start = {},
                              const std::function<void(int64_t)>& progress = {});

// Of every profile what its neighbours are, `spacing_mm` apart: NeighbourLayers of FitMixture with options.prior
// centred on the session's `mean` layers. It takes kFirstShare of options.prior's photons, for the mean over some fifty
// profiles loses their noise but not their prior.
inline constexpr double kFirstShare = 0.333;
Result<ProfileLayers> FitNeighbours(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                    int width, int height, int channels, const EmOptions& options,
                                    std::span<const LayerSet> mean, double spacing_mm,
                                    const std::function<void(int64_t)>& progress = {});

// FitMixture with a prior of `photons` (ChooseNeighboursPrior) centred on those (docs/math/em.md, "Neighbours"); those
// apart (SrdBatch::apart) are fitted as by FitMixture with options.prior. `progress` receives each profile twice.
Result<MixtureMap> FitAmongNeighbours(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                      int width, int height, int channels, const EmOptions& options,
                                      std::span<const LayerSet> mean, double spacing_mm, double photons,
                                      const std::function<void(int64_t)>& progress = {});

// A fit and what it cost: what EM lowers (EmBlock::Cost), in photons.
struct TracedFit {
  MixtureMap map;
  std::vector<float> cost;  // [profile] NaN where nothing was fitted
  // [profile][sweep - 1] The cost had that sweep been the last, of as many sweeps as were to be traced; of those that
  // settled before, what they settled at.
  std::vector<float> cost_after;
};
// FitMixture, the same bits; a result of fewer sweeps is that of as many, so `traced` of them tell what fewer would
// have cost.
Result<TracedFit> FitTraced(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                            int height, int channels, const EmOptions& options, const StartLayers& start = {},
                            int traced = 0, const std::function<void(int64_t)>& progress = {});

// FitMixture of a row of pixels with each of `photons` (at least one) for options.prior.photons: the same bits. What
// does not depend on the prior is worked out once. Divergences, sweeps and prior shares are not: they stay 0.
Result<std::vector<MixtureMap>> FitWithPriors(std::span<const SrdBatch* const> lights,
                                              const std::vector<int>& projectors, int channels,
                                              const EmOptions& options, const StartLayers& start,
                                              std::span<const double> photons);

// How far each profile of a light is from what each of `fits`, fitted to other lights of the same profiles, predicts of
// it: Kullback-Leibler divergence in photons, [fit][profile]; NaN where the fit or the light has no such profile. The
// surface is that of options.scattering, where that knows it; else it, and the floor, are the mean of the fit's lights.
[[nodiscard]] std::vector<std::vector<double>> DivergencesFrom(std::span<const MixtureMap> fits, const SrdBatch& light,
                                                               int channels, const EmOptions& options);

// Samples that `layers` predict for profile `profile` of a light's batch (its y is not read): g sum_l w_l K(u - d_l s;
// sigma_l), exact line response, wrapped with the comb; of samples farther than `reach_mm` from the line 0. Surface and
// background terms are the caller's.
[[nodiscard]] std::vector<double> PredictSamples(const LayerSet& layers, const SrdBatch& batch, int64_t profile,
                                                 const ScatteringModel& model,
                                                 double reach_mm = std::numeric_limits<double>::infinity());
// What a light shows of it, as profile `at` of `batch` sees it: of one that it was fitted to what the fit found; of
// another what the surface's form says, where the map has one, else the mean.
[[nodiscard]] UnlayeredLight UnlayeredOf(const MixtureMap& map, int64_t profile, int projector, const SrdBatch& batch,
                                         int64_t at);
// All that a fit says of it: with light of the surface itself, B(u) of it, which no angular gain and no directional
// weight is on, and with the floor.
[[nodiscard]] std::vector<double> PredictSamples(const LayerSet& layers, const UnlayeredLight& beside,
                                                 const SrdBatch& batch, int64_t profile, const ScatteringModel& model,
                                                 double reach_mm = std::numeric_limits<double>::infinity());

// The session's tau of the angular gain from white reflectances of the training lights, less what the surface reflects:
// least squares of log(white_p - R_p) - log F_p = a - tau (sec theta_t - 1), a per profile. 0 when the angles do not
// differ enough.
[[nodiscard]] double EstimateTau(std::span<const SrdBatch* const> lights, double eta,
                                 const SurfaceReflection& surface = {});

}  // namespace stratalux::fit
