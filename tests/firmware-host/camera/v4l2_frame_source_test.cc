// SPDX-License-Identifier: Apache-2.0
// The V4L2 camera against vivid (vivid.h says how it is loaded; tests/rig-vm has it). No environment variables; skipped
// on machines without.
#include "firmware-host/camera/v4l2_frame_source.h"

#include <algorithm>
#include <cstdio>
#include <functional>
#include <numeric>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/camera/vivid.h"
#include "tests/support/text_of.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

constexpr int kBlackPattern = 5, kWhitePattern = 6;  // of vivid's menu "Test Pattern"

double MeanLevel(const CapturedFrame& frame) {
  const auto pixels = frame.pixels.pixels();
  return std::accumulate(pixels.begin(), pixels.end(), 0.0) / static_cast<double>(pixels.size());
}

class V4l2FrameSourceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    vivid_ = Vivid::Find();
    if (!vivid_) GTEST_SKIP() << "no vivid on this machine (`modprobe vivid`, see vivid.h)";
    vivid_->Set("OSD Text Mode", 2);     // none
    vivid_->Set("Timestamp Source", 1);  // start of exposure
    log_ = std::tmpfile();
    logger_ = std::make_unique<Logger>(LogLevel::kInfo, log_);
    wiring_.backend = CameraBackend::kV4l2;
    wiring_.driver = "vivid";
    wiring_.format = "Y12";
    wiring_.width = 320;
    wiring_.height = 180;
    wiring_.frame_rate_hz = 30;
    wiring_.exposure_control = ExposureControl::kNone;
    wiring_.fixed_exposure_ms = 5.0;
  }
  void TearDown() override {
    camera_.reset();
    if (vivid_) {
      vivid_->Set("Percentage of Dropped Buffers", 0);
      vivid_->Set("Wrap Timestamp", 0);
      vivid_->Set("Wrap Sequence Number", 0);
    }
    if (log_ != nullptr) std::fclose(log_);
  }
  void Start() {
    Result<std::unique_ptr<FrameSource>> camera = V4l2FrameSource::Open(wiring_, *logger_);
    ASSERT_TRUE(camera.ok()) << camera.status().message();
    camera_ = std::move(camera).value();
    const Status started = camera_->Start();
    ASSERT_TRUE(started.ok()) << started.message();
  }
  // The next `count` frames; fewer where they stay away.
  std::vector<CapturedFrame> Take(int count) {
    std::vector<CapturedFrame> frames;
    while (static_cast<int>(frames.size()) < count) {
      auto frame = camera_->Wait(10s);
      if (!frame.ok()) {
        ADD_FAILURE() << frame.status().message();
        return frames;
      }
      if (!*frame) return frames;
      frames.push_back(std::move(**frame));
    }
    return frames;
  }
  std::string LogText() {
    EXPECT_TRUE(logger_->Flush());
    return TextOf(log_);
  }

  std::unique_ptr<Vivid> vivid_;
  std::FILE* log_ = nullptr;
  std::unique_ptr<Logger> logger_;
  CameraWiring wiring_;
  std::unique_ptr<FrameSource> camera_;
};

// A virtual machine may stall, and vivid then counts what it left out, or one frame twice: no fault of ours, and one
// run of three in which numbers rise, nearly all by one, is enough.
TEST_F(V4l2FrameSourceTest, FramesComeNumberedAndStamped) {
  Start();
  const MonotonicNs before = MonotonicNow();
  std::vector<CapturedFrame> frames;
  int followers = 0;
  for (int run = 0; run < 3 && followers <= 20; ++run) {
    frames = Take(30);
    ASSERT_EQ(frames.size(), 30U);
    followers = 0;
    for (size_t i = 0; i < frames.size(); ++i) {
      EXPECT_EQ(frames[i].clock, ClockSource::kMonotonic);
      EXPECT_EQ(frames[i].exposure_ms, 5.0);
      EXPECT_EQ(frames[i].pixels.width(), 320);
      EXPECT_EQ(frames[i].pixels.height(), 180);
      EXPECT_FALSE(frames[i].corrupt);
      EXPECT_LE(frames[i].time, MonotonicNow());
      if (i == 0) continue;
      EXPECT_LT(frames[i - 1].time, frames[i].time);
      followers += frames[i].sequence == frames[i - 1].sequence + 1 ? 1 : 0;
    }
    if (std::ranges::adjacent_find(frames, std::greater_equal(), &CapturedFrame::sequence) != frames.end())
      followers = 0;
  }
  EXPECT_GT(followers, 20);
  EXPECT_LE(before + -10s, frames[0].time);
}

