// SPDX-License-Identifier: Apache-2.0
// The data EM works on: sampled spatial radiance distributions (SRDs) of many profiles, several projectors each.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace stratalux::fit {

// Samples of one projector for a batch of profiles. All profiles share the number of samples K; positions are regular:
//   sample k of profile i lies at u = first_u_mm[i] + k * step_mm[i] from the pixel's own entry point, wrapped with the
//   period K * step_mm[i] (comb sweeps), or not wrapped (single lines, CSV).
// y is in the reflectance unit (model section 6): the response to a line `line_width_mm` wide, a point sample in the
// line's position.
struct SrdBatch {
  int samples = 0;  // K
  bool wrapped = true;
  // Box that each sample averages over, as a share of the step: 0 for combs (a sample is a point in the line's
  // position), 1 for binned profiles (CSV).
  float sample_box = 0.0F;
  std::vector<float> y;         // [profile][K]; may be negative (never clipped)
  std::vector<float> variance;  // [profile][K] of y, from the camera's noise model
  // Response to all columns at once in units of the samples' sum, from the white frames, and its variance (0: unknown);
  // empty where there are none. It fixes the scale far better than the sum of dim samples does.
  std::vector<float> white, white_variance;
  std::vector<float> first_u_mm;     // [profile]
  std::vector<float> step_mm;        // [profile]
  std::vector<float> line_width_mm;  // [profile]
  std::vector<float> blur_mm;        // [profile] standard deviation of projector + camera blur and pixel footprint
  // The sites that a sample averages: SampleSites of each profile. Empty: 0 everywhere.
  int pool = 1;
  std::vector<float> quad_x_mm, quad_y_mm, pair_mm;  // [profile]
  std::vector<float> slope_in;                       // [profile] tangent of incidence along e: t(omega_i) . e
  std::vector<float> slope_out;                      // [profile] t(omega_o) . e
  std::vector<float> cos_in;                         // [profile] n . omega_i
  std::vector<float> cos_out;                        // [profile] n . omega_o
  std::vector<float> slope_in_across;  // [profile] t(omega_i) . (n x e), the part along the line (for exact refraction)
  std::vector<float> slope_out_across;  // [profile]
  std::vector<uint8_t> valid;           // [profile] 0: this projector does not light the pixel
  [[nodiscard]] int64_t profiles() const { return static_cast<int64_t>(first_u_mm.size()); }
};

// These profiles of `batch` alone, in the order of `which`.
[[nodiscard]] SrdBatch ProfilesOf(const SrdBatch& batch, std::span<const int64_t> which);

}  // namespace stratalux::fit
