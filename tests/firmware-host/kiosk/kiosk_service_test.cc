// SPDX-License-Identifier: Apache-2.0
// The kiosk on a small rig where something around it is wrong: too much light, no disk, another time, work that hangs.
#include <atomic>
#include <cstdio>
#include <map>
#include <mutex>
#include <thread>

#include <gmock/gmock.h>

#include "tests/firmware-host/kiosk/kiosk_fixture.h"
#include "tests/firmware-host/kiosk/notify_socket.h"

namespace stratalux::rig {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;
using namespace std::chrono_literals;

class KioskService : public KioskTest {
 protected:
  // Exposure of the frames of each attempt, ms.
  [[nodiscard]] std::map<int, double> ExposureOfAttempts() const {
    std::map<int, double> exposures;
    const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
    for (const db::SessionSummary& session : Sessions())
      exposures[session.info.attempt] = store->ListFrames(session.info.id)->front().record.exposure_ms;
    return exposures;
  }
  // On the worker's thread, which hangs meanwhile: what systemd hears once the job is over its deadline and the grace,
  // while the loop turns thrice at least.
  static std::vector<std::string> HeardWhileItHangs(NotifySocket& systemd) {
    std::this_thread::sleep_for(500ms);
    static_cast<void>(systemd.Take());
    std::this_thread::sleep_for(1500ms);
    return systemd.Take();
  }
};

// The lamps give three times their light from behind the first pre-scan on (white and black of four projectors).
TEST_F(KioskService, ASaturatedCaptureIsTakenAgainAtHalfTheExposureWithoutAsking) {
  options_.station.simulated->faults.script = {*ParseFault("lamp_drift@9=3")};
  const KioskReport report = Run({Manner::kVisit});
  EXPECT_GE(report.captures, 2);
  EXPECT_EQ(report.tickets, 1);
  EXPECT_THAT(front_->visits[0].screens, Not(Contains(Phase::kGate)));
  const std::map<int, double> exposures = ExposureOfAttempts();
  ASSERT_EQ(exposures.size(), static_cast<size_t>(report.captures));
  for (const auto& [attempt, exposure_ms] : exposures)
    EXPECT_NEAR(exposure_ms, exposures.at(1) / (1 << (attempt - 1)), 1e-3) << "attempt " << attempt;
  CheckStore();
}

// Nothing is free in /sys.
TEST_F(KioskService, WithoutRoomItIsClosedWithNumbersBeforeAnybodySitsDown) {
  options_.station.config.store.folder = "/sys/no-store";
  std::vector<action::Show> shown;
  on_show_ = [&](const action::Show& screen) {
    shown.push_back(screen);
    if (shown.size() == 1) front_->Push(event::Start{});
    stop_.Request(StopReason::kOperator);
  };
  Open();
  front_ = std::make_unique<ScriptedFront>(*station_->rig().simulation, 1, [](int) { return Manner::kVisit; });
  front_->on_show = on_show_;
  std::FILE* file = std::tmpfile();
  Logger logger(LogLevel::kWarning, file);
  const auto report = RunKiosk(*station_, options_, *front_, stop_, logger);
  logger.Flush();
  std::string said(4096, ' ');
  std::rewind(file);
  said.resize(std::fread(said.data(), 1, said.size(), file));
  std::fclose(file);
  ASSERT_FALSE(shown.empty());
  for (const action::Show& screen : shown) EXPECT_EQ(screen.screen, Phase::kClosed);
  EXPECT_TRUE(shown.back().closures.Has(Closure::kSpace));
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->begun, 0);
  EXPECT_THAT(said, HasSubstr("/sys/no-store has 0.0 GB free, the attempts of a visit may take "));
}

TEST_F(KioskService, AClockThatWasSetIsSaidAndTheVisitGoesOn) {
  std::atomic<int64_t> ahead_ns = 0;
  options_.wall = [&] { return WallNs{WallNow().ns + ahead_ns}; };
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen == Phase::kConsent) ahead_ns = 3'600'000'000'000;
  };
  const KioskReport report = Run({Manner::kVisit});
  EXPECT_EQ(front_->told[Word::kClockJumped], 1) << "once, however long it stays ahead";
  EXPECT_EQ(report.tickets, 1);
}

TEST_F(KioskService, SignsOfLifeStopWhileItIsStuckAndComeBack) {
  NotifySocket systemd(folder_ / "notify", 100ms);
  options_.station.config.kiosk.forgetting_s = 1;
  std::atomic<bool> stuck = false;
  std::vector<std::string> meanwhile;
  on_show_ = [&](const action::Show& screen) { stuck = stuck || screen.word == Word::kStuck; };
  options_.after_forget_step = [&](db::ForgetStep step) {
    if (step != db::ForgetStep::kIntent) return;
    for (int look = 0; look < 500 && !stuck; ++look) std::this_thread::sleep_for(10ms);
    meanwhile = HeardWhileItHangs(systemd);
  };
  Run({Manner::kWithdraws, Manner::kSensitive});
  EXPECT_TRUE(stuck);
  EXPECT_THAT(meanwhile, Not(Contains("WATCHDOG=1")));
  EXPECT_THAT(systemd.Take(), Contains("WATCHDOG=1"));
}

// The door takes the machine's own deadline with it.
TEST_F(KioskService, SignsOfLifeStopForWorkThatHangsBehindAnOpenDoor) {
  NotifySocket systemd(folder_ / "notify", 100ms);
  options_.station.config.kiosk.forgetting_s = 5;
  Open();
  std::vector<std::string> meanwhile;
  options_.after_forget_step = [&](db::ForgetStep step) {
    if (step != db::ForgetStep::kIntent) return;
    station_->rig().simulation->Happen(RigSignal::kDoor, SignalLevel::kActive);
    meanwhile = HeardWhileItHangs(systemd);
  };
  Run({Manner::kWithdraws, Manner::kSensitive});
  EXPECT_GT(front_->told[Word::kDoor], 1) << "a reset that is refused is told";
  EXPECT_THAT(meanwhile, Not(Contains("WATCHDOG=1")));
  EXPECT_THAT(systemd.Take(), Contains("WATCHDOG=1"));
}

// Visitors come and are timed out, one after the other: theirs wait behind it for ever.
TEST_F(KioskService, SignsOfLifeStopForAPreScanThatHangs) {
  NotifySocket systemd(folder_ / "notify", 100ms);
  options_.station.config.kiosk.position_s = 5;
  std::vector<std::string> meanwhile;
  std::atomic<bool> over = false;
  on_preview_ = [&] {
    if (!over) meanwhile = HeardWhileItHangs(systemd);
    over = true;
  };
  const KioskReport report = Run(60, [&](int) { return over ? Manner::kSensitive : Manner::kVisit; });
  EXPECT_GT(report.ended[static_cast<size_t>(Word::kTimeOut)], 1);
  EXPECT_TRUE(over);
  EXPECT_THAT(meanwhile, Not(Contains("WATCHDOG=1")));
}

}  // namespace
}  // namespace stratalux::rig
