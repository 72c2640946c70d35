// SPDX-License-Identifier: Apache-2.0
// Who withdraws waits until all is gone and no longer: the search for what might be left holds up nobody, outlives the
// program's end, and tells. What a killed kiosk has of visitors without a ticket goes at its next start.
#include <atomic>
#include <chrono>
#include <csignal>
#include <fstream>
#include <functional>
#include <thread>

#include <sys/wait.h>
#include <unistd.h>

#include "db/ledger/ledger.h"
#include "db/privacy/open_visits.h"
#include "tests/firmware-host/kiosk/kiosk_fixture.h"

namespace stratalux::rig {
namespace {

using ::testing::IsEmpty;
using ::testing::SizeIs;

// So that a test that fails does not hang.
bool WaitFor(const std::atomic<bool>& flag) {
  for (int look = 0; look < 12000 && !flag; ++look) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  return flag;
}

class KioskForgetting : public KioskTest {
 protected:
  [[nodiscard]] std::map<std::string, std::string> Certificates() const {
    const auto ledger = db::Ledger::Read(folder_ / "store");
    EXPECT_TRUE(ledger.ok()) << ledger.status().message();
    return ledger.ok() ? ledger->forgotten() : std::map<std::string, std::string>();
  }
  // A kiosk in a process of its own, killed for good by whoever calls the function that `arm` is given.
  void RunAndKill(const std::vector<Manner>& manners, const std::function<void()>& arm) {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      arm();
      Run(manners);
      _exit(3);  // it came to its end
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) << status;
  }
  void KillOnShow(const std::vector<Manner>& manners, const std::function<bool(const action::Show&)>& at) {
    RunAndKill(manners, [this, &at] {
      on_show_ = [&at](const action::Show& screen) {
        if (at(screen)) kill(getpid(), SIGKILL);
      };
    });
  }
  // The worker has heard of the ticket, which no visitor waits for.
  [[nodiscard]] bool Kept() const {
    for (int look = 0; look < 1000; ++look) {
      if (db::OpenVisits(folder_ / "store")->empty()) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return false;
  }
  // A kiosk without visitors, until its search has certified what was begun.
  void RunUntilCertified() {
    std::atomic<bool> done = false;
    options_.after_forget_step = [&done](db::ForgetStep step) {
      if (step == db::ForgetStep::kDone) done = true;
    };
    on_show_ = [&done](const action::Show& screen) {
      if (screen.screen != Phase::kIdle) return;
      EXPECT_TRUE(WaitFor(done));
    };
    Run(std::vector<Manner>{});
    options_.after_forget_step = nullptr;
    on_show_ = nullptr;
  }
  // Of all that was forgotten.
  void ExpectProven(size_t sessions) const {
    const auto certificates = Certificates();
    EXPECT_THAT(certificates, SizeIs(sessions));
    for (const auto& [session, certificate] : certificates) EXPECT_NE(certificate, "") << session;
    EXPECT_THAT(*db::UnfinishedForgets(folder_ / "store"), IsEmpty());
    EXPECT_THAT(*db::OpenVisits(folder_ / "store"), IsEmpty());
  }
};

TEST_F(KioskForgetting, AVisitGoesOnWhileTheSearchIsHeld) {
  std::atomic<bool> held = false, released = false;
  options_.after_forget_step = [&](db::ForgetStep step) {
    if (step != db::ForgetStep::kScanned || held) return;
    held = true;
    EXPECT_TRUE(WaitFor(released)) << "the visit waits for the search";
  };
  on_show_ = [&](const action::Show& screen) {
    if (screen.screen != Phase::kThanks) return;
    EXPECT_TRUE(WaitFor(held));
    EXPECT_THAT(Sessions(), SizeIs(1)) << "the next one's; of the first no row is left";
    const auto forgotten = Certificates();
    ASSERT_THAT(forgotten, SizeIs(1)) << "entered";
    EXPECT_EQ(forgotten.begin()->second, "") << "not proven yet";
    EXPECT_FALSE(std::filesystem::exists(folder_ / "store" / "sessions" / forgotten.begin()->first));
    EXPECT_FALSE(std::filesystem::exists(folder_ / "store" / "forgetting"));
    released = true;
  };
  const KioskReport report = Run({Manner::kLeavesCapture, Manner::kVisit});
  EXPECT_EQ(report.tickets, 1);
  EXPECT_EQ(report.discarded, 1);
  EXPECT_EQ(front_->told[Word::kLeftover], 0);
  CheckStore();
}

TEST_F(KioskForgetting, KilledBetweenTheHalvesItIsSearchedAndCertifiedAtTheNextStart) {
  RunAndKill({Manner::kLeavesCapture}, [this] {
    options_.after_forget_step = [](db::ForgetStep step) {
      if (step == db::ForgetStep::kRemoved) kill(getpid(), SIGKILL);
    };
  });
  EXPECT_THAT(Sessions(), IsEmpty());
  ASSERT_THAT(*db::UnfinishedForgets(folder_ / "store"), SizeIs(1));
  EXPECT_EQ(Certificates().begin()->second, "");
  RunUntilCertified();
  ExpectProven(1);
}

TEST_F(KioskForgetting, ASearchThatTheEndBrokeOffIsMadeAtTheNextStart) {
  const std::filesystem::path large = folder_ / "store" / "sessions" / "large.bin";
  options_.after_forget_step = [&](db::ForgetStep step) {
    if (step != db::ForgetStep::kRows) return;
    std::ofstream(large) << "sparse";
    std::filesystem::resize_file(large, int64_t{1} << 40);  // read for many minutes
  };
  Run({Manner::kLeavesCapture});
  EXPECT_THAT(*db::UnfinishedForgets(folder_ / "store"), SizeIs(1));
  std::filesystem::remove(large);
  station_.reset();
  RunUntilCertified();
  ExpectProven(1);
}

TEST_F(KioskForgetting, ASearchThatFindsSomethingTellsAndClosesNothing) {
  const std::filesystem::path note = folder_ / "store" / "notes.txt";
  options_.after_forget_step = [&](db::ForgetStep step) {
    if (step == db::ForgetStep::kRemoved)
      std::ofstream(note) << "nice face in " << db::UnfinishedForgets(folder_ / "store")->at(0) << "\n";
  };
  options_.after_step = [&](const VisitState& state, const VisitEvent& event) {
    if (!std::holds_alternative<event::Leftover>(event)) return;
    EXPECT_TRUE(state.closed_for.empty());
    front_->Push(event::Shutdown{});
  };
  on_show_ = [](const action::Show& screen) {
    if (screen.screen == Phase::kIdle) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  };
  // Visitors come and go until it tells.
  const KioskReport report =
      Run(3000, [](int visit) { return visit == 0 ? Manner::kLeavesCapture : Manner::kSensitive; });
  EXPECT_EQ(front_->told[Word::kLeftover], 1);
  EXPECT_FALSE(report.owed);
  EXPECT_THAT(Certificates().begin()->second, ::testing::HasSubstr("notes.txt, offset 13: session id"));
  std::filesystem::remove(note);
  options_.after_step = nullptr;
  station_.reset();
  RunUntilCertified();
  ExpectProven(1);
}

TEST_F(KioskForgetting, WhatAKillInTheMidstOfACaptureLeftGoesAtTheNextStart) {
  KillOnShow({Manner::kVisit, Manner::kVisit}, [tickets = 0](const action::Show& screen) mutable {
    if (screen.screen == Phase::kThanks) tickets = 1;
    return tickets == 1 && screen.screen == Phase::kCapture && 2 * screen.number > screen.of && screen.of > 0;
  });
  EXPECT_THAT(Sessions(), SizeIs(2));
  ASSERT_THAT(*db::OpenVisits(folder_ / "store"), SizeIs(1));
  const std::string visitor = db::OpenVisits(folder_ / "store")->front().visitor;
  RunUntilCertified();
  const auto left = Sessions();
  ASSERT_THAT(left, SizeIs(1)) << "the first visitor has a ticket";
  EXPECT_NE(left[0].info.visitor, visitor);
  EXPECT_THAT(*db::ListConsents(folder_ / "store", visitor), IsEmpty());
  ExpectProven(1);
}

TEST_F(KioskForgetting, AWholeSessionWithoutATicketGoesToo) {
  Simulate(options_.station, "sphere");
  options_.station.simulated->faults.script = {*ParseFault("subject_moved@200=3")};
  KillOnShow({Manner::kVisit}, [](const action::Show& screen) { return screen.screen == Phase::kGate; });
  ASSERT_THAT(Sessions(), SizeIs(1));
  EXPECT_EQ(Sessions()[0].info.status, SessionStatus::kDegraded) << "finished before the kill";
  RunUntilCertified();
  EXPECT_THAT(Sessions(), IsEmpty());
  ExpectProven(1);
}

TEST_F(KioskForgetting, WhoseTicketCouldNotBeHandedOutIsNotKept) {
  has_paper_ = false;
  EXPECT_EQ(Run({Manner::kVisit}).tickets, 0);
  has_paper_ = true;
  EXPECT_THAT(*db::OpenVisits(folder_ / "store"), SizeIs(1)) << "nobody has the code";
  RunUntilCertified();
  EXPECT_THAT(Sessions(), IsEmpty());
  ExpectProven(1);
}

TEST_F(KioskForgetting, WhoHoldsTheTicketIsKeptThroughAKill) {
  KillOnShow({Manner::kVisit, Manner::kVisit}, [this, tickets = 0](const action::Show& screen) mutable {
    if (screen.screen == Phase::kThanks) tickets = 1;
    return tickets == 1 && screen.screen == Phase::kConsent && Kept();
  });
  ASSERT_THAT(Sessions(), SizeIs(1));
  Run(std::vector<Manner>{});
  EXPECT_THAT(Sessions(), SizeIs(1));
  EXPECT_THAT(*db::OpenVisits(folder_ / "store"), IsEmpty());
}

}  // namespace
}  // namespace stratalux::rig
