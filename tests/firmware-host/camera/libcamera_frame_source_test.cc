// SPDX-License-Identifier: Apache-2.0
// A camera behind libcamera, held to what FrameSource promises; in the virtual machine it is vimc
// (tests/rig-vm/jobs/libcamera.sh), whose pictures are BGR888 and whose exposure cannot be set.
//   STRATALUX_TEST_LIBCAMERA         id of the camera (`cam -l`); unset: these tests are skipped
//   STRATALUX_TEST_LIBCAMERA_UNBIND  its driver's `unbind` file and the device's name, separated by a blank: the test
//                                    that unplugs it and plugs it in again by the `bind` file beside it
// What a cable may do otherwise: libcamera_unplug_test.cc.
#include "firmware-host/camera/libcamera_frame_source.h"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using std::chrono::seconds;
using ::testing::HasSubstr;

class LibcameraCamera : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* id = std::getenv("STRATALUX_TEST_LIBCAMERA");
    if (id == nullptr) GTEST_SKIP() << "STRATALUX_TEST_LIBCAMERA names no camera";
    wiring_.backend = CameraBackend::kLibcamera;
    wiring_.device = id;
    wiring_.format = "BGR888";
    wiring_.width = 636;
    wiring_.height = 480;
    wiring_.buffers = 4;
    wiring_.fixed_exposure_ms = 10.0;
  }
  std::unique_ptr<FrameSource> Open() {
    auto camera = LibcameraFrameSource::Open(wiring_, logger_);
    EXPECT_TRUE(camera.ok()) << camera.status().message();
    return camera.ok() ? std::move(camera).value() : nullptr;
  }
  Status RefusalOf() { return LibcameraFrameSource::Open(wiring_, logger_).status(); }
  static CapturedFrame Next(FrameSource& camera) {
    auto frame = camera.Wait(seconds(5));
    EXPECT_TRUE(frame.ok()) << frame.status().message();
    EXPECT_TRUE(frame.ok() && frame->has_value()) << "no frame in 5 s";
    return frame.ok() && *frame ? std::move(**frame) : CapturedFrame{};
  }
  CameraWiring wiring_;
  Logger logger_{LogLevel::kWarning};
};

TEST_F(LibcameraCamera, NumbersAndStampsItsFrames) {
  const auto camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->SetExposure(10.0, 1.0).ok());
  const MonotonicNs before = MonotonicNow();
  ASSERT_TRUE(camera->Start().ok());
  CapturedFrame last;
  for (int k = 0; k < 20; ++k) {
    CapturedFrame frame = Next(*camera);
    ASSERT_EQ(frame.pixels.width(), 636);
    ASSERT_EQ(frame.pixels.height(), 480);
    EXPECT_EQ(frame.format, PixelFormat::kMono12);
    EXPECT_EQ(frame.cfa, Cfa::kMono);
    EXPECT_FALSE(frame.corrupt);
    EXPECT_EQ(frame.clock, ClockSource::kMonotonic);
    EXPECT_EQ(frame.exposure_ms, 10.0);
    EXPECT_EQ(frame.gain, 1.0);
    EXPECT_LE(frame.time, MonotonicNow());
    if (k > 0) {
      EXPECT_GT(frame.sequence, last.sequence);
      EXPECT_GT(frame.time, last.time);
    } else {
      EXPECT_GE(frame.time, before) << "a frame from before Start";
    }
    last = std::move(frame);
  }
  // vimc paints bars of colours: their green is full here and missing there.
  const auto [darkest, brightest] = std::minmax_element(last.pixels.pixels().begin(), last.pixels.pixels().end());
  EXPECT_LT(*darkest, 400);
  EXPECT_GT(*brightest, 2500);
  EXPECT_LE(*brightest, 4095);
}

TEST_F(LibcameraCamera, GivesNothingAtTheDeadlineAndGoesOn) {
  const auto camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->Start().ok());
  Next(*camera);
  int waits = 0;
  for (bool none = false; !none && waits < 1000; ++waits) {
    const auto frame = camera->Wait({});
    ASSERT_TRUE(frame.ok()) << frame.status().message();
    none = !frame->has_value();
  }
  EXPECT_LT(waits, 1000) << "faster than any camera";
  Next(*camera);
}