TEST_F(V4l2FrameSourceTest, EveryRawFormatShowsWhiteAndBlack) {
  for (const char* format : {"GREY", "Y10",  "Y12",  "Y16",  "Y16-BE", "BA81", "GBRG", "GRBG", "RGGB", "BG10", "GB10",
                             "BA10", "RG10", "BG12", "GB12", "BA12",   "RG12", "BYR2", "GB16", "GR16", "RG16"}) {
    SCOPED_TRACE(format);
    wiring_.format = format;
    std::vector<double> levels;
    for (const int pattern : {kBlackPattern, kWhitePattern}) {
      ASSERT_TRUE(vivid_->Set("Test Pattern", pattern));
      Start();
      const std::vector<CapturedFrame> frames = Take(2);
      camera_.reset();
      ASSERT_EQ(frames.size(), 2U);
      const double full = frames[1].format == PixelFormat::kMono16 ? 65535.0 : 4095.0;
      levels.push_back(MeanLevel(frames[1]) / full);
      EXPECT_LE(std::ranges::max(frames[1].pixels.pixels()), full);
    }
    EXPECT_LT(levels[0], 0.15);
    EXPECT_GT(levels[1], 0.75);
  }
  vivid_->Set("Test Pattern", 0);
}

TEST_F(V4l2FrameSourceTest, WithoutAFormatTheOneOfMostBitsIsTaken) {
  wiring_.format.clear();
  Start();
  const std::vector<CapturedFrame> frames = Take(1);
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].format, PixelFormat::kMono16);
}

TEST_F(V4l2FrameSourceTest, DroppedBuffersAreGapsInTheNumbers) {
  Start();
  ASSERT_TRUE(vivid_->Set("Percentage of Dropped Buffers", 30));
  const std::vector<CapturedFrame> frames = Take(60);
  ASSERT_EQ(frames.size(), 60U);
  EXPECT_GT(frames.back().sequence - frames.front().sequence, 59);
  for (size_t i = 1; i < frames.size(); ++i) EXPECT_GT(frames[i].sequence, frames[i - 1].sequence);
}

TEST_F(V4l2FrameSourceTest, TheErrorFlagMarksItsFrameAlone) {
  Start();
  ASSERT_EQ(Take(2).size(), 2U);
  ASSERT_TRUE(vivid_->Set("Inject V4L2_BUF_FLAG_ERROR", 1));
  const std::vector<CapturedFrame> frames = Take(30);
  EXPECT_EQ(std::count_if(frames.begin(), frames.end(), [](const CapturedFrame& f) { return f.corrupt; }), 1);
}

TEST_F(V4l2FrameSourceTest, AFatalStreamingErrorIsMendedByOpeningAgain) {
  Start();
  const std::vector<CapturedFrame> before = Take(3);
  ASSERT_EQ(before.size(), 3U);
  ASSERT_TRUE(vivid_->Set("Inject Fatal Streaming Error", 1));
  const std::vector<CapturedFrame> frames = Take(30);
  ASSERT_EQ(frames.size(), 30U);
  bool gap = false;
  int64_t last = before.back().sequence;
  for (const CapturedFrame& frame : frames) {
    EXPECT_GT(frame.sequence, last);
    gap = gap || frame.sequence > last + 1;
    last = frame.sequence;
  }
  EXPECT_TRUE(gap) << "what was lost while the device was closed must show";
  EXPECT_THAT(LogText(), HasSubstr("opened again"));
}

