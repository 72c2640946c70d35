// SPDX-License-Identifier: Apache-2.0
// The machine is what visit_table.txt says, pair by pair.
#include <fstream>
#include <set>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/kiosk/visit_cases.h"

namespace stratalux::rig {
namespace {

struct Entry {
  int line = 0;
  std::string phase;  // "nothing", "noted", "same" or a phase
  std::string actions;
};
using Pair = std::pair<std::string, std::string>;

std::vector<std::string> Words(const std::string& text) {
  std::istringstream in(text);
  return {std::istream_iterator<std::string>(in), {}};
}

std::string Joined(const std::vector<VisitAction>& actions) {
  std::string text;
  for (const VisitAction& action : actions) text += (text.empty() ? "" : ", ") + ToString(action);
  return text;
}

// Complains of what is doubled or no entry.
std::map<Pair, Entry> ReadTable() {
  std::map<Pair, Entry> table;
  std::ifstream file(STRATALUX_SOURCE_DIR "/tests/firmware-host/kiosk/visit_table.txt");
  EXPECT_TRUE(file.good());
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    if (line.empty() || line[0] == '#') continue;
    const size_t colon = line.find(" : "), arrow = line.find(" -> ");
    if (colon == std::string::npos || arrow == std::string::npos || arrow < colon) {
      ADD_FAILURE() << "line " << number << " is no entry: " << line;
      continue;
    }
    const std::string result = line.substr(arrow + 4);
    const size_t doing = result.find(" : ");
    const Entry entry{number, result.substr(0, doing), doing == std::string::npos ? "" : result.substr(doing + 3)};
    for (const std::string& state : Words(line.substr(0, colon)))
      for (const std::string& event : Words(line.substr(colon + 3, arrow - colon - 3)))
        EXPECT_TRUE(table.emplace(Pair(state, event), entry).second)
            << "line " << number << ": " << state << " and " << event << " stand in line " << table[{state, event}].line
            << " already";
  }
  return table;
}

TEST(VisitTable, HasEveryPairOnceAndNoOther) {
  std::map<Pair, Entry> table = ReadTable();
  std::set<Phase> phases;
  for (const auto& [name, state] : TableStates()) {
    phases.insert(state.phase);
    for (const auto& [event, happened] : TableEvents(state))
      EXPECT_EQ(table.erase({name, event}), 1U) << name << " and " << event << " are missing";
  }
  for (const auto& [pair, entry] : table)
    ADD_FAILURE() << "line " << entry.line << ": no state " << pair.first << " or no event " << pair.second;
  EXPECT_EQ(phases.size(), static_cast<size_t>(kPhases)) << "every phase has a state in the table";
  std::set<size_t> kinds;
  for (const auto& [event, happened] : TableEvents({})) kinds.insert(happened.index());
  EXPECT_EQ(kinds.size(), std::variant_size_v<VisitEvent>) << "every kind of event is in the table";
}

TEST(VisitTable, IsWhatTheMachineDoes) {
  const std::map<Pair, Entry> table = ReadTable();
  for (const auto& [name, state] : TableStates())
    for (const auto& [event, happened] : TableEvents(state)) {
      const auto found = table.find({name, event});
      if (found == table.end()) continue;
      const Entry& entry = found->second;
      const VisitStep step = Step(TableRules(), state, happened);
      const std::string where = "line " + std::to_string(entry.line) + ": " + name + " and " + event;
      EXPECT_EQ(Joined(step.actions), entry.actions) << where;
      if (entry.phase == "nothing") {
        EXPECT_EQ(step.state, state) << where << ": " << ToString(step.state);
      } else if (entry.phase == "noted") {
        VisitState noted = step.state;
        EXPECT_NE(noted, state) << where << " is not remembered";
        noted.closed_for = state.closed_for;
        EXPECT_EQ(noted, state) << where << ": more than why to close changed";
      } else {
        const std::string phase = entry.phase == "same" ? ToString(state.phase) : entry.phase;
        EXPECT_EQ(ToString(step.state.phase), phase) << where;
      }
    }
}

// Names are keys: of language files, of the store, of this table.
TEST(VisitWords, AreAllDifferent) {
  std::set<std::string> names;
  for (int i = 0; i < kWords; ++i) names.insert(ToString(static_cast<Word>(i)));
  EXPECT_EQ(names.size(), static_cast<size_t>(kWords));
  names.clear();
  for (int i = 0; i < kPhases; ++i) names.insert(ToString(static_cast<Phase>(i)));
  EXPECT_EQ(names.size(), static_cast<size_t>(kPhases));
  names.clear();
  for (int i = 0; i < kClosures; ++i) names.insert(ToString(static_cast<Closure>(i)));
  EXPECT_EQ(names.size(), static_cast<size_t>(kClosures));
  names.clear();
  for (int i = 0; i < kDeadlines; ++i) names.insert(ToString(static_cast<Deadline>(i)));
  EXPECT_EQ(names.size(), static_cast<size_t>(kDeadlines));
}

// Behind the pairs: what a whole visit comes to.
class Visit : public ::testing::Test {
 protected:
  void Tell(const VisitEvent& event) {
    VisitStep step = Step(rules_, state_, event);
    state_ = step.state;
    last_ = std::move(step.actions);
  }
  void SitDown() {
    for (const VisitEvent& event :
         std::vector<VisitEvent>{event::Space{1000}, event::Calibration{true, 1}, event::Hours{true}, event::Start{}})
      Tell(event);
    Tell(event::NotSensitive{});
    Tell(event::Agree{{true, false, false, 0, 0}});
    for (int i = 0; i < 2; ++i) Tell(event::Face{{300, 100, 700, 900}, 800, 1000, 16000});
    CountDown();
  }
  void CountDown() {
    ASSERT_EQ(state_.phase, Phase::kCountdown);
    for (int i = 0; i < 3; ++i) Tell(event::Tick{Deadline::kCountdown});
    ASSERT_EQ(state_.phase, Phase::kCapture);
  }
  void CapturedAs(const CaptureFacts& facts) { Tell(event::Captured{facts}); }

