// SPDX-License-Identifier: Apache-2.0
// What must hold in every run of the machine (docs/kiosk.md), on random sequences of events. The watcher believes the
// actions alone: what it knows of light and sessions it was told to do, as the shell would be. Broken machines show
// that it sees what it watches for.
#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/kiosk/visit_cases.h"

namespace stratalux::rig {
namespace {

using ::testing::AnyOf;
using ::testing::HasSubstr;

template <typename T>
bool Is(const VisitEvent& event) {
  return std::holds_alternative<T>(event);
}

// The world as the actions make it, and the laws.
class Watcher {
 public:
  explicit Watcher(const VisitRules& rules) : rules_(rules) {}

  // The first law that the step breaks; empty: none.
  std::string See(const VisitState& before, const VisitEvent& event, const VisitStep& step) {
    broken_.clear();
    const bool was_lit = lit_;
    Hear(before, event);
    for (const VisitAction& action : step.actions) Note(action);
    CheckLight(before, event, step, was_lit);
    CheckSafe(before, event, step.state);
    CheckSessions(step.state);
    return broken_;
  }

 private:
  void Break(const std::string& law) {
    if (broken_.empty()) broken_ = law;
  }
  void Hear(const VisitState& before, const VisitEvent& event) {
    // The ticket is given back.
    if (Is<event::Refuse>(event) && before.phase == Phase::kThanks) kept_ = false;
    const bool over = Is<event::Captured>(event) || Is<event::Failed>(event);
    const auto* captured = std::get_if<event::Captured>(&event);
    // Of a capture that nobody began nothing is kept.
    if (captured != nullptr && captured->facts.worth != CaptureFacts::Worth::kFailed) usable_ |= begun_ && capturing_;
    if (over && capturing_) {
      capturing_ = false;
      capture_light_ = false;
    }
    if (Is<event::Failed>(event)) previewing_ = previewing_ && !over;
    if (Is<event::Checked>(event)) checking_ = false;
    if (Is<event::Discarded>(event) && discarding_) {
      discarding_ = false;
      begun_ = kept_ = false;
    }
    if (Is<event::DiscardFailed>(event)) discarding_ = false;
    if (const auto* agree = std::get_if<event::Agree>(&event)) agreed_ |= agree->choice.fit;
    if (rules_.paper_consent && Is<event::Start>(event)) agreed_ = true;
    lit_ = previewing_ || capture_light_ || checking_;
  }
  void Note(const VisitAction& action) {
    if (std::holds_alternative<action::LightOff>(action)) previewing_ = capture_light_ = checking_ = false;
    if (std::holds_alternative<action::Preview>(action)) {
      previewing_ = true;
      if (!agreed_) Break("2: a preview of somebody who has not agreed");
    }
    if (std::holds_alternative<action::CheckRig>(action)) checking_ = true;
    if (const auto* start = std::get_if<action::StartCapture>(&action)) Begin(*start);
    if (const auto* discard = std::get_if<action::Discard>(&action)) {
      if (capturing_) Break("3: discards what is still being written");
      if (!begun_ || discard->visit != visit_) Break("3: discards what is not there");
      discarding_ = true;
    }
    if (const auto* ticket = std::get_if<action::PrintTicket>(&action)) {
      if (!begun_ || !usable_ || ticket->visit != visit_) Break("3: a ticket for nothing");
      kept_ = true;
    }
    const auto* show = std::get_if<action::Show>(&action);
    const bool offered = show != nullptr && show->usable, gate = show != nullptr && show->screen == Phase::kGate;
    if (offered && (!gate || !usable_)) Break("8: offers to keep what is not there");
    if (gate && usable_ && !offered) Break("8: does not offer to keep what is worth it");
    if (std::holds_alternative<action::Count>(action) && begun_) Break("2: a count of what is on the disk");
    lit_ = previewing_ || capture_light_ || checking_;
  }
  void Begin(const action::StartCapture& start) {
    if (!agreed_ || !start.consent.fit) Break("2: a capture of somebody who has not agreed");
    if (capturing_ || discarding_) Break("3: a capture beside other work");
    if (begun_ && start.visit != visit_) Break("3: the visit before was neither kept nor discarded");
    attempts_ = begun_ ? attempts_ + 1 : 1;
    usable_ = begun_ && usable_;
    if (attempts_ > 3 || start.attempt != attempts_) Break("3: attempt " + std::to_string(start.attempt));
    if (start.exposure_us <= 0) Break("3: a capture without an exposure");
    visit_ = start.visit;
    begun_ = capturing_ = capture_light_ = true;
    kept_ = false;
  }
  void CheckLight(const VisitState& before, const VisitEvent& event, const VisitStep& step, bool was_lit) {
    const Phase phase = step.state.phase;
    const bool may = phase == Phase::kPosition || phase == Phase::kCapture || phase == Phase::kSelfcheck;
    if (lit_ && !may) Break("1: light in " + std::string(ToString(phase)));
    const auto* interlock = std::get_if<event::InterlockChanged>(&event);
    const auto* device = std::get_if<event::DeviceChanged>(&event);
    const bool takes = (interlock != nullptr && interlock->active) || (device != nullptr && !device->there) ||
                       Is<event::Shutdown>(event) || (Is<event::Leave>(event) && was_lit && before.phase != phase);
    const bool first = !step.actions.empty() && std::holds_alternative<action::LightOff>(step.actions.front());
    if (takes && (lit_ || !first)) Break("1: light off is not the first that is done");
  }
  void CheckSafe(const VisitState& before, const VisitEvent& event, const VisitState& after) {
    if (const auto* interlock = std::get_if<event::InterlockChanged>(&event)) {
      open_.Set(interlock->which, interlock->active);
      if (interlock->active) reset_ = false;
      if (interlock->active && after.phase != Phase::kSafe) Break("5: the interlock does not win");
    }
    const auto* ordered = std::get_if<event::Operator>(&event);
    if (before.phase == Phase::kSafe && ordered != nullptr && ordered->command == OperatorCommand::kReset)
      reset_ = true;
    if (before.phase == Phase::kSafe && after.phase != Phase::kSafe) {
      if (!open_.empty()) Break("5: leaves safe with an open interlock");
      if (!reset_) Break("5: leaves safe without a reset");
    }
    if (after.phase != Phase::kSafe) reset_ = false;
  }
  void CheckSessions(const VisitState& after) {
    if (after.phase != Phase::kIdle) return;
    if (capturing_ || discarding_) Break("3: idle with work under way");
    if (begun_ && !kept_) Break("3: idle with a session that is neither kept nor discarded");
    begun_ = kept_ = agreed_ = false;
  }

