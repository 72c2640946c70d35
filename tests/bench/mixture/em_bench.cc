// SPDX-License-Identifier: Apache-2.0
// EM of the scattering layers: rates by instruction set and threads, the machine's peak, the textbook's loop, OpenCV's
// EM, how cost grows, and a full-size visitor (docs/benchmarks.md).
//   build/bench/bin/em_bench [--benchmark_filter=...]
// A component evaluation is one profile x cell of the fine grid x layer x sweep. "grid" counts all of them as the model
// has them; "evaluated" only those not skipped as negligible. Rates are per second of processor time and per core.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <numbers>
#include <numeric>
#include <string>
#include <thread>

#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include "fitter/mixture/em_block.h"
#include "fitter/mixture/fit_mixture.h"
#include "shared/base/check.h"
#include "tests/bench/mixture/em_peers.h"
#include "tests/bench/mixture/fma_peak.h"
#include "tests/bench/mixture/textbook_em.h"
#include "tests/fitter/mixture/em_cases.h"
#include "tests/fitter/mixture/simd_targets.h"

namespace stratalux::bench {
namespace {

using fit::EmCases;
using fit::EmOptions;
using fit::LayerSet;
using fit::MixtureMap;

// Figures by name, for the ratios of the last lines.
std::map<std::string, double>& Figures() {
  static std::map<std::string, double> figures;
  return figures;
}

EmOptions Plain(int sweeps, int layers = 20) {
  EmOptions options;
  options.accelerated = false;
  options.tolerance = 0.0;
  options.max_iterations = sweeps;
  options.layers = layers;
  return options;
}

constexpr int kSkins = 512;

const EmCases& Skins(int profiles = kSkins, int samples = 64) {
  static std::map<std::pair<int, int>, EmCases> made;
  const auto [at, is_new] = made.try_emplace({profiles, samples});
  if (is_new) at->second = fit::MakeEmCases({.profiles = profiles, .samples = samples, .alike = 256}, EmOptions(), 1);
  return at->second;
}

MixtureMap Fit(const EmCases& cases, const EmOptions& options) {
  std::vector<int> projectors(cases.batches.size());
  std::iota(projectors.begin(), projectors.end(), 0);
  const int profiles = static_cast<int>(cases.batches[0].profiles());
  auto map = fit::FitMixture(cases.lights(), projectors, profiles, 1, 1, options);
  SLX_CHECK(map.ok());
  return *std::move(map);
}

// Runs `body` on several threads at once; Google Benchmark sums their processor time.
template <typename Body>
void OnThreads(int threads, const Body& body) {
  std::vector<std::thread> pool;
  for (int t = 1; t < threads; ++t) pool.emplace_back(body);
  body();
  for (std::thread& thread : pool) thread.join();
}

// What a machine can do: lanes multiplied and added a second.
void PeakMultiplyAdds(benchmark::State& state, int64_t target) {
  fit::ChooseSimdTarget(target);
  const int threads = static_cast<int>(state.range(0));
  double floats = 0.0;
  for (auto _ : state) OnThreads(threads, [] { MultiplyAdds(2'000'000); });
  floats = static_cast<double>(MultiplyAdds(1) * 2'000'000) * threads;
  state.counters["G/s"] = benchmark::Counter(floats * 1e-9, benchmark::Counter::kIsIterationInvariantRate);
  fit::ChooseSimdTarget(0);
}

// Plain sweeps of blocks of profiles, each thread its own.
void Components(benchmark::State& state, int64_t target) {
  fit::ChooseSimdTarget(target);
  const int threads = static_cast<int>(state.range(0));
  const EmCases& skins = Skins();
  const auto lights = skins.lights();
  const std::vector<std::vector<uint8_t>> usable(lights.size(), std::vector<uint8_t>(kSkins, 1));
  const std::vector<int> cells(lights.size(), fit::CellsPerSample(*lights[0], 0, EmOptions()));
  std::vector<int64_t> members(kSkins);
  std::iota(members.begin(), members.end(), 0);
  const EmOptions options = Plain(50);
  double grid = 0.0, evaluated = 0.0;
  for (auto _ : state) {
    OnThreads(threads, [&] {
      fit::EmBlock em(lights, usable, cells, options, {});
      em.Fit(members, [](int /*lane*/, int64_t /*profile*/) {});
      grid = static_cast<double>(em.GridComponents());
      evaluated = static_cast<double>(em.EvaluatedComponents());
    });
  }
  state.counters["grid G/s"] = benchmark::Counter(grid * threads * 1e-9, benchmark::Counter::kIsIterationInvariantRate);
  state.counters["evaluated G/s"] =
      benchmark::Counter(evaluated * threads * 1e-9, benchmark::Counter::kIsIterationInvariantRate);
  fit::ChooseSimdTarget(0);
}

// One light's profile as a textbook, or a peer, wants it: photons at the cells of the fine grid.
struct Photons {
  std::vector<double> at;
  double first = 0.0, step = 0.0;
};
Photons PhotonsOf(const fit::SrdBatch& b, int64_t profile, int per_sample, double total) {
  Photons p;
  p.step = double(b.step_mm[profile]) / per_sample;
  p.first = double(b.first_u_mm[profile]) - 0.5 * (per_sample - 1) * p.step;
  double sum = 0.0;
  for (int k = 0; k < b.samples; ++k) sum += std::max(double(b.y[profile * b.samples + k]), 0.0);
  for (int k = 0; k < b.samples; ++k)
    for (int j = 0; j < per_sample; ++j)
      p.at.push_back(total * std::max(double(b.y[profile * b.samples + k]), 0.0) / (sum * per_sample));
  return p;
}

LayerSet SpreadStart(int layers) {
  LayerSet set;
  for (int l = 0; l < layers; ++l) {
    set.weight.push_back(1.0 / layers);
    set.depth_mm.push_back(0.02 * l);
    set.sigma_mm.push_back(0.15 * std::pow(40.0, l / (layers - 1.0)));
  }
  return set;
}

void TextbookLoop(benchmark::State& state) {
  const Photons photons = PhotonsOf(Skins().batches[0], 0, 4, 1.0);
  constexpr int kSweeps = 10, kLayers = 20;
  for (auto _ : state) {
    LayerSet layers = SpreadStart(kLayers);
    TextbookEm(photons.at, photons.first, photons.step, kSweeps, layers);
    benchmark::DoNotOptimize(layers.weight.data());
  }
  state.counters["grid G/s"] = benchmark::Counter(static_cast<double>(photons.at.size()) * kLayers * kSweeps * 1e-9,
                                                  benchmark::Counter::kIsIterationInvariantRate);
}

// Divergence of a normalised mixture, integrated over each sample's step, from a profile, as [M 6] compares them.
double DivergenceOf(const Photons& photons, const LayerSet& layers) {
  const auto below = [&](double x) {
    double sum = 0.0;
    for (size_t l = 0; l < layers.weight.size(); ++l)
      sum += layers.weight[l] * 0.5 * std::erfc((layers.depth_mm[l] - x) / (layers.sigma_mm[l] * std::numbers::sqrt2));
    return sum;
  };
  const double total = std::accumulate(photons.at.begin(), photons.at.end(), 0.0);
  const double start = photons.first - 0.5 * photons.step, span = photons.step * static_cast<double>(photons.at.size());
  const double model_total = below(start + span) - below(start);
  double divergence = 0.0;
  for (size_t i = 0; i < photons.at.size(); ++i) {
    const double left = start + static_cast<double>(i) * photons.step;
    const double p = photons.at[i] / total, q = (below(left + photons.step) - below(left)) / model_total;
    if (p > 0.0) divergence += p * std::log(p / std::max(q, 1e-12));
  }
  return divergence;
}

// Own sweeps: as many as bring the divergence below the peer's, whose k-means places its clusters first.
constexpr int kPeerProfiles = 4, kPeerSweeps = 50, kOwnSweeps = 500, kPeerLayers = 20;
constexpr double kPeerPhotons = 5000.0;

// Profiles of one light as a peer can fit them, each on its own with free means: photons alone, as far from the entry
// point as free means may go, and nothing but the step's width between layers and samples.
fit::SrdBatch PeerBatch(fit::SrdBatch b) {
  constexpr double kFarthestMm = 7.5;
  b.line_width_mm = b.step_mm;
  std::fill(b.blur_mm.begin(), b.blur_mm.end(), 0.0F);
  for (size_t i = 0; i < b.y.size(); ++i) {
    const size_t profile = i / b.samples;
    const double u = double(b.first_u_mm[profile]) + static_cast<double>(i % b.samples) * double(b.step_mm[profile]);
    b.y[i] = std::abs(u) < kFarthestMm ? std::max(b.y[i], 0.0F) : 0.0F;
    b.variance[i] = b.y[i] / static_cast<float>(kPeerPhotons);
  }
  return b;
}
const fit::SrdBatch& PeerProfiles() {
  static const fit::SrdBatch batch = PeerBatch(Skins().batches[0]);
  return batch;
}
// What they would be without noise: a mixture that follows the noise is not the better one.
const fit::SrdBatch& PeerTruth() {
  static const fit::SrdBatch batch = [] {
    fit::SrdBatch b = Skins().batches[0];
    for (int i = 0; i < kPeerProfiles; ++i) {
      const auto y = fit::PredictSamples(Skins().skins[i], b, i, EmOptions());
      std::copy(y.begin(), y.end(), b.y.begin() + int64_t{i} * b.samples);
    }
    return PeerBatch(std::move(b));
  }();
  return batch;
}

// Divergences of a fit from the profile it was given and from the one without noise.
void KeepDivergences(benchmark::State& state, const std::string& whose, int profile, const LayerSet& fitted) {
  const double noisy = DivergenceOf(PhotonsOf(PeerProfiles(), profile, 1, kPeerPhotons), fitted);
  const double truth = DivergenceOf(PhotonsOf(PeerTruth(), profile, 1, kPeerPhotons), fitted);
  state.counters["divergence"] = Figures()[whose + " divergence"] += noisy / kPeerProfiles;
  state.counters["of the truth"] = Figures()[whose + " of the truth"] += truth / kPeerProfiles;
}

void PeerOpencv(benchmark::State& state) {
  std::vector<LayerSet> fitted(kPeerProfiles);
  for (auto _ : state)
    for (int i = 0; i < kPeerProfiles; ++i) {
      const Photons photons = PhotonsOf(PeerProfiles(), i, 1, kPeerPhotons);
      fitted[i] = OpencvEm(photons.at, photons.first, photons.step, kPeerLayers, kPeerSweeps);
    }
  Figures()["opencv divergence"] = Figures()["opencv of the truth"] = 0.0;
  for (int i = 0; i < kPeerProfiles; ++i) KeepDivergences(state, "opencv", i, fitted[i]);
  state.counters["profiles/s"] = benchmark::Counter(kPeerProfiles, benchmark::Counter::kIsIterationInvariantRate);
}

void OwnOnThePeersProfiles(benchmark::State& state) {
  EmOptions options = Plain(kOwnSweeps, kPeerLayers);
  options.accelerated = true;
  options.mode = fit::FitMode::kFree;
  options.gain_model = options.surface_term = options.background_term = false;
  setenv("STRATALUX_THREADS", "1", 1);
  const fit::SrdBatch* light = &PeerProfiles();
  MixtureMap map;
  for (auto _ : state) {
    auto fitted = fit::FitMixture(std::span(&light, 1), {0}, kSkins, 1, 1, options);
    SLX_CHECK(fitted.ok());
    map = *std::move(fitted);
  }
  unsetenv("STRATALUX_THREADS");
  Figures()["own divergence"] = Figures()["own of the truth"] = 0.0;
  for (int i = 0; i < kPeerProfiles; ++i) KeepDivergences(state, "own", i, fit::LayersOf(map, i));
  state.counters["profiles/s"] = benchmark::Counter(kSkins, benchmark::Counter::kIsIterationInvariantRate);
}

// Nanoseconds of a core for each profile x sample x layer x sweep: constant where cost is linear.
void Linearity(benchmark::State& state) {
  const int profiles = static_cast<int>(state.range(0)), samples = static_cast<int>(state.range(1)),
            layers = static_cast<int>(state.range(2));
  const EmCases& skins = Skins(profiles, samples);
  setenv("STRATALUX_THREADS", "1", 1);
  for (auto _ : state) Fit(skins, Plain(50, layers));
  unsetenv("STRATALUX_THREADS");
  state.counters["ns"] =
      benchmark::Counter(3e-9 * 50 * profiles * samples * layers,
                         benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

// 696 x 521 pixels, three channels, three projectors, 64 samples, 20 layers: 8,192 skins' noisy profiles in turn.
EmCases FullSize() {
  constexpr int kDistinct = 8192;
  constexpr int64_t kProfiles = int64_t{696} * 521 * 3;
  EmCases cases = fit::MakeEmCases({.profiles = kDistinct, .alike = 256}, EmOptions(), 2);
  for (fit::SrdBatch& b : cases.batches) {
    const auto repeat = [&](auto& values, int64_t each) {
      values.resize(kProfiles * each);
      for (int64_t i = kDistinct * each; i < kProfiles * each; ++i) values[i] = values[i - kDistinct * each];
    };
    for (auto* v : {&b.y, &b.variance}) repeat(*v, b.samples);
    repeat(b.valid, 1);
    for (auto* v : {&b.first_u_mm, &b.step_mm, &b.line_width_mm, &b.blur_mm, &b.slope_in, &b.slope_out, &b.cos_in,
                    &b.cos_out, &b.slope_in_across, &b.slope_out_across})
      repeat(*v, 1);
  }
  return cases;
}

void FullSizeVisitor(benchmark::State& state) {
  const EmCases cases = FullSize();
  double divergence = 0.0;
  for (auto _ : state) {
    const MixtureMap map = Fit(cases, EmOptions());
    for (size_t i = 0; i < 8192; ++i) divergence += double(map.divergence[i]) / 8192;
  }
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  EmCases few = fit::MakeEmCases({.profiles = 8192, .alike = 256}, EmOptions(), 2);
  const MixtureMap plain = Fit(few, Plain(50));
  state.counters["divergence"] = divergence / static_cast<double>(state.iterations());
  state.counters["of 50 plain"] = std::accumulate(plain.divergence.begin(), plain.divergence.end(), 0.0) / 8192;
  state.counters["peak GiB"] = static_cast<double>(usage.ru_maxrss) / (1024.0 * 1024.0);
}

void Register() {
  const std::map<std::string, int64_t> targets = {{"AVX-512", HWY_AVX3}, {"AVX2", HWY_AVX2}, {"NEON", HWY_NEON}};
  for (const auto& [name, target] : targets) {
    if ((hwy::SupportedTargets() & target) == 0) continue;
    for (int threads : {1, 2}) {
      benchmark::RegisterBenchmark(("multiply-adds/" + name).c_str(), PeakMultiplyAdds, target)
          ->Arg(threads)
          ->ArgName("threads")
          ->MeasureProcessCPUTime();
      benchmark::RegisterBenchmark(("components/" + name).c_str(), Components, target)
          ->Arg(threads)
          ->ArgName("threads")
          ->MeasureProcessCPUTime();
    }
  }
  benchmark::RegisterBenchmark("textbook", TextbookLoop);
  benchmark::RegisterBenchmark("peer/own", OwnOnThePeersProfiles)->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("peer/OpenCV", PeerOpencv)
      ->Unit(benchmark::kMillisecond)
      ->Iterations(1)
      ->MeasureProcessCPUTime();
  auto* linear = benchmark::RegisterBenchmark("linear", Linearity)->ArgNames({"profiles", "samples", "layers"});
  for (int profiles : {256, 512, 1024}) linear->Args({profiles, 64, 20});
  for (int samples : {32, 128}) linear->Args({512, samples, 20});
  for (int layers : {5, 10, 32}) linear->Args({512, 64, layers});
  linear->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("visitor", FullSizeVisitor)
      ->Iterations(1)
      ->Unit(benchmark::kSecond)
      ->UseRealTime()
      ->MeasureProcessCPUTime();
}

// Keeps the figures that the ratios need.
class Reporter : public benchmark::ConsoleReporter {
 public:
  Reporter() : ConsoleReporter(OO_None) {}
  void ReportRuns(const std::vector<Run>& runs) override {
    ConsoleReporter::ReportRuns(runs);
    for (const Run& run : runs)
      for (const auto& [name, counter] : run.counters) Figures()[run.benchmark_name() + " " + name] = counter.value;
  }
};

double Figure(const std::string& name) {
  const auto at = Figures().lower_bound(name);
  return at != Figures().end() && at->first.starts_with(name) ? at->second : 0.0;
}

void PrintRatios() {
  for (const char* name : {"AVX-512", "AVX2", "NEON"}) {
    const std::string of = std::string("components/") + name + "/threads:1/process_time ";
    const double grid = Figure(of + "grid"), evaluated = Figure(of + "evaluated");
    const double peak = Figure(std::string("multiply-adds/") + name + "/threads:1/process_time G/s");
    const double textbook = Figure("textbook grid");
    if (!(grid > 0.0) || !(peak > 0.0) || !(textbook > 0.0)) continue;
    // Eight arithmetic instructions for each evaluated component: three in the mass, five in the moments.
    std::printf("%s: %.0f (evaluated ones alone: %.0f) times the textbook's loop; %.0f %% of the multiply-add peak\n",
                name, grid / textbook, evaluated / textbook, 100.0 * 8.0 * evaluated / peak);
  }
  const double own = Figure("peer/own profiles/s"), opencv = Figure("peer/OpenCV/iterations:1/process_time profiles/s");
  if (own > 0.0 && opencv > 0.0)
    std::printf("%.0f times OpenCV's EM; divergence %.2e from the data, %.2e from the truth, OpenCV's %.2e and %.2e\n",
                own / opencv, Figures()["own divergence"], Figures()["own of the truth"],
                Figures()["opencv divergence"], Figures()["opencv of the truth"]);
  std::printf("Armadillo's gmm_diag and scikit-learn: not measured, not installed here\n");
}

}  // namespace
}  // namespace stratalux::bench

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  stratalux::bench::Register();
  stratalux::bench::Reporter reporter;
  benchmark::RunSpecifiedBenchmarks(&reporter);
  stratalux::bench::PrintRatios();
  return 0;
}
