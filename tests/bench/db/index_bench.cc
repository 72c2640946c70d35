// SPDX-License-Identifier: Apache-2.0
// How long an operator waits on an index of 1,000 sessions x 1,000 frames: first every command and named query as a
// program started anew, beside the sqlite3 shell with a plain query of the same rows; then inside one process, beside
// the same question asked without schema 2's totals and schema 3's indexes.
//
// With --sessions=100000 --frames=10 --real-fits=0: what a selector costs in a store of a hundred thousand.
//
//   build/bench/bin/index_bench [--sessions=N] [--frames=N] [--real-fits=0] [--runs=N] [--store=DIR]
//   [--programs-only=1]
//                               [Google Benchmark's flags]
//
// --real-fits=0: three figures a fit instead of as many as metrics.json holds, which take ten minutes to write so
// often. --store=DIR: written there where nothing is yet, and kept for the next time, with the same numbers. --runs=N:
// how often each program is run.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>

#include <benchmark/benchmark.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/apps/session_views.h"
#include "db/apps/table_output.h"
#include "db/catalogue/named_query.h"
#include "db/catalogue/session_filter.h"
#include "tests/bench/db/program_runs.h"
#include "tests/db/index_rows.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

// The same answers from the rows alone.
const std::map<std::string, std::string> kPeers = {
    {"ls",
     "SELECT s.id, count(f.frame), sum(f.stored_bytes), (SELECT count(*) FROM fits t WHERE t.session = s.number)"
     " FROM sessions s LEFT JOIN frames f ON f.session = s.number GROUP BY s.number ORDER BY s.number DESC"},
    {"disk-use",
     "SELECT s.rig, s.kind, s.status, count(DISTINCT s.number), count(*), sum(f.stored_bytes) FROM sessions s"
     " JOIN frames f ON f.session = s.number GROUP BY 1, 2, 3"},
    {"rigs",
     "SELECT s.rig, count(DISTINCT s.number), count(*), sum(f.stored_bytes) FROM sessions s JOIN frames f"
     " ON f.session = s.number GROUP BY 1"},
    {"sessions-per-day",
     "SELECT s.started_wall_ns / 86400000000000, count(DISTINCT s.number), count(*),"
     " sum(f.stored_bytes) FROM sessions s JOIN frames f ON f.session = s.number GROUP BY 1"},
    {"retakes",
     "SELECT s.rig, p.retake_cause, count(*), count(DISTINCT s.number) FROM proofs p"
     " JOIN sessions s ON s.number = p.session WHERE +p.retake_cause <> '' GROUP BY 1, 2"},
    {"missing-frames",
     "SELECT s.id, s.planned_steps AS planned, count(DISTINCT f.step) AS good FROM sessions s"
     " LEFT JOIN frames f NOT INDEXED ON f.session = s.number AND f.level_check <> 2"
     " GROUP BY s.number HAVING good < planned"},
};

struct Folder {
  std::filesystem::path path;
  enum class Lifetime { kThisRun, kKept } lifetime = Lifetime::kThisRun;
  ~Folder() {
    if (lifetime == Lifetime::kThisRun) std::filesystem::remove_all(path);
  }
};

// A figure of a question that failed would be worth nothing.
void Check(const Status& status) {
  if (status.ok()) return;
  std::fprintf(stderr, "index_bench: %s\n", status.message().c_str());
  std::exit(1);
}

void RunStatement(benchmark::State& state, const std::filesystem::path& store, const std::string& sql) {
  auto index = ReadOnlyIndex::Open(store);
  Check(index.status());
  for (auto _ : state) {
    auto table = index->Run(sql, {}, {.time = std::chrono::minutes(1), .rows = INT64_MAX, .bytes = INT64_MAX});
    Check(table.status());
    benchmark::DoNotOptimize(table);
  }
}

void RunNamed(benchmark::State& state, const std::filesystem::path& store, const NamedQuery& query, WallNs now) {
  auto index = ReadOnlyIndex::Open(store);
  Check(index.status());
  for (auto _ : state) {
    auto table = RunQuery(*index, query, {{"now_ns", now.ns}}, {.rows = INT64_MAX});
    Check(table.status());
    benchmark::DoNotOptimize(TableAsText(*table));
  }
}

