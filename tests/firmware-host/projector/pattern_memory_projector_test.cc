// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/pattern_memory_projector.h"

#include <deque>
#include <functional>
#include <iterator>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/projector/memory_layout.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

// A module with a cyclic memory; it steps at TRIGGER and answers with SYNC, unless told otherwise.
class Module final : public LineBank, public PatternMemoryLines {
 public:
  explicit Module(std::vector<Pattern> memory) : memory_(std::move(memory)) {}

  Result<TriggerReceipt> TriggerProjector(int) override {
    const TriggerReceipt receipt{pulses++, MonotonicNow()};
    if (on_pulse) on_pulse(receipt.number);
    const int steps = deaf.contains(receipt.number) ? 0 : doubled.contains(receipt.number) ? 2 : 1;
    for (int i = 0; i < steps; ++i) {
      shown = (shown + 1) % static_cast<int>(memory_.size());
      edges_.push_back({0, sync_count_++, MonotonicNow()});
    }
    return receipt;
  }
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds) override {
    if (edges_.empty()) return std::optional<SyncEdge>();
    const SyncEdge edge = edges_.front();
    edges_.pop_front();
    return std::optional(edge);
  }
  Status ResetMemory(int) override {
    ++resets;
    shown = -1;
    return Status::Ok();
  }
  int64_t SyncCount(int) override { return sync_count_; }

  Result<TriggerReceipt> TriggerCamera() override { return TriggerReceipt{}; }
  std::optional<MonotonicNs> LastStrobe() override { return std::nullopt; }

  // What the next TRIGGER shows, and those after it.
  [[nodiscard]] const Pattern& Next(size_t ahead = 0) const {
    return memory_[(static_cast<size_t>(shown + 1) + ahead) % memory_.size()];
  }
  // Shots of the sequence: one pulse each.
  [[nodiscard]] bool Shows(const std::vector<Pattern>& sequence) {
    for (const Pattern& pattern : sequence) {
      if (!(Next() == pattern) || !TriggerProjector(0).ok()) return false;
      while (WaitSync({}).value()) continue;
    }
    return true;
  }

  std::function<void(int64_t pulse)> on_pulse;
  int shown = -1, resets = 0;
  int64_t pulses = 0;
  std::set<int64_t> deaf, doubled;  // pulses

 private:
  std::vector<Pattern> memory_;
  int64_t sync_count_ = 0;
  std::deque<SyncEdge> edges_;
};

// One projector's memory of a small plan.
std::vector<Pattern> SmallMemory() {
  PlanOptions options;
  options.projectors = 2;
  return SequenceOf(BuildPlan(options).value(), 1);
}

std::vector<Pattern> From(const std::vector<Pattern>& memory, size_t first) {
  return {memory.begin() + static_cast<std::ptrdiff_t>(first), memory.end()};
}

constexpr MemoryTiming kWithReset{std::chrono::milliseconds(1), std::chrono::milliseconds(10)};
constexpr MemoryTiming kAround{std::chrono::milliseconds(1), std::nullopt};

class PatternMemoryTest : public ::testing::TestWithParam<MemoryTiming> {
 protected:
  explicit PatternMemoryTest(std::vector<Pattern> memory = SmallMemory()) : memory_(std::move(memory)) {}
  std::unique_ptr<Projector> Make() {
    PatternMemoryOptions options;
    options.width = 1024;
    options.height = 768;
    options.memory = memory_;
    options.timing = GetParam();
    return MakePatternMemoryProjector(module_, module_, options, stop_);
  }
  [[nodiscard]] static bool HasReset() { return GetParam().reset.has_value(); }
  std::vector<Pattern> memory_;
  Module module_{memory_};
  StopToken stop_;
};

TEST_P(PatternMemoryTest, TheWholeSequenceIsTheMemory) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(memory_).ok());
  EXPECT_EQ(module_.pulses, 0);
  EXPECT_EQ(module_.Next(), memory_[0]);
}

// As the sequencer does after a spoilt shot: a reload from every place, whatever was shown before.
TEST_P(PatternMemoryTest, AReloadStepsToItsPlace) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(memory_).ok());
  for (const size_t first : {size_t{40}, size_t{41}, size_t{40}, size_t{3}, memory_.size() - 1, size_t{0}}) {
    const Status loaded = projector->Load(From(memory_, first));
    ASSERT_TRUE(loaded.ok()) << loaded.message();
    const std::vector<Pattern> sequence = From(memory_, first);
    for (size_t k = 0; k < sequence.size(); ++k) ASSERT_EQ(module_.Next(k), sequence[k]) << first << " + " << k;
    ASSERT_TRUE(module_.TriggerProjector(0).ok());  // the shot
    ASSERT_TRUE(module_.WaitSync({}).ok());
  }
}

