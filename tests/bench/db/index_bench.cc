// SPDX-License-Identifier: Apache-2.0
// How long an operator waits on an index of 1,000 sessions x 1,000 frames: every named query, `ls` and `show`, inside
// one process and through the program, beside the same question asked without schema 2's totals and schema 3's indexes.
//
// With --sessions=100000 --frames=10 --real-fits=0: what a selector costs in a store of a hundred thousand.
//
//   build/bench/bin/index_bench [--sessions=N] [--frames=N] [--real-fits=0] [Google Benchmark's flags]
//
// --real-fits=0: three figures a fit instead of as many as metrics.json holds, which take ten minutes to write so
// often.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>

#include <benchmark/benchmark.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/apps/session_views.h"
#include "db/apps/table_output.h"
#include "db/catalogue/named_query.h"
#include "db/catalogue/session_filter.h"
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
  ~Folder() { std::filesystem::remove_all(path); }
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

double Ms(const timeval& t) { return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_usec) / 1e3; }

// What one program used.
rusage RunChild(const std::string& command) {
  const pid_t child = fork();
  if (child == 0) {
    execl("/bin/sh", "sh", "-c", ("exec " + command).c_str(), nullptr);
    _exit(127);
  }
  int status = 0;
  rusage usage{};
  if (child < 0 || wait4(child, &status, 0, &usage) != child || status != 0) Check(Status::Failed(command));
  return usage;
}

void RunProgram(benchmark::State& state, const std::string& arguments) {
  const std::string command = std::string(STRATALUX_BIN_DIR) + "/stratalux-db " + arguments + " > /dev/null";
  double ms = 0.0, mib = 0.0;
  for (auto _ : state) {
    const rusage usage = RunChild(command);
    ms += Ms(usage.ru_utime) + Ms(usage.ru_stime);
    mib = std::max(mib, static_cast<double>(usage.ru_maxrss) / 1024.0);
  }
  state.counters["children_ms"] = ms / static_cast<double>(state.iterations());
  state.counters["children_mib"] = mib;
}