void RunList(benchmark::State& state, const std::filesystem::path& store) {
  auto index = ReadOnlyIndex::Open(store);
  Check(index.status());
  for (auto _ : state) {
    const auto table = ListSessions(*index, {});
    Check(table.status());
    benchmark::DoNotOptimize(TableAsText(*table));
  }
}

void RunShow(benchmark::State& state, const std::filesystem::path& folder) {
  const auto store = SessionStore::Open(folder, AccessMode::kReadOnly);
  Check(store.status());
  for (auto _ : state) {
    const auto details = LoadDetails(*store, "latest");
    Check(details.status());
    benchmark::DoNotOptimize(DetailsAsText(*details));
  }
}

// In a process of its own: a program started from here is charged with the memory that this one has.
void WriteRows(const std::filesystem::path& folder, const IndexRowsOptions& options) {
  const pid_t child = fork();
  if (child == 0) {
    WriteIndexRows(folder, options);
    _exit(0);
  }
  int status = 0;
  if (child < 0 || waitpid(child, &status, 0) != child || status != 0) Check(Status::Failed("no rows were written"));
}

void PrintSize(const std::filesystem::path& folder) {
  auto index = ReadOnlyIndex::Open(folder);
  Check(index.status());
  const auto count = index->Run("SELECT sum(frame_count) FROM sessions");
  Check(count.status());
  const auto frames = std::get<int64_t>(count->rows.at(0).at(0));
  const auto bytes = std::filesystem::file_size(folder / "index.sqlite");
  std::printf("%lld frames, index of %.1f MiB: %.0f bytes a frame (target 400)\n", static_cast<long long>(frames),
              static_cast<double>(bytes) / (1 << 20), static_cast<double>(bytes) / static_cast<double>(frames));
}

// A session like those of the rows, with its files behind them: `frames` and `verify` read them.
std::string StoreRealSession(const std::filesystem::path& folder, int frames) {
  auto store = SessionStore::Open(folder, AccessMode::kReadWrite);
  Check(store.status());
  auto writer = store->BeginSession(SimulatedVisit());
  Check(writer.status());
  for (int i = 0; i < frames; ++i) Check(AppendTo(*writer, i));
  Check(writer->Finish(SessionStatus::kComplete));
  return writer->info().id;
}

Cell Rounded(double value, double to) { return std::round(value / to) * to; }

// Keeps what it prints, for the table at the end.
class Collector : public benchmark::ConsoleReporter {
 public:
  Collector() : ConsoleReporter(OO_Tabular) {}
  void ReportRuns(const std::vector<Run>& runs) override {
    ConsoleReporter::ReportRuns(runs);
    for (const Run& run : runs) {
      wall_ms_[run.run_name.function_name] = run.GetAdjustedRealTime();
      cpu_ms_[run.run_name.function_name] = run.GetAdjustedCPUTime();
    }
  }
  [[nodiscard]] Cell Wall(const std::string& name) const { return Of(wall_ms_, name); }
  [[nodiscard]] Cell Cpu(const std::string& name) const { return Of(cpu_ms_, name); }

 private:
  using Times = std::map<std::string, double>;
  static Cell Of(const Times& times, const std::string& name) {
    const auto found = times.find(name);
    return found == times.end() ? Cell() : Rounded(found->second, 0.01);
  }
  Times wall_ms_, cpu_ms_;
};

template <typename Function>
void Register(const std::string& name, Function function) {
  benchmark::RegisterBenchmark(name.c_str(), function)->Unit(benchmark::kMillisecond)->UseRealTime();
}

std::string TextOption(int argc, char** argv, const std::string& name) {
  for (int i = 1; i < argc; ++i)
    if (const std::string text = argv[i]; text.starts_with(name + "=")) return text.substr(name.size() + 1);
  return "";
}

