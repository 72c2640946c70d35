// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/diffuse_normals.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
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
  const EnclosedLight light = [&](int i, int j, int colour, double blurred_mm, std::span<const double> radii_mm,
                                  std::span<double> shares) {
    static const Saturation kSaturation;
    const int64_t profile = map.ProfileOfQuad(i, j, colour, layers.pool);
    if (profile < 0 || !map.Fitted(profile)) return false;
    const auto blurred_mm2 = static_cast<float>(blurred_mm * blurred_mm);
    std::fill(shares.begin(), shares.end(), 0.0);
    double all = 0.0, skin = 0.0, left = 0.0;  // of a wave of 1 / blurred_mm: what the skin leaves, what is left here
    for (int64_t l = profile * map.layers; l < (profile + 1) * map.layers; ++l) {
      const float weight = map.weight[l], of_skin_mm2 = map.sigma_mm[l] * map.sigma_mm[l],
                  left_mm2 = std::max(0.0F, of_skin_mm2 - blurred_mm2);
      all += weight;
      if (blurred_mm2 > 0.0F) {
        skin += weight * std::exp(-0.5F * of_skin_mm2 / blurred_mm2);
        left += weight * std::exp(-0.5F * left_mm2 / blurred_mm2);
      }
      for (size_t k = 0; k < shares.size(); ++k) {
        const auto half_r2 = static_cast<float>(0.5 * radii_mm[k] * radii_mm[k]);
        shares[k] += weight * (left_mm2 > 0.0F ? kSaturation(half_r2 / left_mm2) : 1.0F);
      }
    }
    // What layers narrower than the blur have too much of it, the others are to have too little.
    const double scattered = all > left ? std::clamp((all - std::exp(0.5) * skin) / (all - left), 0.0, 1.0) : 0.0;
    const double of_all = blurred_mm2 > 0.0F ? scattered : 1.0;
    for (double& share : shares) share = 1.0 - of_all + of_all * share / all;
    return true;
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
