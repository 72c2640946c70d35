// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/profile_light.h"

#include <cmath>

#include "fitter/mixture/fine_grid.h"
#include "fitter/mixture/photon_noise.h"
#include "fitter/mixture/surface_reflection.h"

namespace stratalux::fit {

double ProfileLight::Gain(double tau) const { return fresnel * std::exp(-tau * gain_path); }

ProfileLight ProfileLightOf(const SrdBatch& batch, int64_t profile, const EmOptions& options) {
  ProfileLight light;
  const auto y = batch.Samples(profile);
  light.y.assign(y.begin(), y.end());
  light.first_u_mm = batch.first_u_mm[profile];
  light.step_mm = batch.step_mm[profile];
  light.wrapped = batch.wrapped;
  light.cells_per_sample = CellsPerSample(batch, profile, batch.blur_mm[profile], options);
  light.line = LineResponseOf(batch, profile, light.step_mm / light.cells_per_sample);
  const PhotonNoise noise = PhotonNoiseOf(batch, profile);
  light.counts = noise.counts;
  light.read_shift = noise.read_shift;
  if (!batch.white_variance.empty()) light.white_variance = batch.white_variance[profile];
  const ScatteringModel& model = options.scattering;
  light.s = ShiftCoefficient(model, batch, profile);
  light.directions = DirectionsOf(batch, profile, model.eta);
  light.reflected = HeldReflection(model.reflection, batch, profile, model.eta);
  if (model.gain_model) {
    light.fresnel = AngularGain(batch.cos_in[profile], model.eta, 0.0);
    light.gain_path = GainPath(batch.cos_in[profile], model.eta);
  }
  return light;
}

}  // namespace stratalux::fit