  VisitRules rules_ = TableRules();
  VisitState state_;
  std::vector<VisitAction> last_;
};

TEST_F(Visit, HasThreeAttemptsAndNoFourth) {
  SitDown();
  CaptureFacts moved;
  moved.worth = CaptureFacts::Worth::kDegraded;
  moved.moved = true;
  for (int attempt = 1; attempt < 3; ++attempt) {
    CapturedAs(moved);
    EXPECT_EQ(state_.phase, Phase::kGate);
    Tell(event::Start{});
    CountDown();
    EXPECT_EQ(state_.attempt, attempt + 1);
  }
  CapturedAs(moved);
  EXPECT_EQ(state_.phase, Phase::kThanks);
  EXPECT_EQ(state_.sessions, VisitState::Sessions::kKept);
}

TEST_F(Visit, HalvesTheExposureOfASaturatedCaptureWithoutAsking) {
  SitDown();
  CaptureFacts bright;
  bright.saturated_permille = 100;
  for (const int exposure_us : {8000, 4000}) {
    CapturedAs(bright);
    CountDown();
    EXPECT_THAT(last_, ::testing::Contains(VisitAction(
                           action::StartCapture{1, state_.attempt, exposure_us, {true, false, false, 0, 0}})));
  }
  CapturedAs(bright);
  EXPECT_EQ(state_.phase, Phase::kThanks) << "the third is kept as it is";
}

TEST_F(Visit, WithoutProofTwiceTheRigIsNotTrusted) {
  SitDown();
  CaptureFacts unproven;
  unproven.worth = CaptureFacts::Worth::kDegraded;
  unproven.unproven = true;
  CapturedAs(unproven);
  EXPECT_EQ(state_.phase, Phase::kGate);
  Tell(event::Start{});
  CountDown();
  CapturedAs(unproven);
  EXPECT_EQ(state_.phase, Phase::kSafe);
  EXPECT_EQ(state_.safe_for, Word::kProof);
  EXPECT_EQ(state_.work, VisitState::Work::kDiscard) << "no ticket was given, so nothing stays";
}

TEST_F(Visit, TwoInARowThatTheRigSpoiltCloseIt) {
  for (int i = 0; i < 2; ++i) {
    SitDown();
    Tell(event::Failed{});
    Tell(event::Discarded{});
  }
  EXPECT_EQ(state_.phase, Phase::kClosed);
  EXPECT_TRUE(state_.closed_for.Has(Closure::kFault));
  Tell(event::Operator{OperatorCommand::kOpen});
  EXPECT_EQ(state_.phase, Phase::kIdle);
}

TEST_F(Visit, TheButtonAloneRunsItWhereTheTextWasAgreedToOnPaper) {
  rules_.paper_consent = true;
  rules_.paper = {true, true, false, 2, 1};
  for (const VisitEvent& event :
       std::vector<VisitEvent>{event::Space{1000}, event::Calibration{true, 1}, event::Hours{true}, event::PageLost{}})
    Tell(event);
  for (int i = 0; i < 3; ++i) Tell(event::Start{});
  ASSERT_EQ(state_.phase, Phase::kPosition);
  EXPECT_EQ(state_.consent, rules_.paper);
}

TEST_F(Visit, IsNotClosedOnOnceItHasBegun) {
  SitDown();
  Tell(event::Hours{false});
  Tell(event::Space{0});
  CapturedAs({});
  EXPECT_EQ(state_.phase, Phase::kThanks);
  Tell(event::Tick{Deadline::kThanks});
  EXPECT_EQ(state_.phase, Phase::kClosed);
}

}  // namespace
}  // namespace stratalux::rig
