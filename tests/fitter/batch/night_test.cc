// SPDX-License-Identifier: Apache-2.0
// The night's queue before workers of every kind: each visitor is fitted once, whoever dies on the way.
#include "fitter/batch/night.h"

#include <csignal>
#include <fstream>
#include <set>
#include <thread>

#include <gmock/gmock.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/job_store.h"
#include "db/catalogue/session_index.h"
#include "db/ledger/ledger_line.h"
#include "db/privacy/forget.h"
#include "fitter/batch/night_status.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using std::chrono::milliseconds;
using namespace std::chrono_literals;
using ::testing::HasSubstr;

class NightTest : public db::StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    work_ = folder_.string() + ".work";
    std::filesystem::create_directories(work_);
    options_.choice.run.store = folder_;
    options_.program = work_ / "worker";
    options_.memory_bytes = int64_t{1} << 30;
    options_.back_off = 0s;
    options_.lease = milliseconds(2000);
  }
  void TearDown() override {
    std::filesystem::remove_all(work_);
    StoreTest::TearDown();
  }
  // What each worker does, a shell script: $S is its session, $N its attempt; each is noted as begun and, at its end,
  // as ended.
  void Workers(const std::string& script) const {
    WriteText(options_.program, "#!/bin/sh\nS=$2; W=" + work_.string() +
                                    "\necho x >> $W/$S.begun; N=$(wc -l < $W/$S.begun)\n" + script +
                                    "\necho x >> $W/$S.ended\n");
    ASSERT_EQ(chmod(options_.program.c_str(), 0755), 0);
  }
  [[nodiscard]] int Lines(const std::string& session, const char* what) const {
    const std::string text = ReadText(work_ / (session + what));
    return static_cast<int>(std::count(text.begin(), text.end(), '\n'));
  }
  void Visitors(int many) {
    for (int i = 0; i < many; ++i) {
      const std::string session = StoreSession(1);
      sessions_.push_back(session);
      choice_.visits.push_back({session, "fit" + std::to_string(i), 1000});
    }
  }
  // A visitor of whom something is left when the consent is withdrawn.
  std::string Consenting(const std::string& visitor) {
    Consent consent;
    consent.fit = true;
    consent.text_version = "1";
    consent.language = "en";
    EXPECT_EQ(db::GiveConsent(folder_, visitor, consent).message(), "");
    db::SessionStore store = OpenStore();
    SessionInfo info;
    info.rig = "bench";
    info.visitor = visitor;
    auto writer = store.BeginSession(info);
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    EXPECT_TRUE(db::AppendTo(*writer, 0).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    choice_.visits.push_back({writer->info().id, "fit", 1000});
    return writer->info().id;
  }
  NightOutcome Run(int stop = -1, const std::function<void(const NightEvent&)>& heard = {}) {
    Logger quiet(LogLevel::kError);
    const auto outcome = RunNight(options_, choice_, stop, heard, quiet);
    EXPECT_TRUE(outcome.ok()) << outcome.status().message();
    if (!outcome.ok()) return {};
    night_ = StatusOf(ReadNight(outcome->folder)->events);
    return *outcome;
  }
  void TwoNights() {
    std::vector<pid_t> nights;
    for (int i = 0; i < 2; ++i) {
      nights.push_back(fork());
      if (nights.back() == 0) {
        Run();
        _exit(::testing::Test::HasFailure() ? 1 : 0);
      }
    }
    for (const pid_t night : nights) {
      int status = -1;
      waitpid(night, &status, 0);
      EXPECT_EQ(status, 0);
    }
  }
  [[nodiscard]] db::Job JobOf(const std::string& session) const {
    auto jobs = db::JobStore::Open(folder_);
    const auto all = jobs->List();
    for (const db::Job& job : *all)
      if (job.request.session == session) return job;
    ADD_FAILURE() << "no job of " << session;
    db::Job none;
    none.state = db::JobState::kCancelled;
    return none;
  }
  [[nodiscard]] db::JobState StateOf(const std::string& session) const { return JobOf(session).state; }
  [[nodiscard]] const NightVisit& VisitOf(const std::string& session) const {
    for (const NightVisit& visit : night_.visits)
      if (visit.session == session) return visit;
    throw std::runtime_error("no visit of " + session);
  }

  std::filesystem::path work_;
  NightOptions options_;
  NightChoice choice_;
  NightStatus night_;
  std::vector<std::string> sessions_;
};

