// SPDX-License-Identifier: Apache-2.0
// The simulation against what can be worked out by hand: conservation, a queue of known mean wait, a night of known
// length, transfers that share a line.
#include "fitter/batch/fleet.h"

#include <cmath>
#include <numeric>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

VisitFigures FiguresOfAVisit() {
  return {.fit_cpu_s = {100.0},
          .longest_stage_share = 0.3,
          .capture_s = 10.0,
          .frames_bytes = 5e8,
          .fit_bytes = 2e8,
          .artifact_bytes = 1e9};
}

std::vector<FleetDay> Simulate(const VisitFigures& figures, const FleetOptions& options) {
  auto days = SimulateFleet(figures, options);
  EXPECT_TRUE(days.ok()) << days.status().message();
  return days.ok() ? std::move(*days) : std::vector<FleetDay>{};
}

template <typename Of>
int64_t Sum(const std::vector<FleetDay>& days, Of of) {
  return std::accumulate(days.begin(), days.end(), int64_t{0},
                         [&](int64_t sum, const FleetDay& day) { return sum + day.*of; });
}

TEST(Fleet, NobodyIsLostOrFittedTwice) {
  FleetOptions options;
  options.kiosks = 20;
  options.visitors = 100;
  options.machines = 3;
  options.cores = 4;
  options.away_share = 0.2;
  options.crash_share = 0.1;
  options.hopeless_share = 0.02;
  options.machine_days = 3.0;
  options.days = 12;
  for (options.seed = 1; options.seed <= 5; ++options.seed) {
    const auto days = Simulate(FiguresOfAVisit(), options);
    ASSERT_EQ(days.size(), 12U);
    EXPECT_LE(Sum(days, &FleetDay::captured), Sum(days, &FleetDay::came));
    EXPECT_EQ(Sum(days, &FleetDay::captured), Sum(days, &FleetDay::pulled) + days.back().on_kiosks);
    // In work in the morning: a core each at most.
    const int64_t left = Sum(days, &FleetDay::pulled) - Sum(days, &FleetDay::fitted) - Sum(days, &FleetDay::set_aside) -
                         days.back().queue_left;
    EXPECT_GE(left, 0);
    EXPECT_LE(left, 12);
    EXPECT_GT(Sum(days, &FleetDay::set_aside), 0);
    for (const FleetDay& day : days) EXPECT_LE(day.cores_busy, 1.0 + 1e-9);
  }
}

// Pollaczek and Khinchine: one server, Poisson arrivals, visits of one length s: the mean wait is rho s / (2 (1 -
// rho)).
TEST(Fleet, VisitorsWaitBeforeAKioskAsTheQueueOfOneServerSays) {
  FleetOptions options;
  options.kiosks = 100;
  options.opens_h = 0.0;
  options.closes_h = 24.0;
  options.between_s = 50.0;
  options.days = 20;
  options.cores = 1;
  for (const double load : {0.3, 0.6, 0.8}) {
    options.visitors = load * 86400.0 / 60.0;
    const auto days = Simulate(FiguresOfAVisit(), options);
    double wait = 0.0;
    for (const FleetDay& day : days) wait += day.mean_wait_s / static_cast<double>(days.size());
    const double expected = load * 60.0 / (2.0 * (1.0 - load));
    EXPECT_NEAR(wait, expected, 0.05 * expected) << load;
  }
}

// All is pulled before the night, all fits take as long: so many rounds of all cores, and not one more.
TEST(Fleet, ANightTakesSoManyRoundsOfItsCores) {
  FleetOptions options;
  options.kiosks = 10;
  options.visitors = 60;
  options.machines = 2;
  options.cores = 8;
  options.days = 3;
  for (const FleetDay& day : Simulate(FiguresOfAVisit(), options)) {
    const double rounds = std::ceil(static_cast<double>(day.captured) / 16.0);
    ASSERT_TRUE(day.done_h);
    EXPECT_NEAR(*day.done_h, 20.0 + rounds * 100.0 / 3600.0, 1e-9);
    EXPECT_EQ(day.queue_longest, day.captured);
    EXPECT_NEAR(day.cores_busy, static_cast<double>(day.captured) * 100.0 / (16 * 11 * 3600.0), 1e-9);
    EXPECT_EQ(day.attempts, day.fitted);
  }
}

