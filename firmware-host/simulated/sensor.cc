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

Sensor::Sensor(const Pinhole& camera, const SensorOptions& options)
    : options_(options),
      top_(options.electronics.bits == 10 ? 4092.0F : 4095.0F),
      step_(options.electronics.bits == 10 ? 4.0F : 1.0F) {
  MakeFixedPattern(camera);
}

void Sensor::MakeFixedPattern(const Pinhole& camera) {
  const CameraElectronics& e = options_.electronics;
  constexpr uint64_t kSerialNumber = 0x5e4507;
  if (e.vignetting > 0.0 || e.prnu > 0.0) {
    Random random(kSerialNumber, 1);
    sensitivity_ = Image<float>(camera.width, camera.height, 1, 1.0F);
    for (int y = 0; y < camera.height; ++y)
      for (int x = 0; x < camera.width; ++x) {
        const double u = (x - camera.cx) / camera.fx, v = (y - camera.cy) / camera.fy;
        const double cos4 = 1.0 / ((1.0 + u * u + v * v) * (1.0 + u * u + v * v));
        sensitivity_(x, y) =
            static_cast<float>(std::pow(cos4, e.vignetting) * std::max(0.0, 1.0 + e.prnu * random.Normal()));
      }
  }
  if (e.dsnu_dn > 0.0) {
    Random random(kSerialNumber, 2);
    offset_dn_ = Image<float>(camera.width, camera.height);
    for (float& v : offset_dn_.pixels()) v = static_cast<float>(e.dsnu_dn * random.Normal());
  }
  if (e.hot_pixels_per_mpx > 0.0) {
    Random random(kSerialNumber, 3);
    hot_dn_per_ms_ = Image<float>(camera.width, camera.height);
    const auto count = static_cast<int64_t>(e.hot_pixels_per_mpx * camera.width * camera.height * 1e-6 + 0.5);
    for (int64_t i = 0; i < count; ++i) {
      const int x = static_cast<int>(random.Uniform() * camera.width),
                y = static_cast<int>(random.Uniform() * camera.height);
      hot_dn_per_ms_(x, y) = static_cast<float>(-e.hot_dn_per_ms * std::log(1.0 - random.Uniform()));
    }
  }
}

// Same-colour neighbours stand for what lies between them; the blur's variance is exact.
void Sensor::Blur(Image<float>& light) const {
  const double variance = options_.electronics.blur_px * options_.electronics.blur_px;
  const int step = options_.electronics.cfa == Cfa::kMono ? 1 : 2;
  const int passes = static_cast<int>(std::ceil(variance / (0.5 * step * step)));
  const auto w = static_cast<float>(variance / (2.0 * step * step * passes));
  for (int pass = 0; pass < passes; ++pass)
    for (const bool along_x : {true, false}) {
      const Image<float> from = light;
      ParallelFor(light.height(), 32, [&](int64_t begin, int64_t end) {
        for (int y = static_cast<int>(begin); y < end; ++y)
          for (int x = 0; x < light.width(); ++x) {
            const int x0 = along_x && x >= step ? x - step : x, x1 = along_x && x + step < light.width() ? x + step : x;
            const int y0 = !along_x && y >= step ? y - step : y,
                      y1 = !along_x && y + step < light.height() ? y + step : y;
            light(x, y) = (1.0F - 2.0F * w) * from(x, y) + w * (from(x0, y0) + from(x1, y1));
          }
      });
    }
}

// Charge above the full well spills to the neighbours above and below, and on from there.
void Sensor::Bloom(Image<float>& light) const {
  const float full = top_ - static_cast<float>(options_.electronics.black_level_dn);
  const auto share = static_cast<float>(0.5 * options_.electronics.blooming);
  std::vector<float> column(static_cast<size_t>(light.height()));  // before anything spilled: both ways start from it
  for (int x = 0; x < light.width(); ++x) {
    for (int y = 0; y < light.height(); ++y) column[y] = light(x, y);
    for (const bool down : {true, false}) {
      float carried = 0.0F;
      for (int i = 0; i < light.height(); ++i) {
        const int y = down ? i : light.height() - 1 - i;
        light(x, y) += carried;
        carried = share * std::max(0.0F, column[y] + carried - full);
      }
    }
  }
}