TEST_F(NightTest, EverybodyIsFittedOnceInTheOrderOfTheChoice) {
  Visitors(5);
  Workers("");
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.fitted, 5);
  EXPECT_EQ(outcome.waiting, 0);
  std::vector<std::string> order;
  for (const NightVisit& visit : night_.visits) order.push_back(visit.session);
  EXPECT_EQ(order, sessions_);
  for (const std::string& session : sessions_) EXPECT_EQ(Lines(session, ".ended"), 1);
  EXPECT_TRUE(night_.ended);
  // Once more, the fits gone: they are made again. Still there, nobody would have been chosen.
  EXPECT_EQ(Run().fitted, 5);
}

TEST_F(NightTest, WhoeverCrashesIsTriedAgainAndTheOthersGoOn) {
  Visitors(4);
  Workers("[ $S != " + sessions_[1] + " ] || [ $N -gt 1 ] || kill -SEGV $$");
  EXPECT_EQ(Run().fitted, 4);
  EXPECT_EQ(VisitOf(sessions_[1]).attempts, 2);
  EXPECT_EQ(VisitOf(sessions_[0]).attempts, 1);
}

TEST_F(NightTest, WhoeverFailsEachTimeIsSetAsideWithTheReason) {
  Visitors(3);
  Workers("[ $S != " + sessions_[0] + " ] || { echo \"error: nothing at attempt $N\"; exit 1; }");
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.fitted, 2);
  EXPECT_EQ(outcome.failed, 1);
  EXPECT_EQ(Lines(sessions_[0], ".begun"), 3);
  EXPECT_EQ(StateOf(sessions_[0]), db::JobState::kSetAside);
  EXPECT_EQ(VisitOf(sessions_[0]).reason, "nothing at attempt 3");
  // The next night leaves it alone, and says how to go on.
  Run();
  EXPECT_EQ(Lines(sessions_[0], ".begun"), 3);
  ASSERT_EQ(night_.left_out.size(), 1U);
  EXPECT_THAT(night_.left_out[0].reason, HasSubstr("nothing at attempt 3; `stratalux-fit batch retry"));
}

TEST_F(NightTest, WhatIsNoAccidentIsNotTriedAgain) {
  Visitors(2);
  Workers("[ $S = " + sessions_[0] + " ] && exit 6; echo 'error: the same words'; exit 1");
  EXPECT_EQ(Run().failed, 2);
  EXPECT_EQ(Lines(sessions_[0], ".begun"), 1) << "integrity";
  EXPECT_EQ(Lines(sessions_[1], ".begun"), 2) << "in the same words twice";
  EXPECT_EQ(StateOf(sessions_[1]), db::JobState::kFailed);
}

TEST_F(NightTest, WhoeverHangsIsEnded) {
  Visitors(2);
  options_.visit_limit = 1s;
  options_.attempts = 1;
  Workers("[ $S != " + sessions_[0] + " ] || exec sleep 1000");
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.fitted, 1);
  EXPECT_EQ(outcome.failed, 1);
  EXPECT_THAT(VisitOf(sessions_[0]).reason, HasSubstr("not finished after"));
}

TEST_F(NightTest, WhoeverEatsMemoryIsEnded) {
  Visitors(2);
  options_.memory_bytes = int64_t{64} << 20;
  options_.attempts = 1;
  // 400 MB of one line.
  WriteText(options_.program, "#!/usr/bin/env bash\n[ $2 != " + sessions_[0] +
                                  " ] || { LINE=$(head -c 400000000 /dev/zero | tr '\\0' x); sleep 1000; }\n");
  ASSERT_EQ(chmod(options_.program.c_str(), 0755), 0);
  EXPECT_EQ(Run().failed, 1);
  EXPECT_THAT(VisitOf(sessions_[0]).reason, HasSubstr("of memory; all workers together may use 0.06 GiB (--memory)"));
  EXPECT_EQ(VisitOf(sessions_[1]).kind, NightEventKind::kDone);
}

