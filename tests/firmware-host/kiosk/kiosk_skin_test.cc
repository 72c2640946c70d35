// SPDX-License-Identifier: Apache-2.0
// Visitors of simulated skin, one after another before one open rig: light to dark, with faults, refusals, retakes and
// walk-aways. What is kept is good for something, is found by the store's queries, and took the time that was said.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <set>
#include <string>

#include <nlohmann/json.hpp>

#include "firmware-host/apps/plan_command.h"
#include "firmware-host/sequence/visit_time.h"
#include "shared/base/random.h"
#include "shared/capture/plan.h"
#include "tests/firmware-host/kiosk/kiosk_fixture.h"
#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

constexpr double kLightest = 0.01, kDarkest = 0.25;  // melanin of the epidermis, volume fraction
constexpr double kVisitS = 60.0;                     // of rig time, from one START to the next

int Visits() {
  const char* text = std::getenv("STRATALUX_SKIN_VISITS");
  return text != nullptr ? std::atoi(text) : 1;
}
uint64_t Seed() {
  const char* text = std::getenv("STRATALUX_SEED");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 1;
}

// By the rig's own clock, which passes exposures, not computing.
struct Times {
  double began_s = 0.0, capture_began_s = 0.0, capture_s = 0.0;
  int attempts = 0;
};

class KioskSkin : public KioskTest {
 protected:
  void SetUp() override {
    StationOptions& station = options_.station;
    station.config.camera.width = 348;
    station.config.camera.height = 260;
    station.config.plan = PlanOptions();
    station.config.kiosk.margin = KioskConfig().margin;
    station.config.kiosk.steady_looks = KioskConfig().steady_looks;
    Simulate(station, "head");
    station.simulated->scattering = true;
    station.simulated->devices.timing.overlapped_readout = true;  // docs/examples/scenes/overlapped.toml
    Open();
    options_.timing = TimingOf(station.config, station_->rig().simulation->timing());
  }
  [[nodiscard]] double NowS() const { return 1e-9 * static_cast<double>(station_->rig().simulation->clock().Now().ns); }
  // Evenly spaced in the logarithm; every head and every blood is another's.
  void Seat(int visit, int visits) {
    const double share = visits > 1 ? static_cast<double>(visit) / (visits - 1) : 0.5;
    const double melanin = kLightest * std::pow(kDarkest / kLightest, share);
    const auto file = folder_ / "visitor.toml";
    WriteText(file, "[subject]\nshape = \"head\"\n[skin]\nmelanin = " + std::to_string(melanin) + "\n");
    SubjectOptions subject;
    subject.scene = file.string();
    subject.seed = Seed() + static_cast<uint64_t>(visit);
    const Status seated = station_->SetSubject(subject);
    ASSERT_TRUE(seated.ok()) << seated.message();
  }
  void TakeTimes(const action::Show& screen) {
    if (screen.screen == Phase::kQuestion) times_.push_back({.began_s = NowS()});
    if (times_.empty()) return;
    Times& times = times_.back();
    const bool captures = screen.screen == Phase::kCapture;
    if (captures && shown_ != Phase::kCapture) times.capture_began_s = NowS(), ++times.attempts;
    if (!captures && shown_ == Phase::kCapture) times.capture_s = NowS() - times.capture_began_s;
    shown_ = screen.screen;
  }

  std::vector<Times> times_;
  Phase shown_ = Phase::kClosed;
};

TEST_F(KioskSkin, VisitorsOfEverySkinAreKeptOrLeaveNothing) {
  const int visits = Visits();
  if (visits > 1) {
    options_.station.simulated->faults.rate = 0.0005;
    options_.station.simulated->faults.seed = Seed();
    station_.reset();
    Open();
  }
  Random random(Seed());
  on_show_ = [&](const action::Show& screen) { TakeTimes(screen); };
  const KioskReport report = Run(visits, [&](int visit) {
    Seat(visit, visits);
    // A single one stays to the end.
    if (visits == 1 || random.Uniform() < 0.6) return Manner::kVisit;
    return static_cast<Manner>(random.Uniform() * kManners);
  });
  const double end_s = NowS();
  EXPECT_EQ(report.begun, visits);
  EXPECT_FALSE(report.owed);
  EXPECT_GE(report.tickets, std::max(1, visits / 3));
  CheckStore();

  ASSERT_EQ(times_.size(), static_cast<size_t>(visits));
  double longest_s = 0.0, longest_capture_s = 0.0;
  for (size_t i = 0; i < times_.size(); ++i) {
    const double visit_s = (i + 1 < times_.size() ? times_[i + 1].began_s : end_s) - times_[i].began_s;
    EXPECT_LE(visit_s, kVisitS) << "visit " << i << ", " << times_[i].attempts << " attempts";
    longest_s = std::max(longest_s, visit_s);
  }
  // `stratalux-db` finds each visitor who kept a ticket, and nobody else.
  std::set<std::string> kept, listed;
  for (const ScriptedVisit& visit : front_->visits)
    if (!visit.ticket.empty() && !visit.gave_back) kept.insert(*db::VisitorOfTicket(visit.ticket));
  const Outcome ls =
      Execute("stratalux-db ls --kind visitor --json --store " + (folder_ / "store").string(), Show::kStdout);
  ASSERT_EQ(ls.code, 0);
  for (const auto& row : nlohmann::json::parse(ls.out)) listed.insert(row.at("visitor").get<std::string>());
  EXPECT_EQ(listed, kept);

  // What was said of each capture that came to its end: nothing shot again is foreseen.
  const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
  ASSERT_TRUE(store.ok());
  for (size_t i = 0; i < times_.size(); ++i) {
    const ScriptedVisit& visit = front_->visits[i];
    if (visit.ticket.empty() || visit.gave_back) continue;
    const auto rows = store->ListSessionsOf(*db::VisitorOfTicket(visit.ticket));
    ASSERT_TRUE(rows.ok() && !rows->empty());
    const auto session = store->FindSession(rows->back().info.id);
    const auto plan = PlanOptionsFromJson(session->info.plan_json);
    ASSERT_TRUE(plan.ok());
    const double said_s = 1e-9 * static_cast<double>(VisitTime(*BuildPlan(*plan), options_.timing).count());
    EXPECT_LE(said_s, options_.station.config.max_visit_s);
    const double taken_s = times_[i].capture_s;
    longest_capture_s = std::max(longest_capture_s, taken_s);
    std::printf("visitor %2zu: %d attempts, exposure %5.1f ms, said %5.2f s, taken %5.2f s, %s\n", i,
                times_[i].attempts, plan->exposure_ms, said_s, taken_s, ToString(session->info.status));
    if (session->info.status == SessionStatus::kComplete && visits == 1) {
      EXPECT_NEAR(taken_s / said_s, 1.0, 0.05);
    }
    EXPECT_LE(taken_s, 1.25 * said_s) << "faults and their repetitions included";
  }
  std::printf("%d visitors, %lld captures, %lld tickets; longest visit %.1f s of rig time, longest capture %.1f s\n",
              visits, static_cast<long long>(report.captures), static_cast<long long>(report.tickets), longest_s,
              longest_capture_s);
}

}  // namespace
}  // namespace stratalux::rig
