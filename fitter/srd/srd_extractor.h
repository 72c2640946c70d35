// SPDX-License-Identifier: Apache-2.0
// SRD extraction: the response of each pixel to the moving comb of one projector (gather reading, model section 6).
#pragma once

#include <array>
#include <cstdint>

#include "fitter/mixture/srd_samples.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// One comb cycle: line k covers columns [first_column + k step, ... + width), repeated every `period` columns.
struct CombCycle {
  int period = 128;
  int width = 2;
  int step = 2;
  double exposure_ms = 0.0;
  [[nodiscard]] int frames() const { return period / step; }
  [[nodiscard]] Status Validate() const;
};

struct SrdOptions {
  int pool = 1;           // pool x pool quads make one profile
  double min_cos = 0.15;  // grazing light or view beyond about 81 degrees carries no usable SRD
  // A profile is too dark when its cycle sum is below this many standard deviations of itself.
  double min_signal_to_noise = 5.0;
  [[nodiscard]] Status Validate() const;
};

enum class SrdReason : uint8_t { kValid = 0, kNoSurface, kUnlit, kGrazing, kSaturated, kTooDark };
inline constexpr int kSrdReasons = 6;
[[nodiscard]] const char* ToString(SrdReason reason);

// Where one pooled pixel lies with respect to one projector's columns. Lengths mm; e is the unit tangent across the
// line, in the sense of rising columns: e = grad_t C / |grad_t C|, and m = 1 / |grad_t C| is the length of a column.
struct SrdGeometry {
  double column = 0.0;                     // C at the colour's own site(s)
  double mm_per_column = 0.0;              // m
  double blur_mm = 0.0;                    // projector and camera blur, pixel box, pooled quads: standard deviation
  double pair_mm = 0.0;                    // half the distance across the line of the two greens of a quad
  double white_dn = 0.0;                   // E: what a white Lambertian target would read here, all columns on
  double slope_in = 0.0, slope_out = 0.0;  // t(omega) . e
  double slope_in_across = 0.0, slope_out_across = 0.0;  // t(omega) . (n x e)
  double cos_in = 0.0, cos_out = 0.0;                    // n . omega
};

// Geometry of colour `channel` of a pixel whose centre is the mosaic position `pixel` and whose surface is the plane
// (point, normal); `pool` quads wide. cos_in <= 0 where the point faces away; white_dn = 0 outside the projector's
// image.
[[nodiscard]] SrdGeometry ComputeSrdGeometry(const RigCalibration& rig, int projector, const Eigen::Vector3d& point,
                                             const Eigen::Vector3d& normal, const Eigen::Vector2d& pixel, int pool,
                                             int channel, double exposure_ms);

// Streams the frames of one cycle: memory holds the samples, never the frames. Thread-bound.
class SrdExtractor {
 public:
  // `lit`: W x H on quads, 1 where the projector reaches the point. The surface must match the camera's quads.
  SrdExtractor(const SurfaceMap& surface, ImageView<const uint8_t> lit, const RigCalibration& rig, int projector,
               const CombCycle& cycle, const SrdOptions& options = {});

  // `raw`: mosaic of cycle frame k; `dark_dn`: the same exposure with the projector black (ambient, black level).
  void AddFrame(int k, ImageView<const uint16_t> raw, ImageView<const float> dark_dn);

  // Mean of `count` white frames of this projector (all columns on), raw; NaN where a site was saturated. Optional.
  void SetWhite(ImageView<const float> mean_dn, int count, ImageView<const float> dark_dn);

  // Call once, after all frames. Profile index as in MixtureMap, of width() x height() x channels.
  SrdBatch Take();
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] const std::array<int64_t, kSrdReasons>& counts() const { return counts_; }

 private:
  void Prepare(const SurfaceMap& surface, ImageView<const uint8_t> lit);
  void PrepareProfile(int64_t profile, const SrdGeometry& g);

  const RigCalibration& rig_;
  int projector_;
  CombCycle cycle_;
  SrdOptions options_;
  int width_ = 0, height_ = 0, channels_ = 0;
  SrdBatch batch_;
  std::vector<float> white_dn_;
  std::vector<uint8_t> reason_;
  std::array<int64_t, kSrdReasons> counts_{};
};

// Surface of pooled pixels: mean point, mean normal; known where at least half of the quads are.
[[nodiscard]] SurfaceMap PoolSurface(const SurfaceMap& surface, int pool);

}  // namespace stratalux::fit
