// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/sensor.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "shared/base/parallel.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

// Standard normal quantiles at (i + 1/2) / 65536: a 16-bit random number looks one up.
const std::array<float, 65536>& NormalTable() {
  static const auto table = [] {
    auto t = std::array<float, 65536>{};
    double z = -4.4;
    for (size_t i = 0; i < t.size(); ++i) {
      const double p = (static_cast<double>(i) + 0.5) / 65536.0;
      for (int k = 0; k < 8; ++k) {  // Newton on the normal distribution function
        const double error = 0.5 * std::erfc(-z / std::sqrt(2.0)) - p;
        z -= std::clamp(error / (std::exp(-0.5 * z * z) / std::sqrt(2.0 * 3.141592653589793)), -0.5, 0.5);
      }
      t[i] = static_cast<float>(z);
    }
    return t;
  }();
  return table;
}

}  // namespace

Image<uint16_t> ExposeSensor(const Image<float>& light_dn, const CameraCalibration& camera, int64_t number,
                             const SensorOptions& options) {
  const auto& normal = NormalTable();
  Image<uint16_t> raw(light_dn.width(), light_dn.height());
  const float black = static_cast<float>(camera.black_level_dn);
  const float per_gain = 1.0F / static_cast<float>(camera.gain_e_per_dn);
  const float read2 = static_cast<float>(camera.read_noise_dn * camera.read_noise_dn);
  const float top = static_cast<float>(camera.saturation_dn);
  ParallelFor(light_dn.height(), 16, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y) {
      Random random(options.seed, (static_cast<uint64_t>(number) << 16) + static_cast<uint64_t>(y));
      uint64_t bits = 0;
      const float* light = light_dn.row(y);
      uint16_t* out = raw.row(y);
      for (int x = 0; x < raw.width(); ++x) {
        float value = light[x] + black;
        if (options.noise) {
          if (x % 4 == 0) bits = random.Bits();
          // Photo-electrons are many (4 a digital number): their Poisson noise is normal with variance signal / gain.
          value += normal[bits & 65535U] * std::sqrt(std::max(light[x], 0.0F) * per_gain + read2);
          bits >>= 16;
        }
        out[x] = static_cast<uint16_t>(std::clamp(value + 0.5F, 0.0F, top));
      }
    }
  });
  return raw;
}

}  // namespace stratalux::rig
