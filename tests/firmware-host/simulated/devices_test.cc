// SPDX-License-Identifier: Apache-2.0
// Optics, electronics and timing of the simulated devices, each held to its definition.
#include <cmath>
#include <numeric>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/simulated_rig.h"
#include "firmware-host/simulated/world.h"
#include "shared/config/toml_reader.h"
#include "tests/firmware-host/simulated/plain_patterns.h"
#include "tests/firmware-host/simulated/small_rig.h"

namespace stratalux::rig {
namespace {

MonotonicNs Ms(double ms) { return MonotonicNs{} + FromMilliseconds(ms); }

class SimulatedDevices : public ::testing::Test {
 protected:
  std::unique_ptr<SimulatedRig> Make(const SimulatedRigOptions& options) {
    auto rig = SimulatedRig::Create(options, logger_);
    EXPECT_TRUE(rig.ok()) << rig.status().message();
    EXPECT_TRUE((*rig)->camera().Start().ok());
    (*rig)->switches()[1]->Set(true);
    return std::move(*rig);
  }
  static void Step(SimulatedRig& rig) {
    EXPECT_TRUE(rig.lines().TriggerProjector(1).ok());
    EXPECT_TRUE((*rig.lines().WaitSync(std::chrono::milliseconds(50))).has_value());
  }
  static Image<float> Expose(SimulatedRig& rig) {
    EXPECT_TRUE(rig.lines().TriggerCamera().ok());
    auto frame = rig.camera().Wait(std::chrono::seconds(60));
    EXPECT_TRUE(frame.ok() && frame->has_value());
    Image<float> light((*frame)->pixels.width(), (*frame)->pixels.height());
    for (size_t i = 0; i < light.size(); ++i) light.data()[i] = static_cast<float>((*frame)->pixels.data()[i]) - 64.0F;
    return light;
  }
  static Image<float> ShowAndExpose(SimulatedRig& rig, const Pattern& pattern) {
    EXPECT_TRUE(rig.projectors()[1]->Load({pattern}).ok());
    Step(rig);
    return Expose(rig);
  }
  static double MeanOf(const Image<float>& image, int margin = 40) {
    double sum = 0.0;
    int count = 0;
    for (int y = margin; y < image.height() - margin; ++y)
      for (int x = margin; x < image.width() - margin; ++x) {
        sum += image(x, y);
        ++count;
      }
    return sum / count;
  }
  Logger logger_{LogLevel::kWarning};
};

TEST_F(SimulatedDevices, SharesOfPicturesAddUpToTheWholeExposure) {
  const std::vector<Shown> timeline = {
      {kBlackPattern, Ms(0)}, {kWhitePattern, Ms(10)}, {kBlackPattern, Ms(13)}, {std::nullopt, Ms(20)}};
  for (const double lag : {0.0, 0.5, 4.0})
    for (double start = 0.0; start < 30.0; start += 1.7) {
      const auto shares = ShareOfPictures(timeline, Ms(start), 5.0, lag);
      EXPECT_NEAR(std::accumulate(shares.begin(), shares.end(), 0.0), 1.0, 1e-12);
      for (const double s : shares) EXPECT_GE(s, -1e-12);
    }
  // Without lag: the overlap of the exposure with the time each picture is on.
  const auto sharp = ShareOfPictures(timeline, Ms(9), 5.0, 0.0);
  EXPECT_NEAR(sharp[0], 0.2, 1e-12);
  EXPECT_NEAR(sharp[1], 0.6, 1e-12);
  EXPECT_NEAR(sharp[2], 0.2, 1e-12);
  EXPECT_NEAR(sharp[3], 0.0, 1e-12);
}

// With time constant tau, light after a step to white at 0, over an exposure from a to b: b - a - tau (e^-a - e^-b).
TEST_F(SimulatedDevices, LagIsAnExponential) {
  const std::vector<Shown> timeline = {{kBlackPattern, Ms(-1000)}, {kWhitePattern, Ms(0)}};
  const double tau = 3.0;
  for (const double a : {0.0, 2.0, 7.5}) {
    const double b = a + 8.0;
    const double expected = (b - a - tau * (std::exp(-a / tau) - std::exp(-b / tau))) / 8.0;
    EXPECT_NEAR(ShareOfPictures(timeline, Ms(a), 8.0, tau)[1], expected, 1e-9);
  }
  // And so reads the camera: the first exposure after the step is darker, in that proportion.
  SimulatedRigOptions options = SmallRig("white");
  options.devices.projector.lag_ms = tau;
  options.devices.projector.black_level = 0.0;
  const auto rig = Make(options);
  ShowAndExpose(*rig, kBlackPattern);
  rig->Sleep(std::chrono::seconds(1));
  const double first = MeanOf(ShowAndExpose(*rig, kWhitePattern));
  rig->Sleep(std::chrono::seconds(1));
  const double settled = MeanOf(Expose(*rig));
  const double a = 0.02, b = 16.02;
  EXPECT_NEAR(first / settled, (b - a - tau * (std::exp(-a / tau) - std::exp(-b / tau))) / 16.0, 2e-3);
}

TEST_F(SimulatedDevices, GreyLevelsFollowTheResponseAndBitsDoNot) {
  SimulatedRigOptions options = SmallRig("white");
  options.devices.projector.gamma = 2.2;
  options.devices.projector.black_level = 0.0;
  const auto bent = Make(options);
  options.devices.projector.gamma = 1.0;
  const auto straight = Make(options);
  EXPECT_EQ(MeanOf(ShowAndExpose(*bent, kWhitePattern)), MeanOf(ShowAndExpose(*straight, kWhitePattern)));
  // The mean of (0.5 + 0.5 cos)^2.2 over a period, by quadrature.
  double expected = 0.0;
  for (int k = 0; k < 1000; ++k) expected += std::pow(0.5 + 0.5 * std::cos(2 * M_PI * k / 1000.0), 2.2) / 1000.0;
  Image<float> sum(174, 130);
  for (int shift = 0; shift < 8; ++shift) {
    const Image<float> frame =
        ShowAndExpose(*bent, {.kind = PatternKind::kSinusoid, .period = 64, .shift = shift, .shifts = 8});
    for (size_t i = 0; i < sum.size(); ++i) sum.data()[i] += frame.data()[i] / 8.0F;
  }
  EXPECT_NEAR(MeanOf(sum) / MeanOf(ShowAndExpose(*straight, kWhitePattern)), expected, 0.004);
}

TEST_F(SimulatedDevices, BlurGrowsAwayFromFocus) {
  SimulatedRigOptions options = SmallRig("white");
  options.camera_width = 696;
  options.camera_height = 520;
  options.devices.projector.blur_px = 0.3;
  options.devices.projector.defocus_px_per_mm = 0.01;
  // Standard deviation of a comb line's image, in projector columns, at one camera row.
  auto width_of_line = [&](double focus_mm) {
    options.devices.projector.focus_mm = focus_mm;
    const auto rig = Make(options);
    const Image<float> black = ShowAndExpose(*rig, kBlackPattern);
    const Image<float> line =
        ShowAndExpose(*rig, {.kind = PatternKind::kComb, .period = 256, .width = 2, .shift = 128});
    const auto maps = *rig->Truth(*BuildPlan({.projector_width = 256, .projector_height = 192}));
    const auto column = std::find_if(maps.begin(), maps.end(), [](const TruthMap& m) { return m.name == "column 1"; });
    double sum = 0.0, mean = 0.0, square = 0.0;
    for (int y = 200; y < 320; ++y)
      for (int x = 0; x < 696; ++x) {
        const double c = column->map(x, y, 0), v = line(x, y) - black(x, y);
        if (!(std::abs(c - 128.5) < 14.0)) continue;
        sum += v;
        mean += v * c;
        square += v * c * c;
      }
    mean /= sum;
    return std::sqrt(square / sum - mean * mean);
  };
  const double distance = (Eigen::Vector3d(-180, -300, 20) - Eigen::Vector3d(0, 4, 700)).norm();
  const double box = 4.0 / 12.0;  // two columns' own variance; the pixel's footprint adds a little
  EXPECT_NEAR(width_of_line(distance), std::sqrt(0.09 + box), 0.1);
  EXPECT_NEAR(width_of_line(distance - 200.0), std::sqrt(0.09 + 4.0 + box), 0.12);
}

TEST_F(SimulatedDevices, FlickerHasItsStatedSpreadAndFollowsTheSeed) {
  SimulatedRigOptions options = SmallRig("white");
  options.devices.projector.flicker = 0.02;
  auto series = [&](uint64_t seed) {
    options.seed = seed;
    const auto rig = Make(options);
    ShowAndExpose(*rig, kWhitePattern);
    std::vector<double> means(80);
    for (double& m : means) m = MeanOf(Expose(*rig));
    return means;
  };
  const auto one = series(1), again = series(1), other = series(2);
  EXPECT_EQ(one, again);
  EXPECT_NE(one, other);
  const double mean = std::accumulate(one.begin(), one.end(), 0.0) / 80.0;
  double variance = 0.0;
  for (const double m : one) variance += std::pow(m / mean - 1.0, 2) / 79.0;
  EXPECT_NEAR(std::sqrt(variance), 0.02, 3 * 0.02 / std::sqrt(2 * 79.0));
}

TEST_F(SimulatedDevices, ALampDriftsWithTheClock) {
  SimulatedRigOptions options = SmallRig("white");
  options.devices.projector.drift_per_minute = -0.1;
  const auto rig = Make(options);
  const double before = MeanOf(ShowAndExpose(*rig, kWhitePattern));
  rig->Sleep(std::chrono::minutes(1));
  EXPECT_NEAR(MeanOf(Expose(*rig)) / before, 0.9, 0.002);
}

TEST_F(SimulatedDevices, ARollingShutterSeesThePictureChangeRowByRow) {
  SimulatedRigOptions options = SmallRig("white");
  options.devices.projector.black_level = 0.0;
  options.devices.camera.shutter = Shutter::kRolling;
  options.devices.camera.line_time_us = 100.0;
  const auto rig = Make(options);
  ASSERT_TRUE(rig->projectors()[1]->Load({kWhitePattern, kBlackPattern}).ok());
  Step(*rig);
  const Image<float> white = Expose(*rig);
  // A new exposure; the picture turns black at its 8th millisecond.
  ASSERT_TRUE(rig->camera().SetExposure(10.0, 1.0).ok());
  SimulatedRigOptions global = options;
  global.devices.camera.shutter = Shutter::kGlobal;
  World world(global, *Scene::Create("white", 1), *SkinTable::Load(SkinTable::DefaultPath()), Ms(0), logger_);
  World rolling(options, *Scene::Create("white", 1), *SkinTable::Load(SkinTable::DefaultPath()), Ms(0), logger_);
  Exposure exposure{Ms(0), 10.0, 1.0, 0, {{{std::nullopt, Ms(-9)}}, {{kWhitePattern, Ms(-9)}, {kBlackPattern, Ms(8)}}}};
  const Image<float> whole = *world.Light({Ms(0), 10.0, 1.0, 0, {{{std::nullopt, Ms(-9)}}, {{kWhitePattern, Ms(-9)}}}});
  const Image<float> at_once = *world.Light(exposure), by_row = *rolling.Light(exposure);
  const double ambient = 0.1 * 10.0;
  for (const int y : {50, 65, 80}) {
    const double lit = whole(87, y) - ambient;
    EXPECT_NEAR((at_once(87, y) - ambient) / lit, 0.8, 1e-3);
    EXPECT_NEAR((by_row(87, y) - ambient) / lit, 0.8 - 0.01 * y, 1e-3) << y;
  }
}

TEST_F(SimulatedDevices, TimingJittersWithinItsSpread) {
  SimulatedRigOptions options = SmallRig("white");
  options.devices.timing.jitter_us = 50.0;
  options.devices.timing.sync_delay_ms = 2.0;
  const auto rig = Make(options);
  ASSERT_TRUE(rig->projectors()[1]->Load(std::vector<Pattern>(200, kWhitePattern)).ok());
  std::vector<double> delays;
  for (int k = 0; k < 200; ++k) {
    const auto receipt = rig->lines().TriggerProjector(1);
    const auto edge = rig->lines().WaitSync(std::chrono::milliseconds(50));
    delays.push_back(1e-3 * static_cast<double>(((*edge)->time - receipt->time).count()));
  }
  const double mean = std::accumulate(delays.begin(), delays.end(), 0.0) / 200.0;
  double variance = 0.0;
  for (const double d : delays) variance += std::pow(d - mean, 2) / 199.0;
  EXPECT_NEAR(mean, 2000.0, 4 * 50 / std::sqrt(200.0));
  EXPECT_NEAR(std::sqrt(variance), 50.0, 10.0);
}

TEST_F(SimulatedDevices, AStreamThatStallsShowsWhatIsOnByThen) {
  SimulatedRigOptions options = SmallRig("white");
  options.free_running = true;
  options.faults.script = {{.kind = FaultKind::kFrameLate, .at = 0}};
  const auto rig = Make(options);
  ASSERT_TRUE(rig->projectors()[1]->Load({kWhitePattern}).ok());
  rig->Sleep(std::chrono::milliseconds(5));  // into what would have been the exposure
  const auto pulse = rig->lines().TriggerProjector(1);
  auto frame = rig->camera().Wait(std::chrono::seconds(1));
  if (frame.ok() && !frame->has_value()) frame = rig->camera().Wait(std::chrono::seconds(1));
  ASSERT_TRUE(frame.ok() && frame->has_value());
  EXPECT_GE((*frame)->time, pulse->time + std::chrono::milliseconds(190));
  const ShownFrame shown = rig->ShownOf((*frame)->sequence);
  EXPECT_TRUE(shown.whole);
  EXPECT_EQ(shown.pictures[1], kWhitePattern);
}

TEST_F(SimulatedDevices, AnOldBufferThatComesAgainInPiecesLeavesTheFirstOneWhole) {
  SimulatedRigOptions options = SmallRig("white");
  options.faults.script = {{.kind = FaultKind::kFrameStale, .at = 1}, {.kind = FaultKind::kFrameGarbled, .at = 1}};
  const auto rig = Make(options);
  ShowAndExpose(*rig, {.kind = PatternKind::kGray, .bit = 1, .bits = 6});
  Expose(*rig);
  EXPECT_EQ(rig->ShownOf(0).spoilt, 0.0);
}

TEST_F(SimulatedDevices, AMonoCameraGivesFullSizeTruth) {
  SimulatedRigOptions options = SmallRig("white");
  options.devices.camera.cfa = Cfa::kMono;
  const auto rig = Make(options);
  EXPECT_EQ(rig->calibration().camera.cfa, Cfa::kMono);
  const auto truth = rig->Truth(*BuildPlan({.projector_width = 256, .projector_height = 192}));
  ASSERT_TRUE(truth.ok());
  for (const TruthMap& map : *truth) EXPECT_EQ(map.map.width(), 174) << map.name;
}

TEST(DeviceOptions, EveryKeyIsReadAndWrongOnesAreNamed) {
  auto root = TomlTable::ParseText(R"(
[camera]
cfa = "gbrg"
bits = 10
gain_e_per_dn = 2.5
prnu = 0.01
shutter = "rolling"
[projectors]
blur_px = 0.7
[[projector]]
gamma = 2.2
[[projector]]
lag_ms = 1.5
[timing]
jitter_us = 20
)",
                                   "devices.toml");
  ASSERT_TRUE(root.ok());
  const auto devices = ReadDevices(*root);
  ASSERT_TRUE(devices.ok() && root->Finish().ok()) << devices.status().message();
  EXPECT_EQ(devices->camera.cfa, Cfa::kGbrg);
  EXPECT_EQ(devices->camera.bits, 10);
  EXPECT_EQ(devices->camera.shutter, Shutter::kRolling);
  EXPECT_EQ(devices->ForProjector(0).gamma, 2.2);
  EXPECT_EQ(devices->ForProjector(1).gamma, 1.0);
  EXPECT_EQ(devices->ForProjector(1).lag_ms, 1.5);
  EXPECT_EQ(devices->ForProjector(1).blur_px, 0.7);
  EXPECT_EQ(devices->ForProjector(3).blur_px, 0.7);
  for (const char* wrong : {"[camera]\ncfa = \"rgb\"\n", "[camera]\nbits = 11\n", "[camera]\ndistortion = [1]\n",
                            "[camera]\nshutter = \"fast\"\n"}) {
    auto bad = TomlTable::ParseText(wrong, "devices.toml");
    const auto read = ReadDevices(*bad);
    EXPECT_EQ(read.status().code(), StatusCode::kUsage);
    EXPECT_THAT(read.status().message(), ::testing::HasSubstr("devices.toml:2")) << wrong;
  }
}

}  // namespace
}  // namespace stratalux::rig
