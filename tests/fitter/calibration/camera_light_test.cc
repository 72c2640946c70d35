// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/camera_light.h"

#include <cmath>

#include <gtest/gtest.h>

#include "fitter/sensor/linear_frame.h"
#include "fitter/structured_light/sensor_noise.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

// A camera as the record describes it, with vices that no part under test knows.
struct Camera {
  int width = 192, height = 128;
  double black = 60.0, read = 2.7, gain = 4.3, compression = 0.0;
  double dsnu = 0.8, dark_dn_per_s = 6.0;
  int step = 1;

  // Signal that a linear pixel above black turns into, DN.
  [[nodiscard]] double Compressed(double light) const { return light * (1.0 - compression * light / (4095.0 - black)); }
  [[nodiscard]] Image<uint16_t> Expose(double light_per_ms, double ms, uint64_t seed) const {
    Random fixed(99), noise(seed);
    Image<uint16_t> raw(width, height);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const double offset = black + dsnu * fixed.Normal(), sensitivity = 1.0 + 0.01 * fixed.Normal();
        // Brighter to the right, as targets are.
        const double light = light_per_ms * ms * (0.4 + 0.6 * x / width) * sensitivity + 1e-3 * dark_dn_per_s * ms;
        // Shot noise is of the light, and compressed with it; read noise comes behind that.
        const double slope = 1.0 - 2.0 * compression * light / (4095.0 - black);
        const double value =
            offset + Compressed(light) + noise.Normal() * std::sqrt(read * read + slope * slope * light / gain);
        raw(x, y) = static_cast<uint16_t>(std::lround(std::clamp(value, 0.0, 4095.0) / step) * step);
      }
    return raw;
  }
  [[nodiscard]] ExposureRamp Ramp(double light_per_ms, double lamp_jitter = 0.0) const {
    ExposureRamp ramp(Cfa::kRggb, 4095.0, black);
    uint64_t seed = 1;
    for (const double share : {1.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85}) {
      const double ms = 16.0 * share;
      const auto a = Expose(light_per_ms * (1.0 + lamp_jitter), ms, ++seed), b = Expose(light_per_ms, ms, ++seed),
                 dark = Expose(0.0, ms, ++seed);
      ramp.Add({a, b, dark, ms});
    }
    return ramp;
  }
};

TEST(DarkStatistics, TellsLevelNoisePatternAndCurrentApart) {
  const Camera camera;
  DarkStatistics statistics;
  uint64_t seed = 0;
  for (const double ms : {16.0, 4.0, 64.0})
    for (int i = 0; i < 12; ++i) {
      Image<uint16_t> raw = camera.Expose(0.0, ms, ++seed);
      raw(17, 5) = static_cast<uint16_t>(60 + 20 * ms);  // a hot pixel
      ASSERT_TRUE(statistics.Add(raw, ms).ok());
    }
  const auto dark = statistics.Finish();
  ASSERT_TRUE(dark.ok()) << dark.status().message();
  EXPECT_NEAR(dark->black_level_dn, 60.0, 0.05);
  EXPECT_NEAR(dark->read_noise_dn, 2.7, 0.05 * 2.7);
  EXPECT_NEAR(dark->offset_spread_dn, 0.8, 0.1);
  EXPECT_NEAR(dark->dark_current_dn_per_s, 6.0, 1.0);
  EXPECT_EQ(dark->hot_pixels, 1);
  EXPECT_EQ(dark->hot(17, 5), 1);
}

TEST(DarkStatistics, RefusesFramesThatTellNoNoise) {
  const Camera camera;
  DarkStatistics statistics;
  EXPECT_FALSE(statistics.Finish().ok());
  ASSERT_TRUE(statistics.Add(camera.Expose(0.0, 16.0, 1), 16.0).ok());
  EXPECT_NE(statistics.Finish().status().message().find("only 1 dark frames"), std::string::npos);
  EXPECT_FALSE(statistics.Add(Image<uint16_t>(8, 8), 16.0).ok());
}

TEST(PhotonTransfer, FixedPatternAndLampLeaveTheGainAlone) {
  Camera camera;
  for (const double jitter : {0.0, 0.01}) {
    const auto transfer = camera.Ramp(200.0, jitter).Transfer({});
    ASSERT_TRUE(transfer.ok()) << transfer.status().message();
    EXPECT_NEAR(transfer->gain_e_per_dn, 4.3, 0.02 * 4.3) << jitter;
    EXPECT_NEAR(transfer->gain_e_per_dn, 4.3, 4.0 * transfer->gain_sd);
    EXPECT_NEAR(transfer->read_noise_dn, 2.7, 0.3);
  }
}

TEST(PhotonTransfer, QuantisationIsNotReadNoise) {
  Camera camera;
  camera.step = 4;
  const auto transfer = camera.Ramp(200.0).Transfer({});
  ASSERT_TRUE(transfer.ok());
  EXPECT_NEAR(transfer->gain_e_per_dn, 4.3, 0.02 * 4.3);
  EXPECT_NEAR(transfer->read_noise_dn, 2.7, 0.3);
  QuantisationStep step;
  step.Add(Image<uint16_t>(8, 8, 1, 64));
  EXPECT_EQ(step.dn(), 64) << "of levels that are all alike";
  step.Add(camera.Expose(100.0, 16.0, 3));
  EXPECT_EQ(step.dn(), 4);
}

