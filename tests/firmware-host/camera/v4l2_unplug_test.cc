// SPDX-License-Identifier: Apache-2.0
// The V4L2 adapter over scripted nodes: what a cable or a driver's error may do to it, and what that leaves behind.
#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include "firmware-host/camera/v4l2_frame_source.h"
#include "firmware-host/session/open_rig.h"
#include "tests/firmware-host/camera/descriptors.h"
#include "tests/firmware-host/camera/scripted_v4l2.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

class V4l2UnplugTest : public ScratchFolderTest {
 protected:
  V4l2UnplugTest() {
    node_ = folder_ / "video0";
    wiring_.backend = CameraBackend::kV4l2;
    wiring_.device = node_.string();
    wiring_.width = ScriptedV4l2::kWidth;
    wiring_.height = ScriptedV4l2::kHeight;
    wiring_.frame_rate_hz = 30;
    wiring_.reopen_tries = 3;
    Plug();
  }
  ~V4l2UnplugTest() override { Refuse(0, 0); }
  void Plug() const { ScriptedV4l2::Plug(node_); }
  void Unplug() const { std::filesystem::remove(node_); }
  static void Refuse(unsigned long request, int times) {
    TheV4l2().refusals.store(times);
    TheV4l2().refused.store(request);
  }
  std::unique_ptr<FrameSource> Open() {
    auto camera = V4l2FrameSource::Open(wiring_, logger_);
    EXPECT_TRUE(camera.ok()) << camera.status().message();
    return camera.ok() ? std::move(camera).value() : nullptr;
  }
  static std::optional<CapturedFrame> Next(FrameSource& camera) {
    auto frame = camera.Wait(5s);
    EXPECT_TRUE(frame.ok()) << frame.status().message();
    EXPECT_TRUE(frame.ok() && frame->has_value());
    return frame.ok() ? std::move(frame).value() : std::nullopt;
  }
  std::filesystem::path node_;
  CameraWiring wiring_;
  Logger logger_{LogLevel::kError};
};

TEST_F(V4l2UnplugTest, AFailedOpeningLeavesNoDescriptor) {
  const auto before = Descriptors();
  for (const unsigned long request :
       {VIDIOC_QUERYCAP, VIDIOC_ENUM_FMT, VIDIOC_S_FMT, VIDIOC_S_PARM, VIDIOC_QUERYCTRL}) {
    Refuse(request, 1);
    EXPECT_FALSE(V4l2FrameSource::Open(wiring_, logger_).ok()) << request;
    EXPECT_EQ(TheV4l2().refusals.load(), 0);
    EXPECT_EQ(Descriptors(), before) << request;
  }
  Refuse(0, 0);
  ASSERT_NE(Open(), nullptr);
  EXPECT_EQ(Descriptors(), before);
}

// A camera that was stopped is opened by the next start. One that could not be set up is not half open: the start after
// that sets it up from the beginning.
TEST_F(V4l2UnplugTest, AFailedStartLeavesNoDescriptorAndTheNextOneGoesWell) {
  const auto before = Descriptors();
  const auto camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->SetExposure(16.0, 1.0).ok());
  for (const unsigned long request : {VIDIOC_ENUM_FMT, VIDIOC_S_FMT, VIDIOC_S_PARM, VIDIOC_QUERYCTRL}) {
    ASSERT_TRUE(camera->Start().ok());
    ASSERT_TRUE(camera->Stop().ok());
    EXPECT_EQ(Descriptors(), before);
    Refuse(request, 1);
    EXPECT_FALSE(camera->Start().ok()) << request;
    EXPECT_EQ(Descriptors(), before) << request;
    ASSERT_TRUE(camera->Start().ok()) << request;
    EXPECT_TRUE(Next(*camera).has_value());
    ASSERT_TRUE(camera->Stop().ok());
  }
}

TEST_F(V4l2UnplugTest, OneThatWasUnpluggedIsOpenedAgainInTheSameProcess) {
  const auto before = Descriptors();
  {
    auto camera = Open();
    ASSERT_NE(camera, nullptr);
    EXPECT_TRUE(V4l2FrameSource::IsThere(wiring_));
    for (int time = 0; time < 3; ++time) {
      ASSERT_TRUE(camera->Start().ok());
      const auto last = Next(*camera);
      ASSERT_TRUE(last.has_value());
      Unplug();
      EXPECT_FALSE(V4l2FrameSource::IsThere(wiring_));
      Status gone;
      for (int i = 0; i < 50 && gone.ok(); ++i) gone = camera->Wait(100ms).status();
      EXPECT_THAT(gone.message(), HasSubstr(node_.string()));
      EXPECT_TRUE(camera->Stop().ok());
      EXPECT_EQ(Descriptors(), before) << "of a device that is gone";
      EXPECT_FALSE(camera->Start().ok());
      EXPECT_EQ(Descriptors(), before);
      Plug();
      EXPECT_TRUE(V4l2FrameSource::IsThere(wiring_));
      // By the same source, or by a new one.
      if (time == 1) camera = Open();
      ASSERT_TRUE(camera->Start().ok());
      const auto first = Next(*camera);
      ASSERT_TRUE(first.has_value());
      if (time != 1) {
        EXPECT_GT(first->sequence, last->sequence + 1) << "what was lost must show";
      }
      ASSERT_TRUE(camera->Stop().ok());
    }
  }
  EXPECT_EQ(Descriptors(), before);
}

TEST_F(V4l2UnplugTest, OneThatComesBackInTimeGoesOn) {
  const auto camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->Start().ok());
  const auto last = Next(*camera);
  const auto open = Descriptors();
  Unplug();
  ASSERT_TRUE(camera->Wait(10ms).ok());
  Plug();
  const auto next = Next(*camera);
  ASSERT_TRUE(last.has_value() && next.has_value());
  EXPECT_GT(next->sequence, last->sequence + 1);
  EXPECT_EQ(Descriptors(), open);
}

// A firmware that counts otherwise after the boot's power, a second camera of the kind: the program must not end of it.
TEST_F(V4l2UnplugTest, OneThatIsNotAsConfiguredMayComeLaterAndNoneIsRefused) {
  StopToken stop;
  RigEvents events(stop);
  wiring_.width = ScriptedV4l2::kWidth + 2;
  EXPECT_EQ(OpenCameraAtStart(wiring_, CameraAtStart::kNeeded, events, logger_).status().code(), StatusCode::kUsage);
  EXPECT_FALSE(events.IsActive(RigSignal::kCamera));
  auto camera = OpenCameraAtStart(wiring_, CameraAtStart::kMayComeLater, events, logger_);
  ASSERT_TRUE(camera.ok()) << camera.status().message();
  EXPECT_THAT((*camera)->Start().message(), HasSubstr("[camera] asks for 66x48"));
  EXPECT_TRUE(events.IsActive(RigSignal::kCamera)) << "away, until an opening goes well";
  wiring_.backend = CameraBackend::kNone;
  EXPECT_EQ(OpenCameraAtStart(wiring_, CameraAtStart::kMayComeLater, events, logger_).status().code(),
            StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::rig
