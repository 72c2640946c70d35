// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/diffuse_normals.h"

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "fitter/export/exr_file.h"
#include "fitter/photometric/diffuse_normals.h"
#include "fitter/stages/colours.h"

namespace stratalux::fit {
namespace {

constexpr const char* kFile = "normal_diffuse.exr";

// 1 - exp(-t), of which a face asks a hundred million times: linear between points, 2e-6 off at most.
class Saturation {
 public:
  Saturation() {
    for (size_t k = 0; k < at_.size(); ++k)
      at_[k] = static_cast<float>(-std::expm1(-static_cast<double>(k) / kPerUnit));
  }
  [[nodiscard]] float operator()(float t) const {
    const float position = t * kPerUnit;
    if (!(position < kPerUnit * kEnd)) return 1.0F;
    const auto k = static_cast<size_t>(position);
    return std::lerp(at_[k], at_[k + 1], position - static_cast<float>(k));
  }

 private:
  static constexpr int kPerUnit = 256, kEnd = 16;
  std::array<float, kPerUnit * kEnd + 1> at_;
};

}  // namespace

Result<Image<float>> FilterNormals(const FaceShape& shape, const Image<float>& specular, const FittedLayers& layers) {
  const MixtureMap& map = layers.map;
  const EnclosedLight light = [&](int i, int j, int colour, double radius_mm, double blurred_mm) -> double {
    const int64_t profile = map.ProfileOfQuad(i, j, colour, layers.pool);
    if (profile < 0 || !map.Fitted(profile)) return std::nan("");
    static const Saturation kSaturation;
    float within = 0.0F, all = 0.0F;
    const auto half_r2 = static_cast<float>(0.5 * radius_mm * radius_mm),
               blurred_mm2 = static_cast<float>(blurred_mm * blurred_mm);
    for (int64_t l = profile * map.layers; l < (profile + 1) * map.layers; ++l) {
      const float left_mm2 = map.sigma_mm[l] * map.sigma_mm[l] - blurred_mm2;
      within += map.weight[l] * (left_mm2 > 0.0F ? kSaturation(half_r2 / left_mm2) : 1.0F);
      all += map.weight[l];
    }
    return within / all;
  };
  return DiffuseNormals(shape.surface, specular, map.channels, light, shape.record.camera);
}

std::vector<std::string> DiffuseNormalNames(int colours) {
  std::vector<std::string> names;
  if (colours == 0) return names;
  for (const std::string& colour : Colours(colours))
    for (const char* axis : {".X", ".Y", ".Z"}) names.push_back(colour + axis);
  return names;
}

Status SaveDiffuseNormals(const std::filesystem::path& folder, const Image<float>& diffuse) {
  return WriteExr(folder / kFile, diffuse, DiffuseNormalNames(diffuse.channels() / 3));
}

Result<Image<float>> LoadDiffuseNormals(const std::filesystem::path& folder, int colours) {
  return ReadExr(folder / kFile, DiffuseNormalNames(colours));
}

Image<float> OneDiffuseNormal(const Image<float>& diffuse) {
  return NormalsOfColour(diffuse, diffuse.channels() / 3 > 1 ? 1 : 0);
}

}  // namespace stratalux::fit
