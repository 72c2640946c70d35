// SPDX-License-Identifier: Apache-2.0
// The light of a rig is calibrated as its operator does it: a cap on the lens, a white target at three places, a grey
// ramp. The simulated rig has vices that its calibration must find, and knows what must come out.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include "shared/base/read_file.h"
#include "shared/capture/rig_calibration.h"
#include "tests/support/run_program.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr const char* kScene = R"(
[subject]
shape = "white"
[plate]
width_mm = 300
height_mm = 230
[camera]
vignetting = 1
compression = 0.05
prnu = 0.008
dsnu_dn = 0.7
gain_e_per_dn = 3.4
read_noise_dn = 3.6
black_level_dn = 72
[projectors]
falloff = [-0.24, 0.06]
black_level = 0.003
gamma = 2.2
[[projector]]
gamma = 1.8
[[projector]]
[[projector]]
gamma = 2.4
falloff = [-0.06, -0.05]
[[projector]]
black_level = 0.001
[ambient]
dn_per_ms = 0.4
[[pose]]
position_mm = [0, 0, 0]
rotation_deg = [4, -3, 0]
[[pose]]
position_mm = [0, 0, -90]
rotation_deg = [-15, 18, 5]
[[pose]]
position_mm = [0, 0, 90]
rotation_deg = [14, -18, 0]
)";

class LightCalibration : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = fs::temp_directory_path() / ("stratalux_light_" + std::to_string(getpid()));
    fs::create_directories(folder_);
    std::ofstream(folder_ / "flat.toml") << kScene;
    for (const std::string kind : {"dark", "flat --pose 0", "flat --pose 1", "flat --pose 2", "response"})
      ASSERT_EQ(Capture("store", kind).code, 0) << kind;
    const auto manifest = ReadFile((FirstSession("store") / "manifest.json").string());
    // The simulation's own record lies in the manifest; RigCalibration reads it from there on its own.
    const std::string& text = manifest.value();
    const size_t from = text.find("{", text.find("\"calibration\":"));
    size_t to = from;
    for (int depth = 0; to < text.size(); ++to) {
      depth += (text[to] == '{') - (text[to] == '}');
      if (depth == 0) break;
    }
    auto truth = RigCalibration::FromJson(text.substr(from, to + 1 - from));
    ASSERT_TRUE(truth.ok()) << truth.status().message();
    truth_ = std::move(truth).value();
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static Outcome Capture(const std::string& store, const std::string& kind) {
    return Execute("stratalux-rig capture --size 348x260 --seed 19 --simulate=" + (folder_ / "flat.toml").string() +
                   " --store " + (folder_ / store).string() + " --kind " + kind);
  }
  static fs::path FirstSession(const std::string& store) {
    std::vector<fs::path> sessions;
    for (const auto& entry : fs::directory_iterator(folder_ / store / "sessions")) sessions.push_back(entry.path());
    return *std::min_element(sessions.begin(), sessions.end());
  }
  // A record of the truth's geometry that knows nothing of the light.
  static std::string Blind() {
    RigCalibration blind = truth_;
    blind.camera.response.clear();
    blind.camera.vignetting = {};
    blind.camera.black_level_dn = 64.0;
    blind.camera.gain_e_per_dn = blind.camera.read_noise_dn = 1.0;
    for (ProjectorCalibration& p : blind.projectors) {
      p.response.clear();
      p.falloff = {};
      p.black_level = p.line_blur_px = 0.0;
      p.white_dn_mm2_per_ms = {1.0, 1.0, 1.0};
    }
    std::ofstream(folder_ / "blind.json") << blind.ToJson();
    return (folder_ / "blind.json").string();
  }
  static Outcome Calibrate(const std::string& store, const std::string& sessions) {
    return Execute("stratalux-fit calibrate " + sessions + " --store " + (folder_ / store).string() + " --known-rig " +
                   Blind() + " --target-albedo 0.99 --out " + (folder_ / "light.json").string());
  }
  static RigCalibration Found() {
    return RigCalibration::FromJson(ReadFile((folder_ / "light.json").string()).value()).value();
  }

  static inline fs::path folder_;
  static inline RigCalibration truth_;
};

