// SPDX-License-Identifier: Apache-2.0
#include "fitter/session/quad_signal.h"

#include <algorithm>
#include <cmath>

#include "shared/geometry/quad.h"

namespace stratalux::fit {

double SaturationOf(const SessionFrames& frames) {
  const double told = frames.info().devices.saturation_dn;
  return told > 0.0 || frames.rows().empty() ? told : FullScaleDn(frames.rows()[0].record.format);
}

SensorNoise NoiseOf(const SessionFrames& frames) {
  if (frames.calibration()) return SensorNoise::From(frames.calibration()->camera);
  const double saturation = SaturationOf(frames);
  if (frames.rows()[0].record.format == PixelFormat::kMono8) return {0.0, saturation, 20.0, 1.0};
  // A sensor of 4 electrons a digital number of 12 bits and a read noise of 12 electrons, in whatever numbers its range
  // is told.
  const double dn_per_dn12 = saturation / FullScaleDn(PixelFormat::kMono12);
  return {0.0, saturation, 4.0 / dn_per_dn12, 3.0 * dn_per_dn12};
}

Image<float> QuadSignal(ImageView<const uint16_t> raw, ImageView<const float> dark, const CameraCalibration& camera) {
  const int step = QuadStep(camera.cfa), channels = QuadChannels(camera.cfa);
  Image<float> quads(raw.width() / step, raw.height() / step, channels);
  for (int j = 0; j < quads.height(); ++j)
    for (int i = 0; i < quads.width(); ++i) {
      float sum[3] = {}, count[3] = {};
      for (int y = j * step; y < (j + 1) * step; ++y)
        for (int x = i * step; x < (i + 1) * step; ++x) {
          const int c = CfaColour(camera.cfa, x, y);
          sum[c] += raw(x, y) >= camera.saturation_dn ? std::nanf("") : static_cast<float>(raw(x, y)) - dark(x, y);
          count[c] += 1.0F;
        }
      for (int c = 0; c < channels; ++c) quads(i, j, c) = sum[c] / count[c];
    }
  return quads;
}

Image<float> QuadVariance(ImageView<const uint16_t> raw, const CameraCalibration& camera) {
  const int step = QuadStep(camera.cfa), channels = QuadChannels(camera.cfa);
  const double read2 = camera.read_noise_dn * camera.read_noise_dn;
  Image<float> quads(raw.width() / step, raw.height() / step, channels);
  for (int j = 0; j < quads.height(); ++j)
    for (int i = 0; i < quads.width(); ++i) {
      double sum[3] = {}, count[3] = {};
      for (int y = j * step; y < (j + 1) * step; ++y)
        for (int x = i * step; x < (i + 1) * step; ++x) {
          const int c = CfaColour(camera.cfa, x, y);
          sum[c] += std::max(raw(x, y) - camera.black_level_dn, 0.0) / camera.gain_e_per_dn + read2;
          count[c] += 1.0;
        }
      for (int c = 0; c < channels; ++c) quads(i, j, c) = static_cast<float>(sum[c] / (count[c] * count[c]));
    }
  return quads;
}

}  // namespace stratalux::fit