int Option(int argc, char** argv, const std::string& name, int otherwise) {
  const std::string text = TextOption(argc, argv, name);
  std::from_chars(text.data(), text.data() + text.size(), otherwise);
  return otherwise;
}

// A question as an operator types it.
struct Question {
  std::string name, arguments;  // of stratalux-db
  Cell most_ms, most_mb;        // aimed at: processor time, memory
  std::string peer_sql;         // the same rows, for the sqlite3 shell; empty: it has no peer
};

// `real`: id of the session that has files.
std::vector<Question> Questions(const IndexRowsOptions& options, const std::string& folder, const std::string& real) {
  const std::string store = " --store " + folder, now = " --now " + ToIso8601(options.now);
  const std::string number = "(SELECT number FROM sessions WHERE id = '" + real + "')";
  const std::string of_session = " WHERE session = " + number + ";";
  const auto due = [&options](int days) {
    return "SELECT s.id, s.frame_count, s.stored_bytes, (SELECT count(*) FROM fits f WHERE f.session = s.number) FROM"
           " sessions s WHERE kind = 'visitor' AND retention = 'long' AND CASE WHEN finished_wall_ns > 0 THEN"
           " finished_wall_ns ELSE started_wall_ns END <= " +
           std::to_string(options.now.ns - days * int64_t{86'400'000'000'000}) + " ORDER BY number";
  };
  // As every night: what became due within a day or two. The rows are of three sessions a day.
  const int days = options.sessions / 3 - 3;
  const int64_t selector_ms = 20, selector_mb = 40, purge_ms = 500;
  // What walks over all sessions is aimed at for a thousand of them.
  const Cell list_ms = options.sessions <= 1000 ? Cell(int64_t{100}) : Cell();
  std::vector<Question> questions = {
      {"--version", "--version", Cell(), Cell(), "SELECT 1"},
      {"show ID", "show " + real + store, selector_ms, selector_mb, "SELECT * FROM sessions WHERE id = '" + real + "'"},
      {"frames ID", "frames " + real + store, selector_ms, selector_mb,
       "SELECT * FROM frames f JOIN proofs p ON p.session = f.session AND p.frame = f.frame WHERE f.session = " +
           number},
      {"verify ID", "verify " + real + store, selector_ms, selector_mb,
       "SELECT * FROM sessions WHERE number = " + number + "; SELECT * FROM frames" + of_session +
           " SELECT * FROM proofs" + of_session + " SELECT * FROM fits" + of_session + " SELECT * FROM metrics" +
           of_session},
      {"purge --dry-run, few due", "purge --dry-run --long-days " + std::to_string(days) + now + store, purge_ms,
       Cell(), due(days)},
      {"purge --dry-run, all due", "purge --dry-run --long-days 0" + now + store, purge_ms, Cell(), due(0)},
      {"ls", "ls" + store, list_ms, Cell(), kPeers.at("ls")}};
  for (const NamedQuery& query : NamedQueries()) {
    const auto peer = kPeers.find(query.name);
    questions.push_back(
        {query.name, "query " + query.name + now + store, list_ms, Cell(), peer == kPeers.end() ? "" : peer->second});
  }
  return questions;
}

