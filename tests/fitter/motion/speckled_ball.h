// SPDX-License-Identifier: Apache-2.0
// A ball with spots on its skin under one light, seen by a camera with quads; its picture in any pose is computed on
// its own rays, without the code under test.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <vector>

#include "fitter/motion/rigid_flow.h"
#include "shared/base/random.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {

class SpeckledBall {
 public:
  explicit SpeckledBall(uint64_t seed, int width = 320, int height = 260) {
    camera_.model = {.width = width,
                     .height = height,
                     .fx = 2.6 * width,
                     .fy = 2.6 * width,
                     .cx = 0.5 * (width - 1),
                     .cy = 0.5 * (height - 1)};
    camera_.cfa = Cfa::kRggb;
    Random random(seed, 7);
    for (Wave& wave : waves_) {
      const double per_mm = 2.0 * std::numbers::pi / random.Uniform(6.0, 25.0);
      wave.along = Eigen::Vector3d(random.Normal(), random.Normal(), random.Normal()).normalized() * per_mm;
      wave.phase = random.Uniform(0.0, 6.28);
    }
  }

  [[nodiscard]] const CameraCalibration& camera() const { return camera_; }
  [[nodiscard]] int width() const { return camera_.model.width / 2; }
  [[nodiscard]] int height() const { return camera_.model.height / 2; }

  // In its place (kCentre) and moved by `pose`; NaN normals and points off it.
  [[nodiscard]] SurfaceMap Surface(const Rigid3& pose = {}) const {
    const float nan = std::nanf("");
    SurfaceMap map{Image<float>(width(), height(), 3, nan), Image<float>(width(), height(), 3, nan),
                   Image<float>(width(), height(), 1, 0.05F), Image<uint8_t>(width(), height())};
    for (int j = 0; j < height(); ++j)
      for (int i = 0; i < width(); ++i) {
        const auto point = Hit(i, j, pose);
        if (!point) continue;
        const Eigen::Vector3d normal = (*point - pose * kCentre).normalized();
        map.mask(i, j) = 1;
        for (int k = 0; k < 3; ++k) {
          map.point_mm(i, j, k) = static_cast<float>((*point)[k]);
          map.normal(i, j, k) = static_cast<float>(normal[k]);
        }
      }
    return map;
  }

  // Mean of 3 x 3 rays a quad; `noise`: relative standard deviation of a quad.
  [[nodiscard]] Image<float> Picture(const Rigid3& pose, double noise, uint64_t seed) const {
    Random random(seed, 3);
    const Rigid3 home = pose.Inverse();
    Image<float> picture(width(), height());
    for (int j = 0; j < height(); ++j)
      for (int i = 0; i < width(); ++i) {
        double sum = 0.0;
        for (int k = 0; k < 9; ++k) {
          const auto point = Hit(i + (k % 3 - 1) / 3.0, j + (k / 3 - 1) / 3.0, pose);
          if (!point) continue;
          const Eigen::Vector3d normal = (*point - pose * kCentre).normalized();
          sum += std::max(0.0, normal.dot((kLight - *point).normalized())) * Albedo(home * *point) / 9.0;
        }
        picture(i, j) = static_cast<float>(1000.0 * sum * (1.0 + noise * random.Normal()));
      }
    return picture;
  }

  // Where the light shines in its first place, away from its edge.
  [[nodiscard]] Image<uint8_t> Lit() const {
    Image<uint8_t> lit(width(), height());
    for (int j = 0; j < height(); ++j)
      for (int i = 0; i < width(); ++i) {
        const auto point = Hit(i, j, {});
        if (point && (*point - kCentre).normalized().dot((kLight - *point).normalized()) > 0.15) lit(i, j) = 1;
      }
    return lit;
  }

  // Pixel of the mosaic at which a point is seen, in quads.
  [[nodiscard]] Eigen::Vector2d Seen(const Eigen::Vector3d& point) const {
    return (*camera_.model.Project(point) - Eigen::Vector2d(0.5, 0.5)) / 2.0;
  }

  static inline const Eigen::Vector3d kCentre{5.0, -8.0, 720.0};
  static inline const Eigen::Vector3d kLight{-350.0, 40.0, 250.0};
  static constexpr double kRadiusMm = 85.0;

 private:
  struct Wave {
    Eigen::Vector3d along = Eigen::Vector3d::Zero();
    double phase = 0.0;
  };

  [[nodiscard]] double Albedo(const Eigen::Vector3d& at_home) const {
    double sum = 0.0;
    for (const Wave& wave : waves_) sum += std::sin(wave.along.dot(at_home) + wave.phase);
    return 0.4 * std::exp(0.02 * sum);
  }

  [[nodiscard]] std::optional<Eigen::Vector3d> Hit(double i, double j, const Rigid3& pose) const {
    const Eigen::Vector3d ray = camera_.model.Unproject({2.0 * i + 0.5, 2.0 * j + 0.5}).normalized();
    const Eigen::Vector3d centre = pose * kCentre;
    const double along = ray.dot(centre);
    const double beyond = kRadiusMm * kRadiusMm - (centre.squaredNorm() - along * along);
    if (beyond <= 0.0) return std::nullopt;
    return Eigen::Vector3d(ray * (along - std::sqrt(beyond)));
  }

  CameraCalibration camera_;
  std::array<Wave, 24> waves_;
};

}  // namespace stratalux::fit