TEST_F(NightTest, WithoutHistoryTheFirstIsAloneThenAsManyAsTheMemoryHolds) {
  Visitors(6);
  options_.workers = 3;
  Workers("ls $W/*.begun | wc -l > $W/$S.seen; sleep 0.2");
  int running = 0, most = 0, before_first = 0;
  bool first = true;
  Run(-1, [&](const NightEvent& event) {
    if (event.kind == NightEventKind::kStarted) ++running;
    if (event.kind == NightEventKind::kStarted && first) ++before_first;
    if (event.kind == NightEventKind::kDone) --running, first = false;
    most = std::max(most, running);
  });
  EXPECT_EQ(before_first, 1);
  EXPECT_EQ(most, 3);
}

TEST_F(NightTest, NobodyIsBegunBehindTheDeadline) {
  Visitors(2);
  Workers("");
  options_.deadline = std::chrono::steady_clock::now() - 1s;
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.fitted, 0);
  EXPECT_EQ(outcome.waiting, 2);
  EXPECT_TRUE(outcome.out_of_time);
  options_.deadline = std::nullopt;
  EXPECT_EQ(Run().fitted, 2) << "the next night goes on";
}

TEST_F(NightTest, WithdrawnBeforeAndOnTheWayIsNotFitted) {
  const std::string early = Consenting("v-5f3a91c2"), late = Consenting("v-6e21b0d4"), other = Consenting("v-7c11d2f6");
  ASSERT_TRUE(db::WithdrawConsent(folder_, "v-5f3a91c2").ok());
  Workers("[ $S != " + late + " ] || exec sleep 1000");
  const NightOutcome outcome = Run(-1, [&](const NightEvent& event) {
    if (event.kind == NightEventKind::kStarted && event.session == late) {
      EXPECT_TRUE(db::WithdrawConsent(folder_, "v-6e21b0d4").ok());
    }
  });
  EXPECT_EQ(outcome.dropped, 2);
  EXPECT_EQ(Lines(early, ".begun"), 0);
  EXPECT_EQ(Lines(late, ".ended"), 0);
  EXPECT_THAT(VisitOf(late).reason, HasSubstr("withdrawn"));
  EXPECT_EQ(StateOf(late), db::JobState::kCancelled);
  EXPECT_EQ(StateOf(other), db::JobState::kDone);
}

TEST_F(NightTest, WhoHasWithdrawnAndWhoseWorkerDoesNotHearIsEndedAllTheSame) {
  const std::string deaf = Consenting("v-5f3a91c2");
  Workers("trap '' TERM\nwhile [ -e " + work_.string() + " ]; do sleep 0.1; done");
  const NightOutcome outcome = Run(-1, [&](const NightEvent& event) {
    if (event.kind == NightEventKind::kStarted) {
      EXPECT_TRUE(db::WithdrawConsent(folder_, "v-5f3a91c2").ok());
    }
  });
  EXPECT_EQ(outcome.dropped, 1);
  EXPECT_EQ(Lines(deaf, ".begun"), 1);
  EXPECT_EQ(Lines(deaf, ".ended"), 0);
  EXPECT_THAT(VisitOf(deaf).reason, HasSubstr("withdrawn"));
}

TEST_F(NightTest, ForgottenOnTheWayIsNotFittedAndTheNightGoesOn) {
  Visitors(3);
  Workers("[ $S != " + sessions_[0] + " ] || exec sleep 1000");
  const NightOutcome outcome = Run(-1, [&](const NightEvent& event) {
    if (event.kind != NightEventKind::kStarted || event.session != sessions_[0]) return;
    Logger quiet(LogLevel::kError);
    db::ForgetRequest request;
    request.sessions = {sessions_[0]};
    EXPECT_TRUE(db::Forget(folder_, request, quiet).ok());
  });
  EXPECT_EQ(outcome.dropped, 1);
  EXPECT_EQ(outcome.fitted, 2);
  for (const auto& entry : std::filesystem::recursive_directory_iterator(outcome.folder)) {
    EXPECT_FALSE(entry.path().filename().string().starts_with(sessions_[0]));
    EXPECT_EQ(ReadText(entry.path()).find(sessions_[0]), std::string::npos) << entry.path();
  }
}

