// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/soak/soak.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "firmware-host/projector/memory_layout.h"
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

// Which pixels of a projector lie on the subject, from the simulation's truth; made when it is first asked.
class Subject {
 public:
  Subject(SimulatedRig& rig, const CapturePlan& plan) : rig_(rig), plan_(plan) {}
  // Share of the camera's pixels that see the subject where a projector's light falls.
  double LitShare(int projector) { return Points(projector).share; }
  // Whether two pictures differ nowhere that the camera sees, but on as many pixels as the witness lets differ: a Gray
  // bit whose every stripe on a face is dark is as good as black.
  bool LooksTheSame(int projector, const Pattern& a, const Pattern& b) {
    constexpr int kAround = 1;  // projector pixels: a pixel of the camera sees about one
    const Lit& lit = Points(projector);
    size_t other = 0;
    for (const auto& [column, row] : lit.points) {
      bool same = true;
      for (int y = row - kAround; y <= row + kAround; ++y)
        for (int x = column - kAround; x <= column + kAround; ++x) same &= a.Intensity(x, y) == b.Intensity(x, y);
      other += same ? 0 : 1;
    }
    return static_cast<double>(other) <= kMayDiffer * static_cast<double>(lit.points.size());
  }
  // WitnessOptions::max_off_fraction: of the lit pixels.
  static constexpr double kMayDiffer = 0.06;

 private:
  struct Lit {
    std::vector<std::pair<int, int>> points;  // column and row of each pixel
    double share = 0.0;
  };
  const Lit& Points(int projector) {
    if (lit_.empty()) {
      const auto truth = rig_.Truth(plan_);
      EXPECT_TRUE(truth.ok()) << truth.status().message();
      lit_.resize(rig_.projectors().size());
      for (size_t p = 0; p < lit_.size(); ++p) {
        const auto at = std::find_if(truth->begin(), truth->end(),
                                     [&](const TruthMap& map) { return map.name == "column " + std::to_string(p); });
        EXPECT_TRUE(at != truth->end());
        for (int y = 0; y < at->map.height(); ++y)
          for (int x = 0; x < at->map.width(); ++x)
            if (std::isfinite(at->map(x, y, 0)))
              lit_[p].points.emplace_back(std::lround(at->map(x, y, 0)), std::lround(at->map(x, y, 1)));
        lit_[p].share = static_cast<double>(lit_[p].points.size()) / (at->map.width() * at->map.height());
      }
    }
    return lit_[projector];
  }
  SimulatedRig& rig_;
  const CapturePlan& plan_;
  std::vector<Lit> lit_;
};

bool Shows(const ShownFrame& shown, const PlanStep& step, Subject& subject) {
  // Of black no camera can tell how long it was exposed.
  const bool timed = step.pattern.kind == PatternKind::kBlack || std::abs(shown.exposure_ms - step.exposure_ms) < 1e-6;
  if (!shown.whole || !timed) return false;
  // Rows out of place that are as dark as those they replace change nothing.
  if (shown.spoilt > 0.0 && shown.spoilt > Subject::kMayDiffer * subject.LitShare(std::max(step.projector, 0)))
    return false;
  for (int p = 0; p < static_cast<int>(shown.pictures.size()); ++p) {
    const std::optional<Pattern>& picture = shown.pictures[p];
    const bool lit = step.projector < 0 || p == step.projector;
    if (picture.has_value() != lit) return false;
    if (lit && !(*picture == step.pattern) && !subject.LooksTheSame(p, *picture, step.pattern)) return false;
  }
  return true;
}

void HoldAgainstTruth(const CapturePlan& plan, const LastFrames& frames, Subject subject, SoakCapture& capture) {
  if (capture.report.status == SessionStatus::kFailed) return;
  // As the store does (db/catalogue/session_index.h): what the report alone calls missing its readers would take.
  const std::set<int> withdrawn = WithdrawnSteps(capture.report.findings);
  std::map<int, ShownFrame> white;  // of each projector
  for (const auto& [step, shown] : frames.of_step) {
    const PlanStep& planned = plan.steps[step];
    if (!withdrawn.contains(step) && !Shows(shown, planned, subject)) capture.mis_associated.push_back(step);
    capture.spoilt_most = std::max(capture.spoilt_most, withdrawn.contains(step) ? 0.0 : shown.spoilt);
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

void AddJumps(const SoakOptions& options, FaultOptions& faults) {
  constexpr int64_t kExposures = 2000;  // more than a capture with its retakes has
  for (int64_t number = 0; number < kExposures; ++number) {
    Random random(options.faults.seed, (uint64_t{1} << 41) + static_cast<uint64_t>(number));
    if (random.Uniform() >= options.jump_rate) continue;
    const double size_mm = random.Uniform(1.0, 6.0);
    faults.script.push_back({FaultKind::kSubjectMoved, number, 1, random.Uniform() < 0.5 ? size_mm : -size_mm});
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
  rig_options.memories = LayOutMemories(options.plan)->Patterns();
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
  AddJumps(options, rig_options.faults);
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
  HoldAgainstTruth(*plan, frames, Subject(**rig, *plan), capture);
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
  spoilt_most_ = std::max(spoilt_most_, capture.spoilt_most);
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
  std::printf("of a frame that counts, at most %.2f %% of the pixels read otherwise than its picture\n",
              100.0 * spoilt_most_);
}

}  // namespace stratalux::rig
