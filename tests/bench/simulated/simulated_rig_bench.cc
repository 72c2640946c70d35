// SPDX-License-Identifier: Apache-2.0
// Frames per second of the simulated rig through its devices' interfaces, and what the making of one projector's light
// transport costs. Run: build/bench/bin/simulated_rig_bench
#include <map>
#include <tuple>

#include <benchmark/benchmark.h>

#include "firmware-host/simulated/simulated_rig.h"

namespace stratalux::rig {
namespace {

struct Case {
  const char* scene;
  int width, height;
  bool scattering;
};
constexpr Case kCases[] = {{"head", 696, 520, true},
                           {"head", 1392, 1042, true},
                           {"head", 1392, 1042, false},
                           {"checkerboard", 1392, 1042, false}};

SimulatedRigOptions OptionsOf(const Case& c) {
  SimulatedRigOptions options;
  options.scene = c.scene;
  options.camera_width = c.width;
  options.camera_height = c.height;
  options.scattering = c.scattering;
  return options;
}

CapturedFrame Shoot(SimulatedRig& rig, const Pattern& pattern) {
  (void)rig.projectors()[1]->Load({pattern}).ok();
  (void)rig.lines().TriggerProjector(1).ok();
  (void)rig.lines().WaitSync(std::chrono::milliseconds(50)).ok();
  (void)rig.lines().TriggerCamera().ok();
  return std::move(**rig.camera().Wait(std::chrono::seconds(60)));
}

std::unique_ptr<SimulatedRig> Make(const Case& c) {
  static Logger shared(LogLevel::kError);
  auto rig = *SimulatedRig::Create(OptionsOf(c), shared);
  (void)rig->camera().Start().ok();
  (void)rig->switches()[1]->Set(true);
  return rig;
}

Pattern PatternOf(int64_t k) {
  switch (k % 3) {
    case 0:
      return {.kind = PatternKind::kComb, .period = 128, .width = 2, .shift = static_cast<int>(k % 64) * 2};
    case 1:
      return {.kind = PatternKind::kGray, .bit = static_cast<int>(k % 10), .bits = 10};
    default:
      return {.kind = PatternKind::kSinusoid, .axis = PatternAxis::kRows, .period = 8, .shift = 1, .shifts = 4};
  }
}

void Frames(benchmark::State& state) {
  const Case& c = kCases[state.range(0)];
  const auto rig = Make(c);
  Shoot(*rig, PatternOf(0));  // makes the light transport
  int64_t k = 0;
  for (auto _ : state) benchmark::DoNotOptimize(Shoot(*rig, PatternOf(++k)).pixels.data());
  state.counters["frames/s"] = benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
  state.SetLabel(std::string(c.scene) + " " + std::to_string(c.width) + "x" + std::to_string(c.height) +
                 (c.scattering ? "" : " opaque"));
}
BENCHMARK(Frames)->DenseRange(0, 3)->Unit(benchmark::kMillisecond)->UseRealTime()->MinTime(2.0);

void FirstFrame(benchmark::State& state) {
  const Case& c = kCases[state.range(0)];
  for (auto _ : state) {
    state.PauseTiming();
    const auto rig = Make(c);
    state.ResumeTiming();
    benchmark::DoNotOptimize(Shoot(*rig, PatternOf(0)).pixels.data());
  }
  state.SetLabel(std::string(c.scene) + " " + std::to_string(c.width) + "x" + std::to_string(c.height) +
                 (c.scattering ? "" : " opaque"));
}
BENCHMARK(FirstFrame)->DenseRange(0, 3)->Unit(benchmark::kMillisecond)->UseRealTime()->Iterations(1);

}  // namespace
}  // namespace stratalux::rig