// As a shard asks the ledger of the sealed sessions: its own store does not hear of a withdrawal there.
TEST_F(NightTest, WhoMayNotByAnotherWordIsNotFittedNorGoneOnWith) {
  Visitors(3);
  Workers("[ $S != " + sessions_[1] + " ] || exec sleep 1000");
  bool withdrawn = false;
  options_.also_asked = [&](const std::string& session) {
    const bool no = session == sessions_[0] || (withdrawn && session == sessions_[1]);
    return no ? Status::Usage("withdrawn elsewhere") : Status::Ok();
  };
  const NightOutcome outcome = Run(-1, [&](const NightEvent& event) {
    withdrawn = withdrawn || (event.kind == NightEventKind::kStarted && event.session == sessions_[1]);
  });
  EXPECT_EQ(outcome.dropped, 2);
  EXPECT_EQ(outcome.fitted, 1);
  EXPECT_EQ(Lines(sessions_[0], ".begun"), 0);
  EXPECT_EQ(Lines(sessions_[1], ".ended"), 0);
  EXPECT_EQ(VisitOf(sessions_[1]).reason, "withdrawn elsewhere");
}

// A question that cannot be answered for the moment is no "no": nobody is cancelled for it.
TEST_F(NightTest, WhatCannotBeAskedDropsNobody) {
  Visitors(2);
  options_.lease = milliseconds(400);
  Workers("[ $S != " + sessions_[1] + " ] || sleep 1");
  int asked = 0;
  options_.also_asked = [&](const std::string& session) -> Status {
    if (session == sessions_[0]) return asked++ < 2 ? Status::Failed("a ledger of a later version") : Status::Ok();
    return Lines(session, ".begun") > 0 ? Status(StatusCode::kNewerSchema, "a line of a later version") : Status::Ok();
  };
  const NightOutcome outcome = Run();
  EXPECT_GT(asked, 2);
  EXPECT_EQ(outcome.dropped, 0);
  EXPECT_EQ(outcome.fitted, 2);
  for (const std::string& session : sessions_) EXPECT_EQ(StateOf(session), db::JobState::kDone) << session;
}

// Neither does a line of the night's log end the night for it: one is written between "begun" and "done".
TEST_F(NightTest, ALedgerThatCannotBeReadForAWhileEndsNoNight) {
  Visitors(2);
  options_.lease = milliseconds(400);
  options_.workers = 2;
  options_.foreseen = {{{1.0, 1000}, 1000}};
  Workers("[ $S = " + sessions_[0] + " ] || sleep 1.5");
  const std::filesystem::path later = folder_ / "ledger" / "0123456789abcdef0123456789abcdef.jsonl";
  const std::string said = R"({"schema":99,"kind":"sealing")";
  bool unreadable_at_the_end = false;
  const NightOutcome outcome = Run(-1, [&](const NightEvent& event) {
    if (event.kind == NightEventKind::kStarted && event.session == sessions_[1]) {
      std::filesystem::create_directories(later.parent_path());
      WriteText(later, said + ",\"hash\":\"" + db::LedgerHash(said + "}") + "\"}\n");
    }
    if (event.kind != NightEventKind::kDone || event.session != sessions_[0]) return;
    unreadable_at_the_end = !db::IsForgotten(folder_, event.session).ok();
    std::thread([later] {
      std::this_thread::sleep_for(milliseconds(700));
      std::filesystem::remove(later);
    }).detach();
  });
  EXPECT_TRUE(unreadable_at_the_end) << "the test shows nothing";
  EXPECT_EQ(outcome.fitted, 2);
  EXPECT_EQ(outcome.dropped, 0);
  for (const std::string& session : sessions_) EXPECT_EQ(StateOf(session), db::JobState::kDone) << session;
  EXPECT_TRUE(night_.ended);
}

