// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/sensor.h"

#include <cmath>

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

CameraElectronics Camera(double gain_e_per_dn, double read_noise_dn) {
  CameraElectronics camera;
  camera.gain_e_per_dn = gain_e_per_dn;
  camera.read_noise_dn = read_noise_dn;
  return camera;
}

struct NoiseOf {
  bool noise = true;
  uint64_t seed = 1;
};

Image<uint16_t> Expose(Image<float> light, const CameraElectronics& camera, const SensorExposure& exposure,
                       const NoiseOf& noise = {}) {
  Pinhole model;
  model.width = light.width();
  model.height = light.height();
  model.fx = model.fy = 1.2 * light.width();
  model.cx = 0.5 * (light.width() - 1);
  model.cy = 0.5 * (light.height() - 1);
  return Sensor(model, {camera, noise.noise ? Noise::kOn : Noise::kOff, noise.seed}).Expose(std::move(light), exposure);
}

Image<uint16_t> ExposeSensor(Image<float> light, const CameraElectronics& camera, int64_t number,
                             const NoiseOf& noise) {
  return Expose(std::move(light), camera, {16.0, 1.0, number}, noise);
}

struct Moments {
  double mean = 0.0, variance = 0.0;
};

Moments MomentsOf(const Image<uint16_t>& raw) {
  double sum = 0.0, squares = 0.0;
  for (const uint16_t v : raw.pixels()) {
    sum += v;
    squares += double(v) * v;
  }
  const double n = static_cast<double>(raw.size()), mean = sum / n;
  return {mean, squares / n - mean * mean};
}

constexpr int kSize = 256;
constexpr double kPixels = double(kSize) * kSize;

Image<float> Flat(float light_dn) { return {kSize, kSize, 1, light_dn}; }

TEST(Sensor, VarianceIsTheLineOfThePhotonTransferCurve) {
  // variance = read^2 + signal / gain (+ 1/12 of rounding to whole numbers), European Machine Vision Association 1288.
  for (const double gain : {1.0, 4.0})
    for (const float signal : {0.0F, 50.0F, 400.0F, 3000.0F}) {
      const Moments m = MomentsOf(ExposeSensor(Flat(signal), Camera(gain, 3.0), 7, {.noise = true, .seed = 3}));
      const double variance = signal / gain + 9.0 + 1.0 / 12.0;
      EXPECT_NEAR(m.mean, 64.0 + signal, 5.0 * std::sqrt(variance / kPixels)) << gain << ' ' << signal;
      EXPECT_NEAR(m.variance / variance, 1.0, 5.0 * std::sqrt(2.0 / kPixels)) << gain << ' ' << signal;
    }
}

TEST(Sensor, ReadNoiseIsThatOfTheCalibration) {
  for (const double read : {1.0, 3.0, 10.0}) {
    const Moments m = MomentsOf(ExposeSensor(Flat(0.0F), Camera(4.0, read), 1, {.noise = true, .seed = 9}));
    EXPECT_NEAR(m.mean, 64.0, 5.0 * read / std::sqrt(kPixels));
    EXPECT_NEAR(m.variance / (read * read + 1.0 / 12.0), 1.0, 5.0 * std::sqrt(2.0 / kPixels)) << read;
  }
}

TEST(Sensor, WithoutNoiseRoundsToTheNearestNumberAndSaturates) {
  const CameraElectronics camera = Camera(4.0, 3.0);
  const NoiseOf clean{.noise = false, .seed = 1};
  EXPECT_EQ(ExposeSensor(Flat(0.0F), camera, 0, clean)(3, 3), 64);
  EXPECT_EQ(ExposeSensor(Flat(100.4F), camera, 0, clean)(3, 3), 164);
  EXPECT_EQ(ExposeSensor(Flat(100.6F), camera, 0, clean)(3, 3), 165);
  EXPECT_EQ(ExposeSensor(Flat(4031.0F), camera, 0, clean)(3, 3), 4095);
  EXPECT_EQ(ExposeSensor(Flat(1e6F), camera, 0, clean)(3, 3), 4095);
}

TEST(Sensor, NoiseNeverLeavesTheTwelveBits) {
  CameraElectronics camera = Camera(1.0, 10.0);
  camera.black_level_dn = 5.0;
  bool zero = false, top = false;
  for (const float light : {0.0F, 4090.0F}) {
    const Image<uint16_t> raw = ExposeSensor(Flat(light), camera, 2, {.noise = true, .seed = 1});
    for (const uint16_t v : raw.pixels()) {
      ASSERT_LE(v, 4095);
      zero |= v == 0;
      top |= v == 4095;
    }
  }
  EXPECT_TRUE(zero && top) << "both ends are met and clipped, not wrapped";
}

