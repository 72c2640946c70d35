// SPDX-License-Identifier: Apache-2.0
#include "fitter/session/quad_signal.h"

#include <algorithm>
#include <cmath>

#include "shared/geometry/quad.h"

namespace stratalux::fit {

SensorNoise NoiseOf(const SessionFrames& frames) {
  if (frames.calibration()) return SensorNoise::From(frames.calibration()->camera);
  const bool eight_bit = frames.rows()[0].record.format == PixelFormat::kMono8;
  return {0.0, eight_bit ? 255.0 : 4095.0, eight_bit ? 20.0 : 4.0, eight_bit ? 1.0 : 3.0};
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
