// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/scattering_model.h"

namespace stratalux::fit {

double ShiftCoefficient(const ScatteringModel& model, const SrdBatch& batch, int64_t profile) {
  if (model.mode == FitMode::kFree) return 1.0;
  return TangentialShift(model.shift_law, batch.slope_in[profile], batch.slope_in_across[profile], model.eta) -
         TangentialShift(model.shift_law, batch.slope_out[profile], batch.slope_out_across[profile], model.eta);
}

double AngularGain(const ScatteringModel& model, double cos_in) {
  return model.gain_model ? AngularGain(cos_in, model.eta, model.tau) : 1.0;
}

}  // namespace stratalux::fit
