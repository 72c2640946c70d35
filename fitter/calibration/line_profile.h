// SPDX-License-Identifier: Apache-2.0
// The profile of one projected line on a matt target, sharper than any one pixel sees it: pixels lie at all distances
// from the lines, and the geometry tells which (docs/math/calibration.md, eq. 6).
#pragma once

#include <optional>
#include <vector>

#include "fitter/calibration/light_report.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Light of a comb at many places, as a share of white.
class LineSamples {
 public:
  LineSamples(int width_px, int period_px);
  // `column`: of the place on the target; `shift`: of the comb (its first line's first column). `columns_per_px2`:
  // squared columns that a step of one camera pixel moves by, x and y together.
  void Add(double column, int shift, double share_of_white, double columns_per_px2);
  void Merge(const LineSamples& other);

  struct Bin {
    double sum = 0.0;
    int64_t count = 0;
  };
  [[nodiscard]] int width_px() const { return width_px_; }
  [[nodiscard]] int period_px() const { return period_px_; }
  [[nodiscard]] const std::vector<Bin>& bins() const { return bins_; }
  [[nodiscard]] double MeanColumnsPerPx2() const;
  // Distance from the line's centre, columns, of bin k's middle.
  [[nodiscard]] double OffsetOf(size_t k) const;

 private:
  static constexpr int kBinsPerColumn = 8;
  int width_px_, period_px_;
  std::vector<Bin> bins_;
  double columns_per_px2_ = 0.0;
  int64_t count_ = 0;
};

// Light of the line in columns of white (its equivalent width), and the standard deviation of all that blurs it: of
//   box(width) * Gaussian(sigma)
// fitted to the profile, place and sigma free. kFailed: gaps in the profile, or no line in it.
struct LineShape {
  double width_px = 0.0, sigma_px = 0.0, centre_px = 0.0;
};
[[nodiscard]] Result<LineShape> FitLine(const LineSamples& samples);

// Projector and camera blur from lines under different footprints:
//   sigma^2 = projector_p^2 + (1/12 + camera^2) columns_per_px^2                                                (6)
// `known_camera_px` where the footprints differ too little to tell the two apart (`camera_px` is then absent).
struct LineBlur {
  std::vector<double> projector_px;
  std::optional<double> camera_px;
};
struct BlurSample {
  int projector = 0;
  double sigma_px = 0.0, columns_per_px2 = 0.0;
};
[[nodiscard]] LineBlur SplitBlur(const std::vector<BlurSample>& samples, size_t projectors, double known_camera_px);

// Full width at half maximum of box(width) * Gaussian(sigma).
[[nodiscard]] double FullWidthAtHalf(double width, double sigma);

}  // namespace stratalux::fit
