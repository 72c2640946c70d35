// SPDX-License-Identifier: Apache-2.0
// One axis of micro phase shifting at one camera site: the column that the waves of all planes agree on, with the
// separation's sinusoids where there are any (docs/math/geometry.md, eq. 5b to 5d).
#pragma once

#include "fitter/structured_light/sinusoid.h"
#include "fitter/structured_light/site_reading.h"
#include "shared/pattern/micro_phase.h"

namespace stratalux::fit {

class MicroPhaseDecoder {
 public:
  MicroPhaseDecoder(const AxisCode& code, const SensorNoise& noise, const DecodeOptions& options);

  // Of a wave's frames both must be unsaturated: beside it a bound is of no use. All of the code's planes can be
  // trusted, or none.
  [[nodiscard]] Position Decode(size_t site, const SiteLight& light) const;

 private:
  const AxisCode& code_;
  const SensorNoise& noise_;
  const DecodeOptions& options_;
  ShiftTable table_;
  MicroPhaseSearch search_;
};

}  // namespace stratalux::fit