// Wall time is what an operator waits; on a busy machine the processor time says what the question costs.
ResultTable AskPrograms(const std::vector<Question>& questions, const std::string& folder, int runs) {
  ResultTable table;
  table.columns = {{"program"}, {"CPU ms, least"}, {"median"},  {"at most"},        {"wall ms, least"},
                   {"median"},  {"peak MB"},       {"at most"}, {"sqlite3 CPU ms"}, {"its peak MB"}};
  const bool has_shell = RunProgram("sqlite3 --version", 0).exit_code == 0;
  for (const Question& question : questions) {
    std::fprintf(stderr, "%s\n", question.name.c_str());
    const ProgramRuns ours = RunProgram(std::string(STRATALUX_BIN_DIR) + "/stratalux-db " + question.arguments, runs);
    if (ours.exit_code != 0) Check(Status::Failed("stratalux-db " + question.arguments));
    Cell peer_ms, peer_mb;
    if (has_shell && !question.peer_sql.empty()) {
      const ProgramRuns peer =
          RunProgram("sqlite3 -readonly " + folder + "/index.sqlite \"" + question.peer_sql + "\"", runs);
      if (peer.exit_code != 0) Check(Status::Failed("sqlite3: " + question.peer_sql));
      peer_ms = Rounded(Least(peer.cpu_ms), 0.1);
      peer_mb = Rounded(peer.peak_mb, 0.1);
    }
    table.rows.push_back({question.name, Rounded(Least(ours.cpu_ms), 0.1), Rounded(Median(ours.cpu_ms), 0.1),
                          question.most_ms, Rounded(Least(ours.wall_ms), 0.1), Rounded(Median(ours.wall_ms), 0.1),
                          Rounded(ours.peak_mb, 0.1), question.most_mb, peer_ms, peer_mb});
  }
  return table;
}

ResultTable Summary(const Collector& results, const std::vector<std::string>& names) {
  ResultTable table;
  table.columns = {{"in process"}, {"ms"}, {"its CPU, ms"}, {"peer CPU, ms"}, {"peer / ours"}};
  for (const std::string& name : names) {
    const Cell ours = results.Cpu(name), peer = results.Cpu("peer/" + name);
    Cell ratio;
    if (std::holds_alternative<double>(ours) && std::holds_alternative<double>(peer))
      ratio = Rounded(std::get<double>(peer) / std::get<double>(ours), 0.1);
    table.rows.push_back({name, results.Wall(name), ours, peer, ratio});
  }
  return table;
}

void AskInProcess(int& argc, char** argv, const std::filesystem::path& folder, const IndexRowsOptions& options) {
  std::vector<std::string> names = {"ls", "show"};
  Register("ls", [&](auto& state) { RunList(state, folder); });
  Register("show", [&](auto& state) { RunShow(state, folder); });
  for (const NamedQuery& query : NamedQueries()) {
    names.push_back(query.name);
    Register(query.name, [&](auto& state) { RunNamed(state, folder, query, options.now); });
  }
  for (const auto& [question, sql] : kPeers)
    Register("peer/" + question, [&, statement = sql](auto& state) { RunStatement(state, folder, statement); });
  Collector results;
  benchmark::Initialize(&argc, argv);
  benchmark::RunSpecifiedBenchmarks(&results);
  std::printf("\n%s\n", TableAsText(Summary(results, names)).c_str());
}

Folder FolderFor(const std::string& given) {
  if (!given.empty()) return {given, Folder::Lifetime::kKept};
  std::string name = (std::filesystem::temp_directory_path() / "stratalux-bench-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) Check(Status::Failed("cannot make " + name));
  return {name};
}

int Main(int argc, char** argv) {
  IndexRowsOptions options;
  options.sessions = Option(argc, argv, "--sessions", 1000);
  options.frames_per_session = Option(argc, argv, "--frames", 1000);
  options.fits =
      Option(argc, argv, "--real-fits", 1) == 0 ? IndexRowsOptions::Fits::kFew : IndexRowsOptions::Fits::kReal;
  const Folder folder = FolderFor(TextOption(argc, argv, "--store"));
  if (!std::filesystem::exists(folder.path / "index.sqlite")) {
    std::fprintf(stderr, "writing %d sessions x %d frames\n", options.sessions, options.frames_per_session);
    WriteRows(folder.path, options);
  }
  const std::string real = StoreRealSession(folder.path, options.frames_per_session);
  const std::string store = folder.path.string();
  std::printf(
      "%s\n",
      TableAsText(AskPrograms(Questions(options, store, real), store, Option(argc, argv, "--runs", 9))).c_str());
  PrintSize(folder.path);
  if (Option(argc, argv, "--programs-only", 0) == 0) AskInProcess(argc, argv, folder.path, options);
  return 0;
}

}  // namespace
}  // namespace stratalux::db

int main(int argc, char** argv) { return stratalux::db::Main(argc, argv); }
