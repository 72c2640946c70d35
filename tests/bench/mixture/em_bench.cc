// SPDX-License-Identifier: Apache-2.0
// EM of the scattering layers: rates by instruction set and threads, the machine's peak, the textbook's loop, Gaussian
// mixtures of OpenCV and Armadillo, how cost grows, and a full-size visitor (docs/benchmarks.md).
//   build/bench/bin/em_bench [--benchmark_filter=...]
//   STRATALUX_BENCH_PROFILES=FILE build/bench/bin/em_bench     writes the peers' profiles for em_sklearn.py, no more
// A component evaluation is one profile x cell of the fine grid x layer x sweep. "grid" counts all of them as the model
// has them; "evaluated" only those not skipped as negligible. Rates are per second of processor time and per core.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <numeric>
#include <string>
#include <thread>
#include <vector>

#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include "fitter/mixture/em_block.h"
#include "fitter/mixture/fine_grid.h"
#include "fitter/mixture/fit_mixture.h"
#include "shared/base/check.h"
#include "tests/bench/mixture/em_peers.h"
#include "tests/bench/mixture/fma_peak.h"
#include "tests/bench/mixture/peer_profiles.h"
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
  const std::vector<int> cells(lights.size(), fit::CellsPerSample(*lights[0], 0, lights[0]->blur_mm[0], EmOptions()));
  std::vector<int64_t> members(kSkins);
  std::iota(members.begin(), members.end(), 0);
  const EmOptions options = Plain(50);
  double grid = 0.0, evaluated = 0.0;
  for (auto _ : state) {
    OnThreads(threads, [&] {
      fit::EmBlock em(lights, usable, cells, options, {});
      em.Fit(members, std::array{0.0}, [](int /*lane*/, int64_t /*profile*/, size_t /*trial*/) {});
      grid = static_cast<double>(em.GridComponents());
      evaluated = static_cast<double>(em.EvaluatedComponents());
    });
  }
  state.counters["grid G/s"] = benchmark::Counter(grid * threads * 1e-9, benchmark::Counter::kIsIterationInvariantRate);
  state.counters["evaluated G/s"] =
      benchmark::Counter(evaluated * threads * 1e-9, benchmark::Counter::kIsIterationInvariantRate);
  fit::ChooseSimdTarget(0);
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
    TextbookEm(photons.at, photons.first_mm, photons.step_mm, kSweeps, layers);
    benchmark::DoNotOptimize(layers.weight.data());
  }
  state.counters["grid G/s"] = benchmark::Counter(static_cast<double>(photons.at.size()) * kLayers * kSweeps * 1e-9,
                                                  benchmark::Counter::kIsIterationInvariantRate);
}

// Accelerated ones; the last bring the divergence below that of peers whose k-means places the clusters first.
constexpr int kOwnSweeps[] = {kPeerSweeps, 200, 500};

const PeerProfiles& Profiles() {
  static const PeerProfiles profiles = MakePeerProfiles(Skins());
  return profiles;
}

// Of a fit, from the profiles it was given and from those without noise.
template <typename FittedLayers>  // LayerSet (int profile)
void CountDivergences(benchmark::State& state, const FittedLayers& fitted) {
  double noisy = 0.0, truth = 0.0;
  for (int i = 0; i < kPeerProfiles; ++i) {
    noisy += DivergenceOf(PhotonsOf(Profiles().noisy, i, 1, kPeerPhotons), fitted(i)) / kPeerProfiles;
    truth += DivergenceOf(PhotonsOf(Profiles().truth, i, 1, kPeerPhotons), fitted(i)) / kPeerProfiles;
  }
  state.counters["divergence"] = noisy;
  state.counters["of the truth"] = truth;
}

enum class Start { kKmeans, kOwn };

void Peer(benchmark::State& state, PeerEm em, Start start) {
  std::vector<LayerSet> fitted(kPeerProfiles);
  for (auto _ : state)
    for (int i = 0; i < kPeerProfiles; ++i) {
      const Photons photons = PhotonsOf(Profiles().noisy, i, 1, kPeerPhotons);
      const LayerSet from = start == Start::kOwn ? OwnStart(Profiles().noisy, i) : LayerSet();
      fitted[i] = em(photons, from, kPeerLayers, kPeerSweeps);
    }
  CountDivergences(state, [&](int i) { return fitted[i]; });
  state.counters["profiles/s"] = benchmark::Counter(kPeerProfiles, benchmark::Counter::kIsIterationInvariantRate);
}

