// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/rig_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/sequence/scripted_rig.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

class RigCheckTest : public ::testing::Test {
 protected:
  RigCheckTest() : rig_(3, 64, 48) {
    const Pattern black, white = {.kind = PatternKind::kWhite};
    options_.markers = {white, black, black, white};
    options_.wait = [](std::chrono::nanoseconds) {};
    options_.frames = 10;
    options_.pulses = 10;
  }
  RigCheckReport Run() {
    const Result<RigCheckReport> report = CheckRig(rig_.devices(), options_);
    EXPECT_TRUE(report.ok()) << report.status().message();
    EXPECT_THAT(rig_.lit(), IsEmpty()) << "a lamp stayed on";
    EXPECT_FALSE(rig_.camera_running);
    return report.ok() ? *report : RigCheckReport();
  }
  static const CheckItem& Item(const RigCheckReport& report, const std::string& name) {
    static const CheckItem none{"", CheckState::kSkipped, "no such item", ""};
    for (const CheckItem& item : report.items)
      if (item.name == name) return item;
    return none;
  }
  static std::vector<std::string> FailedOf(const RigCheckReport& report) {
    std::vector<std::string> names;
    for (const CheckItem& item : report.items)
      if (item.state == CheckState::kFailed) names.push_back(item.name);
    return names;
  }

  ScriptedRig rig_;
  RigCheckOptions options_;
};

TEST_F(RigCheckTest, AHealthyRigPassesAndIsMeasured) {
  const RigCheckReport report = Run();
  EXPECT_THAT(FailedOf(report), IsEmpty());
  EXPECT_EQ(report.sync_latency_ms.size(), 3U * 12U) << "10 pulses and more, in whole sequences";
  for (double latency : report.sync_latency_ms) EXPECT_NEAR(latency, 0.5, 1e-6);
  EXPECT_EQ(report.frame_latency_ms.size(), static_cast<size_t>(options_.frames));
  for (double latency : report.frame_latency_ms) EXPECT_NEAR(latency, 0.05, 1e-6);
  EXPECT_FALSE(report.samples.empty());
  EXPECT_EQ(rig_.trusting_loads, 0);
  EXPECT_EQ(rig_.rests, 3) << "the next program finds each memory at its first pattern";
  EXPECT_EQ(rig_.lit_rests, 0);
  ASSERT_TRUE(report.delays);
  ASSERT_EQ(report.delays->sync.size(), 3U);
  for (const DelayFigures& sync : report.delays->sync) {
    EXPECT_EQ(sync.count, 12);
    EXPECT_NEAR(sync.worst_ms, 0.5, 1e-6);
  }
  EXPECT_EQ(report.delays->frame.count, options_.frames);
  EXPECT_GT(report.delays->frame.median_ms, 0.0);
  EXPECT_EQ(report.delays->exposure_ms, options_.exposure_ms);
}

TEST_F(RigCheckTest, ARigThatFailsTeachesNothing) {
  rig_.enable_wired = {{0, -1}};
  EXPECT_FALSE(Run().delays);
  rig_.enable_wired.clear();
  rig_.interlock = StopReason::kDoorOpen;
  EXPECT_FALSE(Run().delays);
}

TEST_F(RigCheckTest, SwappedSyncCablesAreNamed) {
  rig_.sync_wired = {{0, 2}, {2, 0}};
  const RigCheckReport report = Run();
  const CheckItem& item = Item(report, "projector 0: TRIGGER to SYNC");
  EXPECT_EQ(item.state, CheckState::kFailed);
  EXPECT_THAT(item.remedy, HasSubstr("projectors 0 and 2"));
  EXPECT_EQ(Item(report, "projector 1: TRIGGER to SYNC").state, CheckState::kPassed);
}

TEST_F(RigCheckTest, SwappedLightsAreFoundByLight) {
  rig_.enable_wired = {{1, 2}, {2, 1}};
  const RigCheckReport report = Run();
  EXPECT_EQ(Item(report, "projector 0: light").state, CheckState::kPassed);
  const CheckItem& item = Item(report, "projector 1: light");
  EXPECT_EQ(item.state, CheckState::kFailed);
  EXPECT_THAT(item.remedy, HasSubstr("projectors 1 and 2"));
}

TEST_F(RigCheckTest, NoLightInvertedLightAndAMissingEdgeAreToldApart) {
  rig_.enable_wired = {{0, -1}};
  EXPECT_THAT(Item(Run(), "projector 0: light").remedy, HasSubstr("lamp"));
  rig_.enable_wired.clear();
  rig_.inverted = true;
  EXPECT_THAT(Item(Run(), "projector 0: light").remedy, HasSubstr("inverted"));
  rig_.inverted = false;
  rig_.projector_trouble[{1, rig_.PulsesOf(1) + 2}] = ProjectorTrouble::kNoEdge;
  EXPECT_THAT(Item(Run(), "projector 1: TRIGGER to SYNC").remedy, HasSubstr("polarity"));
}

TEST_F(RigCheckTest, LostAndDoubledFramesAreCounted) {
  // The camera check and three light checks take ten frames; then come those of the last check.
  rig_.camera_trouble[12] = CameraTrouble::kLose;
  rig_.camera_trouble[14] = CameraTrouble::kExtra;
  const RigCheckReport report = Run();
  EXPECT_EQ(report.frames_lost, 1);
  EXPECT_EQ(report.frames_doubled, 1);
  EXPECT_EQ(Item(report, "frames").state, CheckState::kFailed);
}

TEST_F(RigCheckTest, ADeadCameraAndAnOpenInterlockAreItems) {
  rig_.camera_dead_from = 0;
  EXPECT_EQ(Item(Run(), "camera").state, CheckState::kFailed);
  rig_.interlock = StopReason::kDoorOpen;
  const RigCheckReport report = Run();
  ASSERT_EQ(report.items.size(), 1U) << "nothing is lit behind an open door";
  EXPECT_EQ(report.items[0].state, CheckState::kFailed);
}

TEST_F(RigCheckTest, StopEndsIt) {
  rig_.stop.Request(StopReason::kOperator);
  EXPECT_EQ(CheckRig(rig_.devices(), options_).status().message(), "interrupted");
  EXPECT_THAT(rig_.ever_lit(), IsEmpty());
}

}  // namespace
}  // namespace stratalux::rig