// A full disk, a folder that is gone: the night ends, and whoever runs is given back.
TEST_F(NightTest, WhatCannotBeWrittenEndsTheNightAndCostsNobodyAnAttempt) {
  Visitors(4);
  options_.workers = 3;
  options_.foreseen = {{{1.0, 1000}, 1000}};
  // The first one's worker puts a file where the night's folder is.
  Workers("[ $S = " + sessions_[0] +
          " ] || exec sleep 1000\n"
          "while [ $(ls $W/*.begun | wc -l) -lt 3 ]; do sleep 0.05; done\n"
          "NIGHT=$(echo $4/nights/*); mv $NIGHT $W/night && touch $NIGHT");
  Logger quiet(LogLevel::kError);
  const auto outcome = RunNight(options_, choice_, -1, {}, quiet);
  EXPECT_EQ(outcome.status().code(), StatusCode::kFailed) << outcome.status().message();
  EXPECT_EQ(StateOf(sessions_[0]), db::JobState::kDone);
  for (const size_t i : {1, 2, 3}) {
    const db::Job job = JobOf(sessions_[i]);
    EXPECT_EQ(job.state, db::JobState::kQueued) << i;
    EXPECT_EQ(job.attempts, 0) << i;
    EXPECT_EQ(Lines(sessions_[i], ".ended"), 0) << i;
  }
}

// As far as it can be told: one visitor's file cannot be written.
TEST_F(NightTest, ANightThatCannotGoOnSaysSo) {
  Visitors(2);
  options_.workers = 2;
  options_.foreseen = {{{1.0, 1000}, 1000}};
  Workers("[ $S = " + sessions_[0] +
          " ] || exec sleep 1000\n"
          "while [ $(ls $W/*.begun | wc -l) -lt 2 ]; do sleep 0.05; done\n"
          "FILE=$(echo $4/nights/*/$S.jsonl); rm $FILE && mkdir $FILE");
  Logger quiet(LogLevel::kError);
  const auto outcome = RunNight(options_, choice_, -1, {}, quiet);
  EXPECT_EQ(outcome.status().code(), StatusCode::kFailed) << outcome.status().message();
  const std::filesystem::path night = folder_ / "nights" / Nights(folder_).front();
  std::filesystem::remove(night / (sessions_[0] + ".jsonl"));
  night_ = StatusOf(ReadNight(night)->events);
  EXPECT_TRUE(night_.ended);
  EXPECT_TRUE(night_.ended_by_error);
  EXPECT_THAT(night_.end_reason, HasSubstr(sessions_[0] + ".jsonl"));
  EXPECT_EQ(VisitOf(sessions_[1]).kind, NightEventKind::kReleased);
  EXPECT_EQ(JobOf(sessions_[1]).attempts, 0);
}

// Before anybody is begun, too.
TEST_F(NightTest, ANightThatCannotBeginSaysSo) {
  Visitors(1);
  Workers("");
  choice_.left_out = {{"../no-session", LeftOut::kConsent, "withdrawn"}};
  Logger quiet(LogLevel::kError);
  const auto outcome = RunNight(options_, choice_, -1, {}, quiet);
  EXPECT_EQ(outcome.status().code(), StatusCode::kUsage) << outcome.status().message();
  night_ = StatusOf(ReadNight(folder_ / "nights" / Nights(folder_).front())->events);
  EXPECT_TRUE(night_.ended);
  EXPECT_TRUE(night_.ended_by_error);
  EXPECT_EQ(night_.end_reason, outcome.status().message());
  EXPECT_EQ(Lines(sessions_[0], ".begun"), 0);
  EXPECT_EQ(JobOf(sessions_[0]).attempts, 0);
}