TEST(Sensor, NoiseIsIndependentBetweenNeighboursAndFrames) {
  const CameraElectronics camera = Camera(4.0, 3.0);
  const Image<uint16_t> a = ExposeSensor(Flat(500.0F), camera, 10, {.noise = true, .seed = 1});
  const Image<uint16_t> b = ExposeSensor(Flat(500.0F), camera, 11, {.noise = true, .seed = 1});
  const double mean = 564.0, variance = 500.0 / 4.0 + 9.0;
  double right = 0.0, below = 0.0, next = 0.0;
  for (int y = 0; y < kSize - 1; ++y)
    for (int x = 0; x < kSize - 1; ++x) {
      right += (a(x, y) - mean) * (a(x + 1, y) - mean);
      below += (a(x, y) - mean) * (a(x, y + 1) - mean);
      next += (a(x, y) - mean) * (b(x, y) - mean);
    }
  const double limit = 5.0 * std::sqrt(kPixels) * variance;
  EXPECT_LT(std::abs(right), limit);
  EXPECT_LT(std::abs(below), limit);
  EXPECT_LT(std::abs(next), limit);
}

TEST(Sensor, FrameDependsOnSeedAndNumberAlone) {
  const CameraElectronics camera = Camera(4.0, 3.0);
  auto frame = [&](int64_t number, uint64_t seed) {
    const Image<uint16_t> raw = ExposeSensor(Flat(500.0F), camera, number, {.noise = true, .seed = seed});
    return std::vector<uint16_t>(raw.pixels().begin(), raw.pixels().end());
  };
  EXPECT_EQ(frame(5, 1), frame(5, 1));
  EXPECT_NE(frame(5, 1), frame(6, 1));
  EXPECT_NE(frame(5, 1), frame(5, 2));
  for (const int64_t number : {1, 2, 100, 7919}) EXPECT_NE(frame(number, 1), frame(0, 2)) << "seeds share no noise";
}

TEST(Sensor, DarkCurrentGrowsWithTheExposureAndHasShotNoise) {
  CameraElectronics camera = Camera(4.0, 3.0);
  camera.dark_current_e_per_s = 8000.0;
  for (const double exposure_ms : {10.0, 20.0, 100.0}) {
    const Moments m = MomentsOf(Expose(Flat(0.0F), camera, {exposure_ms, 1.0, 3}));
    const double signal = 8.0 * exposure_ms / 4.0, variance = signal / 4.0 + 9.0 + 1.0 / 12.0;
    EXPECT_NEAR(m.mean, 64.0 + signal, 5.0 * std::sqrt(variance / kPixels));
    EXPECT_NEAR(m.variance / variance, 1.0, 5.0 * std::sqrt(2.0 / kPixels));
  }
}

TEST(Sensor, FixedPatternIsTheSameInEveryFrameAndScalesAsItsKindDoes) {
  CameraElectronics camera = Camera(4.0, 0.0);
  camera.prnu = 0.02;
  camera.dsnu_dn = 5.0;
  const Image<uint16_t> dark = ExposeSensor(Flat(0.0F), camera, 0, {.noise = false}),
                        bright = ExposeSensor(Flat(2000.0F), camera, 1, {.noise = false, .seed = 8});
  EXPECT_NEAR(MomentsOf(dark).variance, 25.0 + 1.0 / 12.0, 25.0 * 5 * std::sqrt(2.0 / kPixels));
  const double both = 25.0 + 40.0 * 40.0;
  EXPECT_NEAR(MomentsOf(bright).variance / both, 1.0, 0.03);
  // Where a pixel reads more in the dark, it does in the light.
  double covariance = 0.0;
  const double mean_dark = MomentsOf(dark).mean, mean_bright = MomentsOf(bright).mean;
  for (size_t i = 0; i < dark.size(); ++i)
    covariance += (dark.data()[i] - mean_dark) * (bright.data()[i] - mean_bright) / kPixels;
  EXPECT_NEAR(covariance, 25.0, 6.0);
}

TEST(Sensor, VignettingIsTheFourthPowerOfTheFieldAnglesCosine) {
  CameraElectronics camera = Camera(4.0, 0.0);
  camera.vignetting = 1.0;
  const Image<uint16_t> raw = ExposeSensor(Flat(3000.0F), camera, 0, {.noise = false});
  for (const int x : {0, 60, 128, 255}) {
    const double u = (x - 127.5) / (1.2 * kSize), v = (40 - 127.5) / (1.2 * kSize);
    EXPECT_NEAR(raw(x, 40) - 64, 3000.0 * std::pow(std::cos(std::atan(std::hypot(u, v))), 4), 0.51);
  }
}

TEST(Sensor, HotPixelsAreAsManyAsStatedAndGrowWithTime) {
  CameraElectronics camera = Camera(4.0, 0.0);
  camera.hot_pixels_per_mpx = 500.0;
  const Image<uint16_t> brief = Expose(Flat(0.0F), camera, {10.0, 1.0, 0}, {.noise = false});
  const Image<uint16_t> longer = Expose(Flat(0.0F), camera, {30.0, 1.0, 0}, {.noise = false});
  int hot = 0;
  for (size_t i = 0; i < brief.size(); ++i) {
    hot += longer.data()[i] > 64;
    if (longer.data()[i] < 4095) {
      EXPECT_NEAR(longer.data()[i] - 64, 3 * (brief.data()[i] - 64), 2.0);
    }
  }
  EXPECT_NEAR(hot, 33, 3);  // 500 per 1e6 of 65,536; two may fall together
}

