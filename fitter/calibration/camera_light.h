// SPDX-License-Identifier: Apache-2.0
// Noise, dark signal and response of the camera from raw frames (docs/math/calibration.md, "Light"). Streaming: a few
// frames at a time.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "fitter/calibration/light_report.h"
#include "shared/base/result.h"
#include "shared/image/pixel_format.h"

namespace stratalux::fit {

// Step between the raw levels that occur: 1 for 12 bits, 4 for 10 bits in a 12-bit container.
class QuantisationStep {
 public:
  void Add(ImageView<const uint16_t> raw);
  [[nodiscard]] int dn() const;

 private:
  unsigned bits_ = 0;  // that are set in any level
};
// What a record states as read noise, dn: SensorNoise adds the quantisation of a step of 1, and this what a coarser
// step `step_dn` has beyond that: sqrt(read^2 + (q^2 - 1) / 12).
[[nodiscard]] double NoiseInTheDark(double read_noise_dn, int step_dn);

// Temporal statistics of dark frames, one exposure after the other.
class DarkStatistics {
 public:
  // kIntegrity where the frame's size differs from those before.
  [[nodiscard]] Status Add(const Image<uint16_t>& raw, double exposure_ms);
  // kFailed with fewer than 4 frames of some exposure.
  [[nodiscard]] Result<DarkReport> Finish() const;

 private:
  struct Exposure {
    double ms = 0.0;
    int frames = 0;
    Image<uint16_t> first;  // differences from it add up exactly
    Image<int32_t> sum;
    Image<int64_t> squares;
  };
  [[nodiscard]] double MeanAt(const Exposure& e, size_t site) const;
  [[nodiscard]] double VarianceAt(const Exposure& e, size_t site) const;
  std::vector<Exposure> exposures_;
  QuantisationStep step_;
};

// One exposure of the ramp: whites that differ by noise alone, and the black that belongs to them.
struct RampFrames {
  ImageView<const uint16_t> white_a, white_b, black;
  double exposure_ms = 0.0;
};

// Photon transfer and linearity, from tiles of 16 x 16 sites, each colour apart.
class ExposureRamp {
 public:
  // `saturation_dn`, `black_level_dn`: raw levels.
  ExposureRamp(Cfa cfa, double saturation_dn, double black_level_dn)
      : cfa_(cfa), saturation_dn_(saturation_dn), range_dn_(saturation_dn - black_level_dn) {}

  void Add(const RampFrames& frames);
  // var = read^2 + step^2 / 12 + L / (gain h'(s)^2) (Janesick 2007), least squares over the tiles below 60 % of the
  // range. L = h(s) is the light of level s, by `response` (CameraCalibration::response; empty: h is straight): charges
  // are counted before the camera compresses them, and their noise with them. kFailed: fewer than 50 tiles, or a
  // variance that does not grow with the light.
  [[nodiscard]] Result<PhotonTransfer> Transfer(const std::vector<double>& response) const;
  // h(s) = s (1 + a_1 s + ... + a_4 s^4), s the raw level above black as a share of the range, such that h is
  // proportional to the exposure in every tile; made monotone. kFailed: fewer than 4 exposures or 20 tiles.
  [[nodiscard]] Result<CameraResponseReport> Response() const;

 private:
  struct Cell {
    double level = 0.0, black = 0.0, variance = 0.0;  // raw dn of white and black; dn^2 of one white frame
    int sites = 0;                                    // 0: saturated somewhere
  };
  struct Exposure {
    double ms = 0.0;
    std::vector<Cell> cells;  // tile by tile, colour by colour
  };
  // Levels without light, by cell: the blacks' at exposure 0. All light (ambient and the projector's own black, too)
  // makes noise, and all of it grows with the exposure.
  [[nodiscard]] std::vector<double> Offsets() const;

  Cfa cfa_;
  double saturation_dn_, range_dn_;
  QuantisationStep step_;
  std::vector<Exposure> exposures_;
};

}  // namespace stratalux::fit