// Whose fit is entered, and whose job another night left: its end is no business of tonight's visitors.
TEST_F(NightTest, AJobThatCannotBeClosedEndsNoNight) {
  Visitors(1);
  Workers("");
  const std::string earlier = StoreSession(1);
  auto jobs = db::JobStore::Open(folder_);
  ASSERT_TRUE(jobs.ok());
  ASSERT_TRUE(jobs->Enqueue({JobKey({earlier, "other", 1000}), "fit", earlier,
                             R"({"arguments": [], "fit": "other", "sites": 1000})"})
                  .ok());
  const auto heard = [&](const NightEvent& event) {
    if (event.kind != NightEventKind::kBegan) return;
    auto index = db::SessionIndex::Open(folder_, db::AccessMode::kReadWrite);
    ASSERT_TRUE(index.ok());
    ASSERT_TRUE(index->connection().Execute("ALTER TABLE fits RENAME COLUMN id TO no_id").ok());
  };
  EXPECT_EQ(Run(-1, heard).fitted, 1);
  EXPECT_EQ(StateOf(earlier), db::JobState::kQueued);
}

TEST_F(NightTest, WhoseWorkerCannotBeBegunHasFailedAndIsTold) {
  Visitors(1);
  options_.program = "/nonexistent";
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.failed, 1);
  EXPECT_EQ(StateOf(sessions_[0]), db::JobState::kSetAside);
  EXPECT_EQ(VisitOf(sessions_[0]).kind, NightEventKind::kSetAside);
  EXPECT_THAT(VisitOf(sessions_[0]).reason, HasSubstr("cannot run /nonexistent"));
}

// A night that was killed, whose lease runs out while this one waits for it.
TEST_F(NightTest, WhoFellSilentInTheLastAttemptHasFailedAndIsTold) {
  Visitors(2);
  options_.attempts = 1;
  auto other = db::JobStore::Open(folder_);
  ASSERT_TRUE(other.ok());
  db::JobRequest request{JobKey(choice_.visits[0]), "fit", sessions_[0],
                         R"({"arguments": [], "fit": "fit0", "sites": 1000})"};
  request.max_attempts = 1;
  ASSERT_TRUE(other->Enqueue(request).ok());
  ASSERT_TRUE((*other->Lease({"a night that was killed", {"fit"}, milliseconds(400)})).has_value());
  Workers("");
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.fitted, 1);
  EXPECT_EQ(outcome.failed, 1);
  EXPECT_EQ(VisitOf(sessions_[0]).kind, NightEventKind::kSetAside);
  EXPECT_THAT(VisitOf(sessions_[0]).reason, HasSubstr("fell silent in attempt 1"));
}

TEST_F(NightTest, WhatCannotBeAskedInAnyAttemptFails) {
  Visitors(1);
  Workers("");
  options_.also_asked = [](const std::string&) { return Status::Failed("no ledger"); };
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.dropped, 0);
  EXPECT_EQ(outcome.failed, 1);
  EXPECT_EQ(StateOf(sessions_[0]), db::JobState::kSetAside);
  EXPECT_EQ(VisitOf(sessions_[0]).reason, "no ledger");
}

// "Not found" of a worker that has its session: a degraded capture may lack a frame that a stage needs.
TEST_F(NightTest, WhoLacksAFrameFailsAndDidNotWithdraw) {
  Visitors(1);
  Workers("echo 'error: session has no good frame of projector 2' >&2; exit 4");
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.dropped, 0);
  EXPECT_EQ(outcome.failed, 1);
  EXPECT_EQ(Lines(sessions_[0], ".begun"), 1) << "it will lack it another time, too";
  EXPECT_EQ(StateOf(sessions_[0]), db::JobState::kFailed);
  EXPECT_THAT(VisitOf(sessions_[0]).reason, HasSubstr("no good frame"));
}

