// SPDX-License-Identifier: Apache-2.0
// The whole write path over 1,000 frames: encode, hash, write, fdatasync and commit by groups, seal.
//   STRATALUX_BENCH_STORE=store build/bench/bin/write_path_bench
// $TMPDIR decides which disk. A program of its own, so that its peak memory is the write path's.
#include <cstdio>
#include <cstdlib>
#include <string>

#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include "db/catalogue/session_store.h"
#include "tests/bench/db/visit_frames.h"

namespace stratalux::bench {
namespace {

constexpr size_t kFrames = 1000, kDistinctFrames = 16;

SessionInfo Simulated() {
  SessionInfo info;
  info.simulated = true;
  return info;
}

double ProcessorSeconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

double PeakResidentMiB() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

void WriteSession(benchmark::State& state, const std::vector<VisitFrame>& frames, StoreCodec codec) {
  int64_t bytes = 0;
  double processor_s = 0;
  for (auto _ : state) {
    state.PauseTiming();
    std::string folder = (std::filesystem::temp_directory_path() / "stratalux-bench-XXXXXX").string();
    SLX_CHECK(mkdtemp(folder.data()) != nullptr);
    SLX_CHECK(db::SessionStore::Create(folder).ok());
    {
      auto store = db::SessionStore::Open(folder, db::AccessMode::kReadWrite);
      SLX_CHECK(store.ok());
      state.ResumeTiming();
      processor_s -= ProcessorSeconds();
      auto writer = store->BeginSession(Simulated(), {.codec = codec});
      SLX_CHECK(writer.ok());
      for (size_t i = 0; i < kFrames; ++i) {
        const VisitFrame& frame = frames[i % frames.size()];
        SLX_CHECK(writer->Append(frame.record, frame.pixels.view()).ok());
      }
      SLX_CHECK(writer->Finish(SessionStatus::kComplete).ok());
      processor_s += ProcessorSeconds();
      state.PauseTiming();
      bytes = store->FindSession("latest")->bytes;
    }
    std::filesystem::remove_all(folder);
    state.ResumeTiming();
  }
  state.counters["frames/s"] = benchmark::Counter(static_cast<double>(kFrames), benchmark::Counter::kIsRate);
  state.counters["frames/cpu_s"] = static_cast<double>(kFrames) / processor_s;  // what other work cannot spoil
  state.counters["MiB"] = static_cast<double>(bytes) / (1024.0 * 1024.0);
  state.counters["peak_rss_MiB"] = PeakResidentMiB();
}

}  // namespace
}  // namespace stratalux::bench

int main(int argc, char** argv) {
  using namespace stratalux;
  using namespace stratalux::bench;
  benchmark::Initialize(&argc, argv);
  const auto frames = LoadVisit(kDistinctFrames);
  if (!frames.ok()) {
    std::fprintf(stderr, "write_path_bench: %s\n", frames.status().message().c_str());
    return frames.status().exit_code();
  }
  for (const StoreCodec codec : {StoreCodec::kDelta, StoreCodec::kRaw12})
    benchmark::RegisterBenchmark((std::string("write 1000 frames, ") + ToString(codec)).c_str(),
                                 [&frames, codec](benchmark::State& s) { WriteSession(s, *frames, codec); })
        ->Iterations(1)
        ->UseRealTime()
        ->Unit(benchmark::kMillisecond);
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
