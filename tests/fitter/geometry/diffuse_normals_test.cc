// SPDX-License-Identifier: Apache-2.0
// Diffuse normals against what a Gaussian does to a wave: its amplitude falls to exp(-2 pi^2 s^2 / wavelength^2).
#include "fitter/photometric/diffuse_normals.h"

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "shared/image/finite_at.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 180, kHeight = 140;

CameraCalibration Camera() {
  CameraCalibration camera;
  camera.cfa = Cfa::kMono;
  camera.model = {.width = kWidth, .height = kHeight, .fx = 1400, .fy = 1400, .cx = 89.5, .cy = 69.5};
  return camera;
}

struct Scene {
  SurfaceMap surface;
  Image<float> normal;
};

// A plane through (0, 0, 700) mm.
Scene PlaneFacing(const Eigen::Vector3d& normal) {
  Scene scene;
  scene.surface = {Image<float>(kWidth, kHeight, 3), Image<float>(kWidth, kHeight, 3), Image<float>(kWidth, kHeight),
                   Image<uint8_t>(kWidth, kHeight, 1, 1)};
  const CameraCalibration camera = Camera();
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth; ++i) {
      const Eigen::Vector3d ray = camera.model.Unproject({double(i), double(j)});
      const Eigen::Vector3d point = ray * (700.0 * normal.z() / ray.dot(normal));
      for (int k = 0; k < 3; ++k) {
        scene.surface.point_mm(i, j, k) = static_cast<float>(point[k]);
        scene.surface.normal(i, j, k) = static_cast<float>(normal[k]);
      }
    }
  scene.normal = scene.surface.normal;
  return scene;
}

Eigen::Vector3d At(const Image<float>& normals, int i, int j, int colour = 0) {
  return {normals(i, j, 3 * colour), normals(i, j, 3 * colour + 1), normals(i, j, 3 * colour + 2)};
}

// Gaussians of as many mm.
double Within(double width_mm, double radius_mm) { return -std::expm1(-0.5 * std::pow(radius_mm / width_mm, 2)); }

// share(i, j, colour, radius_mm)
template <typename Share>
EnclosedLight LightOf(const Share& share) {
  return [=](int i, int j, int colour, double, std::span<const double> radii_mm, std::span<double> shares) {
    for (size_t k = 0; k < shares.size(); ++k) shares[k] = share(i, j, colour, radii_mm[k]);
    return std::isfinite(shares[0]);
  };
}

EnclosedLight Gaussian(double width_mm) {
  return LightOf([=](int, int, int, double radius_mm) { return Within(width_mm, radius_mm); });
}

void Set(Image<float>& normals, int i, int j, const Eigen::Vector3d& n) {
  for (int k = 0; k < 3; ++k) normals(i, j, k) = static_cast<float>(n[k]);
}

// Of waves across the surface, along it wherever it leans: lengths are those on the skin, not in the picture.
TEST(DiffuseNormals, FilterAWaveAsAGaussianDoes) {
  constexpr double kTilt = 0.05, kWaveMm = 7.5;
  for (const double lean_deg : {0.0, 45.0}) {
    const double lean = RadFromDeg(lean_deg);
    const Eigen::Vector3d out(std::sin(lean), 0.0, -std::cos(lean)), down_slope(std::cos(lean), 0.0, std::sin(lean));
    for (const Eigen::Vector3d& along : {down_slope, Eigen::Vector3d(0, 1, 0)}) {
      Scene scene = PlaneFacing(out);
      const auto phase = [&](int i, int j) {
        return 2.0 * std::numbers::pi * along.dot(scene.surface.Point(i, j)) / kWaveMm;
      };
      for (int j = 0; j < kHeight; ++j)
        for (int i = 0; i < kWidth; ++i)
          Set(scene.normal, i, j, (out + kTilt * std::cos(phase(i, j)) * along).normalized());
      // The second colour's light: half of it narrow, half wide.
      const EnclosedLight light = LightOf([](int, int, int colour, double radius_mm) {
        return colour == 0 ? Within(1.3, radius_mm) : 0.5 * (Within(0.7, radius_mm) + Within(1.8, radius_mm));
      });
      const auto diffuse = DiffuseNormals(scene.surface, scene.normal, 2, light, Camera());
      ASSERT_TRUE(diffuse.ok());
      ASSERT_EQ(diffuse->channels(), 6);
      for (const int colour : {0, 1}) {
        const auto kept = [&](double s) { return std::exp(-2.0 * std::pow(std::numbers::pi * s / kWaveMm, 2)); };
        const double left = colour == 0 ? kept(1.3) : 0.5 * (kept(0.7) + kept(1.8));
        double worst = 0.0;
        for (int j = 40; j < kHeight - 40; ++j)
          for (int i = 50; i < kWidth - 50; ++i)
            worst =
                std::max(worst, std::abs(At(*diffuse, i, j, colour).dot(along) / kTilt - left * std::cos(phase(i, j))));
        EXPECT_LT(worst, 0.02) << "of the wave, leaning by " << lean_deg << " degrees, colour " << colour;
        EXPECT_GT(left, 0.2) << "there is something to see";
      }
    }
  }
}

