// SPDX-License-Identifier: Apache-2.0
// When the simulated camera exposes, reads out and passes over a trigger, and what a pattern memory's steps take: on
// the rig's clock.
#include <chrono>

#include <gtest/gtest.h>

#include "firmware-host/simulated/simulated_rig.h"
#include "tests/firmware-host/simulated/plain_patterns.h"

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr double kExposureMs = 16.0;

class CameraTiming : public ::testing::Test {
 protected:
  CameraTiming() {
    options_.scene = "white";
    options_.camera_width = 64;
    options_.camera_height = 48;
    options_.projector_width = 64;
    options_.projector_height = 48;
    options_.noise = false;
    options_.devices.timing.shutter_delay_ms = 0.0;
  }
  void Open() {
    auto rig = SimulatedRig::Create(options_, logger_);
    ASSERT_TRUE(rig.ok()) << rig.status().message();
    rig_ = std::move(*rig);
    ASSERT_TRUE(rig_->camera().Start().ok());
    ASSERT_TRUE(rig_->camera().SetExposure(kExposureMs, 1.0).ok());
    start_ = rig_->clock().Now();
  }
  double NowMs() const { return 1e-6 * static_cast<double>((rig_->clock().Now() - start_).count()); }
  void Until(double ms) { rig_->Sleep(FromMilliseconds(ms - NowMs() + 5e-7)); }
  void Trigger() { EXPECT_TRUE(rig_->lines().TriggerCamera().ok()); }
  std::optional<CapturedFrame> Wait(double ms) {
    auto frame = rig_->camera().Wait(FromMilliseconds(ms));
    EXPECT_TRUE(frame.ok());
    return std::move(*frame);
  }

  Logger logger_{LogLevel::kWarning};
  SimulatedRigOptions options_;
  std::unique_ptr<SimulatedRig> rig_;
  MonotonicNs start_;
};

TEST_F(CameraTiming, AFrameComesWhenItIsReadOutAndATriggerTakesNoTime) {
  Open();
  Trigger();
  EXPECT_EQ(NowMs(), 0.0);
  EXPECT_FALSE(Wait(0.0));
  EXPECT_FALSE(Wait(23.9));
  EXPECT_NEAR(NowMs(), 23.9, 1e-6);
  EXPECT_TRUE(Wait(50.0));
  EXPECT_NEAR(NowMs(), 24.0, 1e-6) << "16 of exposure, 8 of read-out";
  EXPECT_FALSE(Wait(10.0)) << "one trigger, one frame";
  EXPECT_NEAR(NowMs(), 34.0, 1e-6);
}

TEST_F(CameraTiming, ASerialReadOutPassesOverTriggersUntilItHasEnded) {
  Open();
  Trigger();
  for (const double early : {0.0, 8.0, 16.0, 23.9}) {
    Until(early);
    Trigger();
  }
  EXPECT_EQ(rig_->ignored_triggers(), 4);
  Until(24.0);
  Trigger();
  EXPECT_EQ(rig_->ignored_triggers(), 4);
  const auto first = Wait(0.0), second = Wait(100.0);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->sequence, 0);
  EXPECT_EQ(second->sequence, 1) << "what was passed over was no exposure";
  EXPECT_NEAR(1e-6 * static_cast<double>((second->time - first->time).count()), 24.0, 1e-6);
  EXPECT_NEAR(NowMs(), 48.0, 1e-6);
  EXPECT_FALSE(Wait(100.0));
}

TEST_F(CameraTiming, AnOverlappedReadOutTakesTheNextExposureMeanwhile) {
  options_.devices.timing.overlapped_readout = true;
  Open();
  Trigger();
  Until(15.9);
  Trigger();  // still exposing
  EXPECT_EQ(rig_->ignored_triggers(), 1);
  for (int k = 1; k <= 10; ++k) {
    Until(16.0 * k);
    Trigger();
  }
  EXPECT_EQ(rig_->ignored_triggers(), 1);
  MonotonicNs last{};
  for (int k = 0; k <= 10; ++k) {
    const auto frame = Wait(100.0);
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->sequence, k);
    if (k > 0) {
      EXPECT_NEAR(1e-6 * static_cast<double>((frame->time - last).count()), 16.0, 1e-6);
    }
    last = frame->time;
  }
  EXPECT_NEAR(NowMs(), 16.0 * 11 + 8.0, 1e-6);
}

TEST_F(CameraTiming, AShortExposureMayNotEndBeforeTheReadOutOfTheFrameBefore) {
  options_.devices.timing.overlapped_readout = true;
  options_.devices.timing.readout_ms = 30.0;
  Open();
  Trigger();  // exposes to 16, is read out to 46; the next may end then: begins at 30
  Until(29.9);
  Trigger();
  EXPECT_EQ(rig_->ignored_triggers(), 1);
  Until(30.0);
  Trigger();
  EXPECT_EQ(rig_->ignored_triggers(), 1);
}

