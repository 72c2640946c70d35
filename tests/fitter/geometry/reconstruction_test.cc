// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "fitter/export/ply_file.h"
#include "fitter/reconstruction/components.h"
#include "fitter/reconstruction/mesh.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "fitter/reconstruction/triangulate.h"
#include "shared/base/random.h"
#include "tests/fitter/geometry/synthetic_rig.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

const Surface kBall = Sphere({0, 0, 680}, 80.0);

// True coordinates plus Gaussian noise of known sigma, as a decoder would give them.
std::vector<DecodedMap> NoisyMaps(const RigCalibration& rig, const Surface& surface, double sigma_px) {
  std::vector<DecodedMap> maps;
  Random random(7);
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) {
    const int width = rig.camera.model.width, height = rig.camera.model.height;
    const float nan = std::nanf("");
    DecodedMap map{Image<float>(width, height, 1, nan), Image<float>(width, height, 1, nan),
                   Image<float>(width, height, 1, nan), Image<float>(width, height, 1, nan),
                   Image<uint8_t>(width, height, 1, static_cast<uint8_t>(DecodeReason::kUnlit))};
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const auto hit = surface(rig.camera.model.Unproject(Eigen::Vector2d(x, y)));
        if (!hit || hit->normal.dot(rig.projectors[p].CentreInCamera() - hit->point) <= 0.0) continue;
        const Eigen::Vector2d at = *rig.projectors[p].ProjectFromCamera(hit->point);
        map.column(x, y) = static_cast<float>(at.x() + sigma_px * random.Normal());
        map.row(x, y) = static_cast<float>(at.y() + sigma_px * random.Normal());
        map.column_sigma(x, y) = map.row_sigma(x, y) = static_cast<float>(sigma_px);
        map.reason(x, y) = 0;
      }
    maps.push_back(std::move(map));
  }
  return maps;
}

struct Errors {
  double rms_mm = 0.0;
  double rms_in_sigmas = 0.0;
  double largest_mm = 0.0;
  int64_t count = 0;
};

// Of the range along each camera ray, `margin` px away from the edge of the surface.
Errors RangeErrors(const SurfaceMap& map, const SurfaceMap& truth, int margin) {
  Errors e;
  for (int j = margin; j < map.height() - margin; ++j)
    for (int i = margin; i < map.width() - margin; ++i) {
      bool inside = map.mask(i, j) != 0;
      for (int k = -margin; k <= margin; k += std::max(margin, 1))
        for (int l = -margin; l <= margin; l += std::max(margin, 1)) inside = inside && truth.mask(i + k, j + l) != 0;
      if (!inside) continue;
      const double error = map.Point(i, j).norm() - truth.Point(i, j).norm();
      e.rms_mm += error * error;
      e.rms_in_sigmas += std::pow(error / map.depth_sigma_mm(i, j), 2);
      e.largest_mm = std::max(e.largest_mm, std::abs(error));
      ++e.count;
    }
  e.rms_mm = std::sqrt(e.rms_mm / static_cast<double>(e.count));
  e.rms_in_sigmas = std::sqrt(e.rms_in_sigmas / static_cast<double>(e.count));
  return e;
}

TEST(Triangulate, IsExactWithoutNoise) {
  const RigCalibration rig = SyntheticRig();
  const auto out = Triangulate(NoisyMaps(rig, kBall, 0.0), rig);
  ASSERT_TRUE(out.ok()) << out.status().message();
  const Errors e = RangeErrors(out->surface, TrueSurface(rig, kBall), 0);
  EXPECT_GT(e.count, 4000);
  EXPECT_LT(e.largest_mm, 1e-3);
}

TEST(Triangulate, PredictsItsOwnNoise) {
  const RigCalibration rig = SyntheticRig();
  const auto out = Triangulate(NoisyMaps(rig, kBall, 0.2), rig, {.model_sigma_px = 0.0});
  ASSERT_TRUE(out.ok());
  const Errors e = RangeErrors(out->surface, TrueSurface(rig, kBall), 4);
  // Below 1 is the price of widening the covariance where residuals happen to scatter more.
  EXPECT_GT(e.rms_in_sigmas, 0.75);
  EXPECT_LT(e.rms_in_sigmas, 1.1);
}

TEST(Triangulate, AllProjectorsTogetherBeatEachAlone) {
  const RigCalibration rig = SyntheticRig();
  const auto maps = NoisyMaps(rig, kBall, 0.2);
  const SurfaceMap truth = TrueSurface(rig, kBall);
  const double joint = RangeErrors(Triangulate(maps, rig)->surface, truth, 4).rms_mm;
  for (size_t p = 0; p < maps.size(); ++p) {
    RigCalibration one = rig;
    one.projectors = {rig.projectors[p]};
    EXPECT_LT(joint, RangeErrors(Triangulate({&maps[p], 1}, one)->surface, truth, 4).rms_mm) << p;
  }
}

