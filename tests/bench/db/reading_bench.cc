// SPDX-License-Identifier: Apache-2.0
// What reads whole stores: `reindex` in frames a second, and `verify --deep` beside reading and hashing the same files
// alone.
//   build/bench/bin/reading_bench            (its stores lie under $TMPDIR)
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>
#include <fcntl.h>
#include <unistd.h>
#include <xxhash.h>

#include "db/care/reindex.h"
#include "db/care/verify.h"
#include "db/catalogue/session_store.h"
#include "shared/base/check.h"
#include "shared/base/parallel.h"
#include "shared/base/random.h"

namespace stratalux::bench {
namespace {

namespace fs = std::filesystem;

// A store of simulated sessions with frames of noise; removed at the end.
class Store {
 public:
  Store(int sessions, int frames, int width, int height) : frames_(int64_t{sessions} * frames) {
    folder_ = (fs::temp_directory_path() / "stratalux-bench-XXXXXX").string();
    SLX_CHECK(mkdtemp(folder_.data()) != nullptr);
    SLX_CHECK(db::SessionStore::Create(folder_).ok());
    auto store = db::SessionStore::Open(folder_, db::AccessMode::kReadWrite);
    SLX_CHECK(store.ok());
    Image<uint16_t> pixels(width, height);
    Random random(7);
    for (uint16_t& v : pixels.pixels()) v = static_cast<uint16_t>(random.Bits() & 4095U);
    for (int s = 0; s < sessions; ++s) {
      SessionInfo info;
      info.simulated = true;
      auto writer = store->BeginSession(info, {.codec = StoreCodec::kRaw12, .group_frames = 256});
      SLX_CHECK(writer.ok());
      for (int f = 0; f < frames; ++f) {
        FrameRecord record;
        record.step = f;
        record.trigger_number = f;
        record.driver_sequence = f;
        record.width = width;
        record.height = height;
        SLX_CHECK(writer->Append(record, pixels.view()).ok());
      }
      SLX_CHECK(writer->Finish(SessionStatus::kComplete).ok());
    }
  }
  ~Store() { fs::remove_all(folder_); }
  Store(const Store&) = delete;
  Store& operator=(const Store&) = delete;
  [[nodiscard]] const std::string& folder() const { return folder_; }
  [[nodiscard]] int64_t frames() const { return frames_; }
  [[nodiscard]] std::vector<fs::path> Segments() const {
    std::vector<fs::path> files;
    for (const auto& entry : fs::recursive_directory_iterator(folder_))
      if (entry.path().extension() == ".seg") files.push_back(entry.path());
    return files;
  }

 private:
  std::string folder_;
  int64_t frames_;
};

void ReindexFrames(benchmark::State& state) {
  const Store store(200, 500, 16, 4);
  Logger logger(LogLevel::kError);
  for (auto _ : state) {
    const auto report = db::Reindex(store.folder(), logger);
    SLX_CHECK(report.ok() && report->frames == store.frames());
  }
  state.counters["frames/s"] =
      benchmark::Counter(static_cast<double>(store.frames() * state.iterations()), benchmark::Counter::kIsRate);
}
BENCHMARK(ReindexFrames)->Unit(benchmark::kMillisecond)->UseRealTime()->Iterations(3);

const Store& BigStore() {
  static const Store store(4, 120, 1392, 1042);
  return store;
}

void CountBytes(benchmark::State& state) {
  double bytes = 0.0;
  for (const auto& file : BigStore().Segments()) bytes += static_cast<double>(fs::file_size(file));
  state.counters["GB/s"] =
      benchmark::Counter(1e-9 * bytes * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

// The floor: every byte read once and hashed, on all cores.
void ReadAndHash(benchmark::State& state) {
  const auto files = BigStore().Segments();
  for (auto _ : state)
    ParallelFor(static_cast<int64_t>(files.size()), 1, [&](int64_t begin, int64_t end) {
      std::vector<char> buffer(size_t{4} << 20);
      for (int64_t i = begin; i < end; ++i) {
        const int fd = open(files[i].c_str(), O_RDONLY | O_CLOEXEC);
        XXH3_state_t* hash = XXH3_createState();
        XXH3_128bits_reset(hash);
        for (ssize_t n = 0; (n = read(fd, buffer.data(), buffer.size())) > 0;)
          XXH3_128bits_update(hash, buffer.data(), static_cast<size_t>(n));
        benchmark::DoNotOptimize(XXH3_128bits_digest(hash));
        XXH3_freeState(hash);
        close(fd);
      }
    });
  CountBytes(state);
}
BENCHMARK(ReadAndHash)->Unit(benchmark::kMillisecond)->UseRealTime()->Iterations(5);

void VerifyDeep(benchmark::State& state) {
  const auto store = db::SessionStore::Open(BigStore().folder(), db::AccessMode::kReadOnly);
  SLX_CHECK(store.ok());
  const auto sessions = store->ListSessions();
  for (auto _ : state)
    for (const db::SessionSummary& session : *sessions) {
      const auto report = db::VerifySession(*store, *store->FindSession(session.info.id), {db::VerifyDepth::kDeep});
      SLX_CHECK(report.ok());
      benchmark::DoNotOptimize(report->frames);
    }
  CountBytes(state);
}
BENCHMARK(VerifyDeep)->Unit(benchmark::kMillisecond)->UseRealTime()->Iterations(5);

}  // namespace
}  // namespace stratalux::bench

BENCHMARK_MAIN();
