// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/capture_station.h"

#include <algorithm>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// An opaque plane before two small projectors.
class CaptureStationTest : public ScratchFolderTest {
 protected:
  CaptureStationTest() {
    RigConfig& config = options_.config;
    config.store.folder = (folder_ / "store").string();
    config.camera.width = 88;
    config.camera.height = 66;
    config.plan.projectors = 4;
    config.plan.projector_width = 128;
    config.plan.projector_height = 96;
    config.plan.comb_period = 32;
    config.plan.spot_pitch = 32;
    config.plan.spot_radius = 2;
    SimulatedRigOptions& simulated = options_.simulated.emplace();
    simulated.scene = "plane";
    simulated.scattering = false;
    simulated.camera_width = config.camera.width;
    simulated.camera_height = config.camera.height;
    simulated.projector_width = config.plan.projector_width;
    simulated.projector_height = config.plan.projector_height;
    request_.plan = config.plan;
  }
  std::unique_ptr<CaptureStation> Open() {
    auto station = CaptureStation::Open(options_, stop_, logger_);
    EXPECT_TRUE(station.ok()) << station.status().message();
    return std::move(*station);
  }
  [[nodiscard]] bool Dark(const CaptureStation& station) const {
    const auto switches = station.rig().simulation->switches();
    return std::none_of(switches.begin(), switches.end(), [](LightSwitch* light) {
      bool on = true;
      return light->Read(on) != 0 || on;
    });
  }
  [[nodiscard]] db::SessionRow Row(const std::string& id) const {
    const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
    EXPECT_TRUE(store.ok()) << store.status().message();
    const auto row = store->FindSession(id);
    EXPECT_TRUE(row.ok()) << row.status().message();
    return *row;
  }

  StationOptions options_;
  CaptureRequest request_;
  StopToken stop_;
  Logger logger_{LogLevel::kError};
};

TEST_F(CaptureStationTest, OneRigAndStoreServeManyVisits) {
  const auto station = Open();
  std::vector<std::string> sessions;
  for (int visit = 0; visit < 3; ++visit) {
    request_.visit = "visit-" + std::to_string(visit);
    request_.attempt = 1;
    ASSERT_TRUE(station->SetSubject({"plane", static_cast<uint64_t>(visit), -1, false}).ok());
    const auto outcome = station->Capture(request_);
    ASSERT_TRUE(outcome.ok()) << outcome.status().message();
    EXPECT_EQ(outcome->report.status, SessionStatus::kComplete)
        << (outcome->report.Reasons().empty() ? "" : outcome->report.Reasons().front());
    const SessionInfo info = Row(outcome->session).info;
    EXPECT_EQ(info.seed, visit);
    EXPECT_EQ(info.visit, request_.visit);
    EXPECT_EQ(info.attempt, 1);
    EXPECT_TRUE(Dark(*station));
    sessions.push_back(outcome->session);
  }
  std::sort(sessions.begin(), sessions.end());
  EXPECT_EQ(std::unique(sessions.begin(), sessions.end()), sessions.end());
}

TEST_F(CaptureStationTest, WhatCannotBeginLeavesNoStore) {
  request_.visit = "caf\xe9";
  EXPECT_EQ(CaptureStation::MayBegin(options_, request_).code(), StatusCode::kUsage) << "no text";
  request_.visit.clear();
  request_.visitor = "somebody";
  EXPECT_EQ(CaptureStation::MayBegin(options_, request_).code(), StatusCode::kUsage) << "nobody asked for consent";
  const auto station = Open();
  EXPECT_FALSE(station->Capture(request_).ok());
  request_.visitor.clear();
  request_.calibration = "latest";
  EXPECT_FALSE(station->Capture(request_).ok());
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store"));
}

TEST_F(CaptureStationTest, AStoppedStationCapturesAgainOnceItsLightIsReset) {
  const auto station = Open();
  class Leaves final : public CaptureObserver {
   public:
    explicit Leaves(StopToken& stop) : stop_(stop) {}
    Status BeforeShot(const PlanStep& step, int /*retry*/) override {
      if (step.index == 40) stop_.Request(StopReason::kVisitorLeft);
      return Status::Ok();
    }

   private:
    StopToken& stop_;
  } leaves(stop_);
  const auto left = station->Capture(request_, &leaves);
  ASSERT_TRUE(left.ok()) << left.status().message();
  EXPECT_EQ(left->report.status, SessionStatus::kFailed);
  EXPECT_EQ(left->report.findings.front().kind, FindingKind::kStopped);
  EXPECT_THAT(Row(left->session).info.reasons.front(), HasSubstr(ToString(StopReason::kVisitorLeft)));
  EXPECT_TRUE(Dark(*station));
  EXPECT_FALSE(station->Capture(request_).ok()) << "nobody looked whether the reason is gone";
  ASSERT_TRUE(station->light().Reset().ok());
  const auto next = station->Capture(request_);
  ASSERT_TRUE(next.ok()) << next.status().message();
  EXPECT_EQ(next->report.status, SessionStatus::kComplete);
}

