// SPDX-License-Identifier: Apache-2.0
// SRD extraction: the response of each pixel to the moving comb of one projector (model section 6).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "fitter/mixture/photon_noise.h"
#include "fitter/mixture/srd_samples.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {

// One comb cycle: line k covers columns (or rows) [k step, k step + width), repeated every `period` of them.
struct CombCycle {
  int period = 128;
  int width = 2;
  int step = 2;
  double exposure_ms = 0.0;  // nominal; the white target's digital numbers are those of this exposure
  PatternAxis axis = PatternAxis::kColumns;
  [[nodiscard]] int frames() const { return period / step; }
  // Every column is lit as often as any other: the cycle's frames add up to width / step whites. Not where some of its
  // combs are left out (step > width): then that holds of their mean over the columns alone.
  [[nodiscard]] bool LightsAllAlike() const { return width % step == 0; }
  [[nodiscard]] Status Validate() const;
};

// How a profile is read. Gather: the radiance that leaves at the pixel, over the frames of the cycle; parameters belong
// to the exit point. Scatter ([M]): the radiance beside the line that lies on the pixel, in the one frame that has it
// there; parameters belong to the entry point.
enum class SrdReading : uint8_t { kGather, kScatter };
[[nodiscard]] const char* ToString(SrdReading reading);
[[nodiscard]] Result<SrdReading> ParseSrdReading(const std::string& text);

// Where distances across the line are measured: on the pixel's tangent plane, or along the measured surface.
enum class SrdDistance : uint8_t { kTangentPlane, kSurface };
[[nodiscard]] const char* ToString(SrdDistance distance);
[[nodiscard]] Result<SrdDistance> ParseSrdDistance(const std::string& text);

struct SrdOptions {
  int pool = 1;           // pool x pool quads make one profile
  double min_cos = 0.15;  // grazing light or view beyond about 81 degrees carries no usable SRD
  // A profile is too dark when its cycle sum is below this many standard deviations of itself.
  double min_signal_to_noise = 1.0;
  // A profile moved (or saw another light) when its cycle sum and its white frames differ by more than this share and
  // by more than five standard deviations.
  double energy_tolerance = 0.1;
  SrdReading reading = SrdReading::kGather;
  SrdDistance distance = SrdDistance::kTangentPlane;
  [[nodiscard]] Status Validate() const;
};

enum class SrdReason : uint8_t { kValid = 0, kNoSurface, kUnlit, kGrazing, kSaturated, kTooDark, kMoved, kCutOff };
inline constexpr int kSrdReasons = 8;
[[nodiscard]] const char* ToString(SrdReason reason);

// Where one pooled pixel lies with respect to one projector's columns (for a row sweep: rows, here and below). Lengths
// mm; e is the unit tangent across the line, in the sense of rising columns: e = grad_t C / |grad_t C|, and m = 1 /
// |grad_t C| is the length of a column.
struct SrdGeometry {
  double column = 0.0;                      // C at the colour's own site(s)
  double mm_per_column = 0.0;               // m
  double blur_mm = 0.0;                     // projector and camera blur, pixel's box: standard deviation
  double quad_x_mm = 0.0, quad_y_mm = 0.0;  // what one quad along the image's x, y moves across the line
  double pair_mm = 0.0;                     // half the distance across the line of the two greens of a quad
  // Where the box is so long that no Gaussian is like it: half the distance across the line of the two that stand for
  // it (SampleSites), along the image's x, y.
  double box_x_mm = 0.0, box_y_mm = 0.0;
  double white_dn = 0.0;                   // E: what a white Lambertian target would read here, all columns on
  double slope_in = 0.0, slope_out = 0.0;  // t(omega) . e
  double slope_in_across = 0.0, slope_out_across = 0.0;   // t(omega) . (n x e)
  double cos_in = 0.0, cos_out = 0.0;                     // n . omega
  Eigen::Vector3d across_line = Eigen::Vector3d::Zero();  // e
};

// Geometry of colour `channel` of a pixel, pooled or not, whose centre is the mosaic position `pixel` and whose surface
// is the plane (point, normal). cos_in <= 0 where the point faces away; white_dn = 0 outside the projector's image.
[[nodiscard]] SrdGeometry ComputeSrdGeometry(const RigCalibration& rig, int projector, const Eigen::Vector3d& point,
                                             const Eigen::Vector3d& normal, const Eigen::Vector2d& pixel, int channel,
                                             double exposure_ms, PatternAxis axis = PatternAxis::kColumns);