TEST(Triangulate, OutvotesOneWrongProjector) {
  const RigCalibration rig = SyntheticRig();
  auto maps = NoisyMaps(rig, kBall, 0.05);
  for (float& column : maps[1].column.pixels()) column += 16.0F;
  const auto out = Triangulate(maps, rig);
  ASSERT_TRUE(out.ok());
  const Errors e = RangeErrors(out->surface, TrueSurface(rig, kBall), 12);
  EXPECT_LT(e.rms_mm, 0.1);
  EXPECT_GT(out->counts.rejected_views, 3000);
}

// By how much depth gives way when one projector's columns are displaced follows from the weights.
TEST(Triangulate, WeightsSayWhatCodesDoToTheDepth) {
  const RigCalibration rig = SyntheticRig();
  auto maps = NoisyMaps(rig, kBall, 0.0);
  for (auto* sigma : {&maps[1].column_sigma, &maps[1].row_sigma})
    for (float& v : sigma->pixels()) v += 0.6F;  // of 0; NaN stays
  const auto before = Triangulate(maps, rig);
  constexpr std::array<float, 2> kShift = {0.02F, 0.2F};  // small beside their sigmas
  const int i = rig.camera.model.width / 2, j = rig.camera.model.height / 2;
  const auto seen_by = [&](size_t p) { return before->weights[p](i, j) > 0.0F; };
  ASSERT_TRUE(seen_by(0) && seen_by(1));
  EXPECT_NEAR(before->weights[0](i, j), 1.0F, 1e-3F);
  EXPECT_NEAR(before->weights[1](i, j), 0.04F / (0.04F + 0.36F), 1e-3F);
  // Projector pixels a mm along the camera's ray.
  const auto slope = [&](size_t p) -> Eigen::Vector2d {
    const Eigen::Vector3d x = before->surface.Point(i, j), ray = x.normalized();
    return *rig.projectors[p].ProjectFromCamera(x + 0.5 * ray) - *rig.projectors[p].ProjectFromCamera(x - 0.5 * ray);
  };
  double all = 0.0;
  for (size_t p = 0; p < maps.size(); ++p) all += before->weights[p](i, j) * slope(p).squaredNorm();
  for (const size_t p : {0, 1}) {
    auto moved = maps;
    for (float& column : moved[p].column.pixels()) column += kShift[p];
    const auto after = Triangulate(moved, rig);
    const double gave_way = after->surface.Point(i, j).norm() - before->surface.Point(i, j).norm();
    const double expected = kShift[p] * before->weights[p](i, j) * slope(p).x() / all;
    EXPECT_NEAR(gave_way, expected, 0.08 * std::abs(expected)) << p;
  }
  // Columns that are no part of the surface weigh nothing; their rows do. Nor weighs who sees nothing.
  for (float& column : maps[1].column.pixels()) column += 60.0F;
  EXPECT_NEAR(Triangulate(maps, rig)->weights[1](i, j), before->weights[1](i, j) / 2, 2e-3F);
  EXPECT_EQ(before->weights[0](0, 0), 0.0F);
}

TEST(Triangulate, DoesNotDependOnTheNumberOfThreads) {
  const RigCalibration rig = SyntheticRig();
  const auto maps = NoisyMaps(rig, kBall, 0.2);
  setenv("STRATALUX_THREADS", "1", 1);
  const auto one = Triangulate(maps, rig);
  const auto one_smooth = SmoothSurface(one->surface, rig);
  setenv("STRATALUX_THREADS", "3", 1);
  const auto three = Triangulate(maps, rig);
  const auto three_smooth = SmoothSurface(three->surface, rig);
  unsetenv("STRATALUX_THREADS");
  for (size_t k = 0; k < one_smooth->point_mm.size(); ++k) {
    const float a = one_smooth->point_mm.data()[k], b = three_smooth->point_mm.data()[k];
    ASSERT_TRUE(a == b || (std::isnan(a) && std::isnan(b)));
  }
}

TEST(Triangulate, RefusesMapsOfAnotherCamera) {
  RigCalibration rig = SyntheticRig();
  const auto maps = NoisyMaps(rig, kBall, 0.0);
  rig.camera.model.width += 2;
  EXPECT_EQ(Triangulate(maps, rig).status().code(), StatusCode::kUsage);
}

TEST(SmoothSurface, LeavesASlantedPlaneExactly) {
  const RigCalibration rig = SyntheticRig();
  const Eigen::Vector3d normal = Eigen::Vector3d(0.5, -0.3, -1.0).normalized();
  SurfaceMap plane = TrueSurface(rig, Plane({0, 0, 600}, normal));
  for (float& sigma : plane.depth_sigma_mm.pixels()) sigma = 0.1F;
  const auto smooth = SmoothSurface(plane, rig, {.radius_mm = 6.0});
  ASSERT_TRUE(smooth.ok());
  for (int j = 0; j < plane.height(); ++j)
    for (int i = 0; i < plane.width(); ++i) {
      ASSERT_NEAR(smooth->point_mm(i, j, 2), plane.point_mm(i, j, 2), 2e-3);
      ASSERT_GT(smooth->Normal(i, j).dot(normal), std::cos(2e-3));
    }
}

