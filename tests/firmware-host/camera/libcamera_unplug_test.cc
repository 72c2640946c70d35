// SPDX-License-Identifier: Apache-2.0
// The libcamera adapter, compiled against fake_libcamera: what a cable may do to it, and what that leaves behind.
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <libcamera/libcamera.h>

#include "firmware-host/camera/libcamera_frame_source.h"
#include "tests/firmware-host/camera/descriptors.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using libcamera::fake;
using ::testing::HasSubstr;

class LibcameraUnplugTest : public ::testing::Test {
 protected:
  void SetUp() override {
    wiring_.backend = CameraBackend::kLibcamera;
    wiring_.device = "imx";
    wiring_.width = 64;
    wiring_.height = 48;
    wiring_.buffers = 4;
    fake.plugged = {"imx"};
  }
  std::unique_ptr<FrameSource> Open() {
    auto camera = LibcameraFrameSource::Open(wiring_, logger_);
    EXPECT_TRUE(camera.ok()) << camera.status().message();
    return camera.ok() ? std::move(camera).value() : nullptr;
  }
  Status Refusal() { return LibcameraFrameSource::Open(wiring_, logger_).status(); }
  static void ExpectFrame(FrameSource& camera) {
    const auto frame = camera.Wait(5s);
    ASSERT_TRUE(frame.ok()) << frame.status().message();
    ASSERT_TRUE(frame->has_value());
    EXPECT_EQ((*frame)->pixels.width(), 64);
  }
  // Until the camera says that it is gone; frames may be on their way.
  static Status WaitForTheEnd(FrameSource& camera) {
    for (int i = 0; i < 20; ++i)
      if (const auto frame = camera.Wait(10ms); !frame.ok()) return frame.status();
    return Status::Ok();
  }
  CameraWiring wiring_;
  Logger logger_{LogLevel::kError};
};

TEST_F(LibcameraUnplugTest, IsListedWithItsSensorWhileItIsInUse) {
  const auto camera = Open();
  ASSERT_NE(camera, nullptr);
  const auto listed = LibcameraFrameSource::List();
  ASSERT_TRUE(listed.ok()) << listed.status().message();
  ASSERT_EQ(listed->size(), 1U);
  EXPECT_EQ(listed->front().id, "imx");
  EXPECT_EQ(listed->front().model, "imx477");
  ASSERT_EQ(listed->front().formats.size(), 1U);
  EXPECT_EQ(listed->front().formats[0].name, "SRGGB12");
  EXPECT_EQ(listed->front().formats[0].sizes.back(), (std::pair{64, 48}));
  EXPECT_TRUE(camera->Start().ok()) << "the list took nothing from it";
}

TEST_F(LibcameraUnplugTest, AClosedCameraLeavesNothing) {
  const auto before = Descriptors();
  for (int i = 0; i < 3; ++i) {
    const auto camera = Open();
    ASSERT_NE(camera, nullptr);
    ASSERT_TRUE(camera->SetExposure(16.0, 1.0).ok());
    ASSERT_TRUE(camera->Start().ok());
    ExpectFrame(*camera);
    EXPECT_EQ(Refusal().code(), StatusCode::kBusy) << "one at a time";
  }
  EXPECT_EQ(Descriptors(), before);
  EXPECT_EQ(fake.managers.load(), 0);
}

TEST_F(LibcameraUnplugTest, AFailedOpeningLeavesNothingAndTheNextOneGoesWell) {
  const auto before = Descriptors();
  struct Trouble {
    std::atomic<bool>* refused;
    StatusCode code;
  };
  for (const Trouble& trouble :
       {Trouble{&fake.refuse_acquire, StatusCode::kBusy}, Trouble{&fake.refuse_configure, StatusCode::kFailed},
        Trouble{&fake.refuse_buffers, StatusCode::kFailed}}) {
    trouble.refused->store(true);
    EXPECT_EQ(Refusal().code(), trouble.code);
    trouble.refused->store(false);
    EXPECT_EQ(Descriptors(), before);
  }
  wiring_.width = 65;
  EXPECT_EQ(Refusal().code(), StatusCode::kUsage);
  wiring_.width = 64;
  wiring_.device = "other";
  EXPECT_EQ(Refusal().code(), StatusCode::kNotFound);
  wiring_.device = "imx";
  EXPECT_EQ(Descriptors(), before);
  EXPECT_EQ(fake.managers.load(), 0);
  ASSERT_NE(Open(), nullptr);
}

