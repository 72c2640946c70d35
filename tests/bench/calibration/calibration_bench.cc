// SPDX-License-Identifier: Apache-2.0
// What a calibration costs, stage by stage, and how well it predicts held-out poses beside OpenCV's stereoCalibrate on
// the same corners (docs/benchmarks.md).
//   STRATALUX_BENCH_STORE=store build/bench/bin/calibration_bench      store: sessions of kind calibration (ChArUco)
// Without a store: the real boards of the test data alone. Processor seconds of all threads.
#include <cstdio>
#include <cstdlib>
#include <string>

#include <benchmark/benchmark.h>

#include "db/catalogue/session_store.h"
#include "fitter/calibration/board_stage.h"
#include "fitter/calibration/calibrate_rig.h"
#include "shared/base/check.h"
#include "tests/fitter/calibration/opencv_peer.h"
#include "tests/fitter/calibration/real_boards.h"

namespace stratalux::fit {
namespace {

struct Rig {
  std::string name;
  CalibrationObservations observations;
  double ours_px = 0.0;  // held out
};

void Once(benchmark::internal::Benchmark* b) {
  b->Iterations(1)->Unit(benchmark::kSecond)->MeasureProcessCPUTime()->UseRealTime();
}

std::vector<std::string> BoardSessions(const std::string& store) {
  const auto opened = db::SessionStore::Open(store, db::AccessMode::kReadOnly);
  SLX_CHECK(opened.ok());
  const auto rows = opened->ListSessions();
  SLX_CHECK(rows.ok());
  std::vector<std::string> sessions;
  for (const db::SessionSummary& row : *rows)
    if (row.info.kind == SessionKind::kCalibration) sessions.push_back(row.info.id);
  return sessions;
}

void Observe(benchmark::State& state, const std::string& store, Rig& rig) {
  Logger logger;
  for (auto _ : state) {
    auto boards = ObserveBoards(store, BoardSessions(store), {}, logger);
    SLX_CHECK(boards.ok());
    rig.observations = std::move(boards->observations);
  }
  state.counters["poses"] = static_cast<double>(rig.observations.poses.size());
}

void Calibrate(benchmark::State& state, const Rig& rig) {
  for (auto _ : state) {
    const auto report = CalibrateRig(rig.observations);
    SLX_CHECK(report.ok());
    benchmark::DoNotOptimize(report);
    state.counters["rms_px"] = report->training_total.JointRms();
  }
}

void OursHeldOut(benchmark::State& state, Rig& rig) {
  for (auto _ : state) rig.ours_px = HeldOutOfOurs(rig.observations);
  state.counters["held_out_px"] = rig.ours_px;
}

void TheirsHeldOut(benchmark::State& state, const Rig& rig, const PeerSettings& settings) {
  double px = 0.0;
  for (auto _ : state) px = HeldOutOfOpenCv(rig.observations, settings);
  state.counters["held_out_px"] = px;
  state.counters["over_ours"] = px / rig.ours_px;
}

void Register(Rig& rig) {
  Once(benchmark::RegisterBenchmark((rig.name + "/calibrate").c_str(),
                                    [&rig](benchmark::State& state) { Calibrate(state, rig); }));
  Once(benchmark::RegisterBenchmark((rig.name + "/held_out/ours").c_str(),
                                    [&rig](benchmark::State& state) { OursHeldOut(state, rig); }));
  for (const PeerSettings& settings : kPeerSettings)
    Once(benchmark::RegisterBenchmark(
        (rig.name + "/held_out/stereoCalibrate, " + ToString(settings)).c_str(),
        [&rig, settings](benchmark::State& state) { TheirsHeldOut(state, rig, settings); }));
}

}  // namespace
}  // namespace stratalux::fit

int main(int argc, char** argv) {
  using namespace stratalux::fit;
  benchmark::Initialize(&argc, argv);
  auto real_boards = ObserveRealBoards();
  SLX_CHECK(real_boards.ok());
  Rig stored{"store", {}}, real{"real", std::move(real_boards).value()};
  if (const char* store = std::getenv("STRATALUX_BENCH_STORE")) {
    Once(benchmark::RegisterBenchmark("store/observe",
                                      [&, store](benchmark::State& state) { Observe(state, store, stored); }));
    Register(stored);
  }
  if (!real.observations.poses.empty()) Register(real);
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
