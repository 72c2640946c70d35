// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/kiosk.h"

#include <atomic>
#include <cstdlib>
#include <fstream>
#include <set>
#include <stdexcept>
#include <thread>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "db/catalogue/consent.h"
#include "db/ledger/ledger.h"
#include "db/privacy/open_visits.h"
#include "db/privacy/ticket.h"
#include "firmware-host/kiosk/findings_gate.h"
#include "firmware-host/kiosk/rig_worker.h"
#include "firmware-host/kiosk/selfcheck_keeper.h"
#include "firmware-host/session/state_file.h"
#include "tests/firmware-host/kiosk/kiosk_fixture.h"

namespace stratalux::rig {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

TEST_F(KioskTest, AWholeVisitIsKeptUnderItsTicket) {
  const KioskReport report = Run({Manner::kVisit});
  EXPECT_EQ(report.tickets, 1);
  ASSERT_EQ(front_->visits.size(), 1U);
  const auto sessions = Sessions();
  ASSERT_EQ(sessions.size(), 1U);
  const SessionInfo& info = sessions[0].info;
  EXPECT_EQ(info.status, SessionStatus::kComplete) << (info.reasons.empty() ? "" : info.reasons[0]);
  EXPECT_EQ(info.visitor, *db::VisitorOfTicket(front_->visits[0].ticket));
  EXPECT_EQ(info.attempt, 1);
  const auto consents = db::ListConsents(folder_ / "store", info.visitor);
  ASSERT_TRUE(consents.ok() && consents->size() == 1);
  EXPECT_EQ(consents->front().consent.language, "de");
  EXPECT_TRUE(consents->front().consent.research);
  EXPECT_FALSE(consents->front().consent.publication);
  const auto ledger = db::Ledger::Read(folder_ / "store");
  ASSERT_TRUE(ledger.ok());
  EXPECT_EQ(ledger->entries().size(), 1U) << "the consent, with the first frame";
  CheckStore();
}

TEST_F(KioskTest, WhoRefusesOrLeavesBeforeTheCaptureLeavesACountAlone) {
  const KioskReport report = Run({Manner::kSensitive, Manner::kRefuses, Manner::kLeavesQuestion, Manner::kLeavesConsent,
                                  Manner::kLeavesPosition, Manner::kLeavesCountdown});
  EXPECT_EQ(report.begun, 6);
  EXPECT_EQ(report.captures, 0);
  EXPECT_EQ(report.ended[static_cast<size_t>(Word::kSensitive)], 1);
  EXPECT_EQ(report.ended[static_cast<size_t>(Word::kRefused)], 1);
  EXPECT_EQ(report.ended[static_cast<size_t>(Word::kLeft)], 4);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store")) << "pre-scans are never stored";
}

TEST_F(KioskTest, WhoLeavesTheCaptureOrTakesTheTicketBackIsForgotten) {
  const KioskReport report = Run({Manner::kLeavesCapture, Manner::kRefusesCapture, Manner::kWithdraws, Manner::kVisit});
  EXPECT_EQ(report.discarded, 3);
  EXPECT_EQ(report.tickets, 2);
  EXPECT_FALSE(report.owed);
  EXPECT_EQ(Sessions().size(), 1U);
  const auto ledger = db::Ledger::Read(folder_ / "store");
  ASSERT_TRUE(ledger.ok());
  EXPECT_EQ(ledger->forgotten().size(), 3U);
  CheckStore();
}

TEST_F(KioskTest, DoorAndPlugEndAVisitAndTheNextIsServed) {
  const KioskReport report = Run({Manner::kOpensDoor, Manner::kUnplugs, Manner::kVisit});
  EXPECT_EQ(report.tickets, 1);
  EXPECT_THAT(front_->visits[0].screens, Contains(Phase::kSafe));
  EXPECT_THAT(front_->visits[1].screens, Contains(Phase::kClosed));
  EXPECT_THAT(front_->visits[1].screens, Not(Contains(Phase::kSafe)));
  CheckStore();
}

// Whoever mends the camera's cable opens the door first: that it went is told by a count, not by what stopped the rig.
TEST_F(KioskTest, ACameraPluggedAgainBehindAnOpenDoorIsOpenedAnew) {
  Open();
  SimulatedRig& rig = *station_->rig().simulation;
  bool mended = false;
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen != Phase::kSafe || std::exchange(mended, true)) return;
    rig.Happen(RigSignal::kCamera, SignalLevel::kActive);
    rig.Happen(RigSignal::kCamera, SignalLevel::kRest);
  };
  const KioskReport report = Run({Manner::kOpensDoor, Manner::kVisit});
  EXPECT_TRUE(mended);
  EXPECT_EQ(report.tickets, 1);
  CheckStore();
}

