// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_light.h"

#include <algorithm>
#include <cmath>

#include "fitter/mixture/line_response.h"
#include "fitter/mixture/photon_noise.h"
#include "fitter/mixture/surface_reflection.h"

namespace stratalux::fit {
namespace {

// std::remainder(u, period) of |u| <= 1.5 periods, to the last bit: there the difference is exact.
double NearestTurn(double u, double period) {
  if (std::abs(u) <= 0.5 * period) return u;
  return u - std::copysign(period, u);
}

// Samples, geometry and gain of a profile.
void LoadSamples(const ScatteringModel& model, const SrdBatch& batch, int64_t profile, int lane, EmLight& light) {
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
  const auto y = batch.Samples(profile);
  const PhotonNoise noise = PhotonNoiseOf(batch, profile);
  light.shift[lane] = static_cast<float>(noise.read_shift);
  light.counts[lane] = static_cast<float>(noise.counts);
  for (int k = 0; k < light.samples; ++k)
    light.data[RowOf(k) + lane] = std::max(y[(k + turn) % light.samples] + light.shift[lane], 0.0F);
  light.cell_mm[lane] = step / static_cast<float>(light.cells_per_sample);
  // Cell j has its centre at first_u + (j - pad - (cells_per_sample - 1) / 2) cells.
  light.origin[lane] = static_cast<float>(light.pad_cells) + 0.5F * static_cast<float>(light.cells_per_sample - 1) -
                       first_u / light.cell_mm[lane];
  light.s[lane] = static_cast<float>(ShiftCoefficient(model, batch, profile));
  light.gain[lane] = static_cast<float>(AngularGain(model, batch.cos_in[profile]));
  light.reflected[lane] = static_cast<float>(HeldReflection(model.reflection, batch, profile, model.eta));
  if (!model.directional.Off()) {
    const RefractedDirections directions = DirectionsOf(batch, profile, model.eta);
    light.extra_path[lane] = static_cast<float>(directions.ExtraPath());
    // What a layer of no depth and no width shows: the light of few scattering events alone.
    DirectionalWeights narrow = model.directional;
    narrow.sigma_0_mm = 1.0;
    light.phase_m1[lane] = static_cast<float>(DirectionalFactor(narrow, directions, 0.0, 0.0) - 1.0);
  }
  if (!batch.white.empty()) {
    light.white[lane] = batch.white[profile];
    light.white_variance[lane] = batch.white_variance[profile];
  }
}

// Lines of a thinned cycle stand apart: cells between them are seen by few samples or none. All samples' cells are
// alike, so one period of them tells.
void LoadThinned(int reach, int lane, EmLight& light) {
  std::vector<double> seen(static_cast<size_t>(light.cells_per_sample), 0.0);
  for (int t = -reach; t < light.cells_per_sample + reach; ++t) {
    const int cell = (t % light.cells_per_sample + light.cells_per_sample) % light.cells_per_sample;
    seen[static_cast<size_t>(cell)] += light.response[RowOf(light.reach_limit + t) + lane];
  }
  const double most = *std::ranges::max_element(seen);
  for (int c = 0; c < light.grid.cells; ++c)
    light.unseen[RowOf(c) + lane] = static_cast<float>(most - seen[static_cast<size_t>(c % light.cells_per_sample)]);
  light.sees_all = false;
  light.full_coverage[lane] = static_cast<float>(most);
  if (!(light.white[lane] > 0.0F) || !(light.white_variance[lane] > 0.0F) || !(light.counts[lane] > 0.0F)) return;
  // As a sample of the others' photons per unit: its variance is then its value over them.
  light.white_weight[lane] = light.white[lane] / (light.counts[lane] * light.white_variance[lane]);
  light.full_coverage[lane] += light.white_weight[lane] * light.coverage[lane];
}

void LoadResponse(const SrdBatch& batch, int64_t profile, int lane, EmLight& light) {
  const double cell = light.cell_mm[lane];
  const LineResponse line = LineResponseOf(batch, profile, cell);
  const double support = line.Support();
  const int reach = static_cast<int>(std::min(std::ceil(support / cell) + 1.0, double(light.reach_limit)));
  light.reach = std::max(light.reach, reach);
  // Around a sample's own position, which lies between or on cells: (cells_per_sample - 1) / 2 after its first cell.
  const double centre = 0.5 * (light.cells_per_sample - 1);
  const std::vector<double> taps = line.OnCells((-reach - centre) * cell, light.cells_per_sample + 2 * reach);
  double total = 0.0;
  for (int t = -reach; t < light.cells_per_sample + reach; ++t) {
    light.response[RowOf(light.reach_limit + t) + lane] = static_cast<float>(taps[t + reach]);
    total += taps[t + reach];
  }
  light.coverage[lane] = static_cast<float>(total / light.cells_per_sample);
  const double period = cell * light.grid.cells;
  for (int k = 0; k < light.samples; ++k) {
    double u = (light.pad_cells + k * light.cells_per_sample + centre - light.origin[lane]) * cell;
    if (light.grid.wrapped) u = NearestTurn(u, period);
    if (std::abs(u) > support) continue;
    light.surface_response[RowOf(k) + lane] = static_cast<float>(line.At(u));
    light.surface_total[lane] += light.surface_response[RowOf(k) + lane];
  }
  light.full_coverage[lane] = light.coverage[lane];
  if (IsThinned(batch, profile)) return LoadThinned(reach, lane, light);
  if (light.grid.wrapped) return;
  // Open windows: what of each cell no sample sees (B^T 1 short of the full coverage).
  light.sees_all = false;
  for (int c = 0; c < light.grid.cells; ++c) light.unseen[RowOf(c) + lane] = light.coverage[lane];
  for (int k = 0; k < light.samples; ++k)
    for (int t = -reach; t < light.cells_per_sample + reach; ++t) {
      const int cell_at = light.pad_cells + k * light.cells_per_sample + t;
      if (cell_at < 0 || cell_at >= light.grid.cells) continue;
      light.unseen[RowOf(cell_at) + lane] -= light.response[RowOf(light.reach_limit + t) + lane];
    }
}

}  // namespace

void EmWork::MakeRoomFor(const EmLight& light) {
  const auto make = [](LaneRows& rows, int count) { rows.resize(std::max(rows.size(), RowOf(count)), 0.0F); };
  make(mass, light.grid.cells + 2 * light.reach_limit);
  make(ratio, light.samples + 2 * light.halo_samples);
  make(q, light.grid.cells);
}

bool IsThinned(const SrdBatch& batch, int64_t profile) {
  constexpr double kRounding = 1e-3;  // both are lengths in single precision
  const auto i = static_cast<size_t>(profile);
  const double lines = double{batch.line_width_mm[i]} / batch.step_mm[i];
  return batch.wrapped && (lines < 1.0 - kRounding || std::abs(lines - std::round(lines)) > kRounding);
}

void ClearLane(int lane, EmLight& light) {
  light.cell_mm[lane] = light.gain[lane] = 1.0F;
  light.origin[lane] = 0.5F * static_cast<float>(light.grid.cells);
  for (LaneRow* row : {&light.shift, &light.surface_total, &light.s, &light.counts, &light.extra_path, &light.phase_m1,
                       &light.coverage, &light.full_coverage, &light.white, &light.white_variance, &light.white_weight,
                       &light.white_back})
    (*row)[lane] = 0.0F;
  const auto clear = [lane](LaneRows& rows) {
    for (size_t at = lane; at < rows.size(); at += kEmLanes) rows[at] = 0.0F;
  };
  clear(light.data);
  clear(light.surface_response);
  if (!light.sees_all) clear(light.unseen);
  for (int t = -light.reach; t < light.cells_per_sample + light.reach; ++t)
    light.response[RowOf(light.reach_limit + t) + lane] = 0.0F;
}

void LoadLane(const ScatteringModel& model, const SrdBatch& batch, int64_t profile, int lane, EmLight& light) {
  LoadSamples(model, batch, profile, lane, light);
  LoadResponse(batch, profile, lane, light);
}

}  // namespace stratalux::fit
