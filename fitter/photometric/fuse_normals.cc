// SPDX-License-Identifier: Apache-2.0
#include "fitter/photometric/fuse_normals.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "fitter/image/gaussian_blur.h"

namespace stratalux::fit {

Status FuseOptions::Validate() const {
  if (window_quads > 0.0 && window_quads < 1000.0) return Status::Ok();
  return Status::Usage("fuse: window_quads = " + std::to_string(window_quads) + ", allowed: above 0, below 1000");
}

namespace {

// 0: it knows of none.
double MedianSmoothing(const SurfaceMap& surface) {
  std::vector<float> known;
  for (const float quads : surface.smoothing_quads.pixels())
    if (quads > 0.0F) known.push_back(quads);
  if (known.empty()) return 0.0;
  const auto middle = known.begin() + std::ssize(known) / 2;
  std::ranges::nth_element(known, middle);
  return *middle;
}

}  // namespace

Result<Image<float>> FuseNormals(const SurfaceMap& surface, const PhotometricMap& photometric,
                                 const FuseOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const int width = surface.width(), height = surface.height();
  if (photometric.normal.width() != width || photometric.normal.height() != height)
    return Status::Usage("fuse: the photometric normals and the surface differ in size");

  const double smoothing = MedianSmoothing(surface);
  if (!(smoothing > 0.0)) return surface.normal;

  // Channels 0..2: photometric minus geometric; 3: weight, so that holes neither count nor bleed in; 4: variance before
  // it was widened; 5, 6: squared residuals over their variances and their degrees of freedom.
  Image<float> difference(width, height, 7);
  const auto both = [&](int i, int j) {
    return surface.mask(i, j) != 0 && photometric.reason(i, j) == static_cast<uint8_t>(PhotometricReason::kValid);
  };
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      if (!both(i, j)) continue;
      for (int k = 0; k < 3; ++k) difference(i, j, k) = photometric.normal(i, j, k) - surface.normal(i, j, k);
      difference(i, j, 3) = 1.0F;
      difference(i, j, 4) = photometric.normal_sigma_rad(i, j) * photometric.normal_sigma_rad(i, j);
      const int freedom = photometric.usable(i, j) - 3;
      if (freedom <= 0) continue;
      difference(i, j, 4) /= std::max(1.0F, photometric.scatter(i, j));
      difference(i, j, 5) = static_cast<float>(freedom) * photometric.scatter(i, j);
      difference(i, j, 6) = static_cast<float>(freedom);
    }
  const Image<float> low = GaussianBlur(difference, smoothing);
  const Image<float> local = GaussianBlur(difference, options.window_quads);

  Image<float> energy(width, height);  // |D - L D|^2
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      if (!both(i, j)) continue;
      for (int k = 0; k < 3; ++k) {
        difference(i, j, k) -= low(i, j, k) / low(i, j, 3);
        energy(i, j) += difference(i, j, k) * difference(i, j, k);
      }
    }
  const Image<float> local_energy = GaussianBlur(energy, options.window_quads);
  const auto above = static_cast<float>(NoiseAboveBlur(smoothing));

  Image<float> fused = surface.normal;
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      if (!both(i, j)) continue;
      // One quad's residuals tell little of its noise, a neighbourhood's do.
      const float scatter = local(i, j, 6) > 0.0F ? local(i, j, 5) / local(i, j, 6) : 1.0F;
      const float noise = above * local(i, j, 4) * scatter;
      const float gain = local_energy(i, j) > noise ? 1.0F - noise / local_energy(i, j) : 0.0F;
      Eigen::Vector3f n;
      for (int k = 0; k < 3; ++k) n[k] = surface.normal(i, j, k) + gain * difference(i, j, k);
      n.normalize();
      for (int k = 0; k < 3; ++k) fused(i, j, k) = n[k];
    }
  return fused;
}

}  // namespace stratalux::fit
