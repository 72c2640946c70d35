// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/holdout.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>

#include "fitter/mixture/choose_prior.h"
#include "fitter/mixture/estimate_directions.h"
#include "fitter/mixture/shift_law.h"
#include "fitter/pipeline/free_fit.h"
#include "fitter/pipeline/measured_surface.h"
#include "fitter/srd/srd_extractor.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

Pattern PatternOf(const std::string& light, const PlanOptions& o) {
  if (light == "stripe")
    return {.kind = PatternKind::kComb, .period = o.comb_period, .width = o.comb_width, .shift = 0};
  if (light == "spot") return {.kind = PatternKind::kSpots, .period = o.spot_pitch, .width = o.spot_radius};
  return {.kind = PatternKind::kWhite};
}

CapturePhase PhaseOf(const std::string& light) {
  return light == "stripe" ? CapturePhase::kSweep : light == "spot" ? CapturePhase::kSpot : CapturePhase::kReference;
}

Image<float> Sum(const Image<float>& a, const Image<float>& b) {
  Image<float> sum = a;
  for (size_t i = 0; i < sum.size(); ++i) sum.pixels()[i] += b.pixels()[i];
  return sum;
}

Image<float> Difference(const Image<float>& a, const Image<float>& b) {
  Image<float> difference = a;
  for (size_t i = 0; i < difference.size(); ++i) difference.pixels()[i] -= b.pixels()[i];
  return difference;
}

// Skin that the held-out light reaches and whose layers were fitted.
Image<uint8_t> SkinMask(const HoldOutInput& in, const MixtureMap& map) {
  Image<uint8_t> mask = in.face.lit[in.projector];
  for (int j = 0; j < mask.height(); ++j)
    for (int i = 0; i < mask.width(); ++i) {
      bool fitted = in.surface.mask(i, j) != 0 && i / in.pool < map.width && j / in.pool < map.height;
      for (int c = 0; c < map.channels && fitted; ++c)
        fitted = map.Fitted(map.ProfileIndex(i / in.pool, j / in.pool, c));
      if (!fitted) mask(i, j) = 0;
    }
  return mask;
}

// As `options` have it, else chosen by the data.
Result<LayerPrior> PriorOf(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int channels,
                           const EmOptions& options, Logger& logger, const std::string& label) {
  if (!options.choose_prior) return options.prior;
  SLX_ASSIGN_OR_RETURN(const auto choice, ChoosePrior(lights, projectors, channels, options));
  std::ostringstream text;
  text << label << ": prior of " << choice.prior.photons << " photons a profile";
  for (const auto& trial : choice.trials)
    text << (&trial == &choice.trials.front() ? "; divergence of the lights left out in turn: " : ", ")
         << trial.divergence << " with " << trial.photons;
  logger.Info(text.str());
  return choice.prior;
}

std::string Describe(const EmOptions& options, const std::string& label) {
  std::ostringstream text;
  text.precision(3);
  text << label << ": tau " << options.tau << ", surface ";
  if (options.reflection.Known())
    text << options.reflection.strength << " of Fresnel's, roughness " << options.reflection.roughness;
  else
    text << "of each light its own";
  return text.str();
}

}  // namespace

Result<std::vector<const SrdBatch*>> TrainingLights(const SrdSet& srds, int heldout, std::vector<int>* projectors) {
  std::vector<const SrdBatch*> lights;
  for (const auto* batches : {&srds.batches, &srds.row_batches})
    for (int p = 0; p < static_cast<int>(batches->size()); ++p) {
      if (p == heldout) continue;
      lights.push_back(&(*batches)[p]);
      projectors->push_back(p);
    }
  if (lights.empty())
    return Status::Usage("with projector " + std::to_string(heldout) +
                         " held out no light is left to fit: the layers need sweeps of two projectors at least");
  return lights;
}