TEST_F(V4l2FrameSourceTest, AnErrorAtStreamingOrQueueingIsTriedAgain) {
  ASSERT_TRUE(vivid_->Set("Inject VIDIOC_STREAMON Error", 1));
  Start();
  EXPECT_EQ(Take(3).size(), 3U);
  ASSERT_TRUE(vivid_->Set("Inject VIDIOC_QBUF Error", 1));
  EXPECT_EQ(Take(10).size(), 10U);
  camera_.reset();
  ASSERT_TRUE(vivid_->Set("Inject VIDIOC_REQBUFS Error", 1));
  Start();
  EXPECT_EQ(Take(3).size(), 3U);
}

TEST_F(V4l2FrameSourceTest, TheDriversNumberWrapsWithoutAGap) {
  constexpr int64_t kWrap = int64_t{1} << 32;
  ASSERT_TRUE(vivid_->Set("Wrap Sequence Number", 1));
  Start();
  const std::vector<CapturedFrame> frames = Take(140);  // it starts 128 before the wrap
  ASSERT_EQ(frames.size(), 140U);
  EXPECT_LT(frames.front().sequence, kWrap);
  EXPECT_GE(frames.back().sequence, kWrap);
  EXPECT_LT(frames.back().sequence, kWrap + 140) << "the stalls of a virtual machine apart";
  for (size_t i = 1; i < frames.size(); ++i) EXPECT_GT(frames[i].sequence, frames[i - 1].sequence);
}

TEST_F(V4l2FrameSourceTest, AWrappingClockMarksItsFrames) {
  ASSERT_TRUE(vivid_->Set("Wrap Timestamp", 1));
  Start();
  const std::vector<CapturedFrame> frames = Take(3);
  ASSERT_EQ(frames.size(), 3U);
  for (const CapturedFrame& frame : frames) EXPECT_TRUE(frame.corrupt);
  EXPECT_THAT(LogText(), HasSubstr("clock wrapped or jumped"));
}

TEST_F(V4l2FrameSourceTest, AStampOfTheEndIsCarriedBackToTheStart) {
  using Case = std::tuple<int, std::chrono::nanoseconds, std::chrono::nanoseconds>;
  wiring_.readout_ms = 400.0;
  for (const auto& [source, at_least, at_most] :
       {Case{0, 300ms, 10s}, Case{1, -1s, 300ms}}) {  // end of frame, start of exposure
    SCOPED_TRACE(source);
    ASSERT_TRUE(vivid_->Set("Timestamp Source", source));
    Start();
    std::chrono::nanoseconds least = 1h;  // the machine may stall, but not at each frame
    for (int i = 0; i < 40; ++i) {
      const std::vector<CapturedFrame> frames = Take(1);
      ASSERT_EQ(frames.size(), 1U);
      least = std::min(least, MonotonicNow() - frames[0].time);
    }
    camera_.reset();
    EXPECT_GE(least, at_least);
    EXPECT_LE(least, at_most);
  }
}

TEST_F(V4l2FrameSourceTest, GainIsSetAndReadBackForTheFramesThatHaveIt) {
  wiring_.gain_control = GainControl::kGain;
  wiring_.gain_unit = 100.0;
  Start();
  ASSERT_TRUE(camera_->SetExposure(5.0, 1.0).ok());
  ASSERT_EQ(Take(10).size(), 10U);
  ASSERT_TRUE(camera_->SetExposure(5.0, 1.5).ok());
  const MonotonicNs set = MonotonicNow();
  const std::vector<CapturedFrame> frames = Take(20);
  ASSERT_EQ(frames.size(), 20U);
  EXPECT_EQ(frames.back().gain, 1.5);
  for (const CapturedFrame& frame : frames) {
    if (set < frame.time) {
      EXPECT_EQ(frame.gain, 1.5);
    }
  }
  ASSERT_TRUE(camera_->Stop().ok());
  ASSERT_TRUE(vivid_->Set("Gain", 40));
  ASSERT_TRUE(camera_->Start().ok());
  const std::vector<CapturedFrame> again = Take(2);
  ASSERT_EQ(again.size(), 2U);
  EXPECT_EQ(again.back().gain, 1.5) << "a new start sets what was asked for";
  EXPECT_EQ(camera_->SetExposure(5.0, 3.0).code(), StatusCode::kUsage) << "beyond the control's range";
  EXPECT_EQ(camera_->SetExposure(6.0, 1.0).code(), StatusCode::kUsage) << "the exposure is fixed";
}

