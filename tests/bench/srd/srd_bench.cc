// SPDX-License-Identifier: Apache-2.0
// SRD extraction of one projector at full size (1392x1042 mosaic: 1.09 M profiles x 64 frames), frames in memory: what
// each reading and option costs, and what it gains to take sixteen frames at a time. Reading the frames from the store
// comes on top (reading_bench). Run: build/bench/bin/srd_bench
#include <cmath>
#include <cstdlib>

#include <benchmark/benchmark.h>

#include "fitter/srd/srd_extractor.h"
#include "shared/base/random.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 1392, kHeight = 1042;

struct Visitor {
  RigCalibration rig;
  SurfaceMap surface;
  Image<uint8_t> lit;
  Image<float> dark{kWidth, kHeight, 1, 64.0F};
  std::vector<Image<uint16_t>> frames;
  CombCycle cycle{.period = 128, .width = 2, .step = 2, .exposure_ms = 16.0};
};

Visitor MakeVisitor() {
  Visitor v;
  v.rig.camera.model = {kWidth, kHeight, 3200, 3200, (kWidth - 1) / 2.0, (kHeight - 1) / 2.0, {-0.05, 0.01, 0, 0, 0}};
  v.rig.camera.black_level_dn = 64;
  v.rig.camera.gain_e_per_dn = 4;
  v.rig.camera.read_noise_dn = 3;
  ProjectorCalibration p;
  p.model = {1024, 768, 2300, 2300, 511, 384, {-0.03, 0, 0, 0, 0}};
  p.camera_from_projector = LookAt({-350, -40, 0}, {0, 0, 700});
  p.white_dn_mm2_per_ms = {1.1e8, 1.2e8, 1.0e8};
  v.rig.projectors.push_back(p);
  const int w = kWidth / 2, h = kHeight / 2;
  v.surface = {Image<float>(w, h, 3), Image<float>(w, h, 3), Image<float>(w, h, 1, 0.1F), Image<uint8_t>(w, h, 1, 1)};
  v.lit = Image<uint8_t>(w, h, 1, 1);
  // A curved cheek: z = 700 + r^2 / 300 mm.
  for (int j = 0; j < h; ++j)
    for (int i = 0; i < w; ++i) {
      const Eigen::Vector3d ray = v.rig.camera.model.Unproject(QuadCentre(Cfa::kRggb, i, j));
      Eigen::Vector3d x = ray * (700.0 / ray.z());
      x = ray * ((700.0 + (x.x() * x.x() + x.y() * x.y()) / 300.0) / ray.z());
      const Eigen::Vector3d n = Eigen::Vector3d(2 * x.x() / 300.0, 2 * x.y() / 300.0, -1.0).normalized();
      for (int k = 0; k < 3; ++k) {
        v.surface.point_mm(i, j, k) = static_cast<float>(x[k]);
        v.surface.normal(i, j, k) = static_cast<float>(n[k]);
      }
    }
  Random random(1);
  for (int k = 0; k < v.cycle.frames(); ++k) {
    v.frames.emplace_back(kWidth, kHeight);
    for (uint16_t& raw : v.frames.back().pixels()) raw = static_cast<uint16_t>(80 + random.Bits() % 256);
  }
  return v;
}

void Extract(benchmark::State& state, const SrdOptions& options, int at_a_time, std::vector<double> brackets) {
  static const Visitor visitor = MakeVisitor();
  setenv("STRATALUX_THREADS", std::to_string(state.range(0)).c_str(), 1);
  int64_t valid = 0;
  for ([[maybe_unused]] auto iteration : state) {
    SrdExtractor extractor(visitor.surface, visitor.lit, visitor.rig, 0, visitor.cycle, options);
    for (int k = 0; k < visitor.cycle.frames(); k += at_a_time) {
      std::vector<CombFrame> block;
      for (int f = k; f < k + at_a_time; ++f) {
        block.push_back({f, {}});
        for (double factor : brackets)
          block.back().shots.push_back({visitor.frames[f], visitor.dark, visitor.cycle.exposure_ms * factor});
      }
      extractor.AddFrames(block);
    }
    const SrdBatch batch = extractor.Take();
    valid = extractor.counts()[0];
    benchmark::DoNotOptimize(batch.y.data());
  }
  unsetenv("STRATALUX_THREADS");
  state.counters["profiles"] = static_cast<double>(valid);
  state.counters["frames/s"] =
      benchmark::Counter(static_cast<double>(state.iterations() * visitor.cycle.frames()), benchmark::Counter::kIsRate);
}

void Gather(benchmark::State& state) { Extract(state, {}, 16, {1.0}); }
void GatherFrameByFrame(benchmark::State& state) { Extract(state, {}, 1, {1.0}); }
void GatherTwoBrackets(benchmark::State& state) { Extract(state, {}, 8, {1.0, 4.0}); }
void GatherAlongSurface(benchmark::State& state) { Extract(state, {.distance = SrdDistance::kSurface}, 16, {1.0}); }
void Scatter(benchmark::State& state) { Extract(state, {.reading = SrdReading::kScatter}, 16, {1.0}); }

BENCHMARK(Gather)->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();
BENCHMARK(GatherFrameByFrame)->Arg(1)->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();
BENCHMARK(GatherTwoBrackets)->Arg(1)->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();
BENCHMARK(GatherAlongSurface)->Arg(1)->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();
BENCHMARK(Scatter)->Arg(1)->Unit(benchmark::kMillisecond)->UseRealTime()->MeasureProcessCPUTime();

}  // namespace
}  // namespace stratalux::fit