Result<MixtureMap> FitLayers(const SrdSet& srds, int heldout, EmOptions options, Logger& logger,
                             const std::string& label) {
  std::vector<int> projectors;
  SLX_ASSIGN_OR_RETURN(const auto lights, TrainingLights(srds, heldout, &projectors));
  // Pooled profiles have more photons and a wider response, which EM resolves slowly, and are fewer by as much.
  constexpr int kMostSweeps = 100000;
  options.max_iterations =
      static_cast<int>(std::min<int64_t>(int64_t{options.max_iterations} * srds.pool * srds.pool, kMostSweeps));
  options.reflection = {};
  if (options.surface_term && options.estimate_reflection)
    options.reflection = EstimateSurfaceReflection(lights, srds.channels, options.eta);
  if (options.gain_model) options.tau = EstimateTau(lights, options.eta, options.reflection);
  logger.Info(Describe(options, label));
  if (options.choose_directions && options.mode == FitMode::kTied && !options.direction_blind) {
    SLX_ASSIGN_OR_RETURN(const auto chosen, EstimateDirections(lights, srds.channels, options));
    options.tau = chosen.tau;
    options.directional = chosen.weights;
    std::ostringstream text;
    text << label << ": tau " << chosen.tau << ", kappa " << chosen.weights.kappa_per_mm << " / mm, phase slope "
         << chosen.weights.phase_slope << ", sigma_0 " << chosen.weights.sigma_0_mm << " mm; training divergence "
         << chosen.divergence << ", without " << chosen.divergence_without;
    logger.Info(text.str());
  }
  int64_t usable = 0;
  for (int64_t i = 0; i < lights[0]->profiles(); ++i) {
    bool any = false;
    for (const SrdBatch* b : lights) any = any || b->valid[i] != 0;
    usable += any ? 1 : 0;
  }
  std::vector<LayerSet> start;
  const bool free = options.mode == FitMode::kFree;
  if (options.choose_prior || options.prior.photons > 0.0) {
    EmOptions tied = options;  // the session's mean layers, which all pixels start from, are those of all lights
    tied.mode = FitMode::kTied;
    SLX_ASSIGN_OR_RETURN(start, MeanLayers(lights, srds.channels, tied));
    SLX_ASSIGN_OR_RETURN(options.prior, PriorOf(lights, projectors, srds.channels, tied, logger, label));
  }
  Progress progress(logger, label, free ? usable * static_cast<int64_t>(lights.size()) : usable);
  const auto advance = [&](int64_t done) { progress.Advance(done); };
  if (free) return FitFree(lights, projectors, srds.width, srds.height, srds.channels, options, start, advance);
  return FitMixture(lights, projectors, srds.width, srds.height, srds.channels, options, start, advance);
}

Result<std::vector<LightComparison>> CompareHeldOut(const HoldOutInput& in, const std::vector<ModelToCompare>& models,
                                                    const std::vector<std::string>& lights,
                                                    std::vector<HeldOutFigure>& figures) {
  const RigCalibration& rig = *in.frames.calibration();
  const PlanOptions& plan = *in.frames.plan();
  const double open = 1.0 - rig.projectors[in.projector].black_level;  // a frame minus its black frame
  const LitSurface lit = BuildLitSurface(in.surface, rig.projectors[in.projector], plan.exposure_ms);
  SLX_ASSIGN_OR_RETURN(const auto dark, in.frames.MeanBlack(in.projector));
  const Image<uint8_t> mask = SkinMask(in, *models[0].map);
  const Image<float> rho_measured = MeasuredSurface(in, *models[0].map),
                     rho_trained = SurfaceReflectance(*models[0].map, in.surface, lit.light, in.pool);
  std::vector<LightComparison> comparisons;
  for (const std::string& light : lights) {
    const Pattern pattern = PatternOf(light, plan);
    SLX_ASSIGN_OR_RETURN(const auto raw, in.frames.Read(in.projector, PhaseOf(light), pattern));
    const Image<float> variance = QuadVariance(raw, rig.camera);
    const LitPyramid pyramid = LightWith(lit, pattern, open);
    LightComparison comparison{light, QuadSignal(raw, dark, rig.camera), {}, {}, {}, {}};
    comparison.surface_measured = RenderSurface(rho_measured, in.surface, rig, pyramid, lit);
    comparison.surface_rendered = RenderSurface(rho_trained, in.surface, rig, pyramid, lit);
    // The subsurface part alone: the truth in simulation, else what is measured less its direct part.
    Image<float> reference = Difference(comparison.measured, comparison.surface_measured);
    if (in.truth) {
      SLX_ASSIGN_OR_RETURN(reference, in.truth->Subsurface(light, in.projector));
    }
    for (const ModelToCompare& model : models) {
      const Image<float> subsurface = RenderSubsurface(*model.map, in.surface, rig, pyramid, lit, {in.pool});
      auto add = [&](const char* part, const char* direct, const Image<float>& real, const Image<float>& estimate) {
        const bool of_truth = &real == &reference && in.truth;
        figures.push_back({in.projector, light, model.name, part, direct, in.geometry, in.pool,
                           CompareImages(real, estimate, mask), of_truth ? 0.0 : NoiseFloor(real, variance, mask)});
      };
      add("total", "measured", comparison.measured, Sum(subsurface, comparison.surface_measured));
      add("total", "rendered", comparison.measured, Sum(subsurface, comparison.surface_rendered));
      add("subsurface", "none", reference, subsurface);
      if (&model == &models[0]) comparison.subsurface = subsurface;
    }
    comparison.total = Sum(comparison.subsurface, comparison.surface_measured);
    comparisons.push_back(std::move(comparison));
  }
  return comparisons;
}

}  // namespace stratalux::fit
