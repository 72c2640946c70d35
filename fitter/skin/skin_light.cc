// SPDX-License-Identifier: Apache-2.0
#include "fitter/skin/skin_light.h"

#include <cmath>
#include <string>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// Of all projectors that light a quad, added up.
struct QuadLight {
  std::array<double, 3> direct{}, global{}, white{};  // by colour; 0 of those that the camera lacks
  int projectors = 0;
};

class Measurement {
 public:
  Measurement(std::span<const SeparationMap> separation, std::span<const Image<uint8_t>> lit, const SurfaceMap& surface,
              const RigCalibration& rig, double exposure_ms)
      : separation_(separation), lit_(lit), surface_(surface), rig_(rig), exposure_ms_(exposure_ms) {}

  void MeasureQuad(int i, int j, SkinLight& light) const {
    const SkinReason reason = surface_.mask(i, j) == 0 ? SkinReason::kNoSurface : Measured(i, j, light);
    light.reason(i, j) = static_cast<uint8_t>(reason);
  }

 private:
  [[nodiscard]] QuadLight LightAt(int i, int j) const {
    QuadLight all;
    for (size_t p = 0; p < separation_.size(); ++p) {
      const SeparationMap& map = separation_[p];
      if (lit_[p](i, j) == 0 || map.reason(i, j) != static_cast<uint8_t>(SeparationReason::kValid)) continue;
      const auto white = [&](int c) {
        return rig_.projectors[p].WhiteTargetDn(surface_.Point(i, j), surface_.Normal(i, j), c, exposure_ms_);
      };
      if (!(white(0) > 0.0)) continue;  // the surface faces away
      for (int c = 0; c < map.direct.channels(); ++c) {
        all.direct[c] += map.direct(i, j, c);
        all.global[c] += map.global(i, j, c);
        all.white[c] += white(c);
      }
      ++all.projectors;
    }
    return all;
  }

  [[nodiscard]] SkinReason Measured(int i, int j, SkinLight& light) const {
    const QuadLight all = LightAt(i, j);
    if (all.projectors == 0) return SkinReason::kUnlit;
    const int channels = light.share.channels();
    for (int c = 0; c < channels; ++c) {
      const double total = all.global[c] + all.direct[c];
      if (!(all.global[c] > 0.0) || !(total > 0.0) || !std::isfinite(total)) return SkinReason::kNotPositive;
    }
    for (int c = 0; c < channels; ++c) {
      light.reflectance(i, j, c) = static_cast<float>(all.global[c] / all.white[c]);
      light.share(i, j, c) = static_cast<float>(all.global[c] / (all.global[c] + all.direct[c]));
    }
    return SkinReason::kMeasured;
  }

  std::span<const SeparationMap> separation_;
  std::span<const Image<uint8_t>> lit_;
  const SurfaceMap& surface_;
  const RigCalibration& rig_;
  double exposure_ms_;
};

Status CheckInput(std::span<const SeparationMap> separation, std::span<const Image<uint8_t>> lit,
                  const SurfaceMap& surface, const RigCalibration& rig, double exposure_ms) {
  const size_t projectors = rig.projectors.size();
  if (separation.size() != projectors || lit.size() != projectors)
    return Status::Usage("skin: " + std::to_string(separation.size()) + " separations and " +
                         std::to_string(lit.size()) + " maps of lit quads for " + std::to_string(projectors) +
                         " projectors; needs one each");
  if (!(exposure_ms > 0.0)) return Status::Usage("skin: the exposure must be positive");
  for (size_t p = 0; p < projectors; ++p)
    for (const Image<uint8_t>* map : {&separation[p].reason, &lit[p]})
      if (map->width() != surface.width() || map->height() != surface.height())
        return Status::Usage("skin: the light of projector " + std::to_string(p) + " is not of the surface's size");
  return Status::Ok();
}

}  // namespace

const char* ToString(SkinReason reason) {
  constexpr std::array<const char*, kSkinReasons> kNames = {"measured", "no_surface", "unlit", "not_positive"};
  return kNames[static_cast<size_t>(reason)];
}

Result<SkinLight> MeasureSkinLight(std::span<const SeparationMap> separation, std::span<const Image<uint8_t>> lit,
                                   const SurfaceMap& surface, const RigCalibration& rig, double exposure_ms) {
  SLX_RETURN_IF_ERROR(CheckInput(separation, lit, surface, rig, exposure_ms));
  const int width = surface.width(), height = surface.height(),
            channels = separation.empty() ? 1 : separation[0].direct.channels();
  const Image<float> unknown(width, height, channels, std::nanf(""));
  SkinLight light{unknown, unknown, Image<uint8_t>(width, height), {}};
  const Measurement measurement(separation, lit, surface, rig, exposure_ms);
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < width; ++i) measurement.MeasureQuad(i, j, light);
  });
  for (const uint8_t reason : light.reason.pixels()) ++light.counts[reason];
  return light;
}

}  // namespace stratalux::fit