TEST_F(LibcameraUnplugTest, OneThatWasUnpluggedIsOpenedAgainInTheSameProcess) {
  auto camera = Open();
  for (int time = 0; time < 5; ++time) {
    ASSERT_NE(camera, nullptr);
    ASSERT_TRUE(camera->Start().ok());
    ExpectFrame(*camera);
    EXPECT_TRUE(LibcameraFrameSource::IsThere(wiring_));
    libcamera::Unplug("imx");
    EXPECT_FALSE(LibcameraFrameSource::IsThere(wiring_));
    const Status gone = WaitForTheEnd(*camera);
    EXPECT_THAT(gone.message(), HasSubstr("imx: the camera was unplugged"));
    EXPECT_FALSE(camera->Stop().ok());
    camera.reset();
    EXPECT_EQ(Refusal().code(), StatusCode::kNotFound) << "it is away, not in use";
    libcamera::Plug("imx");
    EXPECT_TRUE(LibcameraFrameSource::IsThere(wiring_));
    camera = Open();
  }
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->Start().ok());
  ExpectFrame(*camera);
}

// What a camera that went leaves behind is bounded: its buffers, and nothing for each try to open it.
TEST_F(LibcameraUnplugTest, TriesToOpenOneThatIsAwayLeaveNothing) {
  auto camera = Open();
  ASSERT_NE(camera, nullptr);
  const auto open = Descriptors();
  ASSERT_TRUE(camera->Start().ok());
  libcamera::Unplug("imx");
  EXPECT_FALSE(WaitForTheEnd(*camera).ok());
  camera.reset();
  EXPECT_LE(Descriptors(), open);
  const auto before = Descriptors();
  for (int i = 0; i < 20; ++i) EXPECT_EQ(Refusal().code(), StatusCode::kNotFound);
  EXPECT_EQ(Descriptors(), before);
}

// A capture that the plug stopped stops its camera without having asked for another frame: libcamera would end the
// process there.
TEST_F(LibcameraUnplugTest, StoppingOneThatWentIsAnErrorAndNoMore) {
  for (const bool stop : {true, false}) {
    auto camera = Open();
    ASSERT_NE(camera, nullptr);
    ASSERT_TRUE(camera->Start().ok());
    ExpectFrame(*camera);
    libcamera::Unplug("imx");
    if (stop) {
      EXPECT_THAT(camera->Stop().message(), HasSubstr("the camera was unplugged"));
    }
    camera.reset();
    libcamera::Plug("imx");
  }
  ASSERT_NE(Open(), nullptr);
}

TEST_F(LibcameraUnplugTest, OneThatWentWhileNobodyCapturedIsOpenedAgain) {
  auto camera = Open();
  ASSERT_NE(camera, nullptr);
  libcamera::Unplug("imx");
  libcamera::Plug("imx");
  camera.reset();
  camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->Start().ok());
  ExpectFrame(*camera);
}

// It is still there, and what was given up has it: a new start, or its plug, brings it back, and that is what is said.
TEST_F(LibcameraUnplugTest, OneThatWasGivenUpWithoutAnUnplugSaysWhatBringsItBack) {
  auto camera = Open();
  ASSERT_NE(camera, nullptr);
  fake.cancel_frames = true;
  ASSERT_TRUE(camera->Start().ok());
  const Status failed = WaitForTheEnd(*camera);
  fake.cancel_frames = false;
  EXPECT_THAT(failed.message(), HasSubstr("imx: 5 requests in a row failed"));
  EXPECT_THAT(failed.message(), HasSubstr("once unplugged and plugged in again it is reopened; otherwise"));
  EXPECT_THAT(failed.message(), HasSubstr("restart the program"));
  camera.reset();
  EXPECT_THAT(Refusal().message(), HasSubstr("or this program gave it up; restart that program"));
  libcamera::Unplug("imx");
  libcamera::Plug("imx");
  camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->Start().ok());
  ExpectFrame(*camera);
}

// A thread is stuck inside libcamera: nothing of it may be touched any more.
TEST_F(LibcameraUnplugTest, AfterACallThatHangsThisProcessOpensNoOther) {
  const auto hang = [this] {
    auto camera = Open();
    fake.hang_in_start = true;
    const Status started = camera->Start();
    camera.reset();
    const Status next = Refusal();
    std::fprintf(stderr, "%s | %s\n", started.message().c_str(), next.message().c_str());
    _exit(next.code() == StatusCode::kBusy ? 0 : 1);
  };
  EXPECT_EXIT(hang(), ::testing::ExitedWithCode(0), "starting hangs inside libcamera.*restart the program");
}

}  // namespace
}  // namespace stratalux::rig
