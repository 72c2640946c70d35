// SPDX-License-Identifier: Apache-2.0
// The measured line response B (model section 7): what share of the light that leaves at offset t from the line's
// position one sample sees. Exact box of the line, Gaussian blur, box of the sample, mean over the sample's sites;
// averaged over a cell of the fine grid.
#pragma once

#include <vector>

#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

// Camera sites that a sample averages, by their places across the line: `pool` x `pool` quads, one site or two in each,
// each of them a Gaussian or, along an axis of the image, two.
struct SampleSites {
  int pool = 1;
  // What one quad along x and one along y of the image move across the line; their signs do not matter.
  double quad_x_mm = 0.0, quad_y_mm = 0.0;
  // Half the distance of the two sites of a quad (the greens); 0: one site.
  double pair_mm = 0.0;
  // Half the distance of the two Gaussians that stand for a site's box along x and y (pixel_box.h); 0: the blur holds
  // it.
  double box_x_mm = 0.0, box_y_mm = 0.0;

  // visit(offset from their mean, mm; share of the sample), the shares adding up to one.
  template <typename Visit>
  void ForEach(const Visit& visit) const {
    const int along_x = quad_x_mm != 0.0 ? pool : 1, along_y = quad_y_mm != 0.0 ? pool : 1;
    const auto each_way = [](double half, const auto& at) {
      at(-half);
      if (half != 0.0) at(half);
    };
    const double share =
        1.0 / (along_x * along_y * (pair_mm != 0.0 ? 2 : 1) * (box_x_mm != 0.0 ? 2 : 1) * (box_y_mm != 0.0 ? 2 : 1));
    for (int j = 0; j < along_y; ++j)
      for (int i = 0; i < along_x; ++i) {
        const double quad = (i - 0.5 * (along_x - 1)) * quad_x_mm + (j - 0.5 * (along_y - 1)) * quad_y_mm;
        each_way(pair_mm, [&](double pair) {
          each_way(box_x_mm,
                   [&](double x) { each_way(box_y_mm, [&](double y) { visit(quad + pair + x + y, share); }); });
        });
      }
  }
  // Of the outermost site.
  [[nodiscard]] double ReachMm() const;
  [[nodiscard]] double VarianceMm2() const;
};

struct LineResponse {
  double line_width_mm = 0.0;
  double blur_mm = 0.0;        // standard deviation
  double sample_box_mm = 0.0;  // binned profiles
  double cell_mm = 0.0;
  SampleSites sites = {};

  // Mean over the cell centred at t, the sample's box and its sites of Phi((t + w/2) / blur) - Phi((t - w/2) / blur).
  [[nodiscard]] double At(double t_mm) const;
  // At(first_mm + i cell_mm) of `count` neighbouring cells, which share their edges.
  [[nodiscard]] std::vector<double> OnCells(double first_mm, int count) const;
  // Beyond this offset the response is below 1e-6.
  [[nodiscard]] double Support() const;

 private:
  [[nodiscard]] double OfOneSite(double t_mm) const;
};

// Those of a profile of `batch`, on cells of `cell_mm`.
[[nodiscard]] SampleSites SampleSitesOf(const SrdBatch& batch, int64_t profile);
[[nodiscard]] LineResponse LineResponseOf(const SrdBatch& batch, int64_t profile, double cell_mm);

}  // namespace stratalux::fit
