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

}  // namespace
}  // namespace stratalux::rig
