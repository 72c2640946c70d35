// SPDX-License-Identifier: Apache-2.0
// Jobs are done once, by whoever holds the newest lease, whatever clocks, workers and machines do.
#include "db/catalogue/job_store.h"

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <random>
#include <set>
#include <thread>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/base/sqlite.h"
#include "db/care/reindex.h"
#include "db/privacy/forget.h"
#include "shared/base/formatted.h"
#include "shared/base/unique_fd.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using std::chrono::milliseconds;
using std::chrono::minutes;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pair;

class JobStoreTest : public StoreTest {
 protected:
  [[nodiscard]] JobStore Open() {
    JobClock clock{[this] { return boot_; }, [this] { return wall_; }, ""};
    clock.boot_id = boot_id_;
    auto jobs = JobStore::Open(folder_, {clock});
    EXPECT_TRUE(jobs.ok()) << jobs.status().message();
    return std::move(jobs).value();
  }
  static std::optional<Job> Lease(JobStore& jobs, const std::string& owner = "a", std::vector<std::string> kinds = {}) {
    auto job = jobs.Lease({owner, std::move(kinds), minutes(1)});
    EXPECT_TRUE(job.ok()) << job.status().message();
    return job.ok() ? *job : std::nullopt;
  }
  static std::string KeyOf(const std::optional<Job>& job) { return job ? job->request.key : "none"; }

  std::chrono::nanoseconds boot_{std::chrono::hours(5)};
  WallNs wall_{1'800'000'000'000'000'000};
  std::string boot_id_ = "boot-1";
};

TEST_F(JobStoreTest, TheSameKeyIsOneJob) {
  JobStore jobs = Open();
  const int64_t id = *jobs.Enqueue({"k", "fit"});
  EXPECT_EQ(*jobs.Enqueue({"k", "fit", "", "{}", 9}), id);
  EXPECT_EQ(jobs.Find(id)->request.priority, 0) << "asking again changes nothing";
  ASSERT_TRUE(jobs.Complete(Lease(jobs)->token).ok());
  EXPECT_EQ(*jobs.Enqueue({"k", "fit"}), id);
  EXPECT_EQ(jobs.Find(id)->state, JobState::kDone);
  EXPECT_EQ(KeyOf(Lease(jobs)), "none");
}

TEST_F(JobStoreTest, HighestPriorityFirstThenTheOldestThatIsDue) {
  JobStore jobs = Open();
  ASSERT_TRUE(jobs.Enqueue({"old", "fit"}).ok());
  ASSERT_TRUE(jobs.Enqueue({"young", "fit"}).ok());
  ASSERT_TRUE(jobs.Enqueue({"urgent", "fit", "", "{}", 5}).ok());
  ASSERT_TRUE(jobs.Enqueue({"night", "fit", "", "{}", 9, {wall_.ns + 1000}}).ok());
  ASSERT_TRUE(jobs.Enqueue({"board", "calibrate", "", "{}", 7}).ok());
  EXPECT_EQ(KeyOf(Lease(jobs, "a", {"fit"})), "urgent");
  EXPECT_EQ(KeyOf(Lease(jobs, "a", {"fit"})), "old");
  EXPECT_EQ(KeyOf(Lease(jobs, "a", {"nothing", "calibrate"})), "board");
  EXPECT_EQ(KeyOf(Lease(jobs)), "young");
  EXPECT_EQ(KeyOf(Lease(jobs)), "none");
  wall_.ns += 1000;
  EXPECT_EQ(KeyOf(Lease(jobs)), "night");
  EXPECT_THAT(*jobs.Count(), ElementsAre(Pair(JobState::kRunning, 5)));
}

