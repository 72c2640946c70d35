// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/kiosk.h"

#include <atomic>
#include <cstdlib>
#include <set>
#include <stdexcept>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "db/catalogue/consent.h"
#include "db/ledger/ledger.h"
#include "db/privacy/ticket.h"
#include "tests/firmware-host/kiosk/scripted_front.h"
#include "tests/firmware-host/kiosk/small_kiosk.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class KioskTest : public ScratchFolderTest {
 protected:
  KioskTest() : options_(SmallKiosk(folder_)) {}
  void Open() {
    auto station = CaptureStation::Open(options_.station, stop_, logger_);
    if (!station.ok()) throw std::runtime_error(station.status().message());  // no test goes on without
    station_ = std::move(*station);
  }
  KioskReport Run(int visits, const std::function<Manner(int)>& next) {
    if (!station_) Open();
    front_ = std::make_unique<ScriptedFront>(*station_->rig().simulation, visits, next);
    front_->on_show = on_show_;
    auto report = RunKiosk(*station_, options_, *front_, stop_, logger_);
    EXPECT_TRUE(report.ok()) << report.status().message();
    EXPECT_TRUE(Dark());
    return report.ok() ? *report : KioskReport();
  }
  KioskReport Run(const std::vector<Manner>& manners) {
    return Run(static_cast<int>(manners.size()), [&](int visit) { return manners[static_cast<size_t>(visit)]; });
  }
  [[nodiscard]] bool Dark() const {
    const auto switches = station_->rig().simulation->switches();
    return std::none_of(switches.begin(), switches.end(), [](LightSwitch* light) {
      bool on = true;
      return light->Read(on) != 0 || on;
    });
  }
  [[nodiscard]] std::vector<db::SessionSummary> Sessions() const {
    const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
    EXPECT_TRUE(store.ok()) << store.status().message();
    return store.ok() ? *store->ListSessions() : std::vector<db::SessionSummary>();
  }
  // What is left is of visitors who have their ticket, and good for something; nothing else is of anybody.
  void CheckStore() const {
    std::set<std::string> kept, consenting, found, usable;
    for (const ScriptedVisit& visit : front_->visits)
      if (!visit.ticket.empty() && !visit.gave_back) kept.insert(*db::VisitorOfTicket(visit.ticket));
    for (const db::SessionSummary& session : Sessions()) {
      EXPECT_NE(session.info.status, SessionStatus::kRecording) << session.info.id;
      EXPECT_TRUE(session.info.status == SessionStatus::kComplete || !session.info.reasons.empty()) << session.info.id;
      EXPECT_GE(session.info.attempt, 1);
      EXPECT_LE(session.info.attempt, 3);
      EXPECT_NE(session.info.visit, "");
      EXPECT_NE(session.key_id, "") << "a kiosk's frames are encrypted";
      found.insert(session.info.visitor);
      if (session.info.status != SessionStatus::kFailed) usable.insert(session.info.visitor);
    }
    const auto consents = db::ListConsents(folder_ / "store", "");
    ASSERT_TRUE(consents.ok());
    for (const db::ConsentRow& row : *consents) consenting.insert(row.visitor);
    EXPECT_EQ(found, kept);
    EXPECT_EQ(usable, kept);
    EXPECT_EQ(consenting, kept);
  }

  KioskOptions options_;
  StopToken stop_;
  Logger logger_{LogLevel::kError};
  std::unique_ptr<CaptureStation> station_;
  std::unique_ptr<ScriptedFront> front_;
  std::function<void(const action::Show&)> on_show_;
};

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
  for (const auto& [session, certificate] : ledger->forgotten()) EXPECT_NE(certificate, "") << "proven";
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
