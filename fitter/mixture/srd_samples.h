// SPDX-License-Identifier: Apache-2.0
// The data EM works on: sampled spatial radiance distributions (SRDs) of many profiles, several projectors each.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "shared/base/check.h"

namespace stratalux::fit {

// By SrdBatch::apart, or marks like it.
[[nodiscard]] inline bool IsApart(std::span<const uint8_t> apart, int64_t profile) {
  return !apart.empty() && apart[static_cast<size_t>(profile)] != 0;
}

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
  std::vector<float> y;  // [row][K]; may be negative (never clipped)
  // Row of a profile, -1: it has none and is not valid. Empty: profile i has row i. Of a camera's pixels a
  // fifth shows lit face: the samples of the others would be most of the memory.
  std::vector<int32_t> row;
  // Response to all columns at once in units of the samples' sum, from the white frames, and its variance (0: unknown);
  // empty where there are none. It fixes the scale far better than the sum of dim samples does.
  std::vector<float> white, white_variance;
  // [profile] by the camera's noise model: var(y) = noise_floor + noise_slope max(y, 0) (photon_noise.h).
  std::vector<float> noise_floor, noise_slope;
  std::vector<float> first_u_mm;     // [profile]
  std::vector<float> step_mm;        // [profile]
  std::vector<float> line_width_mm;  // [profile]
  std::vector<float> blur_mm;        // [profile] standard deviation of projector + camera blur and pixel's box
  // The sites that a sample averages: SampleSites of each profile. Empty: 0 everywhere.
  int pool = 1;
  std::vector<float> quad_x_mm, quad_y_mm, pair_mm, box_x_mm, box_y_mm;  // [profile]
  std::vector<float> slope_in;         // [profile] tangent of incidence along e: t(omega_i) . e
  std::vector<float> slope_out;        // [profile] t(omega_o) . e
  std::vector<float> cos_in;           // [profile] n . omega_i
  std::vector<float> cos_out;          // [profile] n . omega_o
  std::vector<float> slope_in_across;  // [profile] t(omega_i) . (n x e), the part along the line (for exact refraction)
  std::vector<float> slope_out_across;  // [profile]
  std::vector<uint8_t> valid;           // [profile] 0: this projector does not light the pixel
  // [profile] 1: fitted as any other, but without a part in what all pixels share (surface reflection, tau, mean
  // layers, offset, prior): it is no skin. The same for all lights. Empty: none.
  std::vector<uint8_t> apart;
  // [profile] Which profile of the whole map it is, where these are some of them (ProfilesOf); empty: the same.
  std::vector<int64_t> place;
  [[nodiscard]] int64_t PlaceOf(int64_t profile) const {
    return place.empty() ? profile : place[static_cast<size_t>(profile)];
  }
  [[nodiscard]] bool IsApart(int64_t profile) const { return fit::IsApart(apart, profile); }
  [[nodiscard]] bool Shares(int64_t profile) const {
    return valid[static_cast<size_t>(profile)] != 0 && !IsApart(profile);
  }
  [[nodiscard]] int64_t profiles() const { return static_cast<int64_t>(first_u_mm.size()); }
  // Of a profile that has a row: its K samples.
  [[nodiscard]] std::span<const float> Samples(int64_t profile) const {
    return {y.data() + FirstOf(profile), static_cast<size_t>(samples)};
  }
  [[nodiscard]] std::span<float> Samples(int64_t profile) {
    return {y.data() + FirstOf(profile), static_cast<size_t>(samples)};
  }
  // Of all of its samples together, by that line: of brackets some samples of which saturated up to a third too much.
  [[nodiscard]] double VarianceOfSum(int64_t profile) const;
  // Rows for the profiles for which `wanted` is not 0, in their order, and for no other; values are lost.
  void AllotRows(std::span<const uint8_t> wanted, float value);
  // Drops the rows of profiles that are not valid.
  void KeepValidRows();

 private:
  [[nodiscard]] size_t FirstOf(int64_t profile) const {
    const int64_t at = row.empty() ? profile : row[static_cast<size_t>(profile)];
    SLX_CHECK(at >= 0);
    return static_cast<size_t>(at * samples);
  }
};

// These profiles of `batch` alone, in the order of `which`.
[[nodiscard]] SrdBatch ProfilesOf(const SrdBatch& batch, std::span<const int64_t> which);

}  // namespace stratalux::fit