// In a process of its own: a program started from here is charged with the memory that this one has. Gives the frames.
int64_t WriteRows(const std::filesystem::path& folder, const IndexRowsOptions& options) {
  const pid_t child = fork();
  if (child == 0) {
    WriteIndexRows(folder, options);
    _exit(0);
  }
  int status = 0;
  if (child < 0 || waitpid(child, &status, 0) != child || status != 0) Check(Status::Failed("no rows were written"));
  auto index = ReadOnlyIndex::Open(folder);
  Check(index.status());
  const auto count = index->Run("SELECT sum(frame_count) FROM sessions");
  Check(count.status());
  return std::get<int64_t>(count->rows.at(0).at(0));
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

// Keeps what it prints, for the table at the end.
class Collector : public benchmark::ConsoleReporter {
 public:
  Collector() : ConsoleReporter(OO_Tabular) {}
  void ReportRuns(const std::vector<Run>& runs) override {
    ConsoleReporter::ReportRuns(runs);
    for (const Run& run : runs) {
      wall_ms_[run.run_name.function_name] = run.GetAdjustedRealTime();
      const auto children = run.counters.find("children_ms");
      cpu_ms_[run.run_name.function_name] =
          children == run.counters.end() ? run.GetAdjustedCPUTime() : children->second.value;
      if (const auto mib = run.counters.find("children_mib"); mib != run.counters.end())
        mib_[run.run_name.function_name] = mib->second.value;
    }
  }
  [[nodiscard]] Cell Wall(const std::string& name) const { return Of(wall_ms_, name); }
  [[nodiscard]] Cell Cpu(const std::string& name) const { return Of(cpu_ms_, name); }
  [[nodiscard]] Cell Memory(const std::string& name) const { return Of(mib_, name); }

 private:
  using Times = std::map<std::string, double>;
  static Cell Of(const Times& times, const std::string& name) {
    const auto found = times.find(name);
    return found == times.end() ? Cell() : Cell(std::round(found->second * 100.0) / 100.0);
  }
  Times wall_ms_, cpu_ms_, mib_;
};

template <typename Function>
void Register(const std::string& name, Function function) {
  benchmark::RegisterBenchmark(name.c_str(), function)->Unit(benchmark::kMillisecond)->UseRealTime();
}

int Option(int argc, char** argv, const std::string& name, int otherwise) {
  int value = otherwise;
  for (int i = 1; i < argc; ++i)
    if (const std::string text = argv[i]; text.starts_with(name + "="))
      std::from_chars(text.data() + name.size() + 1, text.data() + text.size(), value);
  return value;
}

// Wall time is what an operator waits; on a busy machine the processor time says what the question costs.
ResultTable Summary(const Collector& results, const std::vector<std::string>& names) {
  ResultTable table;
  table.columns = {{"question"}, {"in process, ms"}, {"its CPU, ms"},  {"program, ms"}, {"its CPU, ms"},
                   {"its MiB"},  {"at most, ms"},    {"peer CPU, ms"}, {"peer / ours"}};
  const std::map<std::string, int64_t> targets = {
      {"show", 20}, {"frames", 20}, {"verify ID", 20}, {"purge --dry-run", 500}};
  for (const std::string& name : names) {
    const Cell ours = results.Cpu(name), peer = results.Cpu("peer/" + name);
    Cell ratio;
    if (std::holds_alternative<double>(ours) && std::holds_alternative<double>(peer))
      ratio = std::round(std::get<double>(peer) / std::get<double>(ours) * 10.0) / 10.0;
    table.rows.push_back({name, results.Wall(name), ours, results.Wall("program/" + name),
                          results.Cpu("program/" + name), results.Memory("program/" + name),
                          targets.contains(name) ? targets.at(name) : int64_t{100}, peer, ratio});
  }
  return table;
}

int Main(int argc, char** argv) {
  IndexRowsOptions options;
  options.sessions = Option(argc, argv, "--sessions", 1000);
  options.frames_per_session = Option(argc, argv, "--frames", 1000);
  options.fits =
      Option(argc, argv, "--real-fits", 1) == 0 ? IndexRowsOptions::Fits::kFew : IndexRowsOptions::Fits::kReal;
  std::string name = (std::filesystem::temp_directory_path() / "stratalux-bench-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) return 1;
  const Folder folder{name};
  std::fprintf(stderr, "writing %d sessions x %d frames\n", options.sessions, options.frames_per_session);
  const int64_t frames = WriteRows(folder.path, options);

  const std::string store = " --store " + folder.path.string();
  const std::string now = " --now " + ToIso8601(options.now);
  const std::string real = StoreRealSession(folder.path, options.frames_per_session);
  std::vector<std::string> names = {"ls", "show", "frames", "verify ID", "purge --dry-run"};
  // Programs first, for their memory (WriteRows).
  Register("program/show", [&](auto& state) { RunProgram(state, "show latest" + store); });
  Register("program/frames", [&](auto& state) { RunProgram(state, "frames " + real + store); });
  Register("program/verify ID", [&](auto& state) { RunProgram(state, "verify " + real + store); });
  // As every night: what became due within a day or two. The rows are of three sessions a day.
  const std::string days = std::to_string(options.sessions / 3 - 3);
  Register("program/purge --dry-run",
           [&](auto& state) { RunProgram(state, "purge --dry-run --long-days " + days + now + store); });
  Register("program/ls", [&](auto& state) { RunProgram(state, "ls" + store); });
  for (const NamedQuery& query : NamedQueries()) {
    names.push_back(query.name);
    Register("program/" + query.name,
             [&, arguments = "query " + query.name + now + store](auto& state) { RunProgram(state, arguments); });
  }
  Register("ls", [&](auto& state) { RunList(state, folder.path); });
  Register("show", [&](auto& state) { RunShow(state, folder.path); });
  for (const NamedQuery& query : NamedQueries())
    Register(query.name, [&](auto& state) { RunNamed(state, folder.path, query, options.now); });
  for (const auto& [question, sql] : kPeers)
    Register("peer/" + question, [&, statement = sql](auto& state) { RunStatement(state, folder.path, statement); });
  Collector results;
  benchmark::Initialize(&argc, argv);
  benchmark::RunSpecifiedBenchmarks(&results);
  std::printf("\n%s\n", TableAsText(Summary(results, names)).c_str());
  const auto bytes = std::filesystem::file_size(folder.path / "index.sqlite");
  std::printf("%lld frames, index of %.1f MiB: %.0f bytes a frame (target 400)\n", static_cast<long long>(frames),
              static_cast<double>(bytes) / (1 << 20), static_cast<double>(bytes) / static_cast<double>(frames));
  return 0;
}

}  // namespace
}  // namespace stratalux::db

int main(int argc, char** argv) { return stratalux::db::Main(argc, argv); }
