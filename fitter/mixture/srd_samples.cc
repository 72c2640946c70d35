// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/srd_samples.h"

#include <algorithm>
#include <array>
#include <numeric>

namespace stratalux::fit {

double SrdBatch::VarianceOfSum(int64_t profile) const {
  // In single precision side by side: it weighs profiles, and is asked of all of them.
  constexpr size_t kSums = 8;
  std::array<float, kSums> sums{};
  const auto values = Samples(profile);
  for (size_t k = 0; k < values.size(); ++k) sums[k % kSums] += std::max(values[k], 0.0F);
  const double light = std::accumulate(sums.begin(), sums.end(), 0.0);
  return double{noise_floor[profile]} * samples + double{noise_slope[profile]} * light;
}

void SrdBatch::AllotRows(std::span<const uint8_t> wanted, float value) {
  row.assign(wanted.size(), -1);
  int32_t rows = 0;
  for (size_t i = 0; i < wanted.size(); ++i)
    if (wanted[i] != 0) row[i] = rows++;
  y.assign(static_cast<size_t>(rows) * static_cast<size_t>(samples), value);
}

void SrdBatch::KeepValidRows() {
  if (row.empty()) {
    row.resize(valid.size());
    std::iota(row.begin(), row.end(), 0);
  }
  int32_t rows = 0;
  for (size_t i = 0; i < row.size(); ++i) {
    if (row[i] < 0 || valid[i] == 0) {
      row[i] = -1;
      continue;
    }
    const int64_t from = int64_t{row[i]} * samples, to = int64_t{rows} * samples;  // rows lie in the profiles' order
    std::copy(y.begin() + from, y.begin() + from + samples, y.begin() + to);
    row[i] = rows++;
  }
  y.resize(static_cast<size_t>(rows) * static_cast<size_t>(samples));
  y.shrink_to_fit();
}

SrdBatch ProfilesOf(const SrdBatch& batch, std::span<const int64_t> which) {
  SrdBatch part;
  part.samples = batch.samples;
  part.wrapped = batch.wrapped;
  part.sample_box = batch.sample_box;
  part.pool = batch.pool;
  // A field that has nothing has nothing of each profile.
  const auto copy = [&](auto field) {
    const auto& from = batch.*field;
    if (from.empty()) return;
    for (int64_t i : which) (part.*field).push_back(from[static_cast<size_t>(i)]);
  };
  for (const auto field : {&SrdBatch::noise_floor, &SrdBatch::noise_slope, &SrdBatch::white, &SrdBatch::white_variance,
                           &SrdBatch::first_u_mm, &SrdBatch::step_mm, &SrdBatch::line_width_mm, &SrdBatch::blur_mm,
                           &SrdBatch::quad_x_mm, &SrdBatch::quad_y_mm, &SrdBatch::pair_mm, &SrdBatch::box_x_mm,
                           &SrdBatch::box_y_mm, &SrdBatch::slope_in, &SrdBatch::slope_out, &SrdBatch::cos_in,
                           &SrdBatch::cos_out, &SrdBatch::slope_in_across, &SrdBatch::slope_out_across})
    copy(field);
  copy(&SrdBatch::valid);
  copy(&SrdBatch::apart);
  part.place.reserve(which.size());
  for (const int64_t i : which) part.place.push_back(batch.PlaceOf(i));
  std::vector<uint8_t> has_row(which.size(), 1);
  for (size_t k = 0; k < which.size() && !batch.row.empty(); ++k)
    has_row[k] = batch.row[static_cast<size_t>(which[k])] >= 0 ? 1 : 0;
  part.AllotRows(has_row, 0.0F);
  for (size_t k = 0; k < which.size(); ++k) {
    if (has_row[k] == 0) continue;
    const auto to = static_cast<int64_t>(k);
    std::ranges::copy(batch.Samples(which[k]), part.Samples(to).begin());
  }
  return part;
}

}  // namespace stratalux::fit
