// SPDX-License-Identifier: Apache-2.0
// How far a prediction of light may be off that nobody captured: learnt from lights that the fit did not see and that
// were captured all the same (docs/math/evaluation.md, "Intervals").
//
// A pixel's error is the sum of four, independent of each other, each as large as what it acts on:
//   sigma^2 = (albedo p)^2 + (normal_rad tan(theta) p)^2                                                          (6)
//             + (placement_quads w |step (p / w)|)^2 + (spread p (1 - p / w))^2
// with p the prediction, theta the angle of incidence, w what the light's white would show in the place of its
// pattern, |step (p / w)| how far that share differs from one quad to the next. What may be misplaced is the pattern on
// the skin; the skin itself was fitted in its place, so w's own steps do not count. How far light spreads matters where
// a part of the white's is missing. All are proportional to the light, so that (6) holds at any strength of it.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "fitter/mixture/standard_errors.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// What the error of one pixel and colour depends on, in the unit of the prediction.
struct ErrorCauses {
  float prediction = 0.0F;
  float tan_incidence = 0.0F;
  float step = 0.0F;    // w |step (p / w)|, per quad
  float spread = 0.0F;  // p (1 - p / w)
};

// Of a prediction W x H x C (NaN or off the surface: nobody's neighbour) and that of the light's white, itself where
// the light has no pattern: |step|^2 = the product of the differences to the left and right neighbours plus that of
// those to the upper and lower ones (where light falls off exponentially that is its slope, on either flank; at a jump
// between two even shares it is 0); of one neighbour alone its square. Both must outlive it.
class ErrorCauseMaps {
 public:
  ErrorCauseMaps(const SurfaceMap& surface, const Eigen::Vector3d& light_mm, const Image<float>& prediction,
                 const Image<float>& white);
  [[nodiscard]] ErrorCauses At(int i, int j, int c) const {
    const float p = prediction_(i, j, c), w = white_(i, j, c);
    return {p, tan_incidence_(i, j), step_(i, j, c), w > p ? p * (1.0F - p / w) : 0.0F};
  }

 private:
  const Image<float>&prediction_, &white_;
  Image<float> tan_incidence_, step_;
};

// A pixel and colour of a light that was predicted and captured.
struct ErrorSample {
  ErrorCauses causes;
  float residual = 0.0F;        // captured less predicted
  float squared_error = 0.0F;   // of the prediction, without the capture's noise in expectation: may be negative
  float noise_variance = 0.0F;  // of the capture
};

// Of one colour.
struct PredictionError {
  double albedo = 0.0;           // share of the light
  double normal_rad = 0.0;       // of the surface that is lit
  double placement_quads = 0.0;  // of the pattern on the skin
  double spread = 0.0;           // of how far light goes: share of p where most of its white is missing
  int64_t samples = 0;
  // Of the incidences that it was learnt from: beyond, where little but scattered light is left, (6) takes this one.
  double most_tan_incidence = 0.0;

  [[nodiscard]] double Sigma(const ErrorCauses& causes) const;
  // Half the 95 % interval of the light.
  [[nodiscard]] double HalfWidth(const ErrorCauses& causes) const { return kInterval95 * Sigma(causes); }
};

// The parts, none below 0, by which kInterval95 sigma leaves 5 % of the errors outside, whichever part prevails: errors
// of light have more outliers than a normal distribution, by whose mean square all other intervals would be too wide.
// Where hardly any error exceeds its noise, the mean square's. nullopt: too few samples, or noise is all that they
// tell.
[[nodiscard]] std::optional<PredictionError> LearnPredictionError(std::span<const ErrorSample> samples);

// Half the 95 % intervals of a prediction by a light at `light_mm`, whose white is predicted as `white`, `colours` of
// its colours: W x H x C, NaN where the prediction is, 0 off the surface.
[[nodiscard]] Image<float> HalfWidths(const SurfaceMap& surface, const Eigen::Vector3d& light_mm,
                                      const Image<float>& prediction, const Image<float>& white,
                                      std::span<const PredictionError> colours);

// Share of the samples that lie within the interval, widened by their own noise's. NaN of none.
[[nodiscard]] double ShareWithin(std::span<const ErrorSample> samples, const PredictionError& error);

}  // namespace stratalux::fit
