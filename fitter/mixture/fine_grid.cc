// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/fine_grid.h"

#include <numeric>

namespace stratalux::fit {

int CellsPerSample(const SrdBatch& batch, int64_t profile, double blur_mm, const EmOptions& options) {
  const double step = batch.step_mm[profile];
  // More would be a step of decimetres, fitted coarsely rather than without end.
  constexpr double kMost = 256.0;
  // Cells of a quarter of the blur widen nothing that the samples could tell.
  constexpr double kCellsOfBlur = 4.0;
  const double cell = std::max(batch.wrapped ? options.max_cell_mm : options.max_cell_mm / 2, blur_mm / kCellsOfBlur);
  const int fine = static_cast<int>(std::min(std::ceil(step / cell), kMost));
  return std::max(batch.wrapped ? options.cells_per_sample : 1, fine);
}

FineGrid::FineGrid(const ProfileLight& light) : light_(&light) {
  const int k = light.samples(), n = light.cells_per_sample;
  pad_ = light.wrapped ? 0 : n * k / 4;
  cells_ = n * k + 2 * pad_;
  const int reach = std::min(static_cast<int>(std::ceil(light.line.Support() / CellMm())) + 1, cells_ / 2 - 1);
  // A sample's own position lies (n - 1) / 2 cells after its first one.
  before_ = reach;
  for (int t = 0; t < 2 * reach + n; ++t) response_.push_back(light.line.At((t - reach - 0.5 * (n - 1)) * CellMm()));
  coverage_ = std::accumulate(response_.begin(), response_.end(), 0.0) / n;
  for (int j = 0; j < k; ++j) {
    const double u = light.first_u_mm + j * light.step_mm;
    surface_.push_back(light.line.At(light.wrapped ? std::remainder(u, k * light.step_mm) : u));
  }
  seen_ = BackProject(std::vector<double>(k, 1.0));
}

}  // namespace stratalux::fit