TEST_F(V4l2FrameSourceTest, WaitKeepsItsDeadline) {
  Start();
  ASSERT_TRUE(vivid_->Set("Percentage of Dropped Buffers", 100));
  const auto started = std::chrono::steady_clock::now();
  while (true) {
    const auto frame = camera_->Wait(300ms);
    ASSERT_TRUE(frame.ok());
    if (!*frame) break;
    ASSERT_LT(std::chrono::steady_clock::now() - started, 10s) << "frames although all are dropped";
  }
}

TEST_F(V4l2FrameSourceTest, WhatIsNotThereIsNamed) {
  wiring_.card = "no such card";
  Status status = V4l2FrameSource::Open(wiring_, *logger_).status();
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_THAT(status.message(), HasSubstr("vivid"));
  wiring_.card.clear();
  wiring_.format = "Y99";
  status = V4l2FrameSource::Open(wiring_, *logger_).status();
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("Y12"));
  wiring_.format = "Y12";
  wiring_.width = 333;
  EXPECT_THAT(V4l2FrameSource::Open(wiring_, *logger_).status().message(), HasSubstr("offers"));
  wiring_.width = 320;
  wiring_.exposure_control = ExposureControl::kExposureAbsolute;
  EXPECT_THAT(V4l2FrameSource::Open(wiring_, *logger_).status().message(), HasSubstr("exposure_control"));
  wiring_.device = "/dev/no-such-camera";
  EXPECT_EQ(V4l2FrameSource::Open(wiring_, *logger_).status().code(), StatusCode::kNotFound);
}

TEST_F(V4l2FrameSourceTest, AnUnpluggedCameraComesBack) {
  Start();
  const std::vector<CapturedFrame> before = Take(3);
  ASSERT_EQ(before.size(), 3U);
  ASSERT_TRUE(vivid_->Set("Disconnect", 1));
  std::thread world([this] {
    std::this_thread::sleep_for(1s);
    vivid_.reset();  // plugged in again
  });
  std::vector<CapturedFrame> frames;
  const auto started = std::chrono::steady_clock::now();
  while (frames.size() < 5 && std::chrono::steady_clock::now() - started < 30s) {
    auto frame = camera_->Wait(200ms);
    if (!frame.ok()) {
      ADD_FAILURE() << frame.status().message();
      break;
    }
    if (*frame && (*frame)->sequence > before.back().sequence + 1) frames.push_back(std::move(**frame));
  }
  world.join();
  EXPECT_EQ(frames.size(), 5U);
  EXPECT_THAT(LogText(), HasSubstr("opened again"));
  vivid_ = Vivid::Find();
}

TEST_F(V4l2FrameSourceTest, ACameraThatStaysAwayIsAnError) {
  wiring_.reopen_tries = 3;
  Start();
  ASSERT_EQ(Take(2).size(), 2U);
  ASSERT_TRUE(vivid_->Set("Disconnect", 1));
  Status status;
  for (int i = 0; i < 100 && status.ok(); ++i) status = camera_->Wait(200ms).status();
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_THAT(status.message(), HasSubstr("3 tries"));
  camera_.reset();
  vivid_.reset();
  vivid_ = Vivid::Find();
  EXPECT_NE(vivid_, nullptr);
}

}  // namespace
}  // namespace stratalux::rig