TEST_F(JobStoreTest, OfNamedJobsNoOtherIsLeasedOrCounted) {
  JobStore jobs = Open();
  const int64_t first = *jobs.Enqueue({"first", "fit"}), second = *jobs.Enqueue({"second", "fit"});
  ASSERT_TRUE(jobs.Enqueue({"urgent", "fit", "", "{}", 5}).ok());
  const LeaseRequest named{"a", {"fit"}, minutes(1), {second, first, 99}};
  EXPECT_EQ(KeyOf(*jobs.Lease(named)), "first");
  EXPECT_THAT(*jobs.CountOf(named.jobs), ElementsAre(Pair(JobState::kQueued, 1), Pair(JobState::kRunning, 1)));
  EXPECT_EQ(KeyOf(*jobs.Lease(named)), "second");
  EXPECT_EQ(KeyOf(*jobs.Lease(named)), "none");
  EXPECT_EQ(KeyOf(Lease(jobs)), "urgent");
}

TEST_F(JobStoreTest, WhoFallsSilentIsReplacedAndRefused) {
  JobStore jobs = Open(), other = Open();
  ASSERT_TRUE(jobs.Enqueue({"k", "fit"}).ok());
  const auto first = Lease(jobs, "first");
  boot_ += std::chrono::seconds(59);
  EXPECT_EQ(KeyOf(Lease(other, "second")), "none");
  ASSERT_TRUE(jobs.Heartbeat(first->token, minutes(1)).ok());
  boot_ += std::chrono::seconds(59);
  EXPECT_EQ(KeyOf(Lease(other, "second")), "none") << "the heartbeat counts";
  boot_ += std::chrono::seconds(1);
  const auto second = Lease(other, "second");
  ASSERT_TRUE(second);
  EXPECT_GT(second->token, first->token);
  EXPECT_EQ(second->attempts, 2);
  EXPECT_THAT(second->last_error, HasSubstr("worker first fell silent"));
  for (const Status& status :
       {jobs.Heartbeat(first->token, minutes(1)), jobs.Complete(first->token), jobs.Release(first->token),
        jobs.Fail(first->token, "x", milliseconds(0)), jobs.Fail(first->token, "x", std::nullopt)}) {
    EXPECT_EQ(status.code(), StatusCode::kFailed);
    EXPECT_THAT(status.message(), HasSubstr("outdated"));
  }
  EXPECT_TRUE(other.Complete(second->token).ok());
  EXPECT_EQ(other.Complete(second->token).code(), StatusCode::kFailed) << "exactly once";
}

TEST_F(JobStoreTest, ALeaseThatRanOutUnseenIsStillGood) {
  JobStore jobs = Open();
  ASSERT_TRUE(jobs.Enqueue({"k", "fit"}).ok());
  const auto job = Lease(jobs);
  boot_ += std::chrono::hours(9);
  EXPECT_TRUE(jobs.Heartbeat(job->token, minutes(1)).ok());
  boot_ += std::chrono::hours(9);
  EXPECT_TRUE(jobs.Complete(job->token).ok()) << "nobody else has begun";
}

TEST_F(JobStoreTest, NoClockThatIsSetMovesALease) {
  JobStore jobs = Open();
  ASSERT_TRUE(jobs.Enqueue({"k", "fit"}).ok());
  const auto job = Lease(jobs);
  for (const int64_t year : {-40, 40}) {
    wall_.ns += year * 365 * 86400 * 1'000'000'000;
    EXPECT_EQ(KeyOf(Lease(jobs, "b")), "none");
  }
  ASSERT_TRUE(jobs.Fail(job->token, "disk full", minutes(10)).ok());
  wall_.ns += int64_t{365} * 86400 * 1'000'000'000;
  EXPECT_EQ(KeyOf(Lease(jobs)), "none") << "nor a back-off";
  boot_ += minutes(10);
  EXPECT_EQ(KeyOf(Lease(jobs)), "k");
}

