// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/srd_samples.h"

#include <algorithm>
#include <numeric>

namespace stratalux::fit {

void SrdBatch::AllotRows(std::span<const uint8_t> wanted, float value, float its_variance) {
  row.assign(wanted.size(), -1);
  int32_t rows = 0;
  for (size_t i = 0; i < wanted.size(); ++i)
    if (wanted[i] != 0) row[i] = rows++;
  y.assign(static_cast<size_t>(rows) * static_cast<size_t>(samples), value);
  variance.assign(y.size(), its_variance);
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
    for (auto* values : {&y, &variance})
      std::copy(values->begin() + from, values->begin() + from + samples, values->begin() + to);
    row[i] = rows++;
  }
  for (auto* values : {&y, &variance}) {
    values->resize(static_cast<size_t>(rows) * static_cast<size_t>(samples));
    values->shrink_to_fit();
  }
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
  for (const auto field : {&SrdBatch::white, &SrdBatch::white_variance, &SrdBatch::first_u_mm, &SrdBatch::step_mm,
                           &SrdBatch::line_width_mm, &SrdBatch::blur_mm, &SrdBatch::quad_x_mm, &SrdBatch::quad_y_mm,
                           &SrdBatch::pair_mm, &SrdBatch::slope_in, &SrdBatch::slope_out, &SrdBatch::cos_in,
                           &SrdBatch::cos_out, &SrdBatch::slope_in_across, &SrdBatch::slope_out_across})
    copy(field);
  copy(&SrdBatch::valid);
  copy(&SrdBatch::apart);
  std::vector<uint8_t> has_row(which.size(), 1);
  for (size_t k = 0; k < which.size() && !batch.row.empty(); ++k)
    has_row[k] = batch.row[static_cast<size_t>(which[k])] >= 0 ? 1 : 0;
  part.AllotRows(has_row, 0.0F, 1.0F);
  for (size_t k = 0; k < which.size(); ++k) {
    if (has_row[k] == 0) continue;
    const auto to = static_cast<int64_t>(k);
    std::ranges::copy(batch.Samples(which[k]), part.Samples(to).begin());
    std::ranges::copy(batch.Variances(which[k]), part.Variances(to).begin());
  }
  return part;
}

}  // namespace stratalux::fit