TEST_P(PatternMemoryTest, ADoubtedPlaceIsLeftByResetWhereThereIsOne) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(memory_).ok());
  const int resets = module_.resets;
  ASSERT_TRUE(projector->Load(From(memory_, 5)).ok());
  EXPECT_EQ(module_.resets, resets) << "five steps are shorter than RESET";
  --module_.shown;  // a pulse confirmed, but not followed: no count tells
  projector->Doubt();
  ASSERT_TRUE(projector->Load(From(memory_, 6)).ok());
  EXPECT_EQ(module_.resets, HasReset() ? resets + 1 : 0);
  EXPECT_EQ(module_.Next() == memory_[6], HasReset()) << "without RESET the witness finds it, frame by frame";
  ASSERT_TRUE(projector->Load(From(memory_, 9)).ok());
  EXPECT_EQ(module_.resets, HasReset() ? resets + 1 : 0) << "doubt is over once the place is known again";
}

TEST_P(PatternMemoryTest, RestIsTheFirstPatternAndLeavesNoDoubtBehindReset) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(From(memory_, 40)).ok());
  ASSERT_TRUE(projector->Rest().ok());
  EXPECT_EQ((module_.shown + 1) % std::ssize(memory_), 0);
  module_.shown = 17;  // unseen
  ASSERT_TRUE(projector->Rest().ok());
  EXPECT_EQ((module_.shown + 1) % std::ssize(memory_) == 0, HasReset());
}

TEST_P(PatternMemoryTest, AStopOnTheWayLosesNothing) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(memory_).ok());
  module_.on_pulse = [&](int64_t pulse) {
    if (pulse == 20) stop_.Request(StopReason::kOperator);
  };
  EXPECT_EQ(projector->Load(From(memory_, 60)).code(), StatusCode::kFailed);
  EXPECT_EQ(module_.pulses, 21);
  while (module_.WaitSync({}).value()) continue;
  stop_.Reset();
  ASSERT_TRUE(projector->Load(From(memory_, 30)).ok());
  EXPECT_EQ(module_.Next(), memory_[30]);
}

TEST_P(PatternMemoryTest, APulseTheModuleMissedOrTookTwiceDoesNotShiftTheNextLoad) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(memory_).ok());
  module_.deaf = {2};
  module_.doubled = {5};
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(module_.TriggerProjector(0).ok());
  while (module_.WaitSync({}).value()) continue;
  ASSERT_TRUE(projector->Load(From(memory_, 20)).ok());
  EXPECT_EQ(module_.shown + 1, 20);
}

TEST_P(PatternMemoryTest, ADoubledStepOverTheTargetIsStillFoundOut) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(memory_).ok());
  module_.doubled = {6};  // from 6 to 8, past the wanted 7
  ASSERT_TRUE(projector->Load(From(memory_, 7)).ok());
  EXPECT_EQ(module_.Next(), memory_[7]);
  EXPECT_EQ((module_.shown + 1) % static_cast<int>(memory_.size()), 7);
}

TEST_P(PatternMemoryTest, AnotherPlansPatternsAreRefused) {
  const auto projector = Make();
  std::vector<Pattern> other = memory_;
  std::swap(other[10], other[11]);
  const Status status = projector->Load(other);
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("plan render"));
}

TEST_P(PatternMemoryTest, ASilentModuleIsAnErrorThatNamesTheCables) {
  const auto projector = Make();
  for (int64_t pulse = 0; pulse < 1000; ++pulse) module_.deaf.insert(pulse);
  const Status status = projector->Load(From(memory_, 5));
  EXPECT_EQ(status.code(), StatusCode::kFailed);
  EXPECT_THAT(status.message(), HasSubstr("TRIGGER and SYNC"));
}

TEST_P(PatternMemoryTest, AnOpenInterlockStopsTheStepping) {
  const auto projector = Make();
  stop_.Request(StopReason::kEmergencyStop);
  const Status status = projector->Load(From(memory_, 5));
  EXPECT_EQ(status.code(), StatusCode::kFailed);
  EXPECT_THAT(status.message(), HasSubstr("emergency stop"));
  EXPECT_EQ(module_.pulses, 0);
}

