// SPDX-License-Identifier: Apache-2.0
// Micro phase shifting (Gupta & Nayar, CVPR 2012): the column is told by the phases of sinusoids that are all about as
// fine as each other. Light that other parts of the scene send is the same under all of them, as it is under the finest
// stripes alone, and no plane is coarse. Here each period has two planes, a quarter of it apart, and each plane its
// inverse; so one period's phase stands by itself, however much contrast is left of it (docs/math/geometry.md).
#pragma once

#include <optional>
#include <span>
#include <vector>

namespace stratalux {

// The light of a plane at column c: 0.5 + 0.5 cos(2 pi (c + 0.5) / period_px - phase_rad).
struct Wave {
  double period_px = 0.0;  // fractional
  double phase_rad = 0.0;

  [[nodiscard]] double Angle(double column) const;  // of that cosine, rad
};

// Of plane 0 .. bits - 1: planes 2 j and 2 j + 1 have the j-th period. All lie within a fifth of `about_px`, in waves
// a column. bits: 1 .. kMaxCodeBits, about_px >= 3.
[[nodiscard]] Wave MicroPhaseWave(int plane, int bits, int about_px);

// Finds the column that the planes of one site agree on. Reentrant.
class MicroPhaseSearch {
 public:
  // What a sinusoid of period `about_px` says of the column: where in its period, from the period's first edge.
  struct Within {
    double px = 0.0;
    double sigma_px = 0.0;
  };
  struct Found {
    double column = 0.0;    // integer = centre of a projector pixel
    double sigma_px = 0.0;  // of the column, by the weights or, if that is more, by what the planes' phases leave of it
    double astray = 1.0;    // probability that the site lies half a period away and farther
    double chi2 = 0.0;      // of what the column and one amplitude leave of the differences
  };

  // `count`: columns that there are; at most 2^bits.
  MicroPhaseSearch(int count, int bits, int about_px);

  // Optics and skin take more of finer waves, of all sites about alike. `squares`: each plane's squared difference,
  // less its variance, summed over many sites; until then, and where that is nothing, all periods count as alike.
  void LearnContrast(std::span<const double> squares);

  // `difference`: light of each plane less its inverse's; `weight`: 1 / its variance, 0 for a plane that says nothing.
  [[nodiscard]] Found Find(std::span<const double> difference, std::span<const double> weight,
                           std::optional<Within> within = std::nullopt) const;

 private:
  // Columns first + k step, and each plane's angle there but for that of `first`.
  struct Candidates {
    double step_px = 0.0;
    int count = 0;
    std::vector<float> cosine, sine;  // plane by plane
  };
  struct Fit;

  [[nodiscard]] Candidates Every(double step_px) const;
  [[nodiscard]] Fit FitAll(const Candidates& candidates, double first, double sigma_px,
                           std::span<const double> difference, std::span<const double> weight) const;
  void Refine(std::span<const double> difference, std::span<const double> weight, const std::optional<Within>& within,
              Found& found) const;

  int count_ = 0, about_px_ = 0;
  std::vector<Wave> waves_;
  std::vector<double> contrast_;  // of each plane, over that of all
  Candidates periods_, everywhere_;
};

}  // namespace stratalux