// One shot of a comb: mosaic, the projector's black in the same exposure (ambient, black level), the exposure itself.
struct CombShot {
  ImageView<const uint16_t> raw;
  ImageView<const float> dark_dn;
  double exposure_ms = 0.0;
};

// The shots of cycle position k: one a bracket. They are merged quad by quad, each weighted by the inverse of the
// variance that their common level implies; a shot with a saturated site in the quad is left out.
struct CombFrame {
  int k = 0;
  std::vector<CombShot> shots;
};

// Does the cycle add up to the white frames? Over profiles that have both, with less than 5 % of noise.
struct EnergyCheck {
  int64_t profiles = 0;
  double median_ratio = 1.0;  // cycle sum over w / q whites
  double p95_error = 0.0;     // 95th percentile of |ratio - 1|
};

// Streams the frames of one cycle: memory holds the samples, never the cycle's frames. Thread-bound; works on all
// cores, same bits for any number of them.
class SrdExtractor {
 public:
  // `lit`: W x H on quads, 1 where the projector reaches the point. The surface must match the camera's quads.
  SrdExtractor(const SurfaceMap& surface, ImageView<const uint8_t> lit, const RigCalibration& rig, int projector,
               const CombCycle& cycle, const SrdOptions& options = {});

  // Any number of frames at a time, each cycle position once; some sixteen make the best use of the caches.
  void AddFrames(std::span<const CombFrame> frames);

  // Mean of `count` white frames of this projector (all columns on), raw; NaN where a site was saturated. Optional.
  void SetWhite(ImageView<const float> mean_dn, int count, ImageView<const float> dark_dn);

  // Call once. A cycle that lacks one frame gets it from the white frames, less the others (gather only); precondition:
  // no more are missing, and that only where SetWhite() was called and the cycle LightsAllAlike(). Profile index as in
  // MixtureMap, of width() x height() x channels.
  SrdBatch Take();
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] const std::array<int64_t, kSrdReasons>& counts() const { return counts_; }
  [[nodiscard]] const EnergyCheck& energy() const { return energy_; }

 private:
  // Radiance of a row of pooled quads, digital numbers of the nominal exposure above dark, and its variance; NaN where
  // every shot is saturated.
  struct Row {
    std::vector<float> signal, variance;  // [x][channel]
  };
  void Prepare();
  void PrepareProfile(int64_t profile, const SrdGeometry& g);
  void MeasureAlongSurface();
  void MergeRow(const CombFrame& frame, int y, Row& row) const;
  void Gather(std::span<const CombFrame> frames);
  void SetNoise();
  // Of its samples together.
  [[nodiscard]] double VarianceOfSum(int64_t profile) const { return noise_[profile].Sum(batch_.samples); }
  void Scatter(const CombFrame& frame);
  [[nodiscard]] SrdReason ReadBesideLine(int64_t profile, ImageView<const float> signal,
                                         ImageView<const float> variance);
  void FillMissingFrame();
  [[nodiscard]] double ArcTo(int64_t home, double column, int64_t& from) const;
  void ResampleAlongSurface();
  void CheckEnergy();
  void RejectTooDark();

  [[nodiscard]] bool Valid(int64_t profile) const {
    return reason_[profile] == static_cast<uint8_t>(SrdReason::kValid);
  }
  void Reject(int64_t profile, SrdReason reason) { reason_[profile] = static_cast<uint8_t>(reason); }
  [[nodiscard]] Eigen::Vector2d PixelCentre(int x, int y) const;

  const RigCalibration& rig_;
  int projector_;
  CombCycle cycle_;
  SrdOptions options_;
  int width_ = 0, height_ = 0, channels_ = 0;
  SurfaceMap surface_;  // pooled
  Image<uint8_t> lit_;  // pooled
  SrdBatch batch_;
  std::vector<float> white_dn_;
  std::vector<NoiseLine> noise_;  // of each profile's samples so far
  std::vector<uint8_t> reason_;
  std::vector<uint8_t> seen_;           // [k]
  std::vector<Eigen::Vector3f> along_;  // scatter: e of each profile
  std::vector<float> column_;           // scatter, surface distance: C of each profile
  std::vector<float> arc_mm_;           // surface distance: length across the lines along an image row or column
  int64_t walk_ = 0;                    // from a profile to the next one on that row or column
  bool walk_rises_ = true;              // with the projector's columns
  std::array<int64_t, kSrdReasons> counts_{};
  EnergyCheck energy_;
};

// Surface of pooled pixels: mean point, mean normal; known where at least half of the quads are.
[[nodiscard]] SurfaceMap PoolSurface(const SurfaceMap& surface, int pool);

}  // namespace stratalux::fit
