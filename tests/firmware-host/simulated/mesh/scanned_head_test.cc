// SPDX-License-Identifier: Apache-2.0
// A real head as the subject: the scan "Infinite" of Lee Perry-Smith (CC BY 3.0), where the folder of test data holds
// it; skipped elsewhere.
#include <cmath>
#include <cstdio>
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/scene.h"
#include "firmware-host/simulated/simulation_file.h"
#include "shared/image/png.h"
#include "tests/firmware-host/simulated/brute_force_frames.h"
#include "tests/firmware-host/simulated/small_rig.h"
#include "tests/support/jpeg.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/test_data.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

std::filesystem::path ScanFolder() { return TestDataFolder() / "lps_head"; }

class ScannedHead : public ScratchFolderTest {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(ScanFolder() / "head.obj"))
      GTEST_SKIP() << ScanFolder() << " is absent; set STRATALUX_DATA to the folder of the test data";
    ASSERT_TRUE(WritePng8(folder_ / "albedo.png", DecodeJpeg(ReadText(ScanFolder() / "albedo.jpg"))).ok());
    scene_ = (folder_ / "scan.toml").string();
    // Nose and eyes lie where the default head's do. The file came by way of glTF: v runs down.
    WriteText(scene_, "[subject]\nshape = \"mesh\"\n[mesh]\nfile = \"" + (ScanFolder() / "head.obj").string() +
                          "\"\nalbedo = \"albedo.png\"\nflip_v = true\norigin_mm = [0, 63, 64]\nsubdivisions = 1\n");
  }
  std::string scene_;
};

TEST_F(ScannedHead, IsAHeadOfSkin) {
  const SkinTable table = *SkinTable::Load(SkinTable::DefaultPath());
  const auto made = Scene::Create(LoadSimulation(scene_)->scene, 1, &table);
  ASSERT_TRUE(made.ok()) << made.status().message();
  const Scene& head = *made;
  for (const std::string& remark : head.Remarks()) std::printf("%s\n", remark.c_str());
  // A breadth of 155 mm, as its notes say; a nose before its cheeks.
  double left = 0.0, right = 0.0, nose = 1e9;
  for (double x = -100; x <= 100; x += 0.5) {
    if (std::isnan(head.Height(x, 3.0))) continue;  // at the ears
    left = std::min(left, x);
    right = std::max(right, x);
  }
  EXPECT_NEAR(right - left, 155.0, 10.0);
  for (double y = -10; y <= 50; y += 1.0) nose = std::min(nose, head.Height(0.0, y));
  const double cheeks = 0.5 * (head.Height(-40, 20) + head.Height(40, 20));
  EXPECT_GT(cheeks - nose, 20.0);
  EXPECT_LT(cheeks - nose, 70.0);
  auto mean_of = [&](double x, double y) {
    SkinParameters sum{0.0F, 0.0F};
    for (int k = 0; k < 49; ++k) {
      const double at_x = x + k % 7 - 3.0, at_y = y + k / 7 * 0.5 - 1.5;
      const SkinParameters skin = head.Skin({at_x, at_y, head.Height(at_x, at_y)});
      sum.melanin += skin.melanin / 49.0F;
      sum.blood += skin.blood / 49.0F;
    }
    return sum;
  };
  // The picture is the right way up: brows are darker than the forehead, lips redder than it.
  const SkinParameters forehead = mean_of(0, -50), lips = mean_of(0, 45), left_brow = mean_of(-25, -27),
                       right_brow = mean_of(25, -27);
  std::printf("melanin and blood of forehead %.4f %.4f, lips %.4f %.4f, brows %.4f %.4f\n", forehead.melanin,
              forehead.blood, lips.melanin, lips.blood, left_brow.melanin, right_brow.melanin);
  EXPECT_GT(lips.blood, 2.0F * forehead.blood);
  EXPECT_GT(left_brow.melanin, 1.25F * forehead.melanin);
  EXPECT_GT(right_brow.melanin, 1.25F * forehead.melanin);
}

// A few frames through the devices; pixels beside brute-force photons that know the curved surface and the melanin and
// blood of every place.
TEST_F(ScannedHead, FramesAreThoseOfThePhotons) {
  CompareOptions options;
  options.rig = SmallRig(scene_);
  options.rig.projector_width = 512;
  options.rig.projector_height = 384;
  options.exposure_ms = 16.0;  // at twice that, lines saturate the camera
  options.tracing = {.photons = 2000, .seed = 2};
  Logger logger(LogLevel::kWarning);
  const auto compared =
      CompareWithRig(options, CrossCheckLights(options.rig), CrossCheckPixels(options.rig, 2), logger);
  ASSERT_TRUE(compared.ok()) << compared.status().message();
  std::fputs(ComparisonTable(*compared).c_str(), stdout);
  double chi2 = 0.0;
  for (const ComparedPixel& c : *compared) {
    const double sigma = SigmaOf(c, options.exposure_ms);
    EXPECT_NEAR(c.rig, c.traced, 4.0 * sigma) << c.light << " of " << c.projector << " at " << c.x << ", " << c.y;
    chi2 += std::pow((c.rig - c.traced) / sigma, 2);
  }
  EXPECT_EQ(compared->size(), 36U);
  EXPECT_LT(chi2 / 36.0, 1.5);
}

}  // namespace
}  // namespace stratalux::rig
