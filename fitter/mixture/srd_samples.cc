// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

SrdBatch ProfilesOf(const SrdBatch& batch, std::span<const int64_t> which) {
  SrdBatch part;
  part.samples = batch.samples;
  part.wrapped = batch.wrapped;
  part.sample_box = batch.sample_box;
  part.pool = batch.pool;
  // A field that has nothing has nothing of each profile.
  const auto copy = [&](auto field, int64_t values) {
    const auto& from = batch.*field;
    if (from.empty()) return;
    for (int64_t i : which)
      (part.*field).insert((part.*field).end(), from.begin() + i * values, from.begin() + (i + 1) * values);
  };
  for (const auto field : {&SrdBatch::y, &SrdBatch::variance}) copy(field, batch.samples);
  for (const auto field : {&SrdBatch::white, &SrdBatch::white_variance, &SrdBatch::first_u_mm, &SrdBatch::step_mm,
                           &SrdBatch::line_width_mm, &SrdBatch::blur_mm, &SrdBatch::quad_x_mm, &SrdBatch::quad_y_mm,
                           &SrdBatch::pair_mm, &SrdBatch::slope_in, &SrdBatch::slope_out, &SrdBatch::cos_in,
                           &SrdBatch::cos_out, &SrdBatch::slope_in_across, &SrdBatch::slope_out_across})
    copy(field, 1);
  copy(&SrdBatch::valid, 1);
  return part;
}

}  // namespace stratalux::fit
