// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/holdout.h"

#include "fitter/pipeline/heldout_takes.h"
#include "fitter/pipeline/measured_surface.h"

namespace stratalux::fit {
namespace {

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

}  // namespace

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
    const Pattern pattern = HeldOutPattern(light, plan);
    SLX_ASSIGN_OR_RETURN(const auto raw, in.frames.Read(in.projector, HeldOutPhase(light), pattern));
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
