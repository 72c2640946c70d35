// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/pattern_memory_projector.h"

#include <deque>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

// A module with a cyclic memory; it steps at TRIGGER and answers with SYNC, unless told otherwise.
class Module final : public LineBank, public PatternMemoryLines {
 public:
  explicit Module(std::vector<Pattern> memory) : memory_(std::move(memory)) {}

  Result<TriggerReceipt> TriggerProjector(int) override {
    const TriggerReceipt receipt{pulses++, MonotonicNow()};
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

  // What the next TRIGGER shows.
  [[nodiscard]] const Pattern& Next() const { return memory_[static_cast<size_t>(shown + 1) % memory_.size()]; }

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
  return MemoryOf(BuildPlan(options).value(), 1);
}

std::vector<Pattern> From(const std::vector<Pattern>& memory, size_t first) {
  return {memory.begin() + static_cast<std::ptrdiff_t>(first), memory.end()};
}

class PatternMemoryTest : public ::testing::TestWithParam<MemoryRewind> {
 protected:
  std::unique_ptr<Projector> Make() {
    PatternMemoryOptions options;
    options.width = 1024;
    options.height = 768;
    options.memory = memory_;
    options.rewind = GetParam();
    return MakePatternMemoryProjector(module_, module_, options, stop_);
  }
  std::vector<Pattern> memory_ = SmallMemory();
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
    EXPECT_EQ(static_cast<size_t>(module_.shown + 1) % memory_.size(), first);
    ASSERT_TRUE(module_.TriggerProjector(0).ok());  // the shot
    ASSERT_TRUE(module_.WaitSync({}).ok());
  }
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

INSTANTIATE_TEST_SUITE_P(Rewind, PatternMemoryTest,
                         ::testing::Values(MemoryRewind::kResetLine, MemoryRewind::kStepAround),
                         [](const auto& rewind) {
                           return rewind.param == MemoryRewind::kResetLine ? "Reset" : "Around";
                         });

// With RESET one lost pulse costs a rewind, and nothing has to be known of the start.
TEST(PatternMemory, ResetMendsAnUnconfirmedStepAndAnUnknownStart) {
  const std::vector<Pattern> memory = SmallMemory();
  Module module(memory);
  module.shown = 17;
  module.deaf = {4};
  PatternMemoryOptions options;
  options.memory = memory;
  options.rewind = MemoryRewind::kResetLine;
  const StopToken stop;
  const auto projector = MakePatternMemoryProjector(module, module, options, stop);
  ASSERT_TRUE(projector->Load(From(memory, 9)).ok());
  EXPECT_EQ(module.shown + 1, 9);
  EXPECT_EQ(module.resets, 2);
}

TEST(PatternMemory, HoldsThePrerollThenItsOwnSteps) {
  PlanOptions options;
  options.projectors = 2;
  const CapturePlan plan = BuildPlan(options).value();
  const std::vector<Pattern> memory = MemoryOf(plan, 1);
  size_t own = 0;
  for (const PlanStep& step : plan.steps) own += step.projector == 1 ? 1 : 0;
  ASSERT_EQ(memory.size(), static_cast<size_t>(options.preroll_markers) + own);
  EXPECT_EQ(memory[0].kind, PrerollCode(options.preroll_markers)[0] ? PatternKind::kWhite : PatternKind::kBlack);
}

}  // namespace
}  // namespace stratalux::rig
