// SPDX-License-Identifier: Apache-2.0
// The simulated rig through the interfaces of its devices.
#include "firmware-host/simulated/simulated_rig.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include <gtest/gtest.h>

#include "firmware-host/simulated/skin/skin_table.h"
#include "tests/firmware-host/simulated/plain_patterns.h"
#include "tests/firmware-host/simulated/small_rig.h"

namespace stratalux::rig {
namespace {

class SimulatedRigTest : public ::testing::Test {
 protected:
  std::unique_ptr<SimulatedRig> Make(const SimulatedRigOptions& options) {
    auto rig = SimulatedRig::Create(options, logger_);
    EXPECT_TRUE(rig.ok()) << rig.status().message();
    EXPECT_TRUE((*rig)->camera().Start().ok());
    return std::move(*rig);
  }
  // One frame of one projector, all others off.
  static Image<uint16_t> Shoot(SimulatedRig& rig, int projector, const Pattern& pattern, double gain = 1.0,
                               double exposure_ms = 16.0) {
    for (LightSwitch* light : rig.switches()) light->Set(false);
    EXPECT_TRUE(rig.projectors()[projector]->Load({pattern}).ok());
    rig.switches()[projector]->Set(true);
    EXPECT_TRUE(rig.camera().SetExposure(exposure_ms, gain).ok());
    EXPECT_TRUE(rig.lines().TriggerProjector(projector).ok());
    EXPECT_TRUE((*rig.lines().WaitSync(std::chrono::milliseconds(50))).has_value());
    EXPECT_TRUE(rig.lines().TriggerCamera().ok());
    auto frame = rig.camera().Wait(std::chrono::seconds(60));
    EXPECT_TRUE(frame.ok() && frame->has_value());
    return std::move((*frame)->pixels);
  }
  static std::vector<uint16_t> Pixels(const Image<uint16_t>& image) {
    return {image.pixels().begin(), image.pixels().end()};
  }