TEST_F(JobStoreTest, ARestartEndsEveryLeaseAndBackOff) {
  JobStore before = Open();
  ASSERT_TRUE(before.Enqueue({"run", "fit"}).ok());
  const auto job = Lease(before);
  ASSERT_TRUE(before.Enqueue({"waits", "fit"}).ok());
  ASSERT_TRUE(before.Fail(Lease(before)->token, "x", minutes(600)).ok());
  boot_ = std::chrono::seconds(3);  // counts anew: smaller than every deadline
  boot_id_ = "boot-2";
  JobStore after = Open();
  EXPECT_EQ(KeyOf(Lease(after)), "run");
  EXPECT_EQ(KeyOf(Lease(after)), "waits");
  EXPECT_EQ(before.Complete(job->token).code(), StatusCode::kFailed);
}

TEST_F(JobStoreTest, AJobThatFailsAgainAndAgainIsSetAsideWithItsLastError) {
  JobStore jobs = Open();
  const int64_t id = *jobs.Enqueue({"k", "fit", "", "{}", 0, {}, 3});
  ASSERT_TRUE(jobs.Fail(Lease(jobs)->token, "first", milliseconds(0)).ok());
  ASSERT_TRUE(Lease(jobs));
  boot_ += minutes(2);  // the second attempt dies
  ASSERT_TRUE(jobs.Fail(Lease(jobs)->token, "third: no GPU", milliseconds(0)).ok());
  EXPECT_EQ(jobs.Find(id)->state, JobState::kSetAside);
  EXPECT_EQ(jobs.Find(id)->last_error, "third: no GPU");
  EXPECT_NE(jobs.Find(id)->finished.ns, 0);
  EXPECT_EQ(KeyOf(Lease(jobs)), "none");
  ASSERT_TRUE(jobs.Requeue(id).ok());
  EXPECT_EQ(Lease(jobs)->attempts, 1);
  // A job whose workers all die, too.
  for (int attempt = 0; attempt < 3; ++attempt) {
    boot_ += minutes(2);
    EXPECT_EQ(KeyOf(Lease(jobs)), attempt < 2 ? "k" : "none");
  }
  EXPECT_EQ(jobs.Find(id)->state, JobState::kSetAside);
  EXPECT_THAT(jobs.Find(id)->last_error, HasSubstr("fell silent in attempt 3"));
}

TEST_F(JobStoreTest, AReleasedAttemptDoesNotCount) {
  JobStore jobs = Open();
  const int64_t id = *jobs.Enqueue({"k", "fit", "", "{}", 0, {}, 1});
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(jobs.Release(Lease(jobs)->token).ok());
  EXPECT_EQ(jobs.Find(id)->state, JobState::kQueued);
  ASSERT_TRUE(jobs.Fail(Lease(jobs)->token, "no use", std::nullopt).ok());
  EXPECT_EQ(jobs.Find(id)->state, JobState::kFailed);
}

TEST_F(JobStoreTest, ACancelledJobTellsItsWorker) {
  JobStore jobs = Open();
  const int64_t queued = *jobs.Enqueue({"q", "fit"}), running = *jobs.Enqueue({"r", "fit", "", "{}", 1});
  const auto job = Lease(jobs);
  ASSERT_TRUE(jobs.Cancel(running).ok());
  ASSERT_TRUE(jobs.Cancel(queued).ok());
  EXPECT_THAT(jobs.Heartbeat(job->token, minutes(1)).message(), HasSubstr("is cancelled"));
  EXPECT_EQ(KeyOf(Lease(jobs)), "none");
  EXPECT_EQ(jobs.Cancel(queued).code(), StatusCode::kUsage);
  EXPECT_EQ(jobs.Cancel(99).code(), StatusCode::kNotFound);
  ASSERT_TRUE(jobs.Requeue(running).ok());
  EXPECT_EQ(jobs.Requeue(running).code(), StatusCode::kUsage);
  EXPECT_EQ(KeyOf(Lease(jobs)), "r");
  EXPECT_THAT(*jobs.List(JobState::kCancelled), ::testing::SizeIs(1));
}

