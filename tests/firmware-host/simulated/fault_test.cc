// SPDX-License-Identifier: Apache-2.0
// Each fault of the simulated devices has its stated effect, and what a capture makes of it.
#include <cmath>
#include <cstdio>
#include <map>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/config/toml_reader.h"

namespace stratalux::rig {
namespace {

SimulatedRigOptions Small() {
  SimulatedRigOptions options;
  options.scene = "head";
  options.camera_width = 96;
  options.camera_height = 72;
  options.projector_width = 128;
  options.projector_height = 96;
  options.noise = false;
  options.scattering = false;  // quick
  return options;
}

PlanOptions SmallPlan() {
  PlanOptions plan;
  plan.projector_width = 128;
  plan.projector_height = 96;
  plan.preroll_markers = 4;
  plan.separation_shifts = 3;
  plan.comb_period = 32;
  plan.spot_radius = 0;
  plan.motion_whites = 1;
  plan.guards = 1;
  return plan;
}

// The last frame of each step, as the store would hold it.
struct Kept : FrameSink {
  Status Put(FrameRecord record, Image<uint16_t> pixels) override {
    last[record.step] = {record, std::move(pixels)};
    return Status::Ok();
  }
  std::map<int, std::pair<FrameRecord, Image<uint16_t>>> last;
};

struct Capture {
  Result<CaptureReport> report = Status::Failed("not run");
  Kept kept;
  std::vector<InjectedFault> injected;
};

Capture CaptureWith(const FaultOptions& faults) {
  Logger logger(LogLevel::kError, std::tmpfile());
  SimulatedRigOptions options = Small();
  options.faults = faults;
  const auto rig = SimulatedRig::Create(options, logger);
  EXPECT_TRUE(rig.ok()) << rig.status().message();
  const CapturePlan plan = *BuildPlan(SmallPlan());
  SequencerOptions sequencer;
  sequencer.shooter.wait = [&](std::chrono::nanoseconds time) { (*rig)->Sleep(time); };
  sequencer.shooter.sync_deadline = sequencer.shooter.frame_deadline = std::chrono::milliseconds(20);
  const std::atomic<bool> stop = false;
  Capture capture;
  capture.report = Sequencer({(*rig)->lines(), (*rig)->camera(), (*rig)->projectors()}, sequencer, logger, stop)
                       .Run(plan, capture.kept);
  capture.injected = (*rig)->injected();
  return capture;
}

const Capture& Clean() {
  static const Capture clean = CaptureWith({});
  return clean;
}

// A frame shows another picture than its step's: it differs from the clean frame by more than rounding can.
bool ShowsAnotherPicture(const Image<uint16_t>& frame, const Image<uint16_t>& clean) {
  double difference = 0.0, level = 0.0;
  for (size_t i = 0; i < frame.size(); ++i) {
    difference += std::abs(int(frame.data()[i]) - int(clean.data()[i]));
    level += clean.data()[i] - 64.0;
  }
  return difference > 0.02 * level + 0.6 * static_cast<double>(frame.size());
}

struct Verdict {
  bool detected = false;
  int wrong = 0;      // frames with another picture that the capture takes for good
  int confessed = 0;  // with another picture, in a session that says so (degraded or failed)
};

Verdict Judge(const Capture& capture) {
  Verdict verdict;
  const CaptureReport& report = *capture.report;
  verdict.detected = report.retried > 0 || report.status != SessionStatus::kComplete || !report.FaultSummary().empty();
  for (const auto& [step, kept] : capture.kept.last) {
    if (kept.first.level_check == LevelCheck::kFailed) continue;
    if (!ShowsAnotherPicture(kept.second, Clean().kept.last.at(step).second)) continue;
    ++(report.status == SessionStatus::kComplete ? verdict.wrong : verdict.confessed);
  }
  return verdict;
}

TEST(Faults, ACleanCaptureIsCompleteAndRepeatable) {
  ASSERT_TRUE(Clean().report.ok());
  EXPECT_EQ(Clean().report->status, SessionStatus::kComplete);
  EXPECT_TRUE(Clean().injected.empty());
  const Capture again = CaptureWith({});
  const Verdict verdict = Judge(again);
  EXPECT_FALSE(verdict.detected);
  EXPECT_EQ(verdict.wrong + verdict.confessed, 0);
}

// Among the codes, in the sweep.
constexpr int64_t kPlaces[] = {12, 45};

TEST(Faults, EveryKindIsInjectedAndTheTableSaysWhatBecomesOfIt) {
  std::printf("%-16s %9s %9s %9s %15s %15s\n", "fault", "injected", "detected", "survived", "wrong, unsaid",
              "wrong, said");
  for (int k = 0; k < kFaultKinds; ++k) {
    const auto kind = static_cast<FaultKind>(k);
    int injected = 0, detected = 0, survived = 0, wrong = 0, confessed = 0;
    for (const int64_t place : kPlaces) {
      const Capture capture = CaptureWith({{{kind, place, kind == FaultKind::kSyncStuck ? 3 : 1, 0.0}}, 1, 0.0, {}});
      ASSERT_TRUE(capture.report.ok()) << ToString(kind) << ": " << capture.report.status().message();
      ASSERT_FALSE(capture.injected.empty()) << ToString(kind) << " at " << place;
      EXPECT_EQ(capture.injected[0].kind, kind);
      EXPECT_EQ(capture.injected[0].number, place);
      const Verdict verdict = Judge(capture);
      ++injected;
      detected += verdict.detected;
      survived += capture.report->status == SessionStatus::kComplete;
      wrong += verdict.wrong;
      confessed += verdict.confessed;
    }
    std::printf("%-16s %9d %9d %9d %15d %15d\n", ToString(kind), injected, detected, survived, wrong, confessed);
    // What a driver or a line tells is never taken for a good frame. (What only the picture tells, a moved subject and
    // lamps are for the sequencer to learn.)
    const bool told =
        kind <= FaultKind::kFrameStale || kind == FaultKind::kFrameCorrupt || kind >= FaultKind::kCameraGone;
    const bool silent = kind == FaultKind::kProjectorLag || kind == FaultKind::kProjectorSkip;
    if (told && !silent) {
      EXPECT_EQ(wrong, 0) << ToString(kind);
    }
  }
}

TEST(Faults, SeedsDecideAndRepeat) {
  const FaultOptions options{{}, 7, 0.1, {}};
  const FaultScript one(options), same(options), other({{}, 8, 0.1, {}});
  int ones = 0, differences = 0;
  for (int64_t n = 0; n < 5000; ++n) {
    const auto a = one.AtExposure(n), b = same.AtExposure(n), c = other.AtExposure(n);
    ASSERT_EQ(a.size(), b.size());
    if (!a.empty()) {
      ASSERT_EQ(a[0].kind, b[0].kind);
      EXPECT_FALSE(IsLineFault(a[0].kind));
      ++ones;
    }
    differences += a.size() != c.size();
    for (const Fault& fault : one.AtPulse(n)) EXPECT_TRUE(IsLineFault(fault.kind));
  }
  EXPECT_NEAR(ones, 500, 5 * std::sqrt(450.0));
  EXPECT_GT(differences, 500);
}

TEST(Faults, TextAndTablesAreReadAndWrongOnesNamed) {
  const auto fault = ParseFault("lamp_drift@40x3=0.95");
  ASSERT_TRUE(fault.ok());
  EXPECT_EQ(fault->kind, FaultKind::kLampDrift);
  EXPECT_EQ(fault->at, 40);
  EXPECT_EQ(fault->count, 3);
  EXPECT_EQ(fault->value, 0.95);
  for (const char* wrong : {"frame_lost", "frame_lost@", "frame_lost@x", "frame_lost@-1", "lost@3", "frame_lost@3x0",
                            "frame_lost@3=", "@3", "", "frame_lost@3 "})
    EXPECT_EQ(ParseFault(wrong).status().code(), StatusCode::kUsage) << wrong;
  auto root = TomlTable::ParseText(
      "[[fault]]\nkind = \"edge_lost\"\nat = 3\n[faults]\nrate = 0.5\nkinds = [\"frame_lost\"]\n", "f.toml");
  const auto faults = ReadFaults(*root);
  ASSERT_TRUE(faults.ok() && root->Finish().ok());
  EXPECT_EQ(faults->script[0].kind, FaultKind::kEdgeLost);
  EXPECT_EQ(faults->kinds[0], FaultKind::kFrameLost);
  auto unknown = TomlTable::ParseText("[[fault]]\nkind = \"gremlin\"\nat = 3\n", "f.toml");
  EXPECT_THAT(ReadFaults(*unknown).status().message(), ::testing::HasSubstr("f.toml:2"));
}

}  // namespace
}  // namespace stratalux::rig
