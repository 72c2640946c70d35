// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/line_response.h"
#include "fitter/mixture/surface_reflection.h"

namespace stratalux::fit {
namespace {

// Exact response of a sample to a layer, by their distance: the line response's Gaussian and the layer's add in
// variance.
LineResponse WithLayer(LineResponse line, double sigma) {
  line.blur_mm = std::hypot(line.blur_mm, sigma);
  line.cell_mm = 1e-3 * line.blur_mm;  // a point, not a cell
  return line;
}

}  // namespace

std::vector<double> PredictSamples(const LayerSet& layers, const SrdBatch& batch, int64_t profile,
                                   const ScatteringModel& model, double reach_mm) {
  const double step = batch.step_mm[profile], period = step * batch.samples;
  const LineResponse line = LineResponseOf(batch, profile, 1e-4);
  const double s = ShiftCoefficient(model, batch, profile), gain = AngularGain(model, batch.cos_in[profile]);
  const RefractedDirections directions = DirectionsOf(batch, profile, model.eta);
  std::vector<double> weight;
  std::vector<LineResponse> response;
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    weight.push_back(gain * layers.weight[l] *
                     DirectionalFactor(model.directional, directions, layers.depth_mm[l], layers.sigma_mm[l]));
    response.push_back(WithLayer(line, layers.sigma_mm[l]));
  }
  std::vector<double> y(batch.samples, 0.0);
  for (int k = 0; k < batch.samples; ++k) {
    const double from_line = batch.first_u_mm[profile] + k * step;
    if (std::abs(batch.wrapped ? std::remainder(from_line, period) : from_line) > reach_mm) continue;
    for (size_t l = 0; l < layers.weight.size(); ++l) {
      const double u = from_line - layers.depth_mm[l] * s;
      double sum = 0.0;
      if (batch.wrapped) {
        const double nearest = std::remainder(u, period);
        for (int image = -1; image <= 1; ++image) sum += response[l].At(nearest + image * period);
      } else {
        sum = response[l].At(u);
      }
      y[k] += weight[l] * sum;
    }
  }
  return y;
}

UnlayeredLight UnlayeredOf(const MixtureMap& map, int64_t profile, int projector, const SrdBatch& batch, int64_t at) {
  const auto lights = std::ssize(map.training_projectors);
  for (std::ptrdiff_t p = 0; p < lights; ++p)
    if (map.training_projectors[p] == projector)
      return {map.surface[profile * lights + p], map.background[profile * lights + p]};
  UnlayeredLight light = MeanOfLights(map, profile);
  const SurfaceReflection& reflection = map.scattering.reflection;
  if (reflection.Known())
    light.surface = static_cast<float>(ReflectanceOf(reflection, ReflectionAngles::Of(batch, at), map.scattering.eta,
                                                     reflection.gloss.At(map.PlaceOf(profile))));
  return light;
}

std::vector<double> PredictSamples(const LayerSet& layers, const UnlayeredLight& beside, const SrdBatch& batch,
                                   int64_t profile, const ScatteringModel& model, double reach_mm) {
  std::vector<double> y = PredictSamples(layers, batch, profile, model, reach_mm);
  const double step = batch.step_mm[profile], period = step * batch.samples;
  const LineResponse line = LineResponseOf(batch, profile, 1e-4);
  for (int k = 0; k < batch.samples; ++k) {
    const double from_line = batch.first_u_mm[profile] + k * step;
    const double u = batch.wrapped ? std::remainder(from_line, period) : from_line;
    if (std::abs(u) > reach_mm) continue;
    y[k] += beside.surface * line.At(u) + beside.background;
  }
  return y;
}

}  // namespace stratalux::fit