TEST_F(KioskTest, AStoreHasOneKiosk) {
  Open();
  const auto held = db::LockVisits(options_.station.config.store.folder);
  ASSERT_TRUE(held.ok());
  ScriptedFront front(*station_->rig().simulation, 1, [](int) { return Manner::kVisit; });
  const auto report = RunKiosk(*station_, options_, front, stop_, logger_);
  EXPECT_EQ(report.status().code(), StatusCode::kBusy);
  EXPECT_THAT(report.status().message(), HasSubstr("another kiosk"));
}

// Nothing opens lines again but a start: the operator's reset ends the program with an error, and its service starts
// it.
TEST_F(KioskTest, AResetAfterTheLinesWentEndsForANewStart) {
  Open();
  SimulatedRig& rig = *station_->rig().simulation;
  rig.Happen(RigSignal::kLines, SignalLevel::kActive);
  ScriptedFront front(rig, 1, [](int) { return Manner::kVisit; });
  const auto report = RunKiosk(*station_, options_, front, stop_, logger_);
  EXPECT_EQ(report.status().code(), StatusCode::kFailed);
  EXPECT_THAT(report.status().message(), HasSubstr("lines"));
  EXPECT_TRUE(Dark());
}

TEST_F(KioskTest, ACameraOfOneExposureIsNotAskedForAShorterOne) {
  options_.station.simulated.reset();
  options_.station.config.camera.exposure_control = ExposureControl::kExposure;
  ASSERT_TRUE(RulesOf(options_.station).ok());
  CaptureFacts facts;
  facts.saturated_permille = 1000;
  const VisitSoFar before{.attempt = 1, .exposure_us = 16000};
  EXPECT_EQ(JudgeCapture(facts, before, *RulesOf(options_.station)).verdict, Verdict::kRetakeShorter);
  options_.station.config.camera.exposure_control = ExposureControl::kNone;
  EXPECT_EQ(JudgeCapture(facts, before, *RulesOf(options_.station)).verdict, Verdict::kAccept);
}

// Looks and pre-scans come first, how many the clock says: by some fifty exposures sooner or later it is a movement as
// well.
TEST_F(KioskTest, WhoMovedIsOfferedARetakeAndBothAttemptsAreKept) {
  Simulate(options_.station, "sphere");
  options_.station.simulated->faults.script = {*ParseFault("subject_moved@200=3")};
  const KioskReport report = Run({Manner::kVisit});
  EXPECT_EQ(report.captures, 2);
  EXPECT_EQ(report.tickets, 1);
  EXPECT_THAT(front_->visits[0].screens, Contains(Phase::kGate));
  std::map<int, SessionInfo> attempts;
  for (const db::SessionSummary& session : Sessions()) attempts[session.info.attempt] = session.info;
  ASSERT_EQ(attempts.size(), 2U);
  EXPECT_EQ(attempts[1].status, SessionStatus::kDegraded);
  EXPECT_THAT(attempts[1].reasons, Contains(HasSubstr("moved")));
  EXPECT_EQ(attempts[2].status, SessionStatus::kComplete);
  EXPECT_EQ(attempts[1].visit, attempts[2].visit);
  CheckStore();
}

TEST_F(KioskTest, ASelfcheckPassesOnAGoodRigAndVisitorsFollow) {
  bool asked = false;
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen == Phase::kIdle && !std::exchange(asked, true))
      front_->Push(event::Operator{OperatorCommand::kSelfcheck});
  };
  // The first comes while the check runs, and START is nobody's then.
  const KioskReport report = Run({Manner::kVisit, Manner::kVisit});
  EXPECT_THAT(front_->visits[0].screens, Contains(Phase::kSelfcheck));
  EXPECT_EQ(front_->told[Word::kSelfcheckFailed], 0);
  EXPECT_EQ(report.tickets, 1);
}