void Sensor::AddVices(Image<float>& light, const SensorExposure& exposure) const {
  const CameraElectronics& e = options_.electronics;
  if (e.blur_px > 0.0) Blur(light);
  if (!sensitivity_.empty())
    for (size_t i = 0; i < light.size(); ++i) light.data()[i] *= sensitivity_.data()[i];
  const auto dark =
      static_cast<float>(e.dark_current_e_per_s / e.gain_e_per_dn * 1e-3 * exposure.exposure_ms * exposure.gain);
  if (dark > 0.0F)
    for (float& v : light.pixels()) v += dark;
  if (!hot_dn_per_ms_.empty()) {
    const auto scale = static_cast<float>(exposure.exposure_ms * exposure.gain);
    for (size_t i = 0; i < light.size(); ++i) light.data()[i] += scale * hot_dn_per_ms_.data()[i];
  }
  if (e.blooming > 0.0) Bloom(light);
  if (e.compression > 0.0) {
    const float per_dn = static_cast<float>(e.compression / (top_ - e.black_level_dn));
    for (float& v : light.pixels()) v *= 1.0F - per_dn * std::clamp(v, 0.0F, top_);
  }
}

Image<uint16_t> Sensor::Expose(Image<float> light, const SensorExposure& exposure) const {
  AddVices(light, exposure);
  const auto& normal = NormalTable();
  const CameraElectronics& e = options_.electronics;
  Image<uint16_t> raw(light.width(), light.height());
  const auto black = static_cast<float>(e.black_level_dn);
  const auto per_gain = static_cast<float>(exposure.gain / e.gain_e_per_dn);
  const auto read2 = static_cast<float>(e.read_noise_dn * e.read_noise_dn * exposure.gain * exposure.gain);
  const int step = static_cast<int>(step_);
  const float per_step = 1.0F / step_;
  const bool noisy = options_.noise == Noise::kOn;
  // Charges are counted before they are compressed: v = c - per_dn c^2 of c has the noise of c, (1 - 2 per_dn c) times.
  const auto per_dn = static_cast<float>(e.compression / (top_ - e.black_level_dn));
  const auto shot = [per_dn, per_gain](float v) {
    if (!(per_dn > 0.0F)) return std::max(v, 0.0F) * per_gain;
    const float slope2 = std::max(1.0F - 4.0F * per_dn * std::max(v, 0.0F), 0.0F);
    return slope2 * 0.5F * (1.0F - std::sqrt(slope2)) / per_dn * per_gain;
  };
  ParallelFor(light.height(), 16, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y) {
      Random random(options_.seed, (static_cast<uint64_t>(exposure.number) << 16) + static_cast<uint64_t>(y));
      uint64_t bits = 0;
      const float* in = light.row(y);
      const float* offset = offset_dn_.empty() ? nullptr : offset_dn_.row(y);
      uint16_t* out = raw.row(y);
      for (int x = 0; x < raw.width(); ++x) {
        float value = in[x] + black + (offset == nullptr ? 0.0F : offset[x]);
        if (noisy) {
          if (x % 4 == 0) bits = random.Bits();
          // Photo-electrons are many (4 a digital number): their Poisson noise is normal with variance signal / gain.
          value += normal[bits & 65535U] * std::sqrt(shot(in[x]) + read2);
          bits >>= 16;
        }
        const int steps = static_cast<int>(std::clamp(value, 0.0F, top_) * per_step + 0.5F);
        out[x] = static_cast<uint16_t>(steps * step);
      }
    }
  });
  return raw;
}

}  // namespace stratalux::rig