TEST(SmoothSurface, LowersNoiseAndPredictsWhatIsLeft) {
  const RigCalibration rig = SyntheticRig();
  const SurfaceMap truth = TrueSurface(rig, kBall);
  const auto rough = Triangulate(NoisyMaps(rig, kBall, 0.3), rig, {.model_sigma_px = 0.0});
  const auto smooth = SmoothSurface(rough->surface, rig, {.radius_mm = 9.0});
  ASSERT_TRUE(smooth.ok());
  const Errors before = RangeErrors(rough->surface, truth, 12), after = RangeErrors(*smooth, truth, 12);
  EXPECT_LT(after.rms_mm, 0.5 * before.rms_mm);
  EXPECT_NEAR(after.rms_in_sigmas, 1.0, 0.35);
  double worst = 1.0;
  for (int j = 36; j < 60; ++j)
    for (int i = 48; i < 72; ++i) worst = std::min(worst, smooth->Normal(i, j).dot(truth.Normal(i, j)));
  EXPECT_GT(worst, std::cos(0.1));
}

TEST(SmoothSurface, KeepsADepthStep) {
  const RigCalibration rig = SyntheticRig();
  SurfaceMap step = TrueSurface(rig, Plane({0, 0, 600}, {0, 0, -1}));
  for (int j = 0; j < step.height(); ++j)
    for (int i = 0; i < step.width(); ++i) {
      step.depth_sigma_mm(i, j) = 0.1F;
      if (i < 60) continue;
      for (int k = 0; k < 3; ++k) step.point_mm(i, j, k) *= 1.05F;  // 30 mm behind
    }
  const auto smooth = SmoothSurface(step, rig, {.radius_mm = 6.0});
  for (int j = 0; j < step.height(); ++j)
    for (int i = 0; i < step.width(); ++i) ASSERT_NEAR(smooth->point_mm(i, j, 2), i < 60 ? 600.0 : 630.0, 0.01);
}

TEST(RemoveIslands, DropsSpeckleAndKeepsTheFace) {
  const RigCalibration rig = SyntheticRig();
  SurfaceMap map = TrueSurface(rig, Plane({0, 0, 600}, {0, 0, -1}));
  for (int k = 0; k < 3; ++k) map.point_mm(30, 30, k) *= 1.2F;
  EXPECT_EQ(RemoveIslands(map, 4.0, 60), 1);
  EXPECT_EQ(map.mask(30, 30), 0);
  EXPECT_TRUE(std::isnan(map.point_mm(30, 30, 2)));
  EXPECT_EQ(map.mask(31, 30), 1);
}

TEST(Mesh, FacesTheCameraAndIsReadBack) {
  const RigCalibration rig = SyntheticRig();
  const SurfaceMap map = TrueSurface(rig, Plane({0, 0, 600}, {0, 0, -1}));
  const Mesh mesh = MeshFromSurface(map);
  ASSERT_EQ(mesh.triangles.size(), 2U * 119 * 95);
  for (const auto& t : mesh.triangles) {
    const auto p = [&](int k) { return Eigen::Map<const Eigen::Vector3f>(mesh.positions_mm[t[k]].data()); };
    ASSERT_LT((p(1) - p(0)).cross(p(2) - p(0)).z(), 0.0F);
  }
  const ScratchFolder scratch;
  const auto file = scratch / "mesh.ply";
  ASSERT_TRUE(WritePly(file, mesh).ok());
  std::ifstream in(file, std::ios::binary);
  std::string line;
  while (std::getline(in, line) && line != "end_header") {
  }
  float first[6];
  in.read(reinterpret_cast<char*>(first), sizeof(first));
  EXPECT_EQ(first[2], 600.0F);
  EXPECT_EQ(first[5], -1.0F);
  const auto header = static_cast<uintmax_t>(in.tellg()) - sizeof(first);
  EXPECT_EQ(std::filesystem::file_size(file), header + mesh.positions_mm.size() * 24 + mesh.triangles.size() * 13);
}

// The whole road: images of a sphere through the decoder, the triangulation and the smoothing.
TEST(Geometry, RecoversASphereFromNoisyImages) {
  const RigCalibration rig = SyntheticRig();
  std::vector<DecodedMap> maps;
  for (int p = 0; p < 4; ++p) {
    const Frames frames = Shoot(rig, p, kBall, {.noise = true});
    maps.push_back(DecodeGray(frames.Decode(rig.projectors[p], kPeriodPx), SensorNoise::From(rig.camera))->map);
  }
  const auto rough = Triangulate(maps, rig);
  ASSERT_TRUE(rough.ok());
  const auto smooth = SmoothSurface(rough->surface, rig, {.radius_mm = 6.0});
  const Errors e = RangeErrors(*smooth, TrueSurface(rig, kBall), 8);
  EXPECT_GT(e.count, 1500);
  EXPECT_LT(e.rms_mm, 0.05);
}

}  // namespace
}  // namespace stratalux::fit