TEST(Sensor, BlurKeepsTheLightAndHasItsVariance) {
  for (const Cfa cfa : {Cfa::kMono, Cfa::kRggb})
    for (const double sigma : {0.6, 1.5}) {
      CameraElectronics camera = Camera(4.0, 0.0);
      camera.cfa = cfa;
      camera.black_level_dn = 0.0;
      camera.blur_px = sigma;
      Image<float> point(64, 64);
      point(32, 32) = 4000.0F;
      const Image<uint16_t> raw = ExposeSensor(point, camera, 0, {.noise = false});
      double sum = 0.0, square = 0.0;
      for (int y = 0; y < 64; ++y)
        for (int x = 0; x < 64; ++x) {
          sum += raw(x, y);
          square += raw(x, y) * (x - 32.0) * (x - 32.0);
        }
      EXPECT_NEAR(sum / 4000.0, 1.0, 0.01);
      EXPECT_NEAR(std::sqrt(square / sum), sigma, 0.02);
    }
}

TEST(Sensor, BloomingSpillsUpAndDownOnlyAboveTheFullWell) {
  CameraElectronics camera = Camera(4.0, 0.0);
  camera.blooming = 0.5;
  Image<float> spot(9, 33);
  for (float& v : spot.pixels()) v = 100.0F;
  spot(4, 16) = 4031.0F;  // exactly full
  const Image<uint16_t> full = ExposeSensor(spot, camera, 0, {.noise = false});
  EXPECT_EQ(full(4, 15), 164);
  spot(4, 16) = 8031.0F;
  const Image<uint16_t> over = ExposeSensor(spot, camera, 0, {.noise = false});
  EXPECT_NEAR(over(4, 15), 164 + 1000, 1);
  EXPECT_NEAR(over(4, 17), 164 + 1000, 1);
  EXPECT_EQ(over(3, 16), 164);
  EXPECT_EQ(over(5, 16), 164);
}

TEST(Sensor, BloomingSpillsAlikeToBothSidesOfARun) {
  CameraElectronics camera = Camera(4.0, 0.0);
  for (const double blooming : {0.5, 1.0}) {
    camera.blooming = blooming;
    Image<float> run(9, 61);
    for (float& v : run.pixels()) v = 100.0F;
    for (int y = 20; y <= 40; ++y) run(4, y) = 4400.0F;  // all of them over
    const Image<uint16_t> over = ExposeSensor(run, camera, 0, {.noise = false});
    EXPECT_GT(over(4, 19), 164 + 50);
    for (int d = 1; d <= 20; ++d) EXPECT_EQ(over(4, 20 - d), over(4, 40 + d)) << blooming << " " << d;
  }
}

TEST(Sensor, CompressionIsQuadraticAndTenBitsAreFourApart) {
  CameraElectronics camera = Camera(4.0, 0.0);
  camera.compression = 0.05;
  const double full = 4095.0 - 64.0;
  for (const float light : {100.0F, 1500.0F, 3500.0F})
    EXPECT_NEAR(ExposeSensor(Flat(light), camera, 0, {.noise = false})(5, 5), 64 + light * (1 - 0.05 * light / full),
                0.51);
  camera.compression = 0.0;
  camera.bits = 10;
  for (float light = 0.0F; light < 4300.0F; light += 97.3F) {
    const int v = ExposeSensor(Flat(light), camera, 0, {.noise = false})(5, 5);
    EXPECT_EQ(v % 4, 0);
    EXPECT_LE(v, 4092);
    if (light < 4000.0F) {
      EXPECT_NEAR(v, 64 + light, 2.01);
    }
  }
}

TEST(Sensor, ShotNoiseIsOfTheLightAndCompressedWithIt) {
  CameraElectronics camera = Camera(4.0, 0.0);
  camera.compression = 0.1;
  const double full = 4095.0 - 64.0, light = 3000.0, slope = 1.0 - 2.0 * 0.1 * light / full;
  double sum = 0.0, squares = 0.0, count = 0.0;
  const Image<uint16_t> raw = ExposeSensor(Flat(static_cast<float>(light)), camera, 0, {});
  for (const uint16_t v : raw.pixels()) {
    sum += v;
    squares += double(v) * v;
    ++count;
  }
  const double variance = squares / count - (sum / count) * (sum / count) - 1.0 / 12.0;
  EXPECT_NEAR(variance / (slope * slope * light / 4.0), 1.0, 6.0 * std::sqrt(2.0 / count));
}

}  // namespace
}  // namespace stratalux::rig
