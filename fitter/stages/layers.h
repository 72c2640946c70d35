// SPDX-License-Identifier: Apache-2.0
// The fit stage (layers): the layers of every pixel by EM, and what all pixels of a session share, on the training
// lights alone.
#pragma once

#include <string>
#include <vector>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/stages/srd.h"
#include "shared/base/log.h"

namespace stratalux::fit {

inline constexpr int kFitVersion = 21;

// What a session's fit finds on its training lights by itself.
struct SessionChoices {
  bool directions = false;  // directional weights and tau (EstimateDirections); of tied fits
  bool reflection = true;   // of the surface itself (EstimateSurfaceReflection); else unknown
  bool prior = true;        // its strength (ChoosePrior); else em.prior
  bool neighbours = true;   // whose layers it is centred on (FitAmongNeighbours); else the session's mean; of tied fits
};

struct FitOptions {
  EmOptions em;
  SessionChoices choose;
};

// All of them, as JSON: what the fit's key holds.
[[nodiscard]] std::string FitOptionsJson(const FitOptions& options);

// Whether pixels start from the session's mean layers, where a prior holds them as well.
[[nodiscard]] bool HasMeanLayers(const FitOptions& options);
// Pooled profiles have more photons and a wider response, which EM resolves slowly, and are fewer by as much: as many
// times more sweeps from widths spread over all scales.
[[nodiscard]] EmOptions OnPools(EmOptions em, int pool);
// Of sweeps whose lines stand s widths apart EM sees each cell by one line in s, and takes it as seen by a line and the
// white frames: a sweep goes 1 / (2 s) of the way, so 2 s times as many. Whole cycles: as they are.
[[nodiscard]] EmOptions OnThinnedCycles(EmOptions em, const SrdSet& srds);

inline constexpr int kNoneHeldOut = -1;
// The batches of all projectors but one, their row sweeps after their column sweeps. `srds` must outlive it.
struct TrainingLights {
  std::vector<const SrdBatch*> batches;
  std::vector<int> projectors;  // of each batch
};
// kUsage when none is left.
[[nodiscard]] Result<TrainingLights> TrainingLightsOf(const SrdSet& srds, int heldout);

// What white light alone says of all pixels together: how the surface itself reflects, and tau of the gain. Of one set
// of training lights it is the same wherever the surface is placed (it reads no first_u_mm), and for fits that are
// blind to direction.
struct SharedLight {
  SurfaceReflection reflection;  // not Known(): not asked for, or not told
  double tau = 0.0;
};
[[nodiscard]] SharedLight FindSharedLight(const FitOptions& options, const std::vector<const SrdBatch*>& lights,
                                          const ProfileGrid& grid);

// What EM is told but for the prior, with all that the profiles of the session share, chosen on `lights`.
[[nodiscard]] Result<EmOptions> SharedOptions(const FitOptions& options, const std::vector<const SrdBatch*>& lights,
                                              const SrdSet& srds, const SharedLight& shared, Logger& logger,
                                              const std::string& label);

// EM on the training lights, tied or free, by what FindSharedLight found on them. First, as `options` ask for it:
// directional weights, the prior with the mean layers that it is centred on; from these, of a tied fit, the number of
// sweeps, at most em.refinement_iterations.
[[nodiscard]] Result<MixtureMap> FitLayers(const SrdSet& srds, int heldout, const FitOptions& options,
                                           const SharedLight& shared, Logger& logger, const std::string& label);
// The same, by what it finds itself.
[[nodiscard]] Result<MixtureMap> FitLayers(const SrdSet& srds, int heldout, const FitOptions& options, Logger& logger,
                                           const std::string& label);

}  // namespace stratalux::fit