TEST_F(JobStoreTest, RefusesWhatNoJobCanBe) {
  JobStore jobs = Open();
  EXPECT_EQ(jobs.Enqueue({"", "fit"}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(jobs.Enqueue({"k", ""}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(jobs.Enqueue({"k", "fit", "", "{"}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(jobs.Enqueue({"k", "fit", "", "{}", 0, {}, 0}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(jobs.Enqueue({"k", "fit", "s000009-00000000"}).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(jobs.Lease({"", {}, minutes(1)}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(jobs.Lease({"a", {}, milliseconds(0)}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(jobs.Lease({"a", {}, milliseconds::max()}).status().code(), StatusCode::kUsage);
  EXPECT_TRUE(jobs.List()->empty());
  auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(jobs.Enqueue({"k", "fit"}).ok());
  ASSERT_TRUE(connection->Execute("PRAGMA ignore_check_constraints = ON; UPDATE jobs SET state = 'dreaming'").ok());
  EXPECT_EQ(jobs.List().status().code(), StatusCode::kNewerSchema);
}

// Two nights that see at once that what a job had made is gone: in one step, or the second is refused.
TEST_F(JobStoreTest, WhatIsDoneBeginsAgainOnlyWhereItIsAskedFor) {
  JobStore jobs = Open(), other = Open();
  JobRequest again{"k", "fit"};
  again.anew = true;
  const int64_t id = *jobs.Enqueue(again);
  EXPECT_EQ(*other.Enqueue(again), id);
  ASSERT_TRUE(jobs.Complete(Lease(jobs)->token).ok());
  EXPECT_EQ(*jobs.Enqueue({"k", "fit"}), id);
  EXPECT_EQ(jobs.Find(id)->state, JobState::kDone);
  EXPECT_EQ(*jobs.Enqueue(again), id);
  EXPECT_EQ(*other.Enqueue(again), id) << "queued by then";
  EXPECT_EQ(jobs.Find(id)->attempts, 0);
  const auto lease = Lease(other);
  EXPECT_EQ(*jobs.Enqueue(again), id) << "running by then";
  EXPECT_TRUE(other.Fail(lease->token, "no", std::nullopt).ok());
  EXPECT_EQ(*jobs.Enqueue(again), id);
  EXPECT_EQ(jobs.Find(id)->state, JobState::kFailed) << "only what is done";
}

// Who asks last says how: of a job that waits, or begins anew; not of one that somebody works on.
TEST_F(JobStoreTest, ARequestMadeAnewIsTheOneThatCounts) {
  JobStore jobs = Open();
  const auto request = [](const std::string& options) {
    JobRequest asked{"k", "fit"};
    asked.options_json = options;
    asked.anew = true;
    return asked;
  };
  const int64_t id = *jobs.Enqueue(request("[1]"));
  JobRequest second = request("[2]");
  second.priority = 7;
  second.max_attempts = 5;
  ASSERT_EQ(*jobs.Enqueue(second), id);
  EXPECT_EQ(jobs.Find(id)->request.options_json, "[2]");
  EXPECT_EQ(jobs.Find(id)->request.priority, 7);
  EXPECT_EQ(jobs.Find(id)->request.max_attempts, 5);
  const auto lease = Lease(jobs);
  ASSERT_EQ(*jobs.Enqueue(request("[3]")), id);
  EXPECT_EQ(jobs.Find(id)->request.options_json, "[2]") << "under way";
  ASSERT_TRUE(jobs.Complete(lease->token).ok());
  ASSERT_EQ(*jobs.Enqueue(request("[4]")), id);
  EXPECT_EQ(jobs.Find(id)->state, JobState::kQueued);
  EXPECT_EQ(jobs.Find(id)->request.options_json, "[4]");
  // Of a night that was killed: nobody works on it any more.
  ASSERT_TRUE(Lease(jobs).has_value());
  boot_ += std::chrono::hours(1);
  ASSERT_EQ(*jobs.Enqueue(request("[5]")), id);
  EXPECT_EQ(jobs.Find(id)->state, JobState::kQueued);
  EXPECT_EQ(jobs.Find(id)->request.options_json, "[5]");
}

// By triggers, which nothing that happens to a job may miss.
TEST_F(JobStoreTest, TheCountsAreThoseOfTheRows) {
  const std::string session = StoreSession(1);
  const auto expect_right = [&] {
    JobStore jobs = Open();
    std::map<JobState, int64_t> counted;
    const auto all = jobs.List();
    for (const Job& job : *all) ++counted[job.state];
    EXPECT_EQ(*jobs.Count(), counted);
    EXPECT_EQ(*jobs.Count("fit"), counted);
    EXPECT_TRUE(jobs.Count("other")->empty());
  };
  {
    JobStore jobs = Open();
    for (int i = 0; i < 6; ++i) ASSERT_TRUE(jobs.Enqueue({"k" + std::to_string(i), "fit", i == 5 ? session : ""}).ok());
    ASSERT_TRUE(jobs.Enqueue({"k0", "fit"}).ok()) << "no second one";
    ASSERT_TRUE(jobs.Complete(Lease(jobs)->token).ok());
    ASSERT_TRUE(jobs.Fail(Lease(jobs)->token, "no", std::nullopt).ok());
    ASSERT_TRUE(jobs.Release(Lease(jobs)->token).ok());
    ASSERT_TRUE(jobs.Cancel(Lease(jobs)->id).ok());
    (void)Lease(jobs);
  }
  expect_right();
  boot_id_ = "boot-2";
  {
    JobStore jobs = Open();
    (void)Lease(jobs);
  }
  expect_right();
  Logger quiet(LogLevel::kError);
  ForgetRequest request;
  request.sessions = {session};
  ASSERT_TRUE(Forget(folder_, request, quiet).ok());
  expect_right();
  ASSERT_TRUE(Reindex(folder_, quiet).ok());
  expect_right();
}

TEST_F(JobStoreTest, GoesWithItsSession) {
  const std::string session = StoreSession(2);
  JobStore jobs = Open();
  ASSERT_TRUE(jobs.Enqueue({"mine", "fit", session}).ok());
  ASSERT_TRUE(jobs.Enqueue({"nobody's", "report"}).ok());
  const auto job = Lease(jobs);
  EXPECT_EQ(job->request.session, session);
  auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(connection->Execute("PRAGMA foreign_keys = ON; DELETE FROM sessions").ok());
  EXPECT_THAT(jobs.Complete(job->token).message(), HasSubstr("deleted with its session"));
  EXPECT_THAT(*jobs.List(), ::testing::SizeIs(1));
}

TEST_F(JobStoreTest, AReindexTakesJobsAndTokensOver) {
  const std::string session = StoreSession(2);
  int64_t token = 0;
  {
    JobStore jobs = Open();
    ASSERT_TRUE(jobs.Enqueue({"mine", "fit", session, R"({"a":1})", 4}).ok());
    ASSERT_TRUE(jobs.Enqueue({"nobody's", "report"}).ok());
    token = Lease(jobs)->token;
  }
  Logger quiet(LogLevel::kError);
  const auto report = Reindex(folder_, quiet);
  ASSERT_TRUE(report.ok()) << report.status().message();
  JobStore jobs = Open();
  ASSERT_THAT(*jobs.List(), ::testing::SizeIs(2));
  EXPECT_EQ((*jobs.List())[0].request.session, session);
  EXPECT_EQ((*jobs.List())[0].request.options_json, R"({"a":1})");
  EXPECT_TRUE(jobs.Heartbeat(token, minutes(1)).ok());
  EXPECT_EQ(Lease(jobs)->token, token + 1);
}

// The rules in words, held against random workers: a job never runs under two leases, ends once, and none is lost.
TEST_F(JobStoreTest, RandomWorkersNeverShareAJob) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    std::mt19937 random(seed);
    const auto below = [&random](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
    std::vector<JobStore> workers;
    for (int i = 0; i < 4; ++i) workers.push_back(Open());
    std::vector<std::pair<int64_t, int64_t>> tokens;  // token, job: all that were ever given
    std::map<int64_t, int64_t> current;               // job -> token that may work on it
    std::set<int64_t> done;
    int64_t newest = 0;
    const std::string prefix = "seed " + std::to_string(seed) + " job ";
    for (int i = 0; i < 12; ++i)
      ASSERT_TRUE(workers[0].Enqueue({prefix + std::to_string(i), "fit", "", "{}", below(3), {}, 1000}).ok());
    for (int step = 0; step < 400 && done.size() < 12; ++step) {
      JobStore& worker = workers[static_cast<size_t>(below(4))];
      const int act = below(10);
      if (act == 0) boot_ += std::chrono::seconds(below(90));
      if (act == 1) wall_.ns += (below(3) - 1) * int64_t{86400} * 1'000'000'000;
      if (act == 2 && below(8) == 0) {
        boot_ = std::chrono::seconds(1);
        boot_id_ += "+";
        for (JobStore& w : workers) w = Open();
      }
      if (act >= 3 && act < 6) {
        const auto job = Lease(worker, "w" + std::to_string(step));
        if (!job) continue;
        EXPECT_FALSE(done.contains(job->id)) << "a finished job came back";
        EXPECT_GT(job->token, newest);
        newest = job->token;
        tokens.emplace_back(job->token, job->id);
        current[job->id] = job->token;
      }
      if (act >= 6 && !tokens.empty()) {
        const auto [token, job] = tokens[static_cast<size_t>(below(static_cast<int>(tokens.size())))];
        const Status status = act == 6   ? worker.Heartbeat(token, minutes(1))
                              : act == 7 ? worker.Fail(token, "x", std::chrono::seconds(below(5)))
                              : act == 8 ? worker.Release(token)
                                         : worker.Complete(token);
        if (!status.ok()) continue;
        EXPECT_EQ(current[job], token) << "an older lease was heard";
        EXPECT_FALSE(done.contains(job));
        if (act == 9) done.insert(job);
        if (act != 6) current[job] = 0;
      }
    }
    // What is left is done by one patient worker.
    for (int i = 0; i < 200; ++i) {
      boot_ += minutes(2);
      const auto job = Lease(workers[0]);
      if (!job) break;
      EXPECT_TRUE(done.insert(job->id).second);
      ASSERT_TRUE(workers[0].Complete(job->token).ok());
    }
    EXPECT_EQ(done.size(), 12U) << "seed " << seed;
  }
}

// What workers did with each lease: "begun", then "ended", or "late" where somebody else had the job by then. Each word
// is one write, and what was begun is noted before the work.
class WorkersLog {
 public:
  explicit WorkersLog(const std::filesystem::path& file)
      : fd_(open(file.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600)) {}
  void Note(const char* what, const Job& job) const {
    const std::string line =
        Formatted("%s %lld %lld\n", what, static_cast<long long>(job.token), static_cast<long long>(job.id));
    if (write(fd_.get(), line.data(), line.size()) != static_cast<ssize_t>(line.size())) _exit(1);
  }

 private:
  UniqueFd fd_;
};

[[noreturn]] void Work(const std::filesystem::path& store, unsigned seed) {
  std::mt19937 random(seed);
  const WorkersLog log(store / "log");
  auto jobs = JobStore::Open(store);
  if (!jobs.ok()) _exit(1);
  while (true) {
    const auto job = jobs->Lease({std::to_string(getpid()), {}, milliseconds(150)});
    if (!job.ok()) _exit(1);
    if (!*job) {
      usleep(2000);
      continue;
    }
    log.Note("begun", **job);
    usleep(static_cast<useconds_t>(random() % 4000));
    if (random() % 64 == 0) usleep(200'000);  // longer than the lease: somebody takes over
    log.Note(jobs->Complete((*job)->token).ok() ? "ended" : "late", **job);
  }
}

// STRATALUX_JOBS: how many (docs/night.md, queue).
int JobsToDo() {
  const char* text = std::getenv("STRATALUX_JOBS");
  return text != nullptr ? std::max(1, std::atoi(text)) : 1500;
}

TEST_F(JobStoreTest, KilledWorkersLoseNothingAndDoNothingTwice) {
  constexpr int kWorkers = 8;
  const int jobs_to_do = JobsToDo();
  const int most_kills = std::max(40, jobs_to_do / 100);
  {
    auto jobs = JobStore::Open(folder_);
    for (int i = 0; i < jobs_to_do; ++i)
      ASSERT_TRUE(jobs->Enqueue({"job " + std::to_string(i), "fit", "", "{}", 0, {}, 1'000'000}).ok());
  }
  std::mt19937 random(5);
  std::vector<pid_t> workers(kWorkers, 0);
  unsigned seed = 1;
  const auto start = [&](pid_t& pid) {
    pid = fork();
    if (pid == 0) Work(folder_, seed);
    ++seed;
  };
  const auto end = [](pid_t pid) {
    kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
  };
  for (pid_t& pid : workers) start(pid);
  // A kill each time another share of the work is done, so that they fall on all of it on any machine, but for the last
  // quarter: on a busy one this process may see that end before it has killed.
  const int64_t of_work = int64_t{jobs_to_do} * 3 / 4;
  auto jobs = JobStore::Open(folder_);
  ASSERT_TRUE(jobs.ok());
  const auto hung = std::chrono::steady_clock::now() + std::chrono::seconds(60) + milliseconds(20) * jobs_to_do;
  int kills = 0;
  for (int64_t done = 0; done < jobs_to_do; done = (*jobs->Count())[JobState::kDone]) {
    ASSERT_LT(std::chrono::steady_clock::now(), hung) << done << " of " << jobs_to_do << " done";
    usleep(5'000);
    for (; kills < most_kills && done * most_kills >= kills * of_work; ++kills) {
      pid_t& victim = workers[random() % workers.size()];
      end(victim);
      start(victim);
    }
  }
  for (const pid_t pid : workers) end(pid);

  std::map<std::string, std::set<int64_t>> tokens;  // under which each was noted
  std::map<int64_t, int> ends;
  std::ifstream log(folder_ / "log");
  std::string word;
  for (int64_t token = 0, job = 0; log >> word >> token >> job;) {
    EXPECT_TRUE(tokens[word].insert(token).second) << "token " << token << " was given twice";
    if (word == "ended") ++ends[job];
  }
  for (const auto& [job, count] : ends) EXPECT_EQ(count, 1) << "job " << job;
  const auto begun = static_cast<int64_t>(tokens["begun"].size()), late = static_cast<int64_t>(tokens["late"].size());
  printf("%d jobs, %d workers: %d killed, %lld begun, %lld late\n", jobs_to_do, kWorkers, kills,
         static_cast<long long>(begun), static_cast<long long>(late));
  EXPECT_EQ(kills, most_kills);
  EXPECT_GT(late, 0) << "nobody lost a lease";
  // A worker may be killed between its end and the word that says so, and before it says that it is late. Nothing is
  // begun again but after a kill, the last one of all workers too, or where somebody was late.
  EXPECT_LE(jobs_to_do - static_cast<int64_t>(ends.size()), kills + kWorkers);
  EXPECT_LE(begun, jobs_to_do + kills + kWorkers + late);
}

}  // namespace
}  // namespace stratalux::db