// The same visitor asked for with other options: queued before, or done and asked for anew.
TEST_F(NightTest, WorkersFitByTheOptionsOfThisNight) {
  Visitors(2);
  Workers("echo \"$*\" > $W/$S.arguments");
  const auto arguments = [&](size_t i) { return ReadText(work_ / (sessions_[i] + ".arguments")); };
  options_.arguments = {"--offset", "off"};
  const NightChoice both = choice_;
  choice_.visits.resize(1);
  EXPECT_EQ(Run().fitted, 1);
  auto jobs = db::JobStore::Open(folder_);
  ASSERT_TRUE(jobs.ok());
  ASSERT_TRUE(jobs->Enqueue({JobKey(both.visits[1]), "fit", sessions_[1],
                             R"({"arguments": ["--offset", "off"], "fit": "fit1", "sites": 1000})"})
                  .ok());
  choice_ = both;
  options_.arguments = {"--full-evaluation"};
  EXPECT_EQ(Run().fitted, 2);
  for (const size_t i : {0, 1}) {
    EXPECT_THAT(arguments(i), HasSubstr("--full-evaluation")) << i;
    EXPECT_EQ(arguments(i).find("--offset"), std::string::npos) << i;
  }
}

// What an earlier night left waiting is not tonight's, unless it is chosen again.
TEST_F(NightTest, OnlyWhoIsChosenTonightIsFitted) {
  Visitors(3);
  Workers("");
  options_.deadline = std::chrono::steady_clock::now() - 1s;
  EXPECT_EQ(Run().waiting, 3);
  options_.deadline = std::nullopt;
  const NightChoice all = choice_;
  choice_.visits = {all.visits[2]};
  const NightOutcome outcome = Run();
  EXPECT_EQ(outcome.fitted, 1);
  EXPECT_EQ(outcome.waiting, 0);
  EXPECT_EQ(Lines(sessions_[2], ".begun"), 1);
  for (const size_t i : {0, 1}) EXPECT_EQ(Lines(sessions_[i], ".begun"), 0) << i;
  choice_.visits = {};
  EXPECT_EQ(Run().fitted, 0) << "nobody is not anybody";
  choice_.visits = {all.visits[0], all.visits[1]};
  EXPECT_EQ(Run().fitted, 2);
}

// Queued by a night of other options: a fit of another name.
TEST_F(NightTest, AVisitorIsFittedByTonightsOptionsAlone) {
  Visitors(1);
  Workers("");
  auto jobs = db::JobStore::Open(folder_);
  ASSERT_TRUE(jobs.ok());
  ASSERT_TRUE(jobs->Enqueue({JobKey({sessions_[0], "other", 1000}), "fit", sessions_[0],
                             R"({"arguments": ["--layers=3"], "fit": "other", "sites": 1000})"})
                  .ok());
  EXPECT_EQ(Run().fitted, 1);
  EXPECT_EQ(Lines(sessions_[0], ".begun"), 1);
  EXPECT_EQ(VisitOf(sessions_[0]).fit, "fit0");
}

// Its night was killed between the entry of the fit and the end of the job.
TEST_F(NightTest, AJobWhoseFitIsThereIsDone) {
  Visitors(1);
  auto jobs = db::JobStore::Open(folder_);
  ASSERT_TRUE(jobs.ok());
  ASSERT_TRUE(jobs->Enqueue({JobKey(choice_.visits[0]), "fit", sessions_[0],
                             R"({"arguments": [], "fit": "fit0", "sites": 1000})"})
                  .ok());
  auto store = OpenStore();
  std::filesystem::create_directories(store.FitFolder(sessions_[0], "fit0"));
  ASSERT_TRUE(store.RegisterFit({"fit0", sessions_[0], "{}", "{}", WallNow()}).ok());
  choice_.left_out = {{sessions_[0], LeftOut::kComplete, "fitted"}};
  choice_.visits = {};
  EXPECT_EQ(Run().fitted, 0);
  EXPECT_EQ(StateOf(sessions_[0]), db::JobState::kDone);
}

