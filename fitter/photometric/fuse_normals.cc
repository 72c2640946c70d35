// SPDX-License-Identifier: Apache-2.0
#include "fitter/photometric/fuse_normals.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

std::vector<float> GaussianTaps(double sigma) {
  const int reach = static_cast<int>(std::ceil(3.0 * sigma));
  std::vector<float> taps(static_cast<size_t>(2 * reach + 1));
  for (int k = -reach; k <= reach; ++k)
    taps[static_cast<size_t>(k + reach)] = static_cast<float>(std::exp(-0.5 * k * k / (sigma * sigma)));
  return taps;
}

// Convolution along x (dx = 1) or y (dy = 1); outside the image is zero.
Image<float> Convolve(const Image<float>& in, const std::vector<float>& taps, int dx, int dy) {
  Image<float> out(in.width(), in.height(), in.channels());
  const int reach = static_cast<int>(taps.size() / 2);
  ParallelFor(in.height(), 8, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y)
      for (int x = 0; x < in.width(); ++x)
        for (int k = -reach; k <= reach; ++k) {
          if (!in.contains(x + k * dx, y + k * dy)) continue;
          const float weight = taps[static_cast<size_t>(k + reach)];
          for (int c = 0; c < in.channels(); ++c) out(x, y, c) += weight * in(x + k * dx, y + k * dy, c);
        }
  });
  return out;
}

}  // namespace

Status FuseOptions::Validate() const {
  if (sigma_quads > 0.0 && sigma_quads < 1000.0) return Status::Ok();
  return Status::Usage("fuse: sigma_quads = " + std::to_string(sigma_quads) + ", allowed: above 0, below 1000");
}

Result<Image<float>> FuseNormals(const SurfaceMap& surface, const PhotometricMap& photometric,
                                 const FuseOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const int width = surface.width(), height = surface.height();
  if (photometric.normal.width() != width || photometric.normal.height() != height)
    return Status::Usage("fuse: the photometric normals and the surface differ in size");

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
  const std::vector<float> taps = GaussianTaps(options.sigma_quads);
  const Image<float> smooth = Convolve(Convolve(difference, taps, 1, 0), taps, 0, 1);

  Image<float> energy(width, height);  // |D - G D|^2
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      if (!both(i, j)) continue;
      for (int k = 0; k < 3; ++k) {
        difference(i, j, k) -= smooth(i, j, k) / smooth(i, j, 3);
        energy(i, j) += difference(i, j, k) * difference(i, j, k);
      }
    }
  const Image<float> local_energy = Convolve(Convolve(energy, taps, 1, 0), taps, 0, 1);

  Image<float> fused = surface.normal;
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      if (!both(i, j)) continue;
      // One quad's residuals tell little of its noise, a neighbourhood's do.
      const float scatter = smooth(i, j, 6) > 0.0F ? smooth(i, j, 5) / smooth(i, j, 6) : 1.0F;
      const float noise = smooth(i, j, 4) * scatter;
      const float gain = local_energy(i, j) > noise ? 1.0F - noise / local_energy(i, j) : 0.0F;
      Eigen::Vector3f n;
      for (int k = 0; k < 3; ++k) n[k] = surface.normal(i, j, k) + gain * difference(i, j, k);
      n.normalize();
      for (int k = 0; k < 3; ++k) fused(i, j, k) = n[k];
    }
  return fused;
}

}  // namespace stratalux::fit
