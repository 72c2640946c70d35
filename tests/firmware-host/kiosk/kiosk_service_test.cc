// SPDX-License-Identifier: Apache-2.0
// The kiosk on a small rig where something around it is wrong: too much light, no disk, another time, work that hangs.
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <map>
#include <mutex>
#include <thread>
#include <utility>

#include <gmock/gmock.h>

#include "firmware-host/kiosk/rig_worker.h"
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
  // What was logged to `file_`.
  std::string Said() {
    std::string said(4096, ' ');
    std::rewind(file_.get());
    said.resize(std::fread(said.data(), 1, said.size(), file_.get()));
    return said;
  }

  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_{std::tmpfile(), std::fclose};
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
  Logger logger(LogLevel::kWarning, file_.get());
  const auto report = RunKiosk(*station_, options_, *front_, stop_, logger);
  logger.Flush();
  ASSERT_FALSE(shown.empty());
  for (const action::Show& screen : shown) EXPECT_EQ(screen.screen, Phase::kClosed);
  EXPECT_TRUE(shown.back().closures.Has(Closure::kSpace));
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->begun, 0);
  EXPECT_THAT(Said(), HasSubstr("/sys/no-store has 0.0 GB free, the attempts of a visit may take "));
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

// In a self-check the guard takes the light, too: the token it stopped has no way out but a reset.
TEST_F(KioskService, LightThatIsTakenInASelfcheckLeadsToSafe) {
  bool asked = false;
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen == Phase::kIdle && !std::exchange(asked, true))
      front_->Push(event::Operator{OperatorCommand::kSelfcheck});
    if (screen.screen == Phase::kSelfcheck) stop_.Request(StopReason::kLeaseExpired);
  };
  const KioskReport report = Run({Manner::kVisit, Manner::kVisit});
  EXPECT_EQ(front_->told[Word::kLight], 1);
  EXPECT_THAT(front_->visits[0].screens, Contains(Phase::kSafe));
  EXPECT_EQ(report.tickets, 1) << "who comes after the reset finds it good";
}

TEST_F(KioskService, LightThatWasTakenFromWhoLeavesIsNotTheNextVisitors) {
  bool taken = false;
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen == Phase::kCapture && screen.of > 0 && 2 * screen.number >= screen.of &&
        !std::exchange(taken, true))
      stop_.Request(StopReason::kLeaseExpired);
  };
  const KioskReport report = Run({Manner::kLeavesCapture, Manner::kVisit});
  EXPECT_THAT(front_->visits[0].screens, Contains(Phase::kSafe));
  EXPECT_THAT(front_->visits[1].screens, Not(Contains(Phase::kSafe)));
  EXPECT_EQ(report.tickets, 1);
  CheckStore();
}

// A switch that answers no more, once it sticks.
class StickingSwitch final : public LightSwitch {
 public:
  explicit StickingSwitch(LightSwitch& light) : light_(light) {}
  int Set(bool on) noexcept override { return sticks ? EIO : light_.Set(on); }
  int Read(bool& on) noexcept override { return sticks ? EIO : light_.Read(on); }
  [[nodiscard]] const char* name() const noexcept override { return "a switch that sticks"; }
  std::atomic<bool> sticks = false;

 private:
  LightSwitch& light_;
};

TEST_F(KioskService, ALightThatMayShineOnNobodyIsTold) {
  Open();
  SimulatedRig& rig = *station_->rig().simulation;
  StickingSwitch light(*rig.switches()[0]);
  std::vector<std::vector<LightSwitch*>> projectors;
  for (LightSwitch* one : rig.switches()) projectors.push_back({projectors.empty() ? &light : one});
  auto guard = LightGuard::Start(projectors, nullptr, stop_, {.clock = &rig.clock()});
  ASSERT_TRUE(guard.ok()) << guard.status().message();
  const_cast<OpenedRig&>(station_->rig()).light = std::move(*guard);
  std::atomic<bool> looks = false, left = false;
  Logger logger(LogLevel::kError, file_.get());
  {
    RigWorker worker(*station_,
                     {options_.station,
                      {},
                      1ms,
                      [&](const Shot&) {
                        looks = true;
                        for (int wait = 0; wait < 5000 && !left; ++wait) std::this_thread::sleep_for(1ms);
                      }},
                     stop_, logger);
    worker.Begin(action::Preview{});
    for (int wait = 0; wait < 5000 && !looks; ++wait) std::this_thread::sleep_for(1ms);
    worker.LightOff();
    light.sticks = true;
    left = true;
    std::vector<VisitEvent> heard;
    for (int wait = 0; wait < 5000 && heard.empty(); ++wait) {
      std::this_thread::sleep_for(1ms);
      heard = worker.Take();
    }
    EXPECT_THAT(heard, ::testing::ElementsAre(VisitEvent(event::Failed{true})));
    light.sticks = false;
  }
  logger.Flush();
  EXPECT_THAT(Said(), HasSubstr("projector 0 may still be lit: a switch that sticks"));
  station_.reset();
}

}  // namespace
}  // namespace stratalux::rig