TEST(PhotonTransfer, OfACompressingCameraIsThatOfItsCharges) {
  Camera camera;
  camera.compression = 0.1;
  const ExposureRamp ramp = camera.Ramp(230.0);
  const auto response = ramp.Response();
  ASSERT_TRUE(response.ok()) << response.status().message();
  const auto transfer = ramp.Transfer(response->response), straight = ramp.Transfer({});
  ASSERT_TRUE(transfer.ok() && straight.ok());
  EXPECT_NEAR(transfer->gain_e_per_dn, 4.3, 0.02 * 4.3);
  EXPECT_GT(straight->gain_e_per_dn, 1.05 * 4.3);  // the ablation
}

// What a record says of a coarse camera's samples is what they scatter by.
TEST(PhotonTransfer, TheRecordsNoiseHoldsACoarseStep) {
  Camera camera;
  camera.step = 16;
  const auto transfer = camera.Ramp(200.0).Transfer({});
  ASSERT_TRUE(transfer.ok());
  SensorNoise noise;
  noise.black_level_dn = camera.black;
  noise.gain_e_per_dn = transfer->gain_e_per_dn;
  noise.read_noise_dn = NoiseInTheDark(transfer->read_noise_dn, transfer->step_dn);
  const auto a = camera.Expose(4.0, 16.0, 11), b = camera.Expose(4.0, 16.0, 12);
  double variance = 0.0, level = 0.0, sites = 0.0;
  for (size_t i = 0; i < a.size(); ++i) {
    if (a.pixels()[i] > 1000 || b.pixels()[i] > 1000) continue;  // a hot one
    variance += 0.5 * std::pow(double(a.pixels()[i]) - b.pixels()[i], 2);
    level += a.pixels()[i];
    ++sites;
  }
  EXPECT_NEAR(noise.VarianceDn2(level / sites) / (variance / sites), 1.0, 0.1);
  noise.read_noise_dn = transfer->read_noise_dn;
  EXPECT_LT(noise.VarianceDn2(level / sites) / (variance / sites), 0.6);  // the ablation
}

TEST(CameraResponse, UndoesACompressionThatNobodyTold) {
  Camera camera;
  camera.compression = 0.08;
  const auto report = camera.Ramp(240.0).Response();
  ASSERT_TRUE(report.ok()) << report.status().message();
  CameraCalibration calibration;
  calibration.black_level_dn = camera.black;
  calibration.response = report->response;
  const double range = 4095.0 - camera.black;
  double worst = 0.0, without = 0.0;
  for (double light = 0.0; camera.Compressed(light) < report->reached * range; light += 20.0) {
    const double raw = camera.Compressed(light);
    worst = std::max(worst, std::abs(calibration.LinearDn(raw) - light) / range);
    without = std::max(without, std::abs(raw - light) / range);
  }
  EXPECT_LT(worst, 0.005);
  EXPECT_GT(without, 0.04);
  EXPECT_LT(report->residual, 0.002);
}

TEST(CameraResponse, ALinearCameraStaysLinear) {
  const auto report = Camera().Ramp(240.0).Response();
  ASSERT_TRUE(report.ok());
  EXPECT_LT(report->largest_deviation, 0.002);
}

TEST(CameraResponse, NeedsLight) {
  const Camera camera;
  EXPECT_NE(camera.Ramp(2.0).Response().status().message().find("lit tiles"), std::string::npos);
  EXPECT_FALSE(ExposureRamp(Cfa::kRggb, 4095.0, 60.0).Transfer({}).ok());
}

TEST(FrameLineariser, GivesWhatALinearCameraWouldHaveRead) {
  CameraCalibration camera;
  camera.model = {64, 48, 80.0, 80.0, 31.5, 23.5, {}};
  camera.black_level_dn = 60.0;
  camera.vignetting = {-0.2, 0.05};
  const double range = 4095.0 - 60.0;
  for (int k = 0; k < 65; ++k)
    camera.response.push_back((1.0 - std::sqrt(1.0 - 0.32 * k / 64.0)) / 0.16);  // of s = v (1 - 0.08 v)
  const FrameLineariser lineariser(camera);
  Image<uint16_t> frame(64, 48);
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x) {
      const double v = 2000.0 * camera.Vignetting(x, y) / range;
      frame(x, y) = static_cast<uint16_t>(std::lround(60.0 + range * v * (1.0 - 0.08 * v)));
    }
  frame(3, 4) = 4095;
  frame(5, 6) = 57;  // noise below black stays
  lineariser.Apply(frame, 0, 0);
  EXPECT_NEAR(frame(0, 0), 2060, 2);
  EXPECT_NEAR(frame(32, 24), 2060, 2);
  EXPECT_EQ(frame(3, 4), 65535);
  EXPECT_NEAR(frame(5, 6), 57, 1);
  EXPECT_TRUE(lineariser.linear_camera().response.empty());
  EXPECT_LT(lineariser.linear_camera().saturation_dn, 65535.0);
  // The brightest level that was not saturated lies below the linear camera's saturation everywhere.
  Image<uint16_t> bright(64, 48, 1, 4094);
  lineariser.Apply(bright, 0, 0);
  for (const uint16_t v : bright.pixels()) EXPECT_LT(v, lineariser.linear_camera().saturation_dn);
}

TEST(FrameLineariser, LeavesALinearCameraAlone) {
  CameraCalibration camera;
  camera.model = {64, 48, 80.0, 80.0, 31.5, 23.5, {}};
  Image<uint16_t> frame(64, 48, 1, 4095);
  FrameLineariser(camera).Apply(frame, 0, 0);
  EXPECT_EQ(frame(0, 0), 4095);
}

}  // namespace
}  // namespace stratalux::fit
