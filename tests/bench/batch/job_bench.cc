// SPDX-License-Identifier: Apache-2.0
// What the night's queue costs with a million jobs in it: the operator's question how far it is, as a program started
// anew, beside the sqlite3 shell that counts the rows; and a job taken and ended, beside a queue that is a single
// UPDATE ... RETURNING in SQLite with neither leases nor attempts nor counts.
//
//   build/bench/bin/job_bench [--jobs=N] [--visitors=N] [--runs=N] [--leases=N]
//
// --visitors: of the newest night, whose log is read for its state. TMPDIR says where; leases are synced to that disk.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>

#include <unistd.h>

#include "db/base/sqlite.h"
#include "db/catalogue/job_store.h"
#include "db/catalogue/session_store.h"
#include "fitter/batch/night_log.h"
#include "shared/base/formatted.h"
#include "tests/bench/db/program_runs.h"

namespace stratalux::fit {
namespace {

using db::Connection;
using db::JobStore;
using db::Median;
using db::ProgramRuns;
using db::RunProgram;
namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

[[noreturn]] void Fail(const Status& status) {
  std::fprintf(stderr, "job_bench: %s\n", status.message().c_str());
  std::exit(1);
}
void Check(const Status& status) {
  if (!status.ok()) Fail(status);
}
template <typename T>
T Value(Result<T> result) {
  Check(result.status());
  return std::move(result).value();
}

int64_t Option(int argc, char** argv, const std::string& name, int64_t otherwise) {
  for (int i = 1; i < argc; ++i)
    if (std::string(argv[i]).starts_with(name + "=")) return std::atoll(argv[i] + name.size() + 1);
  return otherwise;
}

// As after months: most are done, some were set aside, the rest waits. By SQL, so that a million takes seconds.
void WriteJobs(const fs::path& store, int64_t jobs) {
  Check(db::SessionStore::Create(store));
  auto connection = Value(Connection::Open(store / "index.sqlite", Connection::Mode::kReadWrite));
  const std::string count = std::to_string(jobs);
  Check(connection.Execute(
      "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < " + count +
      ") INSERT INTO jobs (key, kind, state, priority, options_json, created_wall_ns, not_before_wall_ns, attempts,"
      " max_attempts, owner, fence, boot, until_boot_ns, last_error, finished_wall_ns)"
      " SELECT 'fit ' || i, 'fit', CASE WHEN i % 10 < 7 THEN 'done' WHEN i % 1000 = 7 THEN 'set-aside' ELSE 'queued' "
      "END,"
      " i % 5000, '{}', i, 0, 0, 3, '', 0, '', 0, '', CASE WHEN i % 10 < 7 OR i % 1000 = 7 THEN i END FROM n"));
  Check(connection.Execute(
      "CREATE TABLE plain (id INTEGER PRIMARY KEY, state TEXT NOT NULL, priority INTEGER NOT NULL)"));
  Check(connection.Execute("INSERT INTO plain SELECT id, state, priority FROM jobs"));
  Check(connection.Execute("CREATE INDEX plain_queued ON plain (priority DESC, id) WHERE state = 'queued'"));
  Check(connection.Execute("PRAGMA wal_checkpoint(TRUNCATE)"));
}

void WriteNight(const fs::path& store, int64_t visitors) {
  auto log = Value(NightLog::Begin(store));
  Check(log.Add({.kind = NightEventKind::kBegan, .at = WallNow(), .count = visitors}));
  for (int64_t i = 0; i < visitors; ++i) {
    NightEvent event{.kind = NightEventKind::kStarted, .at = WallNow(), .attempt = 1};
    event.session = Formatted("s%06d-%08x", static_cast<int>(i + 1), static_cast<unsigned>(i));
    event.fit = "fit";
    Check(log.Add(event));
    event.kind = NightEventKind::kDone;
    event.seconds = 45.0;
    Check(log.Add(event));
  }
}

void PrintRuns(const char* what, const ProgramRuns& runs) {
  if (runs.exit_code != 0) Fail(Status::Failed(std::string(what) + " ended with " + std::to_string(runs.exit_code)));
  std::printf("%-34s %8.1f %8.1f %10.1f %8.1f\n", what, Median(runs.wall_ms), runs.wall_ms.back(), Median(runs.cpu_ms),
              runs.peak_mb);
}

template <typename Body>
void PrintLeases(const char* what, int64_t leases, const Body& body) {
  std::vector<double> ms;
  for (int64_t i = 0; i < leases; ++i) {
    const auto begin = Clock::now();
    body();
    ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  std::sort(ms.begin(), ms.end());
  std::printf("%-34s %8.3f %8.3f\n", what, Median(ms), ms[ms.size() * 99 / 100]);
}

void LeasesOfOurs(const fs::path& store, int64_t leases) {
  auto jobs = Value(JobStore::Open(store));
  PrintLeases("JobStore: lease, complete", leases, [&] {
    const auto job = Value(jobs.Lease({"bench", {"fit"}, std::chrono::minutes(1)}));
    if (!job) Fail(Status::Failed("the queue is empty: more --jobs"));
    Check(jobs.Complete(job->token));
  });
}

// What a script would do: it loses a job whose worker dies.
void LeasesOfAPlainTable(const fs::path& store, int64_t leases) {
  auto connection = Value(Connection::Open(store / "index.sqlite", Connection::Mode::kReadWrite));
  PrintLeases("plain SQLite: take, done", leases, [&] {
    int64_t id = 0;
    {
      auto take = Value(connection.Prepare(
          "UPDATE plain SET state = 'running' WHERE id = (SELECT id FROM plain WHERE state = 'queued'"
          " ORDER BY priority DESC, id LIMIT 1) RETURNING id"));
      if (!Value(take.Step())) Fail(Status::Failed("the queue is empty: more --jobs"));
      id = take.Integer(0);
      while (Value(take.Step())) {
      }
    }
    auto done = Value(connection.Prepare("UPDATE plain SET state = 'done' WHERE id = ?1"));
    Check(done.Bind(1, id).Run());
  });
}

int Main(int argc, char** argv) {
  const int64_t jobs = Option(argc, argv, "--jobs", 1'000'000), leases = Option(argc, argv, "--leases", 1000);
  const auto runs = static_cast<int>(Option(argc, argv, "--runs", 10));
  if (argc > 1 && std::string(argv[1]).starts_with("--write=")) {
    const fs::path store = std::string(argv[1]).substr(8);
    WriteJobs(store, jobs);
    WriteNight(store, Option(argc, argv, "--visitors", 700));
    return 0;
  }
  std::string folder = (fs::temp_directory_path() / "job_bench.XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr) Fail(Status::Failed("no folder " + folder));
  const fs::path store = fs::path(folder) / "store";
  // In a process of its own: a program started from here is charged with the memory that this one has.
  std::string rows = std::string(argv[0]) + " --write=" + store.string();
  for (int i = 1; i < argc; ++i) rows += std::string(" ") + argv[i];
  if (std::system(rows.c_str()) != 0) Fail(Status::Failed("no jobs were written"));
  const fs::path index = store / "index.sqlite";
  std::printf("%lld jobs, index of %.0f MB\n\n%-34s %8s %8s %10s %8s\n", static_cast<long long>(jobs),
              static_cast<double>(fs::file_size(index)) / 1e6, "program", "median", "worst", "processor", "peak");
  std::printf("%-34s %8s %8s %10s %8s\n", "", "ms", "ms", "ms", "MB");
  const std::string programs = STRATALUX_BIN_DIR;
  PrintRuns("stratalux-fit batch status",
            RunProgram(programs + "/stratalux-fit batch status --store " + store.string(), runs));
  PrintRuns("stratalux-fit batch status --json",
            RunProgram(programs + "/stratalux-fit batch status --json --store " + store.string(), runs));
  PrintRuns("sqlite3: SELECT state, count(*)",
            RunProgram("sqlite3 " + index.string() + " 'SELECT state, count(*) FROM jobs GROUP BY state'", runs));
  std::printf("\n%-34s %8s %8s\n%-34s %8s %8s\n", "a job", "median", "99 %", "", "ms", "ms");
  LeasesOfOurs(store, leases);
  LeasesOfAPlainTable(store, leases);
  fs::remove_all(folder);
  return 0;
}

}  // namespace
}  // namespace stratalux::fit

int main(int argc, char** argv) { return stratalux::fit::Main(argc, argv); }
