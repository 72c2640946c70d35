// SPDX-License-Identifier: Apache-2.0
#include "fitter/photometric/photometric_stereo.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

enum class SourceState : uint8_t { kKnown, kUnlit, kNotFinite, kNegative };

class Estimator {
 public:
  Estimator(std::span<const LitImage> images, const SurfaceMap& surface, const PhotometricOptions& options)
      : images_(images), surface_(surface), options_(options) {}

  void EstimateQuad(int i, int j, PhotometricMap& map) {
    if (surface_.mask(i, j) == 0) {
      map.reason(i, j) = static_cast<uint8_t>(PhotometricReason::kNoSurface);
      return;
    }
    const Eigen::Vector3d point = surface_.Point(i, j);
    const std::vector<PointSource> sources = Sources(i, j, point);
    std::optional<Eigen::Vector3d> surface_normal = surface_.Normal(i, j);
    if (!surface_normal->allFinite()) surface_normal.reset();
    const PointNormal found = EstimatePointNormal(sources, -point.normalized(), surface_normal, options_);
    map.reason(i, j) = static_cast<uint8_t>(found.reason);
    for (int k = 0; k < 3; ++k) map.normal(i, j, k) = static_cast<float>(found.normal[k]);
    map.usable(i, j) = static_cast<uint8_t>(std::ranges::count_if(found.weights, [](double w) { return w > 0.0; }));
    map.residual(i, j) = static_cast<float>(found.residual);
    map.normal_sigma_rad(i, j) = static_cast<float>(found.sigma_rad);
    map.scatter(i, j) = static_cast<float>(found.scatter);
    if (map.usable(i, j) > 0) WriteAlbedo(i, j, sources, found, map);
  }

  void WriteMasked(PhotometricMap& map) const {
    map.masked_not_finite = masked_not_finite_;
    map.masked_negative = masked_negative_;
  }

 private:
  [[nodiscard]] std::vector<PointSource> Sources(int i, int j, const Eigen::Vector3d& point) {
    std::vector<PointSource> sources;
    for (const LitImage& image : images_) {
      PointSource source;
      switch (Measure(image, i, j, point, source)) {
        case SourceState::kKnown:
          sources.push_back(source);
          break;
        case SourceState::kNotFinite:
          ++masked_not_finite_;
          break;
        case SourceState::kNegative:
          ++masked_negative_;
          break;
        case SourceState::kUnlit:
          break;
      }
    }
    return sources;
  }

  // Intensity and its variance as means over channels: weights of their own for each light would mix in the colour of
  // the skin.
  [[nodiscard]] SourceState Measure(const LitImage& image, int i, int j, const Eigen::Vector3d& point,
                                    PointSource& source) const {
    const LightAtPoint light = image.light.At(point);
    if (!light.to_light.allFinite()) return SourceState::kUnlit;
    source.direction = light.to_light;
    const int channels = image.direct.channels();
    for (int c = 0; c < channels; ++c) {
      const double white = light.white_dn[static_cast<size_t>(c)];
      if (!(white > 0.0) || !std::isfinite(white)) return SourceState::kUnlit;
      const double value = image.direct(i, j, c);
      const double variance = image.variance.empty() ? 0.0 : image.variance(i, j, c);
      if (!std::isfinite(value) || !std::isfinite(variance)) return SourceState::kNotFinite;
      if (variance < 0.0 || value < -options_.negative_sigmas * std::sqrt(variance)) return SourceState::kNegative;
      source.per_channel[static_cast<size_t>(c)] = value / white;
      source.intensity += value / white / channels;
      source.variance += variance / (white * white) / (channels * channels);
    }
    return SourceState::kKnown;
  }

  // albedo_c = sum w y_c (n . l) / sum w (n . l)^2.
  static void WriteAlbedo(int i, int j, const std::vector<PointSource>& sources, const PointNormal& found,
                          PhotometricMap& map) {
    std::array<double, 3> sum{};
    double weight = 0.0;
    for (size_t s = 0; s < sources.size(); ++s) {
      const double cosine = found.normal.dot(sources[s].direction);
      for (size_t c = 0; c < 3; ++c) sum[c] += found.weights[s] * cosine * sources[s].per_channel[c];
      weight += found.weights[s] * cosine * cosine;
    }
    for (int c = 0; c < map.albedo.channels(); ++c)
      map.albedo(i, j, c) = static_cast<float>(sum[static_cast<size_t>(c)] / weight);
  }

  std::span<const LitImage> images_;
  const SurfaceMap& surface_;
  const PhotometricOptions& options_;
  std::atomic<int64_t> masked_not_finite_ = 0, masked_negative_ = 0;
};

std::string SizeOf(int width, int height, int channels) {
  return std::to_string(width) + "x" + std::to_string(height) + "x" + std::to_string(channels);
}

Status CheckInput(std::span<const LitImage> images, const SurfaceMap& surface) {
  if (images.empty() || images.size() > 255)
    return Status::Usage("photometric: " + std::to_string(images.size()) + " lights, allowed: 1 .. 255");
  const int width = surface.width(), height = surface.height(), channels = images[0].direct.channels();
  if (channels != 1 && channels != 3)
    return Status::Usage("photometric: " + std::to_string(channels) + " channels, allowed: 1 or 3");
  for (const LitImage& image : images) {
    SLX_RETURN_IF_ERROR(image.light.Validate().WithContext("photometric"));
    for (const auto& view : {image.direct, image.variance.empty() ? image.direct : image.variance})
      if (view.width() != width || view.height() != height || view.channels() != channels)
        return Status::Usage("photometric: an image is " + SizeOf(view.width(), view.height(), view.channels()) +
                             ", needed: " + SizeOf(width, height, channels));
  }
  return Status::Ok();
}

}  // namespace

Result<PhotometricMap> EstimateNormals(std::span<const LitImage> images, const SurfaceMap& surface,
                                       const PhotometricOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckInput(images, surface));
  const int width = surface.width(), height = surface.height();
  const Image<float> unknown(width, height, 1, std::nanf(""));
  PhotometricMap map;
  map.normal = Image<float>(width, height, 3, std::nanf(""));
  map.albedo = Image<float>(width, height, images[0].direct.channels(), std::nanf(""));
  map.residual = map.normal_sigma_rad = map.scatter = unknown;
  map.usable = map.reason = Image<uint8_t>(width, height);
  Estimator estimator(images, surface, options);
  ParallelFor(height, 4, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j)
      for (int i = 0; i < width; ++i) estimator.EstimateQuad(i, static_cast<int>(j), map);
  });
  for (const uint8_t reason : map.reason.pixels()) ++map.counts[reason];
  estimator.WriteMasked(map);
  return map;
}

}  // namespace stratalux::fit