TEST_F(LightCalibration, FindsTheLightOfARigThatNobodyDescribed) {
  const Outcome run = Calibrate("store", "s000001 s000002 s000003 s000004 s000005");
  ASSERT_EQ(run.code, 0) << run.out;
  const RigCalibration found = Found();
  EXPECT_NEAR(found.camera.black_level_dn, 72.0, 0.1);
  EXPECT_NEAR(found.camera.gain_e_per_dn / 3.4, 1.0, 0.02);
  EXPECT_NEAR(found.camera.read_noise_dn / 3.6, 1.0, 0.05);
  const double range = 4095.0 - 72.0;
  for (double raw = 0.0; raw < 0.75 * range; raw += 50.0)
    EXPECT_NEAR(found.camera.LinearDn(raw), truth_.camera.LinearDn(raw), 0.005 * range) << raw;
  for (int x = 0; x < 348; x += 29)
    for (int y = 0; y < 260; y += 26) EXPECT_NEAR(found.camera.Vignetting(x, y), truth_.camera.Vignetting(x, y), 0.01);
  ASSERT_EQ(found.projectors.size(), 4U);
  for (size_t p = 0; p < 4; ++p) {
    const ProjectorCalibration &is = found.projectors[p], &was = truth_.projectors[p];
    for (double grey = 0.0; grey <= 1.0; grey += 0.02)
      EXPECT_NEAR(is.Response(grey), was.Response(grey), 0.005) << p << " at " << grey;
    for (double column = 100; column < 950; column += 50)
      for (double row = 80; row < 720; row += 40)
        EXPECT_NEAR(is.Falloff({column, row}), was.Falloff({column, row}), 0.01) << p;
    EXPECT_NEAR(is.black_level / was.black_level, 1.0, 0.1);
    for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(is.white_dn_mm2_per_ms[c] / was.white_dn_mm2_per_ms[c], 1.0, 0.01) << p;
    // Geometry stays.
    EXPECT_EQ(is.model.fx, was.model.fx);
  }
  // Lines of 2 columns, mm on the target from the light they carry.
  EXPECT_THAT(run.out, HasSubstr("line of 2 px: 2.0"));
}

TEST_F(LightCalibration, WhatNoSessionTellsStaysAndIsNamed) {
  const Outcome run = Calibrate("store", "s000005");
  ASSERT_EQ(run.code, 0) << run.out;
  EXPECT_THAT(run.out, HasSubstr("no session of kind dark"));
  EXPECT_THAT(run.out, HasSubstr("no session of kind flat"));
  const RigCalibration found = Found();
  EXPECT_EQ(found.camera.black_level_dn, 64.0);
  EXPECT_EQ(found.projectors[0].white_dn_mm2_per_ms[0], 1.0);
  EXPECT_NEAR(found.projectors[0].Response(0.5), std::pow(0.5, 1.8), 0.05);  // the camera's compression left in
}

TEST_F(LightCalibration, BadLightIsRefusedWithTheSessionAndTheRemedy) {
  // Degraded: the rig itself says that the light was too bright.
  const Outcome captured = Capture("bad", "response --exposure 36");
  ASSERT_EQ(captured.code, 3) << captured.out;
  EXPECT_THAT(captured.out, HasSubstr("--exposure"));
  const Outcome bright = Calibrate("bad", "latest");
  EXPECT_EQ(bright.code, 1);
  EXPECT_THAT(bright.out, HasSubstr("session s000001"));
  EXPECT_THAT(bright.out, HasSubstr("saturated; expose shorter"));
  ASSERT_EQ(Capture("bad", "response --fault lamp_drift@60=0.8").code, 0);
  const Outcome drift = Calibrate("bad", "latest");
  EXPECT_EQ(drift.code, 1);
  EXPECT_THAT(drift.out, HasSubstr("warm up"));
  for (const auto& entry : fs::recursive_directory_iterator(folder_ / "bad"))
    EXPECT_NE(entry.path().filename(), "calibration.json") << "a refused calibration was kept: " << entry.path();
}

TEST_F(LightCalibration, WithoutGeometryThereIsNoLight) {
  const Outcome run =
      Execute("stratalux-fit calibrate s000002 --store " + (folder_ / "store").string() + " --known-rig /nowhere.json");
  EXPECT_NE(run.code, 0);
  EXPECT_THAT(run.out, HasSubstr("/nowhere.json"));
}

}  // namespace
}  // namespace stratalux
