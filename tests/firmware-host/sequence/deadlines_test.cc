// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/deadlines.h"

#include <cmath>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr nanoseconds kLongest = milliseconds(500);

RigDelays TwoProjectors() {
  RigDelays delays;
  delays.sync = {{60, 0.4, 0.5, 0.1}, {60, 4.0, 5.0, 0.5}};
  delays.frame = {60, 8.0, 9.0, 0.25};
  delays.frame_period_ms = 24.0;
  delays.exposure_ms = 16.0;
  return delays;
}

TEST(FiguresOf, AreMedianWorstAndStandardDeviation) {
  const std::vector<double> delays = {1.0, 5.0, 3.0, 3.0};
  const DelayFigures figures = FiguresOf(delays);
  EXPECT_EQ(figures.count, 4);
  EXPECT_EQ(figures.median_ms, 3.0);
  EXPECT_EQ(figures.worst_ms, 5.0);
  EXPECT_NEAR(figures.spread_ms, std::sqrt(8.0 / 3.0), 1e-12);
  EXPECT_EQ(FiguresOf({}), DelayFigures());
  EXPECT_EQ(FiguresOf(std::vector<double>{2.0}).spread_ms, 0.0);
}

TEST(DeadlinesFrom, AreTheWorstSixSpreadsAMillisecondAndAMargin) {
  const LearntDeadlines learnt = DeadlinesFrom(TwoProjectors(), kLongest);
  ASSERT_EQ(learnt.sync.size(), 2U);
  EXPECT_EQ(learnt.sync[0].usual, FromMilliseconds(0.5 + 0.6 + 1.0));
  EXPECT_EQ(learnt.sync[1].usual, FromMilliseconds(5.0 + 3.0 + 1.0));
  EXPECT_EQ(learnt.sync[1].deadline, FromMilliseconds(9.0 + 4 * 24.0));
  EXPECT_EQ(learnt.frame.usual, FromMilliseconds(9.0 + 1.5 + 1.0));
  EXPECT_EQ(learnt.frame.deadline, FromMilliseconds(11.5 + 24.0));
}

TEST(DeadlinesFrom, AreNeverLongerThanTheConfiguredOneAndLeaveAFastCameraTenMilliseconds) {
  RigDelays delays = TwoProjectors();
  delays.frame_period_ms = 2.0;
  EXPECT_EQ(DeadlinesFrom(delays, kLongest).frame.deadline, FromMilliseconds(21.5));
  delays.frame.worst_ms = 700.0;
  delays.sync[0].spread_ms = 300.0;
  const LearntDeadlines learnt = DeadlinesFrom(delays, kLongest);
  EXPECT_EQ(learnt.frame.deadline, kLongest);
  EXPECT_EQ(learnt.frame.usual, kLongest);
  EXPECT_EQ(learnt.sync[0].deadline, kLongest);
}

// What deadlines.h says of exponential tails.
TEST(DeadlinesFrom, HealthyDelaysOfAnExponentialTailHardlyEverPassWhatIsUsual) {
  std::mt19937_64 engine(7);
  std::exponential_distribution<double> tail(1.0 / 2.0);
  int64_t beyond = 0, late = 0, answers = 0;
  for (int trial = 0; trial < 500; ++trial) {
    std::vector<double> seen(60);
    for (double& ms : seen) ms = 8.0 + tail(engine);
    RigDelays delays = TwoProjectors();
    delays.frame = FiguresOf(seen);
    const AnswerLimit limit = DeadlinesFrom(delays, kLongest).frame;
    for (int k = 0; k < 2000; ++k, ++answers) {
      const nanoseconds delay = FromMilliseconds(8.0 + tail(engine));
      beyond += delay > limit.usual;
      late += delay > limit.deadline;
    }
  }
  EXPECT_EQ(answers, 1'000'000);
  EXPECT_LE(beyond, answers / 8000);
  EXPECT_EQ(late, 0);
}

