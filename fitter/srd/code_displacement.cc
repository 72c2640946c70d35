// SPDX-License-Identifier: Apache-2.0
#include "fitter/srd/code_displacement.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "fitter/mixture/shift_law.h"
#include "fitter/mixture/surface_reflection.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

// Grazing light tells no depth, and its tangents are without bound.
constexpr double kLeastCos = 0.1;

// Two tangents of a plane, across each other.
struct Tangents {
  Eigen::Vector3d normal, first, second;

  explicit Tangents(const Eigen::Vector3d& n) : normal(n), first(n.unitOrthogonal()), second(n.cross(first)) {}
  // t(omega), in them.
  [[nodiscard]] Eigen::Vector2d SlopeOf(const Eigen::Vector3d& direction) const {
    return Eigen::Vector2d(direction.dot(first), direction.dot(second)) / direction.dot(normal);
  }
};

Eigen::Vector2d ShiftOf(const Eigen::Vector2d& slope, const ScatteringModel& model) {
  return {TangentialShift(model.shift_law, slope.x(), slope.y(), model.eta),
          TangentialShift(model.shift_law, slope.y(), slope.x(), model.eta)};
}

// Of one projector's codes.
struct Codes {
  float weight = 0.0F, scattered = 1.0F;
};

double DisplacementAt(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, const std::vector<Codes>& codes,
                      const RigCalibration& rig, const ScatteringModel& model) {
  const Eigen::Vector3d to_camera = -point.normalized();
  if (to_camera.dot(normal) < kLeastCos) return 0.0;
  const Tangents plane(normal);
  const Eigen::Vector2d slope_out = plane.SlopeOf(to_camera), shift_out = ShiftOf(slope_out, model);
  const bool any = std::ranges::any_of(codes, [](const Codes& of) { return of.weight > 0.0F; });
  double of_codes = 0.0, of_depth = 0.0;
  for (size_t p = 0; p < rig.projectors.size(); ++p) {
    const Eigen::Vector3d to_lamp = (rig.projectors[p].CentreInCamera() - point).normalized();
    const double cos_in = to_lamp.dot(normal);
    if (cos_in < kLeastCos) continue;
    const double weight = (any ? codes[p].weight : 1.0) * cos_in * cos_in;
    const Eigen::Vector2d slope_in = plane.SlopeOf(to_lamp), slope = slope_in - slope_out;
    const Eigen::Vector2d shift = ShiftOf(slope_in, model) - shift_out;
    of_codes += weight * codes[p].scattered * shift.dot(slope);
    of_depth += weight * slope.squaredNorm();
  }
  return of_depth > 0.0 ? of_codes / of_depth : 0.0;
}

// Reflectance of what scattered, by pixel: the mean over colours and the `lights` that reach it; the face's own mean
// where none does. 0 where the whole face tells nothing.
std::vector<double> ScatteredReflectance(std::span<const SrdBatch* const> lights, const ScatteringModel& model,
                                         int channels) {
  const int64_t pixels = lights[0]->profiles() / channels;
  std::vector<double> means(static_cast<size_t>(pixels), 0.0);
  ParallelFor(pixels, 4096, [&](int64_t begin, int64_t end) {
    for (int64_t pixel = begin; pixel < end; ++pixel) {
      double sum = 0.0, count = 0.0;
      for (int64_t i = pixel * channels; i < (pixel + 1) * channels; ++i)
        for (const SrdBatch* light : lights) {
          const double white =
              light->valid[static_cast<size_t>(i)] != 0 ? WhiteReflectanceOf(*light, i).value : std::nan("");
          if (!std::isfinite(white)) continue;
          sum += white - HeldReflection(model.reflection, *light, i, model.eta);
          count += 1.0;
        }
      if (sum > 0.0) means[static_cast<size_t>(pixel)] = sum / count;
    }
  });
  const auto told = std::ranges::count_if(means, [](double mean) { return mean > 0.0; });
  const double of_face =
      std::accumulate(means.begin(), means.end(), 0.0) / static_cast<double>(std::max<int64_t>(told, 1));
  for (double& mean : means)
    if (!(mean > 0.0)) mean = of_face;
  return means;
}

}  // namespace

std::vector<Image<float>> ScatteredShares(std::span<const SrdBatch* const> lights, const ProfileGrid& grid, int pool,
                                          const SurfaceMap& surface, const RigCalibration& rig,
                                          const ScatteringModel& model) {
  std::vector<Image<float>> shares(rig.projectors.size(), Image<float>(surface.width(), surface.height(), 1, 1.0F));
  if (!model.reflection.Known()) return shares;
  const std::vector<double> scattered = ScatteredReflectance(lights, model, grid.channels);
  ParallelFor(surface.height(), 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        // Quads beyond the last whole pool are as the last one.
        const int64_t pixel =
            int64_t{std::min(j / pool, grid.height - 1)} * grid.width + std::min(i / pool, grid.width - 1);
        const double subsurface = scattered[static_cast<size_t>(pixel)];
        if (!(subsurface > 0.0)) continue;
        const Eigen::Vector3d point = surface.Point(i, j);
        const double gloss = model.reflection.gloss.At(pixel * grid.channels);
        for (size_t p = 0; p < shares.size(); ++p) {
          const Eigen::Vector3d to_lamp = (rig.projectors[p].CentreInCamera() - point).normalized();
          const double mirrored = ReflectanceOf(
              model.reflection, ReflectionAngles::Between(to_lamp, -point.normalized(), surface.Normal(i, j)),
              model.eta, gloss);
          shares[p](i, j) = static_cast<float>(subsurface / (subsurface + mirrored));
        }
      }
  });
  return shares;
}

Image<float> CodeDisplacement(const SurfaceMap& surface, const std::vector<Image<float>>& coded,
                              const std::vector<Image<float>>& scattered, const RigCalibration& rig,
                              const ScatteringModel& model) {
  Image<float> displacement(surface.width(), surface.height());
  ParallelFor(surface.height(), 8, [&](int64_t begin, int64_t end) {
    std::vector<Codes> here(rig.projectors.size());
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < surface.width(); ++x) {
        if (surface.mask(x, y) == 0) continue;
        for (size_t p = 0; p < here.size(); ++p) here[p] = {coded[p](x, y), scattered[p](x, y)};
        displacement(x, y) =
            static_cast<float>(DisplacementAt(surface.Point(x, y), surface.Normal(x, y), here, rig, model));
      }
  });
  return displacement;
}

}  // namespace stratalux::fit
