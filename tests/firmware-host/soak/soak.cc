// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/soak/soak.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>

#include <gtest/gtest.h>

#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/random.h"
#include "tests/firmware-host/sequence/learnt_rig.h"

namespace stratalux::rig {
namespace {

// The last frame of each step that did not fail its check: what the store's readers take for the step's frame.
// With what it really shows: the simulation does not keep that for long.
struct LastFrames : FrameSink {
  explicit LastFrames(const SimulatedRig& simulation) : rig(simulation) {}
  Status Put(FrameRecord record, Image<uint16_t>) override {
    ++shots;
    if (record.level_check != LevelCheck::kFailed) of_step[record.step] = rig.ShownOf(record.driver_sequence);
    return Status::Ok();
  }
  const SimulatedRig& rig;
  std::map<int, ShownFrame> of_step;
  int shots = 0;
};

// Rows out of place that are as dark as those they replace change nothing.
constexpr double kSpoilt = 0.005;  // share of the pixels

bool Shows(const ShownFrame& shown, const PlanStep& step) {
  // Of black no camera can tell how long it was exposed.
  const bool timed = step.pattern.kind == PatternKind::kBlack || std::abs(shown.exposure_ms - step.exposure_ms) < 1e-6;
  if (!shown.whole || shown.spoilt > kSpoilt || !timed) return false;
  for (int p = 0; p < static_cast<int>(shown.pictures.size()); ++p) {
    const std::optional<Pattern>& picture = shown.pictures[p];
    const bool lit = step.projector < 0 || p == step.projector;
    if (picture.has_value() != lit || (lit && !(*picture == step.pattern))) return false;
  }
  return true;
}

void HoldAgainstTruth(const CapturePlan& plan, const LastFrames& frames, SoakCapture& capture) {
  if (capture.report.status == SessionStatus::kFailed) return;
  const std::set<int> missing(capture.report.missing_steps.begin(), capture.report.missing_steps.end());
  std::map<int, ShownFrame> white;  // of each projector
  for (const auto& [step, shown] : frames.of_step) {
    const PlanStep& planned = plan.steps[step];
    if (!missing.contains(step) && !Shows(shown, planned)) capture.mis_associated.push_back(step);
    capture.spoilt_most = std::max(capture.spoilt_most, missing.contains(step) ? 0.0 : shown.spoilt);
    if (planned.phase == CapturePhase::kReference && planned.pattern.kind == PatternKind::kWhite)
      white[planned.projector] = shown;
    if (capture.report.status != SessionStatus::kComplete || !white.contains(planned.projector)) continue;
    const ShownFrame& reference = white[planned.projector];
    // A lamp that blinks while it is dark changes nothing.
    const bool lit = planned.pattern.kind != PatternKind::kBlack;
    if ((shown.push_mm - reference.push_mm).norm() > 1.0 ||
        (lit && std::abs(shown.light / reference.light - 1.0) > 0.101))
      capture.changed_unsaid.push_back(step);
  }
}

void AddSlowFrames(const SoakOptions& options, FaultOptions& faults) {
  if (options.slow_rate <= 0.0) return;
  constexpr int64_t kExposures = 1000;  // more than a capture with its retakes has
  for (int64_t number = 0; number < kExposures; ++number) {
    Random random(options.faults.seed, (uint64_t{1} << 40) + static_cast<uint64_t>(number));
    if (random.Uniform() < options.slow_rate)
      faults.script.push_back({FaultKind::kFrameSlow, number, 1, random.Uniform(10.0, 80.0)});
  }
}

}  // namespace

PlanOptions SmallPlan() {
  PlanOptions plan;
  plan.projector_width = 64;
  plan.projector_height = 48;
  plan.separation_period = 8;
  plan.comb_period = 16;
  plan.spot_pitch = 16;
  plan.spot_radius = 2;
  plan.motion_whites = 3;
  return plan;
}

SoakCapture CaptureOnce(const SoakOptions& options) {
  Logger logger(LogLevel::kError);
  SimulatedRigOptions rig_options;
  rig_options.scene = options.scene;
  rig_options.scattering = options.scattering;
  rig_options.camera_width = options.camera_width;
  rig_options.camera_height = options.camera_height;
  rig_options.projector_width = options.plan.projector_width;
  rig_options.projector_height = options.plan.projector_height;
  rig_options.free_running = options.plan.sync_mode == SyncMode::kFreeRunning;
  rig_options.devices.timing.overlapped_readout = options.overlapped;
  rig_options.devices.timing.min_frame_period_ms = options.overlapped ? 16.6 : 0.0;
  rig_options.seed = options.seed;
  rig_options.faults = options.faults;
  const auto plan = BuildPlan(options.plan);
  EXPECT_TRUE(plan.ok()) << plan.status().message();
  SequencerOptions sequencer;
  if (options.learnt) {
    const Result<RigDelays> delays = LearnDelays(rig_options, *plan, logger);
    EXPECT_TRUE(delays.ok()) << delays.status().message();
    sequencer.shooter.sync_deadline = std::chrono::milliseconds(500);  // as a station has it
    if (delays.ok()) sequencer.shooter.learnt = DeadlinesFrom(*delays, sequencer.shooter.sync_deadline);
  }
  AddSlowFrames(options, rig_options.faults);
  const auto rig = SimulatedRig::Create(rig_options, logger);
  EXPECT_TRUE(rig.ok()) << rig.status().message();
  if (options.overlapped) {
    sequencer.shooter.camera.read_out = ReadOut::kOverlapped;
    sequencer.shooter.camera.min_frame_period = std::chrono::microseconds(16'700);
  }
  sequencer.shooter.wait = [&](std::chrono::nanoseconds time) { (*rig)->Sleep(time); };
  StopToken stop;
  const auto light = GuardLight(**rig, stop);
  EXPECT_TRUE(light.ok()) << light.status().message();
  SoakCapture capture;
  LastFrames frames(**rig);
  const auto report = Sequencer({**light, (*rig)->lines(), (*rig)->camera(), (*rig)->projectors()}, sequencer, logger)
                          .Run(*plan, frames);
  EXPECT_TRUE(report.ok()) << report.status().message();
  if (!report.ok()) return capture;
  capture.report = *report;
  capture.injected = (*rig)->injected();
  capture.shots = frames.shots;
  capture.learnt_held = options.learnt && std::none_of(report->slow.begin(), report->slow.end(),
                                                       [](const SlowAnswers& slow) { return slow.late > 0; });
  HoldAgainstTruth(*plan, frames, capture);
  return capture;
}

void SoakTable::Add(const SoakCapture& capture) {
  const CaptureReport& report = capture.report;
  frames_ += capture.shots;
  ++captures_;
  complete_ += report.status == SessionStatus::kComplete;
  degraded_ += report.status == SessionStatus::kDegraded;
  failed_ += report.status == SessionStatus::kFailed;
  mis_associated_ += static_cast<int64_t>(capture.mis_associated.size());
  changed_ += static_cast<int64_t>(capture.changed_unsaid.size());
  const bool noticed =
      report.retried > 0 || report.status != SessionStatus::kComplete || !report.FaultSummary().empty();
  if (capture.injected.empty()) {
    ++clean_;
    false_alarms_ += noticed;
  }
  std::set<FaultKind> kinds;
  for (const InjectedFault& fault : capture.injected) {
    ++rows_[fault.kind].injected;
    kinds.insert(fault.kind);
  }
  for (const FaultKind kind : kinds) {
    Row& row = rows_[kind];
    ++row.captures;
    row.detected += noticed;
    row.survived += report.status == SessionStatus::kComplete;
    row.mis_associated += static_cast<int64_t>(capture.mis_associated.size());
    row.changed += static_cast<int64_t>(capture.changed_unsaid.size());
  }
}

void SoakTable::Print() const {
  std::printf("%-16s %9s %9s %9s %9s %15s %15s\n", "fault", "injected", "captures", "detected", "survived",
              "mis-associated", "changed, unsaid");
  for (const auto& [kind, row] : rows_)
    std::printf("%-16s %9lld %9lld %9lld %9lld %15lld %15lld\n", ToString(kind), static_cast<long long>(row.injected),
                static_cast<long long>(row.captures), static_cast<long long>(row.detected),
                static_cast<long long>(row.survived), static_cast<long long>(row.mis_associated),
                static_cast<long long>(row.changed));
  std::printf(
      "%lld frames in %lld captures (%lld complete, %lld degraded, %lld failed): %lld mis-associated; "
      "%lld captures without a fault, %lld false alarms\n",
      static_cast<long long>(frames_), static_cast<long long>(captures_), static_cast<long long>(complete_),
      static_cast<long long>(degraded_), static_cast<long long>(failed_), static_cast<long long>(mis_associated_),
      static_cast<long long>(clean_), static_cast<long long>(false_alarms_));
}

}  // namespace stratalux::rig
