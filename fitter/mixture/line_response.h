// SPDX-License-Identifier: Apache-2.0
// The measured line response B (model section 7): what share of the light that leaves at offset t from the line's
// position one sample sees. Exact box of the line, Gaussian blur, box of the sample; averaged over a cell of the fine
// grid.
#pragma once

#include <vector>

namespace stratalux::fit {

struct LineResponse {
  double line_width_mm = 0.0;
  double blur_mm = 0.0;        // standard deviation
  double sample_box_mm = 0.0;  // binned profiles
  double cell_mm = 0.0;
  // Half the distance, across the line, of the two sites that a sample averages (the greens of a quad); 0: one site.
  double pair_mm = 0.0;

  // Mean over the cell centred at t, and over the sample's box, of Phi((t + w/2) / blur) - Phi((t - w/2) / blur).
  [[nodiscard]] double At(double t_mm) const;
  // At(first_mm + i cell_mm) of `count` neighbouring cells, which share their edges.
  [[nodiscard]] std::vector<double> OnCells(double first_mm, int count) const;
  // Beyond this offset the response is below 1e-6.
  [[nodiscard]] double Support() const;

 private:
  [[nodiscard]] double OfOneSite(double t_mm) const;
};

}  // namespace stratalux::fit