class AnswerWatchTest : public ::testing::Test {
 protected:
  void Confirm(int answers = AnswerWatch::kConfirmations) {
    for (int k = 0; k < answers; ++k) {
      watch_.SawFrame(milliseconds(8));
      for (int p = 0; p < 2; ++p) watch_.SawSync(p, nanoseconds(400'000));
    }
  }
  const LearntDeadlines learnt_ = DeadlinesFrom(TwoProjectors(), kLongest);
  AnswerWatch watch_{kLongest, kLongest, 2, learnt_};
};

TEST_F(AnswerWatchTest, LearntDeadlinesHoldOnceTheFirstAnswersCameAsLearnt) {
  Confirm(AnswerWatch::kConfirmations - 1);
  EXPECT_EQ(watch_.SyncDeadline(0, Patience::kLearnt), kLongest);
  EXPECT_EQ(watch_.FrameDeadline(Patience::kLearnt), kLongest);
  Confirm(1);
  EXPECT_EQ(watch_.SyncDeadline(0, Patience::kLearnt), learnt_.sync[0].deadline);
  EXPECT_EQ(watch_.SyncDeadline(-1, Patience::kLearnt), learnt_.sync[1].deadline) << "of all: the slowest one's";
  EXPECT_EQ(watch_.FrameDeadline(Patience::kLearnt), learnt_.frame.deadline);
  EXPECT_EQ(watch_.SyncDeadline(0, Patience::kConfigured), kLongest);
  EXPECT_EQ(watch_.FrameDeadline(Patience::kConfigured), kLongest);
  EXPECT_TRUE(watch_.Slow().empty());
}

TEST_F(AnswerWatchTest, OneAnswerBeyondItsDeadlineEndsThemAllAndIsSaid) {
  Confirm();
  watch_.SawSync(1, learnt_.sync[1].deadline + nanoseconds(1));
  EXPECT_FALSE(watch_.holds());
  EXPECT_EQ(watch_.SyncDeadline(0, Patience::kLearnt), kLongest);
  EXPECT_EQ(watch_.FrameDeadline(Patience::kLearnt), kLongest);
  Confirm(100);
  EXPECT_FALSE(watch_.holds()) << "for this capture";
  ASSERT_EQ(watch_.Slow().size(), 1U);
  const SlowAnswers slow = watch_.Slow()[0];
  EXPECT_EQ(slow.projector, 1);
  EXPECT_EQ(slow.late, 1);
  const std::string text = SlowAnswersAsText(slow);
  EXPECT_THAT(text, HasSubstr("SYNC of projector 1 came 105.0 ms or more after TRIGGER"));
  EXPECT_THAT(text, HasSubstr("`stratalux-rig selftest` again; until then the configured deadlines hold"));
}

TEST_F(AnswerWatchTest, AGivenUpFrameThatComesAfterAllEndsThem) {
  Confirm();
  watch_.SawLateFrame();
  EXPECT_FALSE(watch_.holds());
  ASSERT_EQ(watch_.Slow().size(), 1U);
  EXPECT_EQ(watch_.Slow()[0].projector, -1);
}

TEST_F(AnswerWatchTest, OneSlowAnswerIsChanceManyAreASlowerRig) {
  Confirm(40);
  watch_.SawFrame(milliseconds(20));
  EXPECT_TRUE(watch_.holds());
  EXPECT_TRUE(watch_.Slow().empty());
  watch_.SawFrame(milliseconds(21));
  EXPECT_TRUE(watch_.holds()) << "2 of 42: said, but within their deadline";
  ASSERT_EQ(watch_.Slow().size(), 1U);
  EXPECT_EQ(watch_.Slow()[0].longest, milliseconds(21));
  EXPECT_THAT(SlowAnswersAsText(watch_.Slow()[0]), Not(HasSubstr("configured")));
  for (int k = 0; k < 4; ++k) watch_.SawFrame(milliseconds(20));
  EXPECT_FALSE(watch_.holds()) << "6 of 46";
}

TEST_F(AnswerWatchTest, AFrameThatWasHereBeforeAnybodyLookedSaysNothingBad) {
  Confirm();
  watch_.HadFrame(milliseconds(400));
  EXPECT_TRUE(watch_.holds());
  EXPECT_TRUE(watch_.Slow().empty());
}

TEST(AnswerWatch, WithoutWhatWasLearntOrOfAnotherRigTheConfiguredOnesHold) {
  for (const int projectors : {2, 3}) {
    std::optional<LearntDeadlines> learnt;
    if (projectors == 3) learnt = DeadlinesFrom(TwoProjectors(), kLongest);
    AnswerWatch watch(milliseconds(100), kLongest, projectors, learnt);
    EXPECT_FALSE(watch.holds());
    for (int k = 0; k < 10; ++k) {
      watch.SawFrame(milliseconds(900));
      watch.SawSync(0, milliseconds(900));
    }
    EXPECT_EQ(watch.SyncDeadline(0, Patience::kLearnt), milliseconds(100));
    EXPECT_EQ(watch.SyncDeadline(-1, Patience::kLearnt), milliseconds(100));
    EXPECT_EQ(watch.FrameDeadline(Patience::kLearnt), kLongest);
    EXPECT_TRUE(watch.Slow().empty());
  }
}

}  // namespace
}  // namespace stratalux::rig