TEST_F(LibcameraCamera, StartsAgainWithFreshFramesAndAGap) {
  const auto camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->Start().ok());
  Next(*camera);
  const CapturedFrame last = Next(*camera);
  ASSERT_TRUE(camera->Stop().ok());
  EXPECT_FALSE(camera->Wait({}).ok()) << "a frame of a stopped camera";
  const MonotonicNs restarted = MonotonicNow();
  ASSERT_TRUE(camera->Start().ok());
  const CapturedFrame first = Next(*camera);
  EXPECT_GE(first.time, restarted);
  EXPECT_GT(first.sequence, last.sequence + 1);
}

TEST_F(LibcameraCamera, RefusesAnExposureItCannotSet) {
  const auto camera = Open();
  ASSERT_NE(camera, nullptr);
  EXPECT_THAT(camera->SetExposure(20.0, 1.0).message(), HasSubstr("fixed_exposure_ms"));
  EXPECT_THAT(camera->SetExposure(10.0, 2.0).message(), HasSubstr("gain"));
}

TEST_F(LibcameraCamera, NamesWhatIsMissing) {
  wiring_.device = "no such camera";
  Status refusal = RefusalOf();
  EXPECT_EQ(refusal.code(), StatusCode::kNotFound);
  EXPECT_THAT(refusal.message(), HasSubstr(std::getenv("STRATALUX_TEST_LIBCAMERA")));
  SetUp();
  wiring_.format = "SRGGB12";
  refusal = RefusalOf();
  EXPECT_EQ(refusal.code(), StatusCode::kUsage);
  EXPECT_THAT(refusal.message(), HasSubstr("BGR888"));
  SetUp();
  wiring_.format.clear();
  EXPECT_EQ(RefusalOf().code(), StatusCode::kUsage) << "took processed pictures for raw ones";
  SetUp();
  wiring_.width = 637;
  EXPECT_THAT(RefusalOf().message(), HasSubstr("asks for 637x480"));
}

TEST_F(LibcameraCamera, IsOpenedOnceAProcessAndAgainWhenClosed) {
  {
    const auto camera = Open();
    ASSERT_NE(camera, nullptr);
    EXPECT_EQ(RefusalOf().code(), StatusCode::kBusy);
  }
  const auto again = Open();
  ASSERT_NE(again, nullptr);
  ASSERT_TRUE(again->Start().ok());
  Next(*again);
}

TEST_F(LibcameraCamera, UnpluggedEndsInAnErrorNotInAHang) {
  const char* unbind = std::getenv("STRATALUX_TEST_LIBCAMERA_UNBIND");
  if (unbind == nullptr) GTEST_SKIP() << "STRATALUX_TEST_LIBCAMERA_UNBIND names no device";
  auto camera = Open();
  ASSERT_NE(camera, nullptr);
  ASSERT_TRUE(camera->Start().ok());
  Next(*camera);
  std::istringstream words(unbind);
  std::string file, device;
  words >> file >> device;
  std::ofstream(file) << device << std::flush;
  // Some frames may still be on their way; then the error, within a bounded number of waits.
  Status status = Status::Ok();
  for (int k = 0; k < 40 && status.ok(); ++k) status = camera->Wait(std::chrono::milliseconds(250)).status();
  EXPECT_FALSE(status.ok()) << "the camera is gone and nobody says so";
  EXPECT_EQ(camera->Wait({}).status().message(), status.message());
  EXPECT_FALSE(camera->Stop().ok());
  camera.reset();
  // vimc's pipeline handler tells libcamera nothing of an unplugged camera (those that do, such as UVC's, are stood for
  // by libcamera_unplug_test): it stays in use.
  EXPECT_EQ(RefusalOf().code(), StatusCode::kBusy);
}

}  // namespace
}  // namespace stratalux::rig