TEST(Fleet, WhatANightCannotDoWaitsAndIsDoneLater) {
  FleetOptions options;
  options.kiosks = 4;
  options.visitors = 100;
  options.machines = 1;
  options.cores = 1;  // 396 in a night of 11 hours
  options.days = 10;
  const auto days = Simulate(FiguresOfAVisit(), options);
  const int64_t captured = Sum(days, &FleetDay::captured), fitted = Sum(days, &FleetDay::fitted);
  EXPECT_LE(fitted, 10 * 396);
  EXPECT_GE(captured, fitted);
  for (const FleetDay& day : days) EXPECT_EQ(day.done_h.has_value(), day.queue_left == 0);
  // A second core has air.
  options.cores = 2;
  for (const FleetDay& day : Simulate(FiguresOfAVisit(), options)) EXPECT_TRUE(day.done_h);
}

// Each attempt dies with probability p: of attempts without end a visitor needs 1 / (1 - p).
TEST(Fleet, CrashesCostTheAttemptsThatTheyShould) {
  FleetOptions options;
  options.kiosks = 50;
  options.visitors = 200;
  options.machines = 10;
  options.cores = 16;
  options.attempts = 100;
  options.crash_share = 0.25;
  options.days = 2;
  const auto days = Simulate(FiguresOfAVisit(), options);
  const auto attempts = static_cast<double>(Sum(days, &FleetDay::attempts)),
             fitted = static_cast<double>(Sum(days, &FleetDay::fitted));
  EXPECT_NEAR(attempts / fitted, 1.0 / 0.75, 0.01);
  EXPECT_EQ(Sum(days, &FleetDay::set_aside), 0);
  // An attempt that dies loses 15 % of a fit on average, or all that it did: never a whole fit.
  double busy_s = 0.0;
  for (const FleetDay& day : days) busy_s += day.cores_busy * 11 * 3600.0 * 160;
  EXPECT_GT(busy_s, fitted * 100.0);
  EXPECT_LT(busy_s, fitted * 100.0 * (1.0 + 0.15 * attempts / fitted * 0.25 + 0.01));

  options.attempts = 3;
  options.crash_share = 0.0;
  options.hopeless_share = 0.1;
  const auto aside = Simulate(FiguresOfAVisit(), options);
  EXPECT_NEAR(
      static_cast<double>(Sum(aside, &FleetDay::set_aside)) / static_cast<double>(Sum(aside, &FleetDay::captured)), 0.1,
      0.01);
}

// All kiosks pull at once, and together they fill the store's line: its rate is all that counts.
TEST(Fleet, PullsShareTheLine) {
  FleetOptions options;
  options.kiosks = 30;
  options.visitors = 100;
  options.link_mbit = 1000.0;
  options.ingress_mbit = 100.0;
  options.days = 12;
  options.cores = 1;
  const auto days = Simulate(FiguresOfAVisit(), options);
  // The first visitor comes at ten of the first day. What counts is whole: pulls under way count when they are over.
  const double seconds = 12 * 86400.0 - 10 * 3600.0 + 7 * 3600.0, bytes = 100.0e6 / 8.0 * seconds;
  const double pulled = static_cast<double>(Sum(days, &FleetDay::pulled)) * 5e8;
  EXPECT_LE(pulled, bytes);
  EXPECT_GE(pulled, 0.85 * bytes);
  EXPECT_GT(days.back().on_kiosks, 0);
  EXPECT_GT(LoadOf(FiguresOfAVisit(), options).ingress, 1.0);
  // With ten times the line nobody is left behind, but who came within the last hour.
  options.ingress_mbit = 10'000.0;
  for (const FleetDay& day : Simulate(FiguresOfAVisit(), options)) EXPECT_EQ(day.on_kiosks, 0);
}