  Logger logger_{LogLevel::kWarning};
};

TEST_F(SimulatedRigTest, CombFramesOfOneCycleAddUpToTheWhiteFrameInDigitalNumbers) {
  const auto rig = Make(SmallRig("plane"));
  const Image<uint16_t> black = Shoot(*rig, 1, {}), white = Shoot(*rig, 1, kWhitePattern);
  constexpr int kPeriod = 32, kFrames = 16;
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    std::vector<int> sum(white.size(), 0);
    for (int shift = 0; shift < kPeriod; shift += kPeriod / kFrames) {
      const Image<uint16_t> frame =
          Shoot(*rig, 1, {.kind = PatternKind::kComb, .axis = axis, .period = kPeriod, .width = 2, .shift = shift});
      for (size_t i = 0; i < sum.size(); ++i) sum[i] += int(frame.pixels()[i]) - int(black.pixels()[i]);
    }
    double mean = 0.0, squares = 0.0;
    for (size_t i = 0; i < sum.size(); ++i) {
      const int error = sum[i] - (int(white.pixels()[i]) - int(black.pixels()[i]));
      // Every frame is rounded by up to 1/2, the black frame 17 times over.
      EXPECT_LE(std::abs(error), kFrames) << "pixel " << i;
      mean += error / static_cast<double>(sum.size());
      squares += double(error) * error / static_cast<double>(sum.size());
    }
    // Black's own rounding, 15 times over, is 15 / sqrt(12).
    EXPECT_LT(std::sqrt(squares), 16.0 / std::sqrt(12.0) + 1.0);
    EXPECT_LT(std::abs(mean), 3.0);
  }
  EXPECT_GT(*std::max_element(white.pixels().begin(), white.pixels().end()), 500) << "there is light";
}

TEST_F(SimulatedRigTest, LightIsLinearInExposureAndSaturatesAtTheTop) {
  const auto rig = Make(SmallRig("sphere"));
  const Image<uint16_t> once = Shoot(*rig, 0, kWhitePattern, 1.0, 3.0), twice = Shoot(*rig, 0, kWhitePattern, 1.0, 6.0),
                        gained = Shoot(*rig, 0, kWhitePattern, 2.0, 3.0),
                        burnt = Shoot(*rig, 0, kWhitePattern, 1.0, 3000.0);
  int top = 0;
  for (size_t i = 0; i < once.size(); ++i) {
    EXPECT_NEAR(twice.pixels()[i] - 64.0, 2.0 * (once.pixels()[i] - 64.0), 1.6);
    EXPECT_EQ(gained.pixels()[i], twice.pixels()[i]);
    EXPECT_LE(burnt.pixels()[i], 4095);
    top += burnt.pixels()[i] == 4095 ? 1 : 0;
  }
  EXPECT_GT(top, 1000);
}

TEST_F(SimulatedRigTest, ASlabOfWaxGlowsBesideALine) {
  // Light of a line is spread over centimetres; without scattering it stays in the line. White light is the same.
  SimulatedRigOptions options = SmallRig("slab");
  const Pattern line = {.kind = PatternKind::kComb, .period = 64, .width = 2, .shift = 30};
  double inside[2] = {}, beside[2] = {}, white[2] = {};
  for (const bool scattering : {false, true}) {
    options.scattering = scattering;
    const auto rig = Make(options);
    const Image<uint16_t> lit = Shoot(*rig, 1, line, 1.0, 30.0), black = Shoot(*rig, 1, kBlackPattern, 1.0, 30.0),
                          full = Shoot(*rig, 1, kWhitePattern, 1.0, 8.0);
    const int y = lit.height() / 2 / 2 * 2, middle = lit.width() / 4 * 2;
    int peak = middle;
    for (int x = middle - 30; x < middle + 30; x += 2)
      if (lit(x, y) > lit(peak, y)) peak = x;
    inside[scattering] = lit(peak, y) - black(peak, y);
    beside[scattering] = 0.5 * (lit(peak - 4, y) + lit(peak + 4, y) - black(peak - 4, y) - black(peak + 4, y));  // 7 mm
    white[scattering] = full(middle, y) - 64.0;
    EXPECT_LT(lit(peak, y), 4000) << "not saturated";
  }
  EXPECT_LT(beside[0], 0.005 * inside[0]);
  EXPECT_GT(beside[1], 0.02 * inside[1]);
  EXPECT_NEAR(white[1] / white[0], 1.0, 0.15) << "one albedo, but for its angles";
}

TEST_F(SimulatedRigTest, ATableOfAnotherTissueIsRefused) {
  SimulatedRigOptions options = SmallRig("slab");
  options.skin_table = SkinTable::DefaultPath();
  const auto rig = SimulatedRig::Create(options, logger_);
  ASSERT_FALSE(rig.ok());
  EXPECT_EQ(rig.status().code(), StatusCode::kUsage);
}

TEST_F(SimulatedRigTest, NoiseKnowsTheAnalogueGain) {
  // At gain g one digital number stands for gain_e_per_dn / g electrons: variance = signal g / gain_e_per_dn + g^2
  // read^2.
  SimulatedRigOptions options = SmallRig("plane");
  const auto clean = Make(options);
  options.noise = true;
  const auto noisy = Make(options);
  const CameraCalibration& camera = clean->calibration().camera;
  for (const double gain : {1.0, 2.0, 4.0}) {
    double ratio = 0.0, count = 0.0;
    for (int frame = 0; frame < 4; ++frame) {
      const Image<uint16_t> mean = Shoot(*clean, 2, kWhitePattern, gain, 4.0),
                            noise = Shoot(*noisy, 2, kWhitePattern, gain, 4.0);
      for (size_t i = 0; i < mean.size(); ++i) {
        const double signal = mean.pixels()[i] - camera.black_level_dn,
                     error = double(noise.pixels()[i]) - mean.pixels()[i];
        if (signal < 30.0 || mean.pixels()[i] > 3500) continue;
        ratio += error * error /
                 (signal * gain / camera.gain_e_per_dn + std::pow(gain * camera.read_noise_dn, 2) + 1.0 / 6.0);
        count += 1.0;
      }
    }
    ASSERT_GT(count, 10000.0);
    EXPECT_NEAR(ratio / count, 1.0, 5.0 * std::sqrt(2.0 / count)) << "gain " << gain;
  }
}

TEST_F(SimulatedRigTest, SameSeedSameBitsWhateverTheThreads) {
  SimulatedRigOptions options = SmallRig("head");
  options.noise = true;
  const Pattern comb = {.kind = PatternKind::kComb, .period = 32, .width = 2, .shift = 6};
  std::vector<std::vector<uint16_t>> frames;
  for (const char* threads : {"1", "3"}) {
    setenv("STRATALUX_THREADS", threads, 1);
    const auto rig = Make(options);
    frames.push_back(Pixels(Shoot(*rig, 0, comb)));
    EXPECT_NE(frames.back(), Pixels(Shoot(*rig, 0, comb))) << "the next frame has noise of its own";
  }
  unsetenv("STRATALUX_THREADS");
  EXPECT_EQ(frames[0], frames[1]);
  options.seed = 2;
  EXPECT_NE(frames[0], Pixels(Shoot(*Make(options), 0, comb)));
}

TEST_F(SimulatedRigTest, AnotherSeedIsAnotherFace) {
  SimulatedRigOptions options = SmallRig("head");
  const Image<uint16_t> one = Shoot(*Make(options), 0, kWhitePattern);
  options.seed = 2;
  const Image<uint16_t> other = Shoot(*Make(options), 0, kWhitePattern);
  int differ = 0, lit = 0;
  for (size_t i = 0; i < one.size(); ++i) {
    lit += one.pixels()[i] > 200 ? 1 : 0;
    differ += std::abs(int(one.pixels()[i]) - int(other.pixels()[i])) > 20 ? 1 : 0;
  }
  EXPECT_GT(lit, 2000);
  EXPECT_GT(differ, lit / 4);
}

TEST_F(SimulatedRigTest, ProjectorsInTheDarkAddNothing) {
  const auto rig = Make(SmallRig("plane"));
  const Image<uint16_t> black = Shoot(*rig, 0, {});
  for (LightSwitch* light : rig->switches()) light->Set(false);
  ASSERT_TRUE(rig->lines().TriggerCamera().ok());
  const auto dark = rig->camera().Wait(std::chrono::seconds(60));
  ASSERT_TRUE(dark.ok() && dark->has_value());
  // A projector's black still shines (0.2 %); off, there is the black level and the ambient light alone.
  double off = 0.0, shining = 0.0;
  for (size_t i = 0; i < black.size(); ++i) {
    off += (*dark)->pixels.pixels()[i] / static_cast<double>(black.size());
    shining += black.pixels()[i] / static_cast<double>(black.size());
  }
  EXPECT_NEAR(off, 64.0 + 0.1 * 16.0, 0.51);
  EXPECT_GT(shining, off + 0.5);
}

TEST_F(SimulatedRigTest, RefusesSizesItCannotSimulateAndNamesThem) {
  SimulatedRigOptions options = SmallRig("head");
  options.camera_width = 173;
  const auto odd = SimulatedRig::Create(options, logger_);
  ASSERT_FALSE(odd.ok());
  EXPECT_EQ(odd.status().code(), StatusCode::kUsage);
  EXPECT_NE(odd.status().message().find("camera width = 173"), std::string::npos) << odd.status().message();
  options = SmallRig("head");
  options.skin_table = "/nowhere/skin_table.bin";
  const auto lost = SimulatedRig::Create(options, logger_);
  ASSERT_FALSE(lost.ok());
  EXPECT_EQ(lost.status().code(), StatusCode::kNotFound);
  EXPECT_NE(lost.status().message().find("/nowhere/skin_table.bin"), std::string::npos);
}

}  // namespace
}  // namespace stratalux::rig