// A nose before a cheek, 15 mm nearer: neither takes of the other, nor what a fold turns away.
TEST(DiffuseNormals, KeepToTheirOwnPartOfTheFace) {
  const Eigen::Vector3d out(0, 0, -1), leaning = Eigen::Vector3d(0.3, 0, -1).normalized();
  Scene scene = PlaneFacing(out);
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth / 2; ++i) {
      for (int k = 0; k < 3; ++k) scene.surface.point_mm(i, j, k) *= 685.0F / 700.0F;
      Set(scene.normal, i, j, leaning);
    }
  const auto diffuse = DiffuseNormals(scene.surface, scene.normal, 1, Gaussian(1.5), Camera());
  ASSERT_TRUE(diffuse.ok());
  EXPECT_LT((At(*diffuse, kWidth / 2 - 1, 70) - leaning).norm(), 1e-6);
  EXPECT_LT((At(*diffuse, kWidth / 2, 70) - out).norm(), 1e-6);

  Scene fold = PlaneFacing(out);
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth / 2; ++i) Set(fold.normal, i, j, Eigen::Vector3d(1, 0, 0.1).normalized());
  const auto beside = DiffuseNormals(fold.surface, fold.normal, 1, Gaussian(1.5), Camera());
  EXPECT_LT((At(*beside, kWidth / 2, 70) - out).norm(), 1e-6);
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth / 2; ++i) Set(fold.normal, i, j, leaning);
  const auto together = DiffuseNormals(fold.surface, fold.normal, 1, Gaussian(1.5), Camera());
  EXPECT_GT((At(*together, kWidth / 2, 70) - out).norm(), 0.05) << "on one surface they do mix";
}

TEST(DiffuseNormals, AreTheSurfacesOwnWhereNothingScattersAndNoneOffIt) {
  Scene scene = PlaneFacing({0, 0, -1});
  scene.surface.mask(5, 5) = 0;
  Set(scene.normal, 60, 60, Eigen::Vector3d(0.2, 0.1, -1).normalized());
  const EnclosedLight light = LightOf([](int i, int j, int, double radius_mm) {
    if (j != 60 || i < 61 || i > 63) return std::nan("");
    return Within(i == 61 ? 1e-9 : i == 62 ? 0.01 : 1e6, radius_mm);  // far below a quad, beyond the picture
  });
  const auto diffuse = DiffuseNormals(scene.surface, scene.normal, 1, light, Camera());
  ASSERT_TRUE(diffuse.ok());
  EXPECT_EQ(At(*diffuse, 60, 60), At(scene.normal, 60, 60));
  for (const int i : {61, 62}) EXPECT_LT((At(*diffuse, i, 60) - At(scene.normal, i, 60)).norm(), 1e-6) << i;
  EXPECT_NEAR(At(*diffuse, 63, 60).norm(), 1.0, 1e-6);
  EXPECT_FALSE(FiniteAt(*diffuse, 5, 5));
}

TEST(DiffuseNormals, RefuseWhatDoesNotBelongTogether) {
  const Scene scene = PlaneFacing({0, 0, -1});
  EXPECT_EQ(DiffuseNormals(scene.surface, Image<float>(3, 3, 3), 1, Gaussian(1.0), Camera()).status().code(),
            StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