// Held up for longer than a lease, as by a machine that was asleep.
TEST_F(NightTest, AVisitorThatAnotherNightHasTakenOverIsLeftToIt) {
  Visitors(1);
  Workers("exec sleep 1000");
  options_.lease = milliseconds(400);
  auto other = db::JobStore::Open(folder_);
  ASSERT_TRUE(other.ok());
  std::optional<db::Job> theirs;
  const NightOutcome outcome = Run(-1, [&](const NightEvent& event) {
    if (event.kind == NightEventKind::kStarted) {
      std::this_thread::sleep_for(2 * options_.lease);
      theirs = *other->Lease({"another night", {"fit"}, 600s});
    }
    if (event.kind == NightEventKind::kReleased) {
      EXPECT_TRUE(other->Complete(theirs->token).ok());
    }
  });
  ASSERT_TRUE(theirs.has_value());
  EXPECT_EQ(outcome.dropped, 0);
  EXPECT_EQ(VisitOf(sessions_[0]).kind, NightEventKind::kReleased);
  EXPECT_EQ(StateOf(sessions_[0]), db::JobState::kDone);
}

TEST_F(NightTest, AStopGivesBackWhoRunsAndCountsNoAttempt) {
  Visitors(2);
  Workers("[ -e $W/go ] || exec sleep 1000");
  const int stop = eventfd(0, EFD_CLOEXEC);
  const NightOutcome outcome = Run(stop, [&](const NightEvent& event) {
    const uint64_t one = 1;
    if (event.kind == NightEventKind::kStarted) {
      EXPECT_EQ(write(stop, &one, sizeof one), static_cast<ssize_t>(sizeof one));
    }
  });
  close(stop);
  EXPECT_TRUE(outcome.stopped);
  EXPECT_FALSE(night_.ended_by_error);
  EXPECT_EQ(VisitOf(sessions_[0]).kind, NightEventKind::kReleased);
  WriteText(work_ / "go", "");
  options_.attempts = 1;
  EXPECT_EQ(Run().fitted, 2);
}

// Also of nights that are long over, with what was made of them.
TEST_F(NightTest, ForgettingTakesWhatNightsSaidAlong) {
  Visitors(2);
  Workers("echo 'error: of '$S; exit 1");
  const NightOutcome outcome = Run();
  WriteText(outcome.folder / "report.html", "<p>" + sessions_[0] + " and " + sessions_[1] + "</p>");
  Logger quiet(LogLevel::kError);
  db::ForgetRequest request;
  request.sessions = {sessions_[0]};
  const auto report = db::Forget(folder_, request, quiet);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_THAT(report->leftovers, ::testing::IsEmpty());
  EXPECT_FALSE(std::filesystem::exists(outcome.folder / "report.html"));
  EXPECT_TRUE(std::filesystem::exists(outcome.folder / (sessions_[1] + ".jsonl")));
  const NightStatus left = StatusOf(ReadNight(outcome.folder)->events);
  ASSERT_EQ(left.visits.size(), 1U);
  EXPECT_EQ(left.visits[0].session, sessions_[1]);
}

// A night that is killed, again and again, at any moment, and nights beside each other.
TEST_F(NightTest, WhoeverIsKilledEverybodyIsFittedInTheEnd) {
  Visitors(12);
  Workers("sleep 0.05");
  options_.workers = 2;
  options_.attempts = 100;
  options_.lease = milliseconds(300);
  for (int kill_after_ms : {50, 90, 140, 200, 260, 330}) {
    const pid_t night = fork();
    if (night == 0) {
      Run();
      _exit(0);
    }
    std::this_thread::sleep_for(milliseconds(kill_after_ms));
    kill(night, SIGKILL);
    waitpid(night, nullptr, 0);
  }
  TwoNights();
  for (const std::string& session : sessions_) {
    EXPECT_EQ(StateOf(session), db::JobState::kDone);
    EXPECT_GE(Lines(session, ".ended"), 1);
  }
}

// Whatever was fitted and is gone is made again by whoever comes first.
TEST_F(NightTest, TwoNightsThatBeginAtOnceMakeAgainWhatIsGone) {
  Visitors(8);
  Workers("");
  EXPECT_EQ(Run().fitted, 8);
  for (int round = 0; round < 5; ++round) TwoNights();
  for (const std::string& session : sessions_) {
    EXPECT_EQ(StateOf(session), db::JobState::kDone);
    EXPECT_GE(Lines(session, ".ended"), 2);
  }
}

}  // namespace
}  // namespace stratalux::fit