INSTANTIATE_TEST_SUITE_P(Rewind, PatternMemoryTest, ::testing::Values(kWithReset, kAround),
                         [](const auto& timing) { return timing.param.reset ? "Reset" : "Around"; });

// With RESET one lost pulse costs a rewind, and nothing has to be known of the start.
TEST(PatternMemory, ResetMendsAnUnconfirmedStepAndAnUnknownStart) {
  const std::vector<Pattern> memory = SmallMemory();
  Module module(memory);
  module.shown = 17;
  module.deaf = {4};
  PatternMemoryOptions options;
  options.memory = memory;
  options.timing = kWithReset;
  const StopToken stop;
  const auto projector = MakePatternMemoryProjector(module, module, options, stop);
  ASSERT_TRUE(projector->Load(From(memory, 9)).ok());
  EXPECT_EQ(module.shown + 1, 9);
  EXPECT_EQ(module.resets, 2);
}

// A whole rig's filling, of projector 0.
class FilledMemoryTest : public PatternMemoryTest {
 protected:
  FilledMemoryTest() : PatternMemoryTest(LayOutMemories({}).value().projectors[0].patterns) {}
  static std::vector<Pattern> Sequence(SessionKind kind) {
    PlanOptions options;
    options.kind = kind;
    return SequenceOf(BuildPlan(options).value(), 0);
  }
};

TEST_P(FilledMemoryTest, OneFillingShowsEveryKindOneAfterTheOther) {
  const auto projector = Make();
  const std::vector<Pattern> pair = {{.kind = PatternKind::kWhite}, {.kind = PatternKind::kBlack}};
  for (const SessionKind kind : {SessionKind::kVisitor, SessionKind::kCalibration, SessionKind::kFlat,
                                 SessionKind::kDark, SessionKind::kResponse, SessionKind::kVisitor}) {
    const Status loaded = projector->Load(Sequence(kind));
    ASSERT_TRUE(loaded.ok()) << ToString(kind) << ": " << loaded.message();
    EXPECT_TRUE(module_.Shows(Sequence(kind))) << ToString(kind);
    ASSERT_TRUE(projector->Load(pair).ok());
    EXPECT_TRUE(module_.Shows(pair)) << "white card after " << ToString(kind);
  }
}

TEST_P(FilledMemoryTest, TheShorterWayIsTaken) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(Sequence(SessionKind::kResponse)).ok());
  ASSERT_TRUE(module_.Shows(Sequence(SessionKind::kResponse)));
  const int64_t pulses = module_.pulses;
  const int resets = module_.resets;
  ASSERT_TRUE(projector->Load(Sequence(SessionKind::kVisitor)).ok());
  EXPECT_EQ(module_.pulses, pulses) << "the last section ends where the first begins";
  EXPECT_EQ(module_.resets, resets);
  ASSERT_TRUE(module_.Shows(Sequence(SessionKind::kVisitor)));
  ASSERT_TRUE(projector->Load(Sequence(SessionKind::kCalibration)).ok());
  EXPECT_EQ(module_.pulses, pulses + 131) << "the visit's shots; calibration lies next";
  EXPECT_EQ(module_.resets, resets);
  // Back into the visit: RESET, or the rest of the memory.
  const int64_t before = module_.pulses;
  ASSERT_TRUE(projector->Load(Sequence(SessionKind::kVisitor)).ok());
  EXPECT_EQ(module_.resets, HasReset() ? resets + 1 : 0);
  EXPECT_EQ(module_.pulses - before, HasReset() ? 0 : std::ssize(memory_) - 131);
}

TEST_P(FilledMemoryTest, AStopInOneSectionLeavesTheNextCaptureInStep) {
  const auto projector = Make();
  ASSERT_TRUE(projector->Load(Sequence(SessionKind::kVisitor)).ok());
  module_.on_pulse = [&](int64_t pulse) {
    if (pulse == 200) stop_.Request(StopReason::kVisitorLeft);
  };
  EXPECT_FALSE(projector->Load(Sequence(SessionKind::kFlat)).ok());
  stop_.Reset();
  for (const SessionKind kind : {SessionKind::kCalibration, SessionKind::kVisitor}) {
    ASSERT_TRUE(projector->Load(Sequence(kind)).ok());
    EXPECT_TRUE(module_.Shows(Sequence(kind))) << ToString(kind);
  }
}

INSTANTIATE_TEST_SUITE_P(Rewind, FilledMemoryTest, ::testing::Values(kWithReset, kAround),
                         [](const auto& timing) { return timing.param.reset ? "Reset" : "Around"; });

}  // namespace
}  // namespace stratalux::rig
