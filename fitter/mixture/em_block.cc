// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_block.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <ranges>
#include <utility>

#include "fitter/mixture/em_projection.h"
#include "shared/base/check.h"

namespace stratalux::fit {
namespace {

constexpr float kTiny = 1e-12F;
constexpr float kFreeReachMm = 8.0F;  // of a mean in free mode

void AddBack(const LaneRow& back, std::span<float> q) {
  if (std::ranges::all_of(back.at, [](float b) { return b == 0.0F; })) return;
  for (size_t at = 0; at < q.size(); ++at) q[at] += back[at % kEmLanes];
}

}  // namespace

EmBlock::EmBlock(std::span<const SrdBatch* const> lights, std::span<const std::vector<uint8_t>> usable,
                 std::span<const int> cells_per_sample, const EmOptions& options, const StartLayers& start)
    : options_(options),
      most_sweeps_(start.empty() ? options.max_iterations : options.refinement_iterations),
      batches_(lights),
      usable_(usable),
      start_(start),
      accelerated_(options.accelerated),
      lights_(lights.size()),
      rows_{options.layers, static_cast<int>(lights.size())} {
  const bool free = options.scattering.mode == FitMode::kFree;
  bounds_.least_depth_mm = free ? -kFreeReachMm : static_cast<float>(options.min_depth_mm);
  bounds_.most_depth_mm = free ? kFreeReachMm : static_cast<float>(options.max_depth_mm);
  bounds_.fixed_depth = options.direction_blind;
  for (auto* v : {&at_, &image_, &last_}) v->assign(RowOf(rows_.size()), 0.0F);
  for (auto* v : {&cell_weight_, &cell_mean_, &cell_sigma_}) v->assign(RowOf(options.layers), 0.0F);
  if (!options.scattering.directional.Off()) factor_.assign(RowOf(options.layers), 1.0F);
  moments_.assign(RowOf(3 * options.layers), 0.0F);
  for (size_t p = 0; p < lights.size(); ++p) {
    EmLight& light = lights_[p];
    light.samples = lights[p]->samples;
    light.cells_per_sample = cells_per_sample[p];
    light.pad_cells = lights[p]->wrapped ? 0 : light.cells_per_sample * light.samples / 4;
    light.grid = {light.cells_per_sample * light.samples + 2 * light.pad_cells, lights[p]->wrapped};
    light.reach_limit = std::max(light.grid.cells / 2 - 1, 0);
    light.halo_samples = (light.pad_cells + light.reach_limit) / light.cells_per_sample + 2;
    for (auto* v : {&light.data, &light.surface_response, &light.model}) v->assign(RowOf(light.samples), 0.0F);
    light.response.assign(RowOf(light.taps()), 0.0F);
    light.unseen.assign(RowOf(light.grid.cells), 0.0F);
  }
  for (int lane = 0; lane < kEmLanes; ++lane) Clear(lane);
}

// An idle lane: no light, no layers, numbers that divide well.
void EmBlock::Clear(int lane) {
  lanes_[lane] = {};
  ClearLayers(lane);
  bounds_.least_sigma_mm[lane] = bounds_.most_sigma_mm[lane] = 1.0F;
  for (EmLight& light : lights_) ClearLane(lane, light);
}

void EmBlock::ClearLayers(int lane) {
  for (int row = 0; row < rows_.size(); ++row)
    at_[RowOf(row) + lane] = image_[RowOf(row) + lane] = last_[RowOf(row) + lane] = 0.0F;
  for (int l = 0; l < rows_.layers; ++l) At(rows_.sigma(l), lane) = 1.0F;
  prior_.Clear(lane);
}

void EmBlock::Load(int lane, int64_t profile) {
  Clear(lane);
  lanes_[lane].profile = profile;
  float floor = static_cast<float>(options_.min_sigma_mm);
  for (size_t p = 0; p < lights_.size(); ++p) {
    if (usable_[p][profile] == 0) continue;
    LoadLane(options_.scattering, *batches_[p], profile, lane, lights_[p]);
    floor = std::max(floor, 0.9F * lights_[p].cell_mm[lane]);
  }
  bounds_.least_sigma_mm[lane] = floor;
  bounds_.most_sigma_mm[lane] = std::max(floor, static_cast<float>(options_.max_sigma_mm));
}

// The loaded profile from its start, with a prior of `photons`.
void EmBlock::Begin(int lane, size_t trial, double photons) {
  lanes_[lane] = {.profile = lanes_[lane].profile, .trial = trial};
  ClearLayers(lane);
  Start(lane, photons);
  lanes_[lane].pace.last = most_sweeps_ == 0;
}

void EmBlock::Start(int lane, double photons) {
  double total = 0.0, exposure = 0.0, longest = 0.0;
  for (size_t p = 0; p < lights_.size(); ++p) {
    const EmLight& light = lights_[p];
    if (!(light.counts[lane] > 0.0F)) continue;
    const auto y = batches_[p]->Samples(lanes_[lane].profile);
    const double white = light.white_weight[lane];
    total +=
        (std::max(std::accumulate(y.begin(), y.end(), 0.0), 1e-6) + white * light.white[lane]) * light.counts[lane];
    exposure += double(light.counts[lane]) * light.gain[lane] * light.coverage[lane] * (1.0 + white);
    longest = std::max(longest, double(light.cell_mm[lane]) * light.grid.cells);
    for (int k = 0; k < light.samples; ++k)
      lanes_[lane].total += double(light.counts[lane]) * light.data[RowOf(k) + lane];
    lanes_[lane].total += light.counts[lane] * white * light.white[lane];
  }
  if (!(exposure > 0.0)) return;
  // What each light shows of the surface and of the layers; light of the layers per exposure.
  double layers = 0.0;
  for (size_t p = 0; p < lights_.size(); ++p) {
    const EmLight& light = lights_[p];
    if (!(light.counts[lane] > 0.0F)) continue;
    const double shown = total / exposure * light.gain[lane];
    double surface = 0.0;
    if (options_.surface_term)
      surface = light.reflected[lane] < 0.0F ? kUnknownSurface * shown : double(light.reflected[lane]);
    At(rows_.surface(static_cast<int>(p)), lane) = static_cast<float>(surface);
    layers += light.counts[lane] * light.coverage[lane] * (shown - surface) * (1.0 + light.white_weight[lane]);
  }
  // White frames, by which surfaces are held, and samples differ by their noise.
  layers = std::max(layers, (1.0 - kMostSurface) * total) / exposure;
  const LayerSet known = start_.Of(lanes_[lane].profile);
  double floor = 0.02;  // share of the light over a whole cycle or window
  if (!known.weight.empty()) {
    floor = known.background / std::max(std::accumulate(known.weight.begin(), known.weight.end(), 0.0), 1e-9);
    StartFrom(known, lane, layers);
  } else {
    SpreadLayers(lane, total / exposure, std::min(options_.max_sigma_mm, longest / 4.0));
  }
  for (int p = 0; p < rows_.lights; ++p) {
    const EmLight& light = lights_[p];
    if (!(light.counts[lane] > 0.0F) || !options_.background_term) continue;
    At(rows_.background(p), lane) =
        static_cast<float>(floor * total / exposure * light.gain[lane] * light.coverage[lane] / light.samples);
  }
  if (options_.shared_background) ShareBackground(at_.data());
  lanes_[lane].own = total;
  const double of_prior = start_.Photons(lanes_[lane].profile, photons);
  if (of_prior > 0.0 && prior_.On() && !known.weight.empty()) prior_.Set(lane, of_prior, at_.data());
}

// Widths spread logarithmically, depths growing with the width, the observed total shared out in proportion to 1 /
// width: EM raises a wide layer that the data ask for faster than it lowers one whose light is below the noise of a
// sample.
void EmBlock::SpreadLayers(int lane, double total, double widest_mm) {
  const double narrowest = bounds_.least_sigma_mm[lane];
  double share = 0.0;
  for (int l = 0; l < options_.layers; ++l) {
    const double f = options_.layers > 1 ? static_cast<double>(l) / (options_.layers - 1) : 0.5;
    const double sigma = narrowest * 1.1 * std::pow(std::max(widest_mm * 0.7, narrowest * 2) / (narrowest * 1.1), f);
    At(rows_.sigma(l), lane) = static_cast<float>(sigma);
    At(rows_.depth(l), lane) = options_.direction_blind ? 0.0F : static_cast<float>(std::min(0.3 * sigma, 1.0));
    At(rows_.weight(l), lane) = static_cast<float>(total / sigma);
    share += 1.0 / sigma;
  }
  for (int l = 0; l < options_.layers; ++l) At(rows_.weight(l), lane) /= static_cast<float>(share);
}

void EmBlock::StartFrom(const LayerSet& layers, int lane, double total) {
  double sum = 0.0;
  for (double w : layers.weight) sum += w;
  for (int l = 0; l < options_.layers; ++l) {
    At(rows_.weight(l), lane) = static_cast<float>(layers.weight[l] / std::max(sum, 1e-9) * total);
    At(rows_.depth(l), lane) = options_.direction_blind ? 0.0F : static_cast<float>(layers.depth_mm[l]);
    At(rows_.sigma(l), lane) = std::max(static_cast<float>(layers.sigma_mm[l]), bounds_.least_sigma_mm[lane]);
  }
}

// The E step of every light and, where layers are still to be updated, the M step.
void EmBlock::Sweep(bool update) {
  for (auto* v : {&sums_.photons, &sums_.moved, &sums_.leverage, &sums_.spread, &sums_.exposure})
    v->assign(RowOf(rows_.layers), 0.0F);
  divergence_ = {};
  if (prior_.On()) prior_.BeginSweep();
  const float* factor = factor_.empty() ? nullptr : factor_.data();
  const LayersOnGrid layers{rows_.layers, cell_weight_.data(), cell_mean_.data(), cell_sigma_.data()};
  thread_local EmWork work;  // of all blocks: theirs would push each other out of the cache
  for (int p = 0; p < rows_.lights; ++p) {
    EmLight& light = lights_[p];
    work.MakeRoomFor(light);
    if (factor != nullptr)
      DirectionalFactors(rows_, options_.scattering.directional, at_.data(), light, factor_.data());
    PlaceLayers(rows_, at_.data(), light, factor, cell_weight_.data(), cell_mean_.data(), cell_sigma_.data());
    const int64_t before = work.tiles.evaluated();
    AddLayers(light.grid, layers, work.tiles, work.Mass(light));
    evaluated_components_ += work.tiles.evaluated() - before;
    Project(light, work, at_.data() + RowOf(rows_.surface(p)), at_.data() + RowOf(rows_.background(p)));
    Compare(light, work, divergence_.data());
    AddWhite(p);
    if (prior_.On()) prior_.AddShown(p, light, at_.data(), cell_weight_.data());
    if (!update) continue;
    ProjectBack(light, work);
    AddBack(light.white_back, {work.q.data(), RowOf(light.grid.cells)});
    LayerMoments(layers, work.tiles, work.q.data(), moments_.data());
    AddMoments(rows_.layers, light, moments_.data(), sums_);
    UpdateFloor(p);
  }
  if (prior_.On()) prior_.AddCost(at_.data(), divergence_.data());
  if (update) UpdateParameters();
}

// The E step of a thinned cycle's white frames: all columns at once, as the samples' sum would be in the mean.
void EmBlock::AddWhite(int p) {
  EmLight& light = lights_[p];
  for (int i = 0; i < kEmLanes; ++i) {
    light.white_back[i] = 0.0F;
    if (!(light.white_weight[i] > 0.0F)) continue;
    double model = At(rows_.surface(p), i);
    for (int l = 0; l < rows_.layers; ++l) model += cell_weight_[RowOf(l) + i];
    model = model * light.coverage[i] + double(light.samples) * At(rows_.background(p), i);
    const double data = light.white[i], photons = double(light.counts[i]) * light.white_weight[i];
    model = std::max(model, double(kTiny));
    light.white_back[i] = static_cast<float>(light.white_weight[i] * light.coverage[i] * data / model);
    divergence_[i] += static_cast<float>(photons * (model - data + data * std::log(data / model)));
  }
}

// EM of the two terms that no layer holds.
void EmBlock::UpdateFloor(int p) {
  const EmLight& light = lights_[p];
  const float* at = at_.data();
  float* image = image_.data();
  const size_t surface = RowOf(rows_.surface(p)), background = RowOf(rows_.background(p));
  const bool held = options_.scattering.reflection.Known();
  for (int i = 0; i < kEmLanes; ++i) {
    const float white = light.white_weight[i] * light.coverage[i], back = light.white_back[i];
    image[surface + i] =
        held ? at[surface + i]
             : at[surface + i] * (light.surface_ratio[i] + back) / std::max(light.surface_total[i] + white, kTiny);
    const float to_samples = light.coverage[i] > 0.0F ? static_cast<float>(light.samples) / light.coverage[i] : 0.0F;
    image[background + i] = at[background + i] * (light.ratio_sum[i] + back * to_samples) /
                            (static_cast<float>(light.samples) * (1.0F + light.white_weight[i]));
  }
}

void EmBlock::UpdateParameters() {
  if (prior_.On()) prior_.AddPhotons(lights_, at_.data(), sums_, image_.data());
  if (options_.shared_background) ShareBackground(image_.data());
  UpdateShapes(rows_, bounds_, sums_, at_.data(), image_.data());
  for (const EmLight& light : lights_) {
    if (!factor_.empty())
      DirectionalFactors(rows_, options_.scattering.directional, image_.data(), light, factor_.data());
    AddExposure(rows_.layers, light, factor_.empty() ? nullptr : factor_.data(), sums_);
  }
  UpdateWeights(rows_, sums_, image_.data());
  if (prior_.On()) prior_.KeepTotal(lights_, sums_, image_.data());
}

// One floor for all lights: the mean of theirs, weighted by the photons each would see of it.
void EmBlock::ShareBackground(float* parameters) const {
  for (int i = 0; i < kEmLanes; ++i) {
    float photons = 0.0F, exposure = 0.0F;
    for (int p = 0; p < rows_.lights; ++p) {
      const float seen = lights_[p].counts[i] * static_cast<float>(lights_[p].samples);
      photons += seen * parameters[RowOf(rows_.background(p)) + i];
      exposure += seen;
    }
    for (int p = 0; p < rows_.lights; ++p)
      if (lights_[p].counts[i] > 0.0F) parameters[RowOf(rows_.background(p)) + i] = photons / exposure;
  }
}

// What each lane does with the sweep just made.
void EmBlock::Judge() {
  for (int i = 0; i < kEmLanes; ++i) {
    Lane& lane = lanes_[i];
    step_[i] = kStay;
    momentum_[i] = 0.0F;
    if (lane.profile < 0 || lane.pace.last) continue;
    const double now = lane.total > 0.0 ? divergence_[i] / lane.total : 0.0;
    step_[i] = lane.pace.Judge(now, options_.tolerance, accelerated_, most_sweeps_, momentum_[i]);
  }
}

// Where the lanes stand without momentum is where they would end.
void EmBlock::TellCosts() {
  const auto told = [&](int i) { return step_[i] != kStay && lanes_[i].pace.sweeps <= traced_sweeps_; };
  const auto lanes = std::views::iota(0, kEmLanes);
  if (std::ranges::none_of(lanes, told)) return;
  const LaneRows at = at_, last = last_;
  const LaneRow no_momentum{};
  Advance(rows_, bounds_, step_.data(), no_momentum.data(), image_.data(), last_.data(), at_.data());
  Sweep(false);
  for (const int i : lanes)
    if (told(i)) traced_(lanes_[i].profile, lanes_[i].pace.sweeps, divergence_[i]);
  at_ = at;
  last_ = last;
}

// Of sample k's model, what no scale may change.
double EmBlock::HeldSurface(const EmLight& light, int p, int k, int lane) const {
  if (!options_.scattering.reflection.Known()) return 0.0;
  return double(at_[RowOf(rows_.surface(p)) + lane]) * light.surface_response[RowOf(k) + lane];
}

// The shape is EM's; its scale and that of the white frames are averaged by their Fisher information. White frames of a
// whole cycle enter here and not as samples of EM: they know nothing of positions and would only slow it down. `model`
// holds predictions.
double EmBlock::ScaleToWhite(int lane) const {
  double information = 0.0, scaled = 0.0;
  bool any = false;
  for (int p = 0; p < rows_.lights; ++p) {
    const EmLight& light = lights_[p];
    if (!(light.counts[lane] > 0.0F)) continue;
    double sum = 0.0, of_samples = 0.0, held = 0.0;
    for (int k = 0; k < light.samples; ++k) {
      const double model = light.model[RowOf(k) + lane], surface = HeldSurface(light, p, k, lane), m = model - surface;
      sum += m;
      held += surface;
      of_samples += m * m * light.counts[lane] / std::max(model + light.shift[lane], double(kTiny));
    }
    information += of_samples;
    scaled += of_samples;  // EM's own scale: 1
    // EM has seen those of a thinned cycle.
    if (!(light.white_variance[lane] > 0.0F) || !(sum > 0.0) || light.white_weight[lane] > 0.0F) continue;
    const double of_white = sum * sum / light.white_variance[lane];
    information += of_white;
    scaled += of_white * (light.white[lane] - held) / sum;
    any = true;
  }
  return any && scaled > 0.0 ? scaled / information : 1.0;
}

void EmBlock::Finish(int lane) {
  const double scale = lanes_[lane].scale = ScaleToWhite(lane);
  for (int l = 0; l < rows_.layers; ++l) At(rows_.weight(l), lane) *= static_cast<float>(scale);
  for (int p = 0; p < rows_.lights; ++p) {
    At(rows_.background(p), lane) *= static_cast<float>(scale);
    if (!options_.scattering.reflection.Known()) At(rows_.surface(p), lane) *= static_cast<float>(scale);
  }
}

// `model` holds predictions before the scale.
double EmBlock::Divergence(int lane) const {
  const double scale = lanes_[lane].scale;
  double divergence = 0.0, total = 0.0;  // of samples alone
  for (int p = 0; p < rows_.lights; ++p) {
    const EmLight& light = lights_[p];
    if (!(light.counts[lane] > 0.0F)) continue;
    for (int k = 0; k < light.samples; ++k) {
      const double data = light.data[RowOf(k) + lane], held = HeldSurface(light, p, k, lane);
      const double model =
          std::max((light.model[RowOf(k) + lane] - held) * scale + held + light.shift[lane], double(kTiny));
      divergence += light.counts[lane] * (model - data + (data > 0.0 ? data * std::log(data / model) : 0.0));
      total += light.counts[lane] * data;
    }
  }
  return total > 0.0 ? divergence / total : 0.0;
}

// Of all that a block fits; lanes without photons are not held.
EmPrior EmBlock::PriorFor(std::span<const double> photons) const {
  if (start_.empty() || std::ranges::none_of(photons, [](double n0) { return n0 > 0.0; })) return {};
  const bool free = options_.scattering.mode == FitMode::kFree;
  return EmPrior(rows_, free ? 0.0 : options_.prior.square_shift, options_.scattering.reflection.Known());
}

void EmBlock::Fit(std::span<const int64_t> profiles, std::span<const double> photons,
                  const std::function<void(int lane, int64_t profile, size_t trial)>& done) {
  prior_ = PriorFor(photons);
  size_t next = 0;
  int busy = 0;
  const auto take_next = [&](int lane) {
    Load(lane, profiles[next++]);
    Begin(lane, 0, photons[0]);
  };
  for (int lane = 0; lane < kEmLanes && next < profiles.size(); ++lane, ++busy) take_next(lane);
  while (busy > 0) {
    int sweeping = 0;
    std::array<bool, kEmLanes> finished{};
    for (int i = 0; i < kEmLanes; ++i) {
      finished[i] = lanes_[i].profile >= 0 && lanes_[i].pace.last;
      sweeping += lanes_[i].profile >= 0 && !lanes_[i].pace.last ? 1 : 0;
    }
    Sweep(sweeping > 0);
    for (const EmLight& light : lights_) grid_components_ += int64_t{light.grid.cells} * rows_.layers * sweeping;
    if (sweeping > 0) {
      Judge();
      TellCosts();
      Advance(rows_, bounds_, step_.data(), momentum_.data(), image_.data(), last_.data(), at_.data());
    }
    for (int lane = 0; lane < kEmLanes; ++lane) {
      if (!finished[lane]) continue;
      Finish(lane);
      const size_t trial = lanes_[lane].trial;
      done(lane, lanes_[lane].profile, trial);
      if (trial + 1 < photons.size()) {
        Begin(lane, trial + 1, photons[trial + 1]);
      } else if (next < profiles.size()) {
        take_next(lane);
      } else {
        Clear(lane);
        --busy;
      }
    }
  }
}

void EmBlock::Hold(std::span<const int64_t> profiles) {
  SLX_CHECK(profiles.size() <= size_t{kEmLanes});
  held_.assign(profiles.begin(), profiles.end());
  prior_ = {};
  for (int lane = 0; lane < static_cast<int>(held_.size()); ++lane) {
    Load(lane, held_[lane]);
    Begin(lane, 0, 0.0);
    for (int l = 0; l < rows_.layers; ++l) lanes_[lane].brightness += Weight(l, lane);
  }
}

LayerSet EmBlock::StartOf(int lane) const {
  LayerSet layers;
  for (int l = 0; l < rows_.layers; ++l) {
    layers.weight.push_back(Weight(l, lane));
    layers.depth_mm.push_back(DepthMm(l, lane));
    layers.sigma_mm.push_back(SigmaMm(l, lane));
  }
  return layers;
}

void EmBlock::Expect(std::span<const LayerSet* const> layers) {
  const int held = static_cast<int>(held_.size());
  for (int lane = 0; lane < held; ++lane) StartFrom(*layers[lane], lane, lanes_[lane].brightness);
  Sweep(true);
  for (int lane = 0; lane < held; ++lane) {
    double photons = 0.0, shown = 0.0;
    for (int l = 0; l < rows_.layers; ++l) {
      photons += sums_.photons[RowOf(l) + lane];
      shown += double(Weight(l, lane)) / lanes_[lane].brightness * sums_.exposure[RowOf(l) + lane];
    }
    if (photons > 0.0 && shown > 0.0) lanes_[lane].brightness = photons / shown;
    for (int p = 0; p < rows_.lights; ++p)
      for (const int row : {rows_.surface(p), rows_.background(p)}) At(row, lane) = image_[RowOf(row) + lane];
  }
}

EmBlock::LayerSums EmBlock::HeldSum(int layer, int lane) const {
  const size_t at = RowOf(layer) + lane;
  return {sums_.photons[at], sums_.moved[at], sums_.leverage[at], sums_.spread[at],
          lanes_[lane].brightness * sums_.exposure[at]};
}

void EmBlock::Take(const MixtureMap& fit, int lane) {
  for (int l = 0; l < rows_.layers; ++l) {
    const size_t at = static_cast<size_t>(lanes_[lane].profile) * fit.layers + l;
    At(rows_.weight(l), lane) = fit.weight[at];
    At(rows_.depth(l), lane) = fit.depth_mm[at];
    At(rows_.sigma(l), lane) = fit.sigma_mm[at];
  }
  const UnlayeredLight mean = MeanOfLights(fit, lanes_[lane].profile);
  for (int p = 0; p < rows_.lights; ++p) {
    const float reflected = lights_[p].reflected[lane];
    At(rows_.surface(p), lane) = reflected < 0.0F ? mean.surface : reflected;
    At(rows_.background(p), lane) = mean.background;
  }
}

void EmBlock::CompareWith(std::span<const int64_t> profiles, std::span<const MixtureMap> fits,
                          const std::function<void(int64_t profile, size_t fit, double photons)>& done) {
  for (size_t first = 0; first < profiles.size(); first += kEmLanes) {
    const auto block = profiles.subspan(first, std::min<size_t>(kEmLanes, profiles.size() - first));
    const int busy = static_cast<int>(block.size());
    for (int lane = 0; lane < kEmLanes; ++lane) lane < busy ? Load(lane, block[lane]) : Clear(lane);
    for (size_t f = 0; f < fits.size(); ++f) {
      for (int lane = 0; lane < busy; ++lane) Take(fits[f], lane);
      Sweep(false);
      for (int lane = 0; lane < busy; ++lane) done(block[lane], f, divergence_[lane]);
    }
  }
}

double EmBlock::PriorShare(int lane) const {
  const double total = prior_.Photons(lane);
  return total > 0.0 ? total / (total + lanes_[lane].own) : 0.0;
}

float EmBlock::MeanBackground(int lane) const {
  float background = 0.0F, lights = 0.0F;
  for (int p = 0; p < rows_.lights; ++p) {
    const EmLight& light = lights_[p];
    if (!(light.counts[lane] > 0.0F)) continue;
    background += Background(p, lane) * static_cast<float>(light.samples) / light.coverage[lane];
    lights += 1.0F;
  }
  return background / std::max(lights, 1.0F);
}

float EmBlock::LargestShift(int lane) const {
  float largest = 0.0F;
  for (const EmLight& light : lights_)
    if (light.counts[lane] > 0.0F) largest = std::max(largest, std::abs(light.s[lane]));
  return largest;
}

}  // namespace stratalux::fit