// First as it is; then behind ten days on which its light was a half more.
TEST_F(KioskTest, WhatASelfcheckMeasuredIsKeptAndADriftIsTold) {
  options_.state = folder_ / "state";
  std::filesystem::create_directory(options_.state);
  const auto file = SelfchecksFile(options_.state, true);
  const auto check = [this] {
    bool asked = false;
    on_show_ = [&](const action::Show& screen) {
      if (screen.screen == Phase::kIdle && !std::exchange(asked, true))
        front_->Push(event::Operator{OperatorCommand::kSelfcheck});
    };
    Run({Manner::kVisit, Manner::kSensitive});
  };
  check();
  EXPECT_EQ(front_->told[Word::kDrift], 0);
  auto kept = ReadSelfchecks(file);
  ASSERT_TRUE(kept.ok()) << kept.status().message();
  ASSERT_EQ(kept->checks().size(), 1U);
  const Selfcheck measured = kept->checks()[0];
  EXPECT_TRUE(measured.passed);
  ASSERT_EQ(measured.Of(CheckFigure::kLevel).size(), 4U);
  EXPECT_GT(measured.Of(CheckFigure::kLevel)[3].value(), 5.0);
  EXPECT_GT(measured.Of(CheckFigure::kDark)[0].value(), 0.0);
  EXPECT_GT(measured.Of(CheckFigure::kSync)[0].value(), 0.0);
  EXPECT_GT(measured.Of(CheckFigure::kFrameRate).at(0).value(), 0.0);
  SelfcheckBook before;
  for (int day = 10; day > 0; --day) {
    Selfcheck earlier = measured;
    earlier.at.ns -= day * 24LL * 3600 * 1'000'000'000;
    *earlier.Of(CheckFigure::kLevel)[3] *= 1.5;
    before.Add(earlier);
  }
  ASSERT_TRUE(KeepState(file, before.ToJson()).ok());
  check();
  EXPECT_EQ(front_->told[Word::kDrift], 1);
  kept = ReadSelfchecks(file);
  ASSERT_EQ(kept->checks().size(), 11U);
  const SelfcheckTrend trend = TrendOf(*kept);
  ASSERT_FALSE(trend.drifts.empty());
  EXPECT_EQ(trend.drifts[0].projector, 3);
}

// The guard's 5 ms, and what a loaded machine adds.
TEST_F(KioskTest, IsDarkWithin50MillisecondsOfALeave) {
  Open();
  std::atomic<int64_t> left_ns = 0, lit_ns = 0;
  std::atomic<bool> over = false;
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen == Phase::kForgetting) left_ns = MonotonicNow().ns;
  };
  std::thread looks([&] {
    while (!over) {
      if (!Dark()) lit_ns = MonotonicNow().ns;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  Run({Manner::kLeavesCapture});
  over = true;
  looks.join();
  EXPECT_GT(left_ns, 0);
  EXPECT_GT(lit_ns, 0) << "there was light";
  EXPECT_LT(lit_ns - left_ns, 50'000'000) << "ms after: " << 1e-6 * static_cast<double>(lit_ns - left_ns);
}

TEST_F(KioskTest, AStopInTheMidstOfACaptureForgetsItAndEnds) {
  Open();
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen == Phase::kCapture && 2 * screen.number > screen.of && screen.of > 0)
      stop_.Request(StopReason::kOperator);
  };
  const KioskReport report = Run({Manner::kVisit});
  EXPECT_EQ(report.discarded, 1);
  EXPECT_THAT(Sessions(), IsEmpty());
  CheckStore();
}

TEST_F(KioskTest, AnIllLitFaceIsNotCaptured) {
  options_.station.config.kiosk.snr = 9.9;
  options_.station.config.kiosk.position_s = 5;
  options_.second = std::chrono::milliseconds(300);
  std::set<Word> words;
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen == Phase::kPosition) words.insert(screen.word);
  };
  const KioskReport report = Run({Manner::kVisit});
  EXPECT_EQ(report.captures, 0);
  EXPECT_EQ(report.ended[static_cast<size_t>(Word::kTimeOut)], 1);
  EXPECT_THAT(words, Contains(Word::kBrighter));
}