TEST_F(CaptureStationTest, ObjectionsDegradeAndFaultsAreThoseOfTheCapture) {
  class Objects final : public CaptureObserver {
   public:
    [[nodiscard]] std::vector<Finding> Objections() const override {
      return {{FindingKind::kWatch, -1, -1, 0.0, 0.0, "the board is upside down"}};
    }
  } objects;
  options_.simulated->faults.script = {*ParseFault("frame_lost@30")};
  const auto station = Open();
  const auto outcome = station->Capture(request_, &objects);
  ASSERT_TRUE(outcome.ok()) << outcome.status().message();
  EXPECT_EQ(outcome->report.status, SessionStatus::kDegraded);
  EXPECT_THAT(outcome->report.Reasons(), ElementsAre("the board is upside down"));
  EXPECT_EQ(outcome->injected.size(), 1U);
  EXPECT_EQ(outcome->report.Found().faults.at("lost frame"), 1);
  EXPECT_EQ(Row(outcome->session).info.found, outcome->report.Found());
  const auto next = station->Capture(request_);
  ASSERT_TRUE(next.ok()) << next.status().message();
  EXPECT_EQ(next->report.status, SessionStatus::kComplete);
  EXPECT_THAT(next->injected, IsEmpty());
}

TEST_F(CaptureStationTest, SnapsWhatIsOnShowAndWhatItIsToldToShow) {
  const auto station = Open();
  const auto dark = station->Snap(16.0);
  ASSERT_TRUE(dark.ok()) << dark.status().message();
  const auto white = station->SnapPattern(1, {.kind = PatternKind::kWhite}, 16.0);
  ASSERT_TRUE(white.ok()) << white.status().message();
  EXPECT_GT(white->record.mean_dn, dark->record.mean_dn + 100.0);
  const auto half = station->SnapPattern(1, {.kind = PatternKind::kWhite}, 8.0);
  ASSERT_TRUE(half.ok());
  EXPECT_NEAR((half->record.mean_dn - dark->record.mean_dn) / (white->record.mean_dn - dark->record.mean_dn), 0.5,
              0.05);
  EXPECT_TRUE(Dark(*station));
  EXPECT_EQ(station->SnapPattern(-1, {.kind = PatternKind::kWhite}, 16.0).status().code(), StatusCode::kUsage);
  EXPECT_EQ(station->SnapPattern(4, {.kind = PatternKind::kWhite}, 16.0).status().code(), StatusCode::kUsage);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store")) << "a preview is never stored";
  // Nothing of it disturbs a capture.
  const auto outcome = station->Capture(request_);
  ASSERT_TRUE(outcome.ok());
  EXPECT_EQ(outcome->report.status, SessionStatus::kComplete);
}

TEST_F(CaptureStationTest, APreScanChoosesWhatTheSubjectNeeds) {
  options_.simulated->scene = "white";
  const auto station = Open();
  const auto seconds = std::chrono::seconds(20);
  const auto choice = station->ChooseExposure(request_.plan, {}, seconds);
  ASSERT_TRUE(choice.ok()) << choice.status().message();
  EXPECT_GE(choice->snr, 16.0);
  EXPECT_LE(choice->saturated, 0.00525);
  EXPECT_TRUE(Dark(*station));
  // A plan whose exposure saturates is scanned at shorter ones, and shortened.
  PlanOptions long_plan = request_.plan;
  long_plan.exposure_ms = 40.0 * choice->exposure_ms;
  const auto shortened = station->ChooseExposure(long_plan, {}, std::chrono::seconds(600));
  ASSERT_TRUE(shortened.ok()) << shortened.status().message();
  EXPECT_LT(shortened->exposure_ms, 0.5 * long_plan.exposure_ms);
  EXPECT_LE(shortened->saturated, 0.00525);
  EXPECT_EQ(station->ChooseExposure(request_.plan, {}, std::chrono::seconds(1)).status().code(), StatusCode::kUsage);
  request_.plan.exposure_ms = choice->exposure_ms;
  request_.prescan = {{FindingKind::kDim, 2, -1, 31.0, 40.0}};
  const auto outcome = station->Capture(request_);
  ASSERT_TRUE(outcome.ok());
  EXPECT_EQ(outcome->report.status, SessionStatus::kComplete) << "a dim corner is nothing against the proof";
  EXPECT_THAT(outcome->report.findings, IsEmpty());
  EXPECT_EQ(outcome->prescan, request_.prescan);
  EXPECT_EQ(Row(outcome->session).info.found.findings, request_.prescan);
  EXPECT_THAT(Row(outcome->session).info.reasons, IsEmpty());
}

TEST_F(CaptureStationTest, ALensCapStaysOnForItsCaptureAlone) {
  const auto station = Open();
  request_.plan.kind = SessionKind::kDark;
  ASSERT_TRUE(station->SetSubject({"plane", 1, -1, true}).ok());
  const auto dark = station->Capture(request_);
  ASSERT_TRUE(dark.ok()) << dark.status().message();
  EXPECT_EQ(dark->report.status, SessionStatus::kComplete);
  request_.plan.kind = SessionKind::kVisitor;
  ASSERT_TRUE(station->SetSubject({"plane", 1, -1, false}).ok());
  const auto open = station->Capture(request_);
  ASSERT_TRUE(open.ok()) << open.status().message();
  EXPECT_EQ(open->report.status, SessionStatus::kComplete);
}

}  // namespace
}  // namespace stratalux::rig