  const VisitRules& rules_;
  bool previewing_ = false, capture_light_ = false, checking_ = false, lit_ = false;
  bool agreed_ = false, begun_ = false, kept_ = false, capturing_ = false, discarding_ = false, reset_ = false;
  bool usable_ = false;  // a capture of the visit
  uint32_t visit_ = 0;
  int attempts_ = 0;
  EnumSet<Interlock> open_;
  std::string broken_;
};

struct Trial {
  std::vector<VisitEvent> events;
  std::string broken;  // the law, and what led there
  EnumSet<Phase> visited;
};

std::string Tail(const std::vector<VisitEvent>& events) {
  std::string text;
  for (size_t i = events.size() > 12 ? events.size() - 12 : 0; i < events.size(); ++i)
    text += "\n  " + ToString(events[i]);
  return text;
}

bool AtRest(const VisitState& state) {
  return state.phase == Phase::kIdle || state.phase == Phase::kClosed || state.phase == Phase::kSafe;
}

// Law 4. The shell owes its answers, but may never give them.
std::string ThenTicksAlone(const StepFunction& step, const VisitRules& rules, VisitState state, Watcher watcher) {
  for (int tick = 0; tick < 64; ++tick) {
    if (AtRest(state)) return state.light == VisitState::Light::kOff ? "" : "4: ends with light on";
    if (state.armed == Deadline::kNone) return std::string("4: no deadline in ") + ToString(state.phase);
    const VisitEvent event = event::Tick{state.armed};
    const VisitStep next = step(rules, state, event);
    if (const std::string broken = watcher.See(state, event, next); !broken.empty()) return broken;
    state = next.state;
  }
  return std::string("4: ticks alone do not end ") + ToString(state.phase);
}

VisitRules RulesOf(Random& random) {
  VisitRules rules = TableRules();
  rules.attempts = 1 + static_cast<int>(random.Uniform() * 3);
  rules.countdown = 1 + static_cast<int>(random.Uniform() * 3);
  rules.steady_looks = 1 + static_cast<int>(random.Uniform() * 2);
  rules.paper_consent = random.Uniform() < 0.2;
  return rules;
}

Trial RandomRun(const StepFunction& step, uint64_t seed, uint64_t number) {
  Random random(seed, number);
  const VisitRules rules = RulesOf(random);
  Watcher watcher(rules);
  Trial run;
  VisitState state;
  const int length = 20 + static_cast<int>(random.Uniform() * 60);
  for (int i = 0; i < length && run.broken.empty(); ++i) {
    const VisitEvent event = AnyEvent(random, state);
    run.events.push_back(event);
    const VisitStep next = step(rules, state, event);
    run.broken = watcher.See(state, event, next);
    state = next.state;
    run.visited.Add(state.phase);
  }
  if (run.broken.empty()) run.broken = ThenTicksAlone(step, rules, state, watcher);
  if (!run.broken.empty())
    run.broken += "\nseed " + std::to_string(seed) + ", sequence " + std::to_string(number) + ":" + Tail(run.events);
  return run;
}

uint64_t Seed() {
  const char* text = std::getenv("STRATALUX_SEED");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 1;
}
uint64_t Sequences() {
  const char* text = std::getenv("STRATALUX_VISIT_SEQUENCES");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 20'000;
}

TEST(VisitProperties, HoldInEveryRun) {
  const uint64_t seed = Seed(), sequences = Sequences();
  std::array<uint64_t, kPhases> visited{};
  uint64_t events = 0;
  for (uint64_t n = 0; n < sequences; ++n) {
    const Trial run = RandomRun(Step, seed, n);
    ASSERT_EQ(run.broken, "");
    events += run.events.size();
    for (int phase = 0; phase < kPhases; ++phase) visited[phase] += run.visited.Has(static_cast<Phase>(phase)) ? 1 : 0;
  }
  // Else the laws would hold for want of anything happening.
  for (int phase = 0; phase < kPhases; ++phase)
    EXPECT_GT(visited[phase], sequences / 50) << ToString(static_cast<Phase>(phase));
  std::printf("%llu sequences, %llu events; of them reached capture %llu, gate %llu, thanks %llu, forgetting %llu\n",
              static_cast<unsigned long long>(sequences), static_cast<unsigned long long>(events),
              static_cast<unsigned long long>(visited[static_cast<size_t>(Phase::kCapture)]),
              static_cast<unsigned long long>(visited[static_cast<size_t>(Phase::kGate)]),
              static_cast<unsigned long long>(visited[static_cast<size_t>(Phase::kThanks)]),
              static_cast<unsigned long long>(visited[static_cast<size_t>(Phase::kForgetting)]));
}

// Law 7, and law 6: the same events without those of the page lead to the same state and do the same, but for what is
// shown again.
std::string Differs(const StepFunction& step, const std::vector<VisitEvent>& events) {
  const VisitRules rules = TableRules();
  VisitState with, again, without;
  for (const VisitEvent& event : events) {
    const VisitStep once = step(rules, with, event), twice = step(rules, again, event);
    if (!(once == twice)) return "7: the same event does something else: " + ToString(event);
    with = once.state;
    again = twice.state;
    if (Is<event::PageLost>(event) || Is<event::PageBack>(event)) {
      for (const VisitAction& action : once.actions)
        if (!std::holds_alternative<action::Show>(action)) return "6: the page makes it do " + ToString(action);
    } else {
      const VisitStep blind = step(rules, without, event);
      if (!(blind.actions == once.actions)) return "6: without the page it does something else at " + ToString(event);
      without = blind.state;
    }
    if (!(with == without)) return "6: the page changed the state";
  }
  return "";
}

TEST(VisitProperties, AreTheSameAgainAndWithoutThePage) {
  for (uint64_t n = 0; n < Sequences() / 10; ++n)
    ASSERT_EQ(Differs(Step, RandomRun(Step, Seed(), n).events), "") << "sequence " << n;
}

// ---- Broken machines ------------------------------------------------------------------------------------------------

// What is found within as many sequences as every build runs.
std::string Found(const StepFunction& broken) {
  for (uint64_t n = 0; n < 2000; ++n) {
    const Trial run = RandomRun(broken, 1, n);
    if (!run.broken.empty()) return run.broken;
    if (const std::string differs = Differs(broken, run.events); !differs.empty()) return differs;
  }
  return "nothing";
}

template <typename Action>
void Drop(VisitStep& step) {
  std::erase_if(step.actions, [](const VisitAction& action) { return std::holds_alternative<Action>(action); });
}

// The machine, with its answer to what `spoil` wants spoilt.
StepFunction Broken(std::function<void(const VisitState& before, const VisitEvent&, VisitStep&)> spoil) {
  return [spoil](const VisitRules& rules, const VisitState& state, const VisitEvent& event) {
    VisitStep step = Step(rules, state, event);
    spoil(state, event, step);
    return step;
  };
}

TEST(VisitAblation, ForgetsLightOffWhenTheVisitorLeaves) {
  const auto broken = Broken([](const VisitState&, const VisitEvent& event, VisitStep& step) {
    if (Is<event::Leave>(event)) Drop<action::LightOff>(step);
  });
  EXPECT_THAT(Found(broken), HasSubstr("1: light"));
}

TEST(VisitAblation, TurnsTheLightOffLast) {
  const auto broken = Broken([](const VisitState&, const VisitEvent& event, VisitStep& step) {
    if (Is<event::Shutdown>(event)) std::rotate(step.actions.begin(), step.actions.begin() + 1, step.actions.end());
  });
  EXPECT_THAT(Found(broken), HasSubstr("1: light off is not the first"));
}

TEST(VisitAblation, SkipsTheConsent) {
  const auto broken = [](const VisitRules& rules, const VisitState& state, const VisitEvent& event) {
    const bool skip = state.phase == Phase::kQuestion && Is<event::NotSensitive>(event);
    if (!skip) return Step(rules, state, event);
    const VisitStep asked = Step(rules, state, event);
    return Step(rules, asked.state, event::Agree{{true, false, false, 0, 0}});
  };
  EXPECT_THAT(Found(broken), HasSubstr("2: "));
}

TEST(VisitAblation, OffersToKeepWhatIsNotWorthItOrHidesWhatIs) {
  const auto says = [](bool usable) {
    return Broken([usable](const VisitState&, const VisitEvent&, VisitStep& step) {
      for (VisitAction& action : step.actions)
        if (auto* show = std::get_if<action::Show>(&action); show != nullptr && show->screen == Phase::kGate)
          show->usable = usable;
    });
  };
  EXPECT_THAT(Found(says(true)), HasSubstr("8: offers to keep what is not there"));
  EXPECT_THAT(Found(says(false)), HasSubstr("8: does not offer to keep"));
}

TEST(VisitAblation, LetsAVisitorTryAFourthTime) {
  const auto broken = [](VisitRules rules, const VisitState& state, const VisitEvent& event) {
    rules.attempts = 4;
    return Step(rules, state, event);
  };
  EXPECT_THAT(Found(broken), HasSubstr("3: attempt 4"));
}

TEST(VisitAblation, ForgetsToForget) {
  const auto broken = Broken([](const VisitState& before, const VisitEvent& event, VisitStep& step) {
    if (before.phase == Phase::kThanks && Is<event::Refuse>(event)) step = Step({}, before, event::Leave{});
  });
  EXPECT_THAT(Found(broken), HasSubstr("3: idle with a session"));
  const auto leaves = Broken([](const VisitState& before, const VisitEvent& event, VisitStep& step) {
    if (before.phase != Phase::kForgetting || step.state.work != VisitState::Work::kDiscard) return;
    if (!Is<event::Captured>(event) || before.work == VisitState::Work::kDiscard) return;
    step = {before, {}};
    step.state.phase = Phase::kIdle;
    step.state.work = VisitState::Work::kNone;
  });
  EXPECT_THAT(Found(leaves), HasSubstr("3: idle with a session"));
}

TEST(VisitAblation, DiscardsWhatIsStillBeingWritten) {
  const auto broken = Broken([](const VisitState& before, const VisitEvent& event, VisitStep& step) {
    if (before.phase == Phase::kCapture && Is<event::Leave>(event))
      step.actions.push_back(action::Discard{before.visit, Word::kLeft});
  });
  EXPECT_THAT(Found(broken), HasSubstr("3: discards what is still being written"));
}

TEST(VisitAblation, ArmsNoDeadline) {
  const auto broken = Broken([](const VisitState& before, const VisitEvent&, VisitStep& step) {
    if (before.phase == Phase::kCapture && step.state.phase == Phase::kGate) step.state.armed = Deadline::kNone;
  });
  EXPECT_THAT(Found(broken), HasSubstr("4: no deadline in gate"));
}

TEST(VisitAblation, CountsDownForEver) {
  const auto broken = Broken([](const VisitState& before, const VisitEvent& event, VisitStep& step) {
    if (before.phase == Phase::kConsent && Is<event::Tick>(event)) step = {before, {}};
  });
  EXPECT_THAT(Found(broken), HasSubstr("4: ticks alone do not end consent"));
}

TEST(VisitAblation, IgnoresTheDoorDuringTheQuestion) {
  const auto broken = Broken([](const VisitState& before, const VisitEvent& event, VisitStep& step) {
    if (before.phase == Phase::kQuestion && Is<event::InterlockChanged>(event)) step.state.phase = Phase::kQuestion;
  });
  EXPECT_THAT(Found(broken), HasSubstr("5: the interlock does not win"));
}

TEST(VisitAblation, LeavesSafeByItself) {
  const auto broken = Broken([](const VisitState& before, const VisitEvent& event, VisitStep& step) {
    const auto* over = std::get_if<event::InterlockChanged>(&event);
    if (before.phase == Phase::kSafe && over != nullptr && !over->active) step.state.phase = Phase::kClosed;
  });
  EXPECT_THAT(Found(broken), HasSubstr("5: leaves safe"));
}

TEST(VisitAblation, EndsTheVisitWhenThePageGoes) {
  const auto broken = [](const VisitRules& rules, const VisitState& state, const VisitEvent& event) {
    return Step(rules, state, Is<event::PageLost>(event) ? VisitEvent(event::Leave{}) : event);
  };
  EXPECT_THAT(Found(broken), HasSubstr("6: "));
}

TEST(VisitAblation, RemembersOutsideItsState) {
  int steps = 0;
  const auto broken = [&steps](const VisitRules& rules, const VisitState& state, const VisitEvent& event) {
    VisitStep step = Step(rules, state, event);
    if (++steps % 1000 == 0) step.actions.push_back(action::TellOperator{Word::kFault});
    return step;
  };
  EXPECT_THAT(Found(broken), AnyOf(HasSubstr("7: "), HasSubstr("6: without the page it does something else")));
}

}  // namespace
}  // namespace stratalux::rig