TEST(Fleet, FramesAreDroppedWhenTheirDaysAreOver) {
  FleetOptions options;
  options.kiosks = 5;
  options.frames_days = 3.0;
  options.fits_days = 1000.0;
  options.artifacts_days = 0.0;
  options.days = 12;
  options.machines = 4;
  options.cores = 16;
  const auto days = Simulate(FiguresOfAVisit(), options);
  double frames = 0.0;
  for (size_t day = 0; day < days.size(); ++day) {
    frames = 0.0;
    // In the morning of the fifth day the frames of the second are three days old.
    for (size_t d = day >= 2 ? day - 2 : 0; d <= day; ++d) frames += static_cast<double>(days[d].pulled) * 5e8;
    double fits = 0.0;
    for (size_t d = 0; d <= day; ++d) fits += static_cast<double>(days[d].fitted) * 2e8;
    EXPECT_NEAR(days[day].store_bytes, frames + fits, 1.0) << day;
  }
}

TEST(Fleet, AKioskThatIsAwayDelaysOnlyItself) {
  FleetOptions options;
  options.kiosks = 2;
  options.machines = 4;
  options.cores = 16;
  options.away_share = 0.5;
  options.days = 30;
  int kept_back = 0, done = 0;
  for (const FleetDay& day : Simulate(FiguresOfAVisit(), options)) {
    kept_back += day.on_kiosks > 0;
    done += day.done_h.has_value() || day.pulled == 0;
    EXPECT_EQ(day.queue_left, 0);
  }
  EXPECT_GT(kept_back, 10);
  EXPECT_EQ(done, 30);
}

TEST(Fleet, TheSameSeedGivesTheSameDays) {
  FleetOptions options;
  options.crash_share = 0.1;
  options.machine_days = 2.0;
  options.days = 3;
  const auto one = Simulate(FiguresOfAVisit(), options), two = Simulate(FiguresOfAVisit(), options);
  options.seed = 2;
  const auto other = Simulate(FiguresOfAVisit(), options);
  ASSERT_EQ(one.size(), two.size());
  for (size_t i = 0; i < one.size(); ++i) {
    EXPECT_EQ(one[i].captured, two[i].captured);
    EXPECT_EQ(one[i].attempts, two[i].attempts);
    EXPECT_EQ(one[i].done_h, two[i].done_h);
  }
  EXPECT_NE(one[0].captured, other[0].captured);
}

TEST(Fleet, WhatCannotBeIsRefusedByName) {
  FleetOptions options;
  const auto refused = [&](const char* name) {
    const auto days = SimulateFleet(FiguresOfAVisit(), options);
    EXPECT_FALSE(days.ok());
    EXPECT_THAT(days.status().message(), HasSubstr(name));
    options = {};
  };
  options.kiosks = 0;
  refused("kiosks");
  options.visitors = std::nan("");
  refused("visitors");
  options.closes_h = options.opens_h;
  refused("close after it opens");
  options.crash_share = 1.5;
  refused("crashes");
  options.visitors = 1e5;
  options.kiosks = 100'000;
  refused("days");
}

TEST(VisitFigures, AreReadAsTheyWereWritten) {
  const VisitFigures figures = FiguresOfAVisit();
  const auto read = ParseVisitFigures(ToJson(figures));
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(read->fit_cpu_s, figures.fit_cpu_s);
  EXPECT_EQ(read->frames_bytes, figures.frames_bytes);
  for (const auto& [text, why] : std::vector<std::pair<std::string, std::string>>{
           {"[]", "object"},
           {"{}", "fit_cpu_s"},
           {R"({"fit_cpu_s": ["x"]})", "fit_cpu_s"},
           {R"({"fit_cpu_s": [1], "frame_bytes": 3})", "frame_bytes"},
           {R"({"fit_cpu_s": [-1], "capture_s": 1, "frames_bytes": 1, "fit_bytes": 1, "artifact_bytes": 1})",
            "fit_cpu_s"},
           {R"({"fit_cpu_s": [1], "capture_s": 0, "frames_bytes": 1, "fit_bytes": 1, "artifact_bytes": 1})",
            "capture_s"}}) {
    const auto bad = ParseVisitFigures(text);
    ASSERT_FALSE(bad.ok()) << text;
    EXPECT_THAT(bad.status().message(), HasSubstr(why)) << text;
  }
}

}  // namespace
}  // namespace stratalux::fit
