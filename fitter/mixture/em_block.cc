// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_block.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "fitter/mixture/line_response.h"
#include "fitter/mixture/shift_law.h"

namespace stratalux::fit {
namespace {

constexpr float kTiny = 1e-12F;

// Photon counts per unit of y and sigma_read^2 in the same unit, from the noise model var = y / counts + shift /
// counts.
struct Noise {
  double counts = 1.0;
  double shift = 0.0;
};
Noise NoiseOf(const SrdBatch& batch, int64_t profile) {
  const float* y = batch.y.data() + profile * batch.samples;
  const float* v = batch.variance.data() + profile * batch.samples;
  int low = 0, high = 0;
  for (int k = 1; k < batch.samples; ++k) {
    if (v[k] < v[low]) low = k;
    if (v[k] > v[high]) high = k;
  }
  const double dy = double(y[high]) - y[low], dv = double(v[high]) - v[low];
  if (!(dy > 0.0) || !(dv > 0.0)) return {};
  const double per_count = dv / dy;
  return {1.0 / per_count, std::max(0.0, v[low] / per_count - std::max(0.0F, y[low]))};
}

// Where a cell of a sample's reach lies in memory; -1 outside an open window.
inline __attribute__((always_inline)) int CellInGrid(const EmGrid& grid, int cell) {
  if (cell >= 0 && cell < grid.cells) return cell;
  if (!grid.wrapped) return -1;
  return cell < 0 ? cell + grid.cells : cell - grid.cells;
}

// model[sample] += sum over taps of response mass; open windows see nothing beyond their grid.
SLX_SIMD_CLONES void Project(const EmLight& light, float* model) {
  const int before = (light.taps - light.cells_per_sample) / 2;
  for (int k = 0; k < light.samples; ++k) {
    Vec sum = Load(model + k * kLanes);
    int cell = light.pad_cells + k * light.cells_per_sample - before;
    for (int t = 0; t < light.taps; ++t, ++cell) {
      const int at = CellInGrid(light.grid, cell);
      if (at < 0) continue;
      sum += Load(light.mass.data() + at * kLanes) * Load(light.response.data() + t * kLanes);
    }
    Store(model + k * kLanes, sum);
  }
}

// q[cell] += sum over taps of response ratio: the transpose of Project.
SLX_SIMD_CLONES void ProjectBack(const EmLight& light, const float* ratios, float* q) {
  const int before = (light.taps - light.cells_per_sample) / 2;
  for (int k = 0; k < light.samples; ++k) {
    const Vec ratio = Load(ratios + k * kLanes);
    int cell = light.pad_cells + k * light.cells_per_sample - before;
    for (int t = 0; t < light.taps; ++t, ++cell) {
      const int at = CellInGrid(light.grid, cell);
      if (at < 0) continue;
      Store(q + at * kLanes, Load(q + at * kLanes) + ratio * Load(light.response.data() + t * kLanes));
    }
  }
}

}  // namespace

EmBlock::EmBlock(std::span<const SrdBatch* const> lights, std::span<const std::vector<uint8_t>> usable,
                 std::span<const int64_t> members, const EmOptions& options, std::span<const LayerSet> start)
    : options_(options),
      sweeps_(start.empty() ? options.max_iterations : options.refinement_iterations),
      members_(members),
      lights_(lights.size()) {
  const size_t size = static_cast<size_t>(options.layers) * kLanes;
  for (auto* v : {&weight_, &depth_, &sigma_, &cell_weight_, &cell_mean_, &cell_sigma_}) v->assign(size, 0.0F);
  moments_.assign(3 * size, 0.0F);
  sigma_floor_.fill(static_cast<float>(options.min_sigma_mm));
  for (size_t p = 0; p < lights.size(); ++p) {
    LoadLight(*lights[p], usable[p], lights_[p]);
    BuildResponse(*lights[p], lights_[p]);
    for (int i = 0; i < kLanes; ++i)
      if (lights_[p].counts[i] > 0.0F) sigma_floor_[i] = std::max(sigma_floor_[i], 0.9F * lights_[p].cell_mm[i]);
  }
  Initialise(start);
}

void EmBlock::LoadLight(const SrdBatch& batch, std::span<const uint8_t> usable, EmLight& light) const {
  light.samples = batch.samples;
  float widest = 0.0F;
  for (int64_t member : members_)
    if (usable[member] != 0) widest = std::max(widest, batch.step_mm[member]);
  light.cells_per_sample =
      std::max(options_.cells_per_sample, static_cast<int>(std::ceil(widest / options_.max_cell_mm)));
  if (!batch.wrapped)
    light.cells_per_sample = std::max(1, static_cast<int>(std::ceil(widest / (options_.max_cell_mm / 2))));
  light.pad_cells = batch.wrapped ? 0 : light.cells_per_sample * batch.samples / 4;
  light.grid = {light.cells_per_sample * batch.samples + 2 * light.pad_cells, batch.wrapped};
  light.y.assign(static_cast<size_t>(light.samples) * kLanes, 0.0F);
  light.shift.assign(light.y.size(), 0.0F);
  light.cell_mm.fill(1.0F);
  light.origin.fill(0.5F * static_cast<float>(light.grid.cells));
  light.gain.fill(1.0F);
  for (int i = 0; i < static_cast<int>(members_.size()); ++i) {
    const int64_t profile = members_[i];
    if (usable[profile] == 0) continue;
    const float step = batch.step_mm[profile];
    // Wrapped profiles are turned so that the pixel's own entry point lies mid-grid in every lane: layers then meet the
    // same cells in all lanes.
    int turn = 0;
    float first_u = batch.first_u_mm[profile];
    if (batch.wrapped) {
      turn = static_cast<int>(std::lround(-first_u / step)) - light.samples / 2;
      first_u += static_cast<float>(turn) * step;
      turn = (turn % light.samples + light.samples) % light.samples;
    }
    const float* y = batch.y.data() + profile * light.samples;
    const Noise noise = NoiseOf(batch, profile);
    for (int k = 0; k < light.samples; ++k) {
      light.y[k * kLanes + i] = y[(k + turn) % light.samples];
      light.shift[k * kLanes + i] = static_cast<float>(noise.shift);
    }
    light.cell_mm[i] = step / static_cast<float>(light.cells_per_sample);
    // Cell j has its centre at first_u + (j - pad - (cells_per_sample - 1) / 2) cells.
    light.origin[i] = static_cast<float>(light.pad_cells) + 0.5F * static_cast<float>(light.cells_per_sample - 1) -
                      first_u / light.cell_mm[i];
    const double t_in =
        TangentialShift(options_.shift_law, batch.slope_in[profile], batch.slope_in_across[profile], options_.eta);
    const double t_out =
        TangentialShift(options_.shift_law, batch.slope_out[profile], batch.slope_out_across[profile], options_.eta);
    light.s[i] = options_.mode == FitMode::kFree ? 1.0F : static_cast<float>(t_in - t_out);
    if (options_.gain_model)
      light.gain[i] = static_cast<float>(AngularGain(batch.cos_in[profile], options_.eta, options_.tau));
    light.counts[i] = static_cast<float>(noise.counts);
    if (!batch.white.empty()) {
      light.white[i] = batch.white[profile];
      light.white_variance[i] = batch.white_variance[profile];
    }
  }
}

void EmBlock::BuildResponse(const SrdBatch& batch, EmLight& light) const {
  const int count = static_cast<int>(members_.size());
  auto line_of = [&](int i) -> LineResponse {
    const int64_t profile = members_[i];
    return {batch.line_width_mm[profile], batch.blur_mm[profile], batch.sample_box * batch.step_mm[profile],
            light.cell_mm[i], batch.pair_mm.empty() ? 0.0 : batch.pair_mm[profile]};
  };
  double support = 0.0;
  for (int i = 0; i < count; ++i)
    if (light.counts[i] > 0.0F) support = std::max(support, line_of(i).Support() / light.cell_mm[i]);
  // Taps around a sample's own position, which lies between or on cells: (cells_per_sample - 1) / 2 after its first
  // cell.
  const int reach = std::min(static_cast<int>(std::ceil(support)) + 1, light.grid.cells / 2 - 1);
  light.taps = 2 * reach + light.cells_per_sample;
  light.response.assign(static_cast<size_t>(light.taps) * kLanes, 0.0F);
  light.surface_response.assign(light.y.size(), 0.0F);
  light.unseen.assign(static_cast<size_t>(light.grid.cells) * kLanes, 0.0F);
  const double centre = reach + 0.5 * (light.cells_per_sample - 1);
  for (int i = 0; i < count; ++i) {
    if (!(light.counts[i] > 0.0F)) continue;
    const double cell = light.cell_mm[i];
    const LineResponse b = line_of(i);
    double total = 0.0;
    for (int t = 0; t < light.taps; ++t) {
      const double r = b.At((t - centre) * cell);
      light.response[t * kLanes + i] = static_cast<float>(r);
      total += r;
    }
    light.coverage[i] = static_cast<float>(total / light.cells_per_sample);
    const double period = cell * light.grid.cells;
    for (int k = 0; k < light.samples; ++k) {
      double u =
          (light.pad_cells + k * light.cells_per_sample + 0.5 * (light.cells_per_sample - 1) - light.origin[i]) * cell;
      if (light.grid.wrapped) u = std::remainder(u, period);
      light.surface_response[k * kLanes + i] = static_cast<float>(b.At(u));
    }
  }
  light.mass.assign(static_cast<size_t>(light.grid.cells) * kLanes, 0.0F);
  light.q.assign(light.mass.size(), 0.0F);
  light.model.assign(light.y.size(), 0.0F);
  if (light.grid.wrapped) return;
  // Open windows: what of each cell no sample sees (B^T 1 short of the full coverage).
  for (int k = 0; k < light.samples; ++k)
    for (int t = 0; t < light.taps; ++t) {
      const int cell = light.pad_cells + k * light.cells_per_sample + t - (light.taps - light.cells_per_sample) / 2;
      if (cell < 0 || cell >= light.grid.cells) continue;
      for (int i = 0; i < kLanes; ++i) light.unseen[cell * kLanes + i] -= light.response[t * kLanes + i];
    }
  for (int c = 0; c < light.grid.cells; ++c)
    for (int i = 0; i < kLanes; ++i) light.unseen[c * kLanes + i] += light.coverage[i];
}

void EmBlock::Initialise(std::span<const LayerSet> start) {
  for (int i = 0; i < static_cast<int>(members_.size()); ++i) {
    double total = 0.0, exposure = 0.0, longest = 0.0;
    for (const EmLight& light : lights_) {
      if (!(light.counts[i] > 0.0F)) continue;
      double sum = 0.0;
      for (int k = 0; k < light.samples; ++k) sum += light.y[k * kLanes + i];
      total += std::max(sum, 1e-6) * light.counts[i];
      exposure += double(light.counts[i]) * light.gain[i] * light.coverage[i];
      longest = std::max(longest, double(light.cell_mm[i]) * light.grid.cells);
    }
    if (!(exposure > 0.0)) continue;
    const size_t channel = start.empty() ? 0 : static_cast<size_t>(members_[i]) % start.size();
    // Shares of the light that returns: surface (the fit does not identify it and stays near its start: skin's Fresnel
    // reflection is 3 to 7 % of the light that returns), and floor over a whole cycle or window.
    const double surface = options_.surface_term ? 0.05 : 0.0;
    double floor = 0.02;
    if (!start.empty() && !start[channel].weight.empty()) {
      const LayerSet& mean = start[channel];
      floor = mean.background / std::max(std::accumulate(mean.weight.begin(), mean.weight.end(), 0.0), 1e-9);
      StartFrom(mean, i, (1.0 - surface) * total / exposure);
    } else {
      SpreadLayers(i, total / exposure, std::min(options_.max_sigma_mm, longest / 4.0));
    }
    for (EmLight& light : lights_) {
      if (!(light.counts[i] > 0.0F)) continue;
      const double light_total = total / exposure * light.gain[i];
      if (options_.surface_term) light.surface[i] = static_cast<float>(surface * light_total);
      if (options_.background_term)
        light.background[i] = static_cast<float>(floor * light_total * light.coverage[i] / light.samples);
    }
  }
  if (options_.shared_background) ShareBackground();
}

// Widths spread logarithmically, depths growing with the width, the observed total shared out in proportion to 1 /
// width: EM raises a wide layer that the data ask for faster than it lowers one whose light is below the noise of a
// sample.
void EmBlock::SpreadLayers(int lane, double total, double widest_mm) {
  const double narrowest = sigma_floor_[lane];
  double share = 0.0;
  for (int l = 0; l < options_.layers; ++l) {
    const double f = options_.layers > 1 ? static_cast<double>(l) / (options_.layers - 1) : 0.5;
    const double sigma = narrowest * 1.1 * std::pow(std::max(widest_mm * 0.7, narrowest * 2) / (narrowest * 1.1), f);
    sigma_[l * kLanes + lane] = static_cast<float>(sigma);
    depth_[l * kLanes + lane] = options_.direction_blind ? 0.0F : static_cast<float>(std::min(0.3 * sigma, 1.0));
    weight_[l * kLanes + lane] = static_cast<float>(total / sigma);
    share += 1.0 / sigma;
  }
  for (int l = 0; l < options_.layers; ++l) weight_[l * kLanes + lane] /= static_cast<float>(share);
}

void EmBlock::StartFrom(const LayerSet& layers, int lane, double total) {
  double sum = 0.0;
  for (double w : layers.weight) sum += w;
  for (int l = 0; l < options_.layers; ++l) {
    weight_[l * kLanes + lane] = static_cast<float>(layers.weight[l] / std::max(sum, 1e-9) * total);
    depth_[l * kLanes + lane] = options_.direction_blind ? 0.0F : static_cast<float>(layers.depth_mm[l]);
    sigma_[l * kLanes + lane] = std::max(static_cast<float>(layers.sigma_mm[l]), sigma_floor_[lane]);
  }
}

// mass = the layers on the grid; model = B mass + surface + background.
void EmBlock::Predict(EmLight& light) {
  for (size_t at = 0; at < weight_.size(); ++at) {
    const size_t i = at % kLanes;
    const float per_cell = 1.0F / light.cell_mm[i];
    cell_weight_[at] = light.counts[i] > 0.0F ? weight_[at] * light.gain[i] : 0.0F;
    cell_mean_[at] = light.origin[i] + depth_[at] * light.s[i] * per_cell;
    cell_sigma_[at] = std::max(sigma_[at] * per_cell, 0.5F);
  }
  std::fill(light.mass.begin(), light.mass.end(), 0.0F);
  AddLayers(light.grid, options_.layers, cell_weight_.data(), cell_mean_.data(), cell_sigma_.data(), light.mass.data());
  for (int k = 0; k < light.samples; ++k) {
    float* model = light.model.data() + k * kLanes;
    const float* own = light.surface_response.data() + k * kLanes;
    for (int i = 0; i < kLanes; ++i) model[i] = light.background[i] + light.surface[i] * own[i];
  }
  Project(light, light.model.data());
}

// q = B^T (y / (B m)) with the shifted Poisson's read noise on both sides; cells outside an open window are filled in
// by the model's own expectation (exact EM for a truncated observation).
void EmBlock::BackProject(EmLight& light) {
  std::copy(light.unseen.begin(), light.unseen.end(), light.q.begin());
  for (int k = 0; k < light.samples; ++k)
    for (int i = 0; i < kLanes; ++i) {
      const float shift = light.shift[k * kLanes + i];
      const float data = std::max(light.y[k * kLanes + i] + shift, 0.0F);
      float& model = light.model[k * kLanes + i];
      model = light.counts[i] > 0.0F ? data / std::max(model + shift, kTiny) : 0.0F;
    }
  ProjectBack(light, light.model.data(), light.q.data());
}

// EM of the two terms that no layer holds; `model` holds the ratios here.
void EmBlock::UpdateFloor(EmLight& light) {
  float own_ratio[kLanes] = {}, own_sum[kLanes] = {}, mean_ratio[kLanes] = {};
  for (int k = 0; k < light.samples; ++k)
    for (int i = 0; i < kLanes; ++i) {
      const float ratio = light.model[k * kLanes + i], own = light.surface_response[k * kLanes + i];
      own_ratio[i] += ratio * own;
      own_sum[i] += own;
      mean_ratio[i] += ratio;
    }
  for (int i = 0; i < kLanes; ++i) {
    if (!(light.counts[i] > 0.0F)) continue;
    light.surface[i] *= own_ratio[i] / std::max(own_sum[i], kTiny);
    light.background[i] *= mean_ratio[i] / static_cast<float>(light.samples);
  }
}

// One floor for all lights: the mean of theirs, weighted by the photons each would see of it.
void EmBlock::ShareBackground() {
  for (int i = 0; i < kLanes; ++i) {
    float photons = 0.0F, exposure = 0.0F;
    for (const EmLight& light : lights_) {
      const float seen = light.counts[i] * static_cast<float>(light.samples);
      photons += seen * light.background[i];
      exposure += seen;
    }
    for (EmLight& light : lights_)
      if (light.counts[i] > 0.0F) light.background[i] = photons / exposure;
  }
}

void EmBlock::Sweep() {
  const int layers = options_.layers;
  const size_t size = static_cast<size_t>(layers) * kLanes;
  // Sums over lights of counts x {c, c s (z - mean), c s^2, c (z - mean)^2}, in mm.
  std::vector<float> photons(size, 0.0F), moved(size, 0.0F), leverage(size, 0.0F), spread(size, 0.0F);
  std::array<float, kLanes> exposure{};
  for (EmLight& light : lights_) {
    Predict(light);
    BackProject(light);
    LayerMoments(light.grid, layers, cell_weight_.data(), cell_mean_.data(), cell_sigma_.data(), light.q.data(),
                 moments_.data());
    for (size_t at = 0; at < size; ++at) {
      const size_t i = at % kLanes, l = at / kLanes;
      if (!(light.counts[i] > 0.0F)) continue;
      const float n = light.counts[i], cell = light.cell_mm[i], s = light.s[i];
      const float c = moments_[(3 * l) * kLanes + i], cz = moments_[(3 * l + 1) * kLanes + i] * cell,
                  czz = moments_[(3 * l + 2) * kLanes + i] * cell * cell;
      photons[at] += n * c;
      moved[at] += n * s * cz;
      leverage[at] += n * s * s * c;
      spread[at] += n * czz;
    }
    for (int i = 0; i < kLanes; ++i) exposure[i] += light.counts[i] * light.gain[i] * light.coverage[i];
    UpdateFloor(light);
  }
  if (options_.shared_background) ShareBackground();
  for (size_t at = 0; at < size; ++at) {
    const size_t i = at % kLanes;
    if (!(exposure[i] > 0.0F)) continue;
    weight_[at] = photons[at] / exposure[i];
    if (!(photons[at] > 1e-9F * exposure[i])) {
      weight_[at] = 0.0F;
      continue;
    }
    // d = sum n s c z / sum n s^2 c with z = d_old s + (z - mean); sigma^2 around the new means.
    float step = 0.0F;
    if (!options_.direction_blind && leverage[at] > 1e-6F * photons[at]) {
      const float wanted = depth_[at] + moved[at] / leverage[at];
      const float allowed =
          std::clamp(wanted, static_cast<float>(options_.min_depth_mm), static_cast<float>(options_.max_depth_mm));
      step = (options_.mode == FitMode::kFree ? std::clamp(wanted, -8.0F, 8.0F) : allowed) - depth_[at];
      depth_[at] += step;
    }
    const float variance = (spread[at] - 2.0F * step * moved[at] + step * step * leverage[at]) / photons[at];
    sigma_[at] =
        std::clamp(std::sqrt(std::max(variance, 0.0F)), sigma_floor_[i], static_cast<float>(options_.max_sigma_mm));
  }
}

// The shape is EM's; its scale and that of the white frames are averaged by their Fisher information. White frames
// enter here and not as samples of EM: they know nothing of positions and would only slow it down. `model` holds
// predictions.
void EmBlock::ScaleToWhite() {
  bool scaled_any = false;
  for (int i = 0; i < kLanes; ++i) {
    double information = 0.0, scaled = 0.0;
    bool any = false;
    for (const EmLight& light : lights_) {
      if (!(light.counts[i] > 0.0F)) continue;
      double sum = 0.0, of_samples = 0.0;
      for (int k = 0; k < light.samples; ++k) {
        const double m = light.model[k * kLanes + i];
        sum += m;
        of_samples += m * m * light.counts[i] / std::max(m + light.shift[k * kLanes + i], double(kTiny));
      }
      information += of_samples;
      scaled += of_samples;  // EM's own scale: 1
      if (!(light.white_variance[i] > 0.0F) || !(sum > 0.0)) continue;
      const double of_white = sum * sum / light.white_variance[i];
      information += of_white;
      scaled += of_white * light.white[i] / sum;
      any = true;
    }
    if (!any || !(scaled > 0.0)) continue;
    scaled_any = true;
    const auto scale = static_cast<float>(scaled / information);
    for (int l = 0; l < options_.layers; ++l) weight_[l * kLanes + i] *= scale;
    for (EmLight& light : lights_) {
      light.surface[i] *= scale;
      light.background[i] *= scale;
    }
  }
  if (!scaled_any) return;
  for (EmLight& light : lights_) Predict(light);
}

int EmBlock::Run() {
  constexpr int kCheckEvery = 8;
  std::array<double, kLanes> last{};
  last.fill(1e300);
  for (int sweep = 1; sweep <= sweeps_; ++sweep) {
    Sweep();
    if (sweep % kCheckEvery != 0) continue;
    for (EmLight& light : lights_) Predict(light);
    const auto now = Divergence();
    bool settled = true;
    for (int i = 0; i < kLanes; ++i)
      settled = settled && last[i] - now[i] <= options_.tolerance * kCheckEvery * std::abs(last[i]);
    last = now;
    if (settled) {
      ScaleToWhite();
      return sweep;
    }
  }
  for (EmLight& light : lights_) Predict(light);
  ScaleToWhite();
  return sweeps_;
}

std::array<double, kLanes> EmBlock::Divergence() const {
  std::array<double, kLanes> divergence{}, total{};
  for (const EmLight& light : lights_)
    for (int k = 0; k < light.samples; ++k)
      for (int i = 0; i < kLanes; ++i) {
        if (!(light.counts[i] > 0.0F)) continue;
        const double shift = light.shift[k * kLanes + i];
        const double data = std::max(light.y[k * kLanes + i] + shift, 0.0);
        const double model = std::max(light.model[k * kLanes + i] + shift, double(kTiny));
        divergence[i] += light.counts[i] * (model - data + (data > 0.0 ? data * std::log(data / model) : 0.0));
        total[i] += light.counts[i] * data;
      }
  for (int i = 0; i < kLanes; ++i) divergence[i] = total[i] > 0.0 ? divergence[i] / total[i] : 0.0;
  return divergence;
}

float EmBlock::MeanBackground(int lane) const {
  float background = 0.0F, lights = 0.0F;
  for (const EmLight& light : lights_) {
    if (!(light.counts[lane] > 0.0F)) continue;
    background += light.background[lane] * static_cast<float>(light.samples) / light.coverage[lane];
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
