// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/capture_station.h"

#include <algorithm>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/session/small_station.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class CaptureStationTest : public ScratchFolderTest {
 protected:
  CaptureStationTest() : options_(SmallStation(folder_)) { request_.plan = options_.config.plan; }
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

// A calibration of such sessions takes it from there: their frames do not say how many bits the sensor has.
TEST_F(CaptureStationTest, SessionsSayWhereTheirSensorSaturates) {
  for (const auto& [bits, saturation_dn] : {std::pair{12, 4095.0}, {10, 4092.0}}) {
    options_.simulated->devices.camera.bits = bits;
    const auto station = Open();
    const auto outcome = station->Capture(request_);
    ASSERT_TRUE(outcome.ok()) << outcome.status().message();
    const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
    ASSERT_TRUE(store.ok()) << store.status().message();
    EXPECT_EQ(store->DevicesOf(outcome->session).saturation_dn, saturation_dn);
  }
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

// Nor is there anything to choose where the driver knows no control of it: any other exposure would be refused.
TEST_F(CaptureStationTest, ACameraOfOneExposureIsLeftAtIt) {
  options_.simulated->scene = "white";
  options_.config.camera.exposure_control = ExposureControl::kNone;
  options_.config.camera.fixed_exposure_ms = 7.0;
  const auto station = Open();
  for (const double plan_ms : {0.7, 7.0, 70.0}) {
    request_.plan.exposure_ms = plan_ms;
    const auto choice = station->ChooseExposure(request_.plan, {}, std::chrono::seconds(600));
    ASSERT_TRUE(choice.ok()) << choice.status().message();
    EXPECT_EQ(choice->exposure_ms, 7.0) << "plan: " << plan_ms;
  }
  EXPECT_EQ(station->ChooseExposure(request_.plan, {}, std::chrono::seconds(1)).status().code(), StatusCode::kUsage);
}

// One filling of the memories, every kind of capture one after the other, single frames between them.
TEST_F(CaptureStationTest, EveryKindIsShotFromOneFilling) {
  options_.simulated->scene = "white";
  const auto station = Open();
  const SimulatedRig& rig = *station->rig().simulation;
  EXPECT_EQ(rig.fillings(), 0);
  const auto white_card = [&] {
    for (int p = 0; p < 4; ++p) {
      const auto white = station->SnapPattern(p, {.kind = PatternKind::kWhite}, 4.0);
      const auto black = station->SnapPattern(p, {.kind = PatternKind::kBlack}, 4.0);
      ASSERT_TRUE(white.ok() && black.ok());
      EXPECT_GT(white->record.mean_dn, black->record.mean_dn + 20.0) << "projector " << p;
    }
  };
  white_card();
  for (const SessionKind kind : {SessionKind::kVisitor, SessionKind::kCalibration, SessionKind::kFlat,
                                 SessionKind::kResponse, SessionKind::kDark, SessionKind::kVisitor}) {
    request_.plan.kind = kind;
    ASSERT_TRUE(station->SetSubject({"white", 1, -1, kind == SessionKind::kDark}).ok());
    const auto outcome = station->Capture(request_);
    ASSERT_TRUE(outcome.ok()) << ToString(kind) << ": " << outcome.status().message();
    EXPECT_EQ(outcome->report.status, SessionStatus::kComplete)
        << ToString(kind) << ": " << (outcome->report.Reasons().empty() ? "" : outcome->report.Reasons().front());
    EXPECT_EQ(outcome->report.retried, 0) << ToString(kind) << ": " << outcome->report.FaultSummary();
    ASSERT_TRUE(station->SetSubject({"white", 1, -1, false}).ok());
    white_card();
  }
  EXPECT_EQ(rig.fillings(), 0);
}

// What left a memory out of step, unseen, is over when the next capture begins: it rested in between.
TEST_F(CaptureStationTest, AMemoryLeftOutOfStepByOneCaptureIsInStepForTheNext) {
  const size_t pulses = BuildPlan(request_.plan)->steps.size();
  // A guard's step that is not taken shows the black of the guard before.
  options_.simulated->faults.script = {*ParseFault("projector_lag@" + std::to_string(pulses - 1))};
  const auto station = Open();
  const auto visit = station->Capture(request_);
  ASSERT_TRUE(visit.ok()) << visit.status().message();
  EXPECT_EQ(visit->report.status, SessionStatus::kComplete);
  EXPECT_EQ(visit->injected.size(), 1U);
  request_.plan.kind = SessionKind::kCalibration;
  const auto calibration = station->Capture(request_);
  ASSERT_TRUE(calibration.ok()) << calibration.status().message();
  EXPECT_EQ(calibration->report.status, SessionStatus::kComplete);
  EXPECT_EQ(calibration->report.retried, 0) << calibration->report.FaultSummary();
}

TEST_F(CaptureStationTest, AnAbortInOneSectionIsFollowedByACaptureInAnother) {
  const auto station = Open();
  class Leaves final : public CaptureObserver {
   public:
    explicit Leaves(StopToken& stop) : stop_(stop) {}
    Status BeforeShot(const PlanStep& step, int /*retry*/) override {
      if (step.index == 90) stop_.Request(StopReason::kVisitorLeft);
      return Status::Ok();
    }

   private:
    StopToken& stop_;
  } leaves(stop_);
  for (const SessionKind next : {SessionKind::kCalibration, SessionKind::kVisitor}) {
    request_.plan.kind = SessionKind::kVisitor;
    const auto left = station->Capture(request_, &leaves);
    ASSERT_TRUE(left.ok()) << left.status().message();
    EXPECT_EQ(left->report.status, SessionStatus::kFailed);
    EXPECT_TRUE(Dark(*station));
    ASSERT_TRUE(station->light().Reset().ok());
    request_.plan.kind = next;
    const auto outcome = station->Capture(request_);
    ASSERT_TRUE(outcome.ok()) << outcome.status().message();
    EXPECT_EQ(outcome->report.status, SessionStatus::kComplete);
    EXPECT_EQ(outcome->report.retried, 0) << outcome->report.FaultSummary();
  }
}

TEST_F(CaptureStationTest, WhatTheMemoriesDoNotHoldIsRefusedBeforeAnyLight) {
  options_.config.memory.sections = {MemorySection::kVisitor};
  options_.config.memory.where = "rig.toml:9";
  const auto station = Open();
  const MonotonicNs opened = station->rig().simulation->clock().Now();
  request_.plan.kind = SessionKind::kCalibration;
  const Status kind = station->Capture(request_).status();
  EXPECT_EQ(kind.code(), StatusCode::kUsage);
  EXPECT_THAT(kind.message(), HasSubstr("rig.toml:9: the pattern memories hold no section 'calibration'"));
  EXPECT_EQ(CaptureStation::MayBegin(options_, request_).code(), StatusCode::kUsage);
  request_.plan.kind = SessionKind::kVisitor;
  request_.plan.comb_period = 16;
  EXPECT_EQ(station->Capture(request_).status().code(), StatusCode::kUsage) << "other patterns than [plan]'s";
  EXPECT_EQ(station->rig().simulation->clock().Now(), opened) << "nothing was moved or lit";
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store"));
  options_.config.plan.kind = SessionKind::kDark;
  EXPECT_EQ(CaptureStation::Open(options_, stop_, logger_).status().code(), StatusCode::kUsage);
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