// systemd's end of $NOTIFY_SOCKET: few messages wait there, so it is read all along.
class Listener {
 public:
  explicit Listener(const std::string& path) : socket_(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path.copy(address.sun_path, sizeof address.sun_path - 1);
    EXPECT_EQ(bind(socket_, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    thread_ = std::thread([this] {
      char buffer[512];
      for (ssize_t n = 0; (n = recv(socket_, buffer, sizeof buffer, 0)) > 0;)
        ++heard_[std::string(buffer, static_cast<size_t>(n))];
    });
  }
  // What was heard; the end is a message of its own, the last.
  std::map<std::string, int> End(const std::string& path) {
    const int sender = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path.copy(address.sun_path, sizeof address.sun_path - 1);
    sendto(sender, "", 0, 0, reinterpret_cast<sockaddr*>(&address), sizeof address);
    thread_.join();
    close(sender);
    close(socket_);
    return heard_;
  }

 private:
  int socket_;
  std::map<std::string, int> heard_;
  std::thread thread_;
};

TEST_F(KioskTest, TellsSystemdThatItIsReadyAndAlive) {
  const std::string path = folder_ / "notify";
  Listener systemd(path);
  setenv("NOTIFY_SOCKET", path.c_str(), 1);
  setenv("WATCHDOG_USEC", "200000", 1);
  Run({Manner::kRefuses, Manner::kVisit});
  unsetenv("NOTIFY_SOCKET");
  unsetenv("WATCHDOG_USEC");
  std::map<std::string, int> heard = systemd.End(path);
  EXPECT_EQ(heard["READY=1"], 1);
  EXPECT_GE(heard["WATCHDOG=1"], 1);
  EXPECT_EQ(heard["STOPPING=1"], 1);
  EXPECT_GE(heard["STATUS=thanks, 1 visits kept"], 1);
}

// A visitor who leaves in the moment in which the countdown ends, behind a pre-scan that still runs.
TEST_F(KioskTest, ACaptureThatWasNotBegunIsAnsweredToo) {
  Open();
  RigWorker worker(*station_, {options_.station, {}, std::chrono::milliseconds(1), {}}, stop_, logger_);
  worker.Begin(action::Preview{});
  const auto heard = [&](auto is) {
    for (int look = 0; look < 5000; ++look) {
      for (const VisitEvent& event : worker.Take())
        if (is(event)) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return false;
  };
  EXPECT_TRUE(heard([](const VisitEvent& event) { return std::holds_alternative<event::Face>(event); }));
  worker.Begin(action::StartCapture{1, 1, 16000, {true, false, false, 0, 0}});
  worker.LightOff();
  EXPECT_TRUE(heard([](const VisitEvent& event) { return event == VisitEvent(event::Failed{}); }));
  worker.Begin(action::Discard{1, Word::kLeft});
  EXPECT_TRUE(heard([](const VisitEvent& event) { return event == VisitEvent(event::Discarded{}); }));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store"));
  EXPECT_TRUE(Dark());
}

// A page may send what it likes.
TEST_F(KioskTest, AnAgreementToATextThatThereIsNotIsNone) {
  bool asked = false;
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen != Phase::kConsent || std::exchange(asked, true)) return;
    front_->Push(event::Agree{{true, false, false, 200, 0}});
    front_->Push(event::Agree{{true, false, false, 0, 200}});
  };
  EXPECT_EQ(Run({Manner::kVisit}).tickets, 1);
  const auto consents = db::ListConsents(folder_ / "store", "");
  ASSERT_TRUE(consents.ok() && consents->size() == 1);
  EXPECT_EQ(consents->front().consent.language, "de");
}

TEST_F(KioskTest, RefusesAPlanThatIsNoVisitors) {
  Open();
  options_.station.config.plan.kind = SessionKind::kDark;
  EXPECT_THAT(options_.Validate().message(), HasSubstr("plan.kind is dark"));
  options_ = SmallKiosk(folder_);
  options_.station.config.store.folder.clear();
  EXPECT_EQ(options_.Validate().code(), StatusCode::kUsage);
  options_ = SmallKiosk(folder_);
  options_.station.config.kiosk.paper_scope = "research";
  EXPECT_THAT(options_.Validate().message(), HasSubstr("scope fit"));
}

// ---- Visits in a row ------------------------------------------------------------------------------------------------

int Visits() {
  const char* text = std::getenv("STRATALUX_VISITS");
  return text != nullptr ? std::atoi(text) : 20;
}
uint64_t Seed() {
  const char* text = std::getenv("STRATALUX_SEED");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 1;
}

// Resident pages of this process, kB.
int64_t ResidentKb() {
  std::ifstream file("/proc/self/statm");
  int64_t size = 0, resident = 0;
  file >> size >> resident;
  return resident * sysconf(_SC_PAGESIZE) / 1024;
}

class KioskVisits : public KioskTest {};

// Half of the visitors do as they are asked; the rig has faults of its own.
TEST_F(KioskVisits, InARowAreKeptOrLeaveNothing) {
  options_.station.simulated->faults.rate = 0.0005;
  options_.station.simulated->faults.seed = Seed();
  Random random(Seed());
  int64_t early_kb = 0;
  const int visits = Visits();
  const KioskReport report = Run(visits, [&](int visit) {
    if (visit == visits / 5) early_kb = ResidentKb();
    return random.Uniform() < 0.5 ? Manner::kVisit : static_cast<Manner>(random.Uniform() * kManners);
  });
  const int64_t late_kb = ResidentKb();
  EXPECT_EQ(front_->visits.size(), static_cast<size_t>(visits));
  EXPECT_EQ(report.begun, visits);
  EXPECT_FALSE(report.owed);
  EXPECT_GE(report.tickets, visits / 3);
  CheckStore();
  std::printf(
      "%d visits, %lld captures, %lld tickets, %lld discarded, %zu sessions; resident %lld kB early, %lld late\n",
      visits, static_cast<long long>(report.captures), static_cast<long long>(report.tickets),
      static_cast<long long>(report.discarded), Sessions().size(), static_cast<long long>(early_kb),
      static_cast<long long>(late_kb));
  // A few visits tell nothing of a leak.
  if (visits >= 200) {
    EXPECT_LT(late_kb, early_kb + early_kb / 20);
  }
}

}  // namespace
}  // namespace stratalux::rig