void OwnOnThePeersProfiles(benchmark::State& state) {
  EmOptions options = PeerOptions(static_cast<int>(state.range(0)));
  options.accelerated = state.range(1) != 0;
  setenv("STRATALUX_THREADS", "1", 1);
  const fit::SrdBatch* light = &Profiles().noisy;
  MixtureMap map;
  for (auto _ : state) {
    auto fitted = fit::FitMixture(std::span(&light, 1), {0}, kSkins, 1, 1, options);
    SLX_CHECK(fitted.ok());
    map = *std::move(fitted);
  }
  unsetenv("STRATALUX_THREADS");
  CountDivergences(state, [&](int i) { return fit::LayersOf(map, i); });
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
    repeat(b.y, b.samples);
    repeat(b.valid, 1);
    for (auto* v : {&b.noise_floor, &b.noise_slope, &b.first_u_mm, &b.step_mm, &b.line_width_mm, &b.blur_mm,
                    &b.slope_in, &b.slope_out, &b.cos_in, &b.cos_out, &b.slope_in_across, &b.slope_out_across})
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

void RegisterPeers() {
  auto* own = benchmark::RegisterBenchmark("peer/own", OwnOnThePeersProfiles)->ArgNames({"sweeps", "accelerated"});
  own->Args({kPeerSweeps, 0});
  for (int sweeps : kOwnSweeps) own->Args({sweeps, 1});
  own->Unit(benchmark::kMillisecond)->MeasureProcessCPUTime();
  const std::map<std::string, PeerEm> peers = {{"OpenCV", OpencvEm}, {"Armadillo", ArmadilloEm()}};
  const std::map<std::string, Start> starts = {{"k-means", Start::kKmeans}, {"own start", Start::kOwn}};
  for (const auto& [name, em] : peers)
    for (const auto& [from, start] : starts)
      if (em != nullptr)
        benchmark::RegisterBenchmark(("peer/" + name + "/" + from).c_str(), Peer, em, start)
            ->Unit(benchmark::kMillisecond)
            ->Iterations(1)
            ->MeasureProcessCPUTime();
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
  RegisterPeers();
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
}

struct PeerFit {
  std::string name;
  double rate = 0.0, from_data = 0.0, from_truth = 0.0;  // profiles/s, divergences
};
std::vector<PeerFit> PeerFits() {
  const std::string rate_of = " profiles/s";
  std::vector<PeerFit> fits;
  for (const auto& [name, rate] : Figures()) {
    if (!name.starts_with("peer/") || !name.ends_with(rate_of)) continue;
    const std::string fit = name.substr(0, name.size() - rate_of.size());
    fits.push_back({fit, rate, Figures()[fit + " divergence"], Figures()[fit + " of the truth"]});
  }
  return fits;
}

// Beside each peer the fastest own fit that is no worse by either divergence.
void PrintPeers() {
  std::vector<PeerFit> own = PeerFits();
  const auto others =
      std::partition(own.begin(), own.end(), [](const PeerFit& fit) { return fit.name.starts_with("peer/own"); });
  const std::vector<PeerFit> peers(others, own.end());
  own.erase(others, own.end());
  std::sort(own.begin(), own.end(), [](const PeerFit& a, const PeerFit& b) { return a.rate > b.rate; });
  for (const PeerFit& peer : peers) {
    const auto best = std::find_if(own.begin(), own.end(), [&](const PeerFit& fit) {
      return fit.from_data <= peer.from_data && fit.from_truth <= peer.from_truth;
    });
    std::printf("%s: %.3g profiles/s, divergence %.2e from the data, %.2e from the truth; ", peer.name.c_str(),
                peer.rate, peer.from_data, peer.from_truth);
    if (best == own.end())
      std::printf("no own fit measured is as good\n");
    else
      std::printf("%s: %.0f times as fast, %.2e and %.2e\n", best->name.c_str(), best->rate / peer.rate,
                  best->from_data, best->from_truth);
  }
  if (ArmadilloEm() == nullptr) std::printf("Armadillo's gmm_diag: not measured, built without libarmadillo-dev\n");
}

}  // namespace
}  // namespace stratalux::bench

int main(int argc, char** argv) {
  if (const char* path = std::getenv("STRATALUX_BENCH_PROFILES"))
    return stratalux::bench::WritePeerProfiles(stratalux::bench::Profiles(), path) ? 0 : 1;
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  stratalux::bench::Register();
  stratalux::bench::Reporter reporter;
  benchmark::RunSpecifiedBenchmarks(&reporter);
  stratalux::bench::PrintRatios();
  stratalux::bench::PrintPeers();
  return 0;
}
