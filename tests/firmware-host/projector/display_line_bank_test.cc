// SPDX-License-Identifier: Apache-2.0
// Displays stepped like pattern memories: each flip is one edge, told when its light is on and not before.
#include "firmware-host/projector/display_line_bank.h"

#include <deque>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;

// A screen whose flips come when the test lets them.
class FakeDisplay : public Display {
 public:
  [[nodiscard]] int width() const override { return 64; }
  [[nodiscard]] int height() const override { return 48; }
  Status Load(const std::vector<Pattern>&) override { return Status::Ok(); }
  Status Flip() override {
    if (gone) return Status::Failed("screen taken away");
    ++flips;
    return Status::Ok();
  }
  Result<std::optional<MonotonicNs>> WaitFlip(std::chrono::nanoseconds) override {
    if (gone) return Status::Failed("screen taken away");
    if (stuck) return std::optional<MonotonicNs>();
    return std::optional<MonotonicNs>(MonotonicNow());
  }
  LightSwitch& light() override { return light_; }
  [[nodiscard]] int64_t skipped_vblanks() const override { return 0; }

  int flips = 0;
  bool stuck = false, gone = false;

 private:
  class NoLight final : public LightSwitch {
   public:
    int Set(bool) noexcept override { return 0; }
    int Read(bool& on) noexcept override {
      on = false;
      return 0;
    }
    [[nodiscard]] const char* name() const noexcept override { return "no light"; }
  };
  NoLight light_;
};

// Real lines that note what they are told.
class FakeLines : public LineBank {
 public:
  Result<TriggerReceipt> TriggerProjector(int projector) override {
    pulses.push_back(projector);
    return TriggerReceipt{.number = 0, .time = MonotonicNow()};
  }
  Result<TriggerReceipt> TriggerCamera() override { return TriggerReceipt{.number = 0, .time = MonotonicNow()}; }
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds) override {
    if (edges.empty()) return std::optional<SyncEdge>();
    const SyncEdge edge = edges.front();
    edges.pop_front();
    return std::optional<SyncEdge>(edge);
  }
  [[nodiscard]] std::optional<MonotonicNs> LastStrobe() override { return strobe; }

  std::vector<int> pulses;
  std::deque<SyncEdge> edges;
  MonotonicNs strobe{8};
};

TEST(DisplayLineBank, TellsEachFlipOnceAndNumbersItPerProjector) {
  FakeDisplay left, right;
  DisplayLineBank bank(nullptr, {{.display = &left}, {.display = &right}});
  for (int k = 0; k < 3; ++k) {
    const auto trigger = bank.TriggerProjector(-1);
    ASSERT_TRUE(trigger.ok());
    EXPECT_EQ((*trigger).number, k);
    std::vector<int> seen;
    for (int p = 0; p < 2; ++p) {
      const auto edge = bank.WaitSync(milliseconds(100));
      ASSERT_TRUE(edge.ok() && edge->has_value());
      EXPECT_EQ((*edge)->sequence, k);
      EXPECT_GE((*edge)->time, (*trigger).time);
      seen.push_back((*edge)->projector);
    }
    EXPECT_THAT(seen, ::testing::UnorderedElementsAre(0, 1));
    const auto none = bank.WaitSync({});
    EXPECT_TRUE(none.ok() && !none->has_value());
  }
  EXPECT_EQ(left.flips, 3);
}

TEST(DisplayLineBank, TellsAnEdgeOnlyWhenItsLightIsOn) {
  FakeDisplay display;
  DisplayLineBank bank(nullptr, {{.display = &display, .latency = milliseconds(30)}});
  ASSERT_TRUE(bank.TriggerProjector(0).ok());
  const auto early = bank.WaitSync(milliseconds(1));
  ASSERT_TRUE(early.ok());
  const auto edge = *early ? early : bank.WaitSync(milliseconds(500));
  ASSERT_TRUE(edge.ok() && edge->has_value());
  EXPECT_LE((*edge)->time, MonotonicNow());
}

TEST(DisplayLineBank, GivesNoEdgeForAFlipThatNeverComes) {
  FakeDisplay display;
  display.stuck = true;
  DisplayLineBank bank(nullptr, {{.display = &display}});
  ASSERT_TRUE(bank.TriggerProjector(0).ok());
  const auto edge = bank.WaitSync(milliseconds(5));
  EXPECT_TRUE(edge.ok() && !edge->has_value());
}

TEST(DisplayLineBank, MixesDisplaysWithProjectorsOnLines) {
  FakeDisplay display;
  FakeLines lines;
  DisplayLineBank bank(&lines, {{.display = &display}, {}});
  ASSERT_TRUE(bank.TriggerProjector(0).ok());
  EXPECT_TRUE(lines.pulses.empty());
  ASSERT_TRUE(bank.TriggerProjector(1).ok());
  ASSERT_TRUE(bank.TriggerProjector(-1).ok());
  EXPECT_THAT(lines.pulses, ::testing::ElementsAre(1, -1));
  lines.edges.push_back({.projector = 1, .sequence = 41, .time = MonotonicNow()});
  std::vector<std::pair<int, int64_t>> seen;
  for (int i = 0; i < 2; ++i) {
    const auto edge = bank.WaitSync(milliseconds(100));
    ASSERT_TRUE(edge.ok() && edge->has_value());
    seen.emplace_back((*edge)->projector, (*edge)->sequence);
  }
  EXPECT_THAT(seen, ::testing::UnorderedElementsAre(::testing::Pair(0, 0), ::testing::Pair(1, 41)));
}

TEST(DisplayLineBank, PassesEverythingElseToTheLines) {
  FakeDisplay display;
  FakeLines lines;
  DisplayLineBank bank(&lines, {{.display = &display}});
  EXPECT_TRUE(bank.TriggerCamera().ok());
  EXPECT_EQ(bank.LastStrobe()->ns, 8);
}

TEST(DisplayLineBank, ReportsAScreenTakenAwayWithItsProjector) {
  FakeDisplay display;
  DisplayLineBank bank(nullptr, {{.display = &display}});
  display.gone = true;
  EXPECT_THAT(bank.TriggerProjector(0).status().message(), ::testing::HasSubstr("projector 0"));
}

TEST(DisplayLineBank, CannotTriggerACameraWithoutALine) {
  DisplayLineBank bank(nullptr, {});
  EXPECT_THAT(bank.TriggerCamera().status().message(), ::testing::HasSubstr("free_running"));
}

}  // namespace
}  // namespace stratalux::rig