TEST_F(CameraTiming, TheMinimumFramePeriodHoldsWhateverElseAllows) {
  options_.devices.timing.overlapped_readout = true;
  options_.devices.timing.min_frame_period_ms = 1000.0 / 60.0;
  Open();
  Trigger();
  Until(16.6);
  Trigger();
  EXPECT_EQ(rig_->ignored_triggers(), 1);
  Until(16.7);
  Trigger();
  EXPECT_EQ(rig_->ignored_triggers(), 1);
}

// A picture that changes during the exposure is seen for its share of it; one that changes during the read-out is not.
TEST_F(CameraTiming, AnExposureSeesWhatIsShownUntilItEnds) {
  options_.devices.projector.black_level = 0.0;
  options_.devices.timing.sync_delay_ms = 0.0;
  options_.devices.timing.overlapped_readout = true;
  Open();
  rig_->switches()[1]->Set(true);
  auto mean_of = [&](double step_at) {
    EXPECT_TRUE(rig_->projectors()[1]->Load({{}, kWhitePattern}).ok());
    EXPECT_TRUE(rig_->lines().TriggerProjector(1).ok());
    rig_->Sleep(milliseconds(100));
    const double begin = NowMs();
    Trigger();
    Until(begin + step_at);
    EXPECT_TRUE(rig_->lines().TriggerProjector(1).ok());
    const auto frame = Wait(100.0);
    EXPECT_EQ(rig_->ShownOf(frame->sequence).whole, step_at == 0.0 || step_at >= kExposureMs);
    return static_cast<double>(frame->pixels(32, 24)) - 64.0;
  };
  const double unlit = mean_of(16.0);
  EXPECT_LT(unlit, 3.0) << "the ambient light alone";
  const double at_once = mean_of(0.0) - unlit;
  EXPECT_GT(at_once, 500.0);
  EXPECT_NEAR((mean_of(8.0) - unlit) / at_once, 0.5, 0.002);
  EXPECT_NEAR((mean_of(12.0) - unlit) / at_once, 0.25, 0.002);
}

TEST_F(CameraTiming, AMemoryTakesItsTimeToWhatIsLoaded) {
  std::vector<Pattern> memory;
  for (int k = 0; k < 40; ++k) memory.push_back({.kind = PatternKind::kComb, .period = 64, .width = 1, .shift = k});
  options_.memories = {memory, memory};
  options_.devices.timing.memory_reset_ms = 50.0;
  options_.devices.timing.memory_step_ms = 4.0;
  Open();
  auto load = [&](int from, int count) {
    const double before = NowMs();
    EXPECT_TRUE(rig_->projectors()[1]->Load({memory.begin() + from, memory.begin() + from + count}).ok());
    return NowMs() - before;
  };
  EXPECT_NEAR(load(0, 40), 50.0, 1e-6) << "RESET";
  EXPECT_NEAR(load(10, 30), 40.0, 1e-6) << "ten steps on";
  EXPECT_TRUE(rig_->lines().TriggerProjector(1).ok());
  EXPECT_NEAR(load(20, 5), 36.0, 1e-6) << "from the eleventh on";
  EXPECT_NEAR(load(5, 5), 70.0, 1e-6) << "RESET and five steps";
  EXPECT_NEAR(load(30, 5), 100.0, 1e-6) << "25 steps on";
  EXPECT_NEAR(load(2, 5), 48.0, 1e-6) << "twelve steps, over the end: shorter than RESET and two";
  rig_->projectors()[1]->Doubt();
  EXPECT_NEAR(load(4, 5), 66.0, 1e-6) << "two steps on, if the place were known";
  const double before = NowMs();
  EXPECT_TRUE(rig_->projectors()[1]->Rest().ok());
  EXPECT_NEAR(NowMs() - before, 50.0, 1e-6);
  EXPECT_NEAR(load(0, 40), 0.0, 1e-6);
  EXPECT_EQ(rig_->projectors()[1]->Load({kWhitePattern}).code(), StatusCode::kUsage) << "it is filled once";
  EXPECT_EQ(rig_->fillings(), 0);
}

TEST_F(CameraTiming, AMemoryCostsNothingUnlessItIsSaidTo) {
  Open();
  EXPECT_TRUE(rig_->projectors()[1]->Load({kWhitePattern}).ok());
  EXPECT_EQ(NowMs(), 0.0);
  EXPECT_EQ(rig_->fillings(), 1);
}

}  // namespace
}  // namespace stratalux::rig
