// SPDX-License-Identifier: Apache-2.0
// What a scripted node (scripted_v4l2.h) can do, and whether a configuration can use it.
#include "firmware-host/camera/v4l2_devices.h"

#include <filesystem>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/camera/scripted_v4l2.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::Each;
using ::testing::HasSubstr;

class V4l2Devices : public ScratchFolderTest {
 protected:
  V4l2Devices() {
    ScriptedV4l2::Plug(folder_ / "video0");
    std::ofstream(folder_ / "null") << "";
    wiring_.width = ScriptedV4l2::kWidth;
    wiring_.height = ScriptedV4l2::kHeight;
  }
  // Of the first node of the folder.
  V4l2Camera Camera() {
    const std::string path = V4l2Paths(folder_.string()).at(0);
    const UniqueFd fd = OpenV4l2(path);
    EXPECT_TRUE(fd.ok());
    return InquireV4l2(fd.get(), DescribeV4l2(fd.get(), path).value());
  }
  CameraWiring wiring_;
};

TEST_F(V4l2Devices, AreTheVideoNodesAlone) {
  ScriptedV4l2::Plug(folder_ / "video10");
  EXPECT_THAT(V4l2Paths(folder_.string()),
              ::testing::ElementsAre((folder_ / "video0").string(), (folder_ / "video10").string()));
}

TEST_F(V4l2Devices, TellFormatSizeIntervalAndControls) {
  const V4l2Camera camera = Camera();
  EXPECT_EQ(camera.node.driver, "scripted");
  ASSERT_EQ(camera.formats.size(), 1U);
  EXPECT_EQ(camera.formats[0].name, "Y12");
  ASSERT_EQ(camera.formats[0].sizes.size(), 1U);
  EXPECT_TRUE(camera.formats[0].sizes[0].Holds(ScriptedV4l2::kWidth, ScriptedV4l2::kHeight));
  EXPECT_FALSE(camera.formats[0].sizes[0].Holds(ScriptedV4l2::kWidth + 1, ScriptedV4l2::kHeight));
  ASSERT_EQ(camera.controls.size(), 4U);
  EXPECT_EQ(camera.controls[0].value, "exposure_absolute");
  EXPECT_EQ(camera.controls[0].maximum, 10000);
}

TEST_F(V4l2Devices, AListThatNeverEndsIsCutOff) {
  const V4l2Camera camera = Camera();
  EXPECT_EQ(camera.formats[0].sizes[0].intervals_ms.size(), 256U);
  EXPECT_THAT(camera.formats[0].sizes[0].intervals_ms, Each(40.0));
}

TEST_F(V4l2Devices, ALinkNamesTheNodeBehindIt) {
  std::filesystem::create_symlink(folder_ / "video0", folder_ / "by-id");
  wiring_.device = (folder_ / "by-id").string();
  EXPECT_TRUE(Names(wiring_, Camera().node));
  wiring_.driver = "another";
  EXPECT_FALSE(Names(wiring_, Camera().node));
  wiring_.driver.clear();
  wiring_.device = (folder_ / "null").string();
  EXPECT_FALSE(Names(wiring_, Camera().node));
}

TEST_F(V4l2Devices, AWrongFormatSizeOrControlIsSaidWithWhatThereIs) {
  V4l2Camera camera = Camera();
  EXPECT_TRUE(CanBe(wiring_, camera).ok());
  wiring_.format = "BG12";
  EXPECT_THAT(CanBe(wiring_, camera).message(), HasSubstr("raw formats of this camera: Y12"));
  wiring_.format.clear();
  wiring_.width = 1392;
  EXPECT_THAT(CanBe(wiring_, camera).message(), HasSubstr("the camera offers 64x48"));
  wiring_.width = ScriptedV4l2::kWidth;
  camera.controls.clear();
  EXPECT_THAT(CanBe(wiring_, camera).message(), HasSubstr("exposure_control = \"exposure_absolute\""));
  wiring_.exposure_control = ExposureControl::kNone;
  EXPECT_TRUE(CanBe(wiring_, camera).ok());
}

}  // namespace
}  // namespace stratalux::rig
