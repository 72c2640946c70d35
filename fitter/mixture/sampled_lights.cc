// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/sampled_lights.h"

namespace stratalux::fit {

SrdBatch SampledPixels(const SrdBatch& all, int channels, int every) {
  SrdBatch part;
  part.samples = all.samples;
  part.wrapped = all.wrapped;
  part.sample_box = all.sample_box;
  part.pool = all.pool;
  for (int64_t i = 0; i < all.profiles(); ++i) {
    if (i / channels % every != 0) continue;
    const auto first = i * all.samples;
    part.y.insert(part.y.end(), all.y.begin() + first, all.y.begin() + first + all.samples);
    part.variance.insert(part.variance.end(), all.variance.begin() + first, all.variance.begin() + first + all.samples);
    for (const auto field :
         {&SrdBatch::white, &SrdBatch::white_variance, &SrdBatch::quad_x_mm, &SrdBatch::quad_y_mm, &SrdBatch::pair_mm})
      if (!(all.*field).empty()) (part.*field).push_back((all.*field)[static_cast<size_t>(i)]);
    for (const auto field : {&SrdBatch::first_u_mm, &SrdBatch::step_mm, &SrdBatch::line_width_mm, &SrdBatch::blur_mm,
                             &SrdBatch::slope_in, &SrdBatch::slope_out, &SrdBatch::cos_in, &SrdBatch::cos_out,
                             &SrdBatch::slope_in_across, &SrdBatch::slope_out_across})
      (part.*field).push_back((all.*field)[static_cast<size_t>(i)]);
    part.valid.push_back(all.valid[i]);
  }
  return part;
}

std::vector<SrdBatch> SampledPixels(std::span<const SrdBatch* const> lights, int channels, int every) {
  std::vector<SrdBatch> parts;
  for (const SrdBatch* light : lights) parts.push_back(SampledPixels(*light, channels, every));
  return parts;
}

}  // namespace stratalux::fit
