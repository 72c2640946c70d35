// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "fitter/export/ply_file.h"
#include "fitter/reconstruction/components.h"
#include "fitter/reconstruction/mesh.h"
#include "fitter/reconstruction/one_surface.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "fitter/reconstruction/triangulate.h"
#include "shared/base/random.h"
#include "shared/geometry/quad.h"
#include "tests/fitter/geometry/synthetic_rig.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

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
  const auto one_smooth = SmoothSurface(one->surface, one->noise_sigma_mm, rig);
  setenv("STRATALUX_THREADS", "3", 1);
  const auto three = Triangulate(maps, rig);
  const auto three_smooth = SmoothSurface(three->surface, three->noise_sigma_mm, rig);
  unsetenv("STRATALUX_THREADS");
  for (size_t k = 0; k < one_smooth->point_mm.size(); ++k) {
    const float a = one_smooth->point_mm.data()[k], b = three_smooth->point_mm.data()[k];
    ASSERT_TRUE(a == b || (std::isnan(a) && std::isnan(b)));
  }
}

// The same rig and face five times as large: the same picture, and the same surface five times as large.
TEST(Triangulate, HasNoScaleOfItsOwn) {
  constexpr double kScale = 5.0;
  const RigCalibration rig = SyntheticRig();
  RigCalibration large = rig;
  for (ProjectorCalibration& p : large.projectors) p.camera_from_projector.translation_mm *= kScale;
  const auto maps = NoisyMaps(rig, kBall, 0.2);
  const auto one = Triangulate(maps, rig), other = Triangulate(maps, large);
  const auto one_smooth = SmoothSurface(one->surface, one->noise_sigma_mm, rig),
             other_smooth = SmoothSurface(other->surface, other->noise_sigma_mm, large);
  int64_t known = 0;
  for (size_t i = 0; i < one_smooth->mask.size(); ++i) {
    ASSERT_EQ(one_smooth->mask.pixels()[i], other_smooth->mask.pixels()[i]);
    if (one_smooth->mask.pixels()[i] == 0) continue;
    ++known;
    for (size_t k = 3 * i; k < 3 * i + 3; ++k) {
      ASSERT_NEAR(kScale * one_smooth->point_mm.data()[k], other_smooth->point_mm.data()[k], 0.01);
      ASSERT_NEAR(one_smooth->normal.data()[k], other_smooth->normal.data()[k], 1e-3);
    }
    ASSERT_NEAR(kScale * one->disagreement_mm.data()[i], other->disagreement_mm.data()[i], 1e-2);
  }
  EXPECT_GT(known, 4000);
}

// Two projectors, one of which is told to be where it is not: their own depths lie to both sides of the joint one.
TEST(Triangulate, ProjectorsThatDisagreeSaySo) {
  RigCalibration rig = SyntheticRig();
  rig.projectors = {rig.projectors[0], rig.projectors[3]};
  auto maps = NoisyMaps(rig, kBall, 0.0);
  const int i = rig.camera.model.width / 2, j = rig.camera.model.height / 2;
  EXPECT_LT(Triangulate(maps, rig)->disagreement_mm(i, j), 1e-3F);
  for (float& column : maps[1].column.pixels()) column += 0.3F;
  const auto out = Triangulate(maps, rig);
  // Each alone, by the same codes.
  std::array<double, 2> alone{};
  for (size_t p = 0; p < 2; ++p) {
    RigCalibration one = rig;
    one.projectors = {rig.projectors[p]};
    alone[p] = Triangulate({&maps[p], 1}, one)->surface.Point(i, j).norm();
    EXPECT_TRUE(std::isnan(Triangulate({&maps[p], 1}, one)->disagreement_mm(i, j)));
  }
  // Of two that weigh about the same, half of what is between them.
  EXPECT_NEAR(out->disagreement_mm(i, j), std::abs(alone[0] - alone[1]) / 2.0, 0.1 * std::abs(alone[0] - alone[1]));
  EXPECT_GT(out->disagreement_mm(i, j), 0.05F);
}

TEST(Triangulate, WhatNothingIsLeftOfIsNamed) {
  const RigCalibration rig = SyntheticRig();
  auto maps = NoisyMaps(rig, kBall, 0.0);
  for (DecodedMap& map : maps)
    for (float* sigma : {map.column_sigma.data(), map.row_sigma.data()})
      for (size_t i = 0; i < map.reason.size(); ++i) sigma[i] = 400.0F;
  const auto uncertain = Triangulate(maps, rig);
  EXPECT_GT(uncertain->counts.uncertain, 4000);
  EXPECT_NE(WhyNoSurface(uncertain->counts).find(std::to_string(uncertain->counts.uncertain) + " pixels whose depth"),
            std::string::npos);
  for (DecodedMap& map : maps) std::ranges::fill(map.reason.pixels(), static_cast<uint8_t>(DecodeReason::kUnlit));
  const auto dark = Triangulate(maps, rig);
  EXPECT_EQ(WhyNoSurface(dark->counts), std::to_string(120 * 96) + " pixels that no projector's code reached");
  EXPECT_EQ(WhyNoSurface({.lone = 3}, 70), "70 quads without neighbours, 3 lone pixels");
}

// Two sites of each quad of the edge's column see a plane 60 mm behind: between them there is nothing.
TEST(Triangulate, QuadsAcrossAnEdgeAreLeftOut) {
  RigCalibration rig = SyntheticRig();
  rig.camera.cfa = Cfa::kRggb;
  constexpr int kEdge = 61;  // within quad 30
  const auto surface = [&](const Eigen::Vector3d& ray) {
    const bool behind = rig.camera.model.Project(ray)->x() >= kEdge - 0.5;
    return Plane({0, 0, behind ? 660.0 : 600.0}, {0, 0, -1})(ray);
  };
  const auto out = Triangulate(NoisyMaps(rig, surface, 0.05), rig);
  EXPECT_GE(out->counts.mixed, 46);
  for (int j = 2; j < 46; ++j) {
    EXPECT_EQ(out->surface.mask(29, j), 1);
    EXPECT_EQ(out->surface.mask(30, j), 0) << out->surface.point_mm(30, j, 2);
    EXPECT_EQ(out->surface.mask(31, j), 1);
  }
}

TEST(Triangulate, RefusesMapsOfAnotherCamera) {
  RigCalibration rig = SyntheticRig();
  const auto maps = NoisyMaps(rig, kBall, 0.0);
  rig.camera.model.width += 2;
  EXPECT_EQ(Triangulate(maps, rig).status().code(), StatusCode::kUsage);
}

// The picture's own corners see a quarter of the smallest window: too few quads.
bool IsCorner(const SurfaceMap& map, int i, int j) {
  return (i == 0 || i == map.width() - 1) && (j == 0 || j == map.height() - 1);
}

TEST(SmoothSurface, LeavesASlantedPlaneExactly) {
  const RigCalibration rig = SyntheticRig();
  const Eigen::Vector3d normal = Eigen::Vector3d(0.5, -0.3, -1.0).normalized();
  SurfaceMap plane = TrueSurface(rig, Plane({0, 0, 600}, normal));
  for (float& sigma : plane.depth_sigma_mm.pixels()) sigma = 0.1F;
  const auto smooth = SmoothSurface(plane, plane.depth_sigma_mm, rig);
  ASSERT_TRUE(smooth.ok());
  for (int j = 0; j < plane.height(); ++j)
    for (int i = 0; i < plane.width(); ++i) {
      if (IsCorner(plane, i, j)) continue;
      ASSERT_NEAR(smooth->point_mm(i, j, 2), plane.point_mm(i, j, 2), 2e-3);
      ASSERT_GT(smooth->Normal(i, j).dot(normal), std::cos(2e-3));
    }
}

TEST(SmoothSurface, LowersNoiseAndPredictsWhatIsLeft) {
  const RigCalibration rig = SyntheticRig();
  const SurfaceMap truth = TrueSurface(rig, kBall);
  const auto rough = Triangulate(NoisyMaps(rig, kBall, 0.3), rig, {.model_sigma_px = 0.0});
  const auto smooth = SmoothSurface(rough->surface, rough->noise_sigma_mm, rig);
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
  const auto smooth = SmoothSurface(step, step.depth_sigma_mm, rig);
  for (int j = 0; j < step.height(); ++j)
    for (int i = 0; i < step.width(); ++i) {
      const bool corner = (j == 0 || j + 1 == step.height()) && (i == 0 || i == 59 || i == 60 || i + 1 == step.width());
      if (corner) continue;
      ASSERT_NEAR(smooth->point_mm(i, j, 2), i < 60 ? 600.0 : 630.0, 0.01);
      ASSERT_GT(-smooth->normal(i, j, 2), 0.9999) << i << ", " << j << ": no normal is drawn across the step";
    }
}

// Of waves that run across and down, as much of each slope is left as a Gaussian of the stated width leaves; and more
// than the window's quadratics would.
TEST(SmoothSurface, SaysByHowMuchItsNormalsAreBlurred) {
  const RigCalibration rig = SyntheticRig();
  for (const auto& [radius, of_quadratic_quads] : {std::pair(2.0, 0.75), std::pair(4.0, 1.46)}) {
    const double wave_quads = 5.0 * radius;
    const double per_unit = 2.0 * M_PI * rig.camera.model.fx / QuadStep(rig.camera.cfa) / wave_quads;
    const auto waves = [&](const Eigen::Vector3d& ray) {
      const Eigen::Vector3d at = ray / ray.z();
      return std::optional(
          Hit{at * (600.0 + 0.05 * (std::sin(per_unit * at.x()) + std::sin(per_unit * at.y()))), {0, 0, -1}});
    };
    SurfaceMap rough = TrueSurface(rig, waves);
    for (float& sigma : rough.depth_sigma_mm.pixels()) sigma = 0.1F;
    const auto smooth = SmoothSurface(rough, rough.depth_sigma_mm, rig,
                                      {.min_radius_quads = radius, .max_radius_quads = radius, .robust_scale = 1e3});
    ASSERT_TRUE(smooth.ok());
    double product = 0.0, squares = 0.0, smoothing = 0.0;
    int quads = 0;
    for (int j = 20; j < rough.height() - 20; ++j)
      for (int i = 20; i < rough.width() - 20; ++i) {
        const Eigen::Vector3d at = rough.Point(i, j) / rough.point_mm(i, j, 2), n = smooth->Normal(i, j);
        // dz/dx of the wave, and of the normal found, but for what z = 600 is seen under.
        for (int k = 0; k < 2; ++k) {
          const double slope = 0.05 * per_unit * std::cos(per_unit * at[k]) / 600.0;
          product += slope * -(n[k] / n.z());
          squares += slope * slope;
        }
        smoothing += smooth->smoothing_quads(i, j);
        ++quads;
      }
    smoothing /= quads;
    const auto left = [wave_quads](double s) { return std::exp(-2.0 * std::pow(M_PI * s / wave_quads, 2)); };
    const double found = product / squares;
    std::printf("radius %.0f: blurred by %.2f quads, %.3f of slopes left, a quadratic's %.3f\n", radius, smoothing,
                found, left(of_quadratic_quads));
    EXPECT_NEAR(found, left(smoothing), 0.02) << radius;
    EXPECT_GT(found, 0.5 * (left(of_quadratic_quads) + left(smoothing))) << "there is something to see";
  }
}

// A noisy plane: wide windows calm its normals, too, though each is of its neighbours' windows.
TEST(SmoothSurface, NormalsAreThoseOfItsPointsAndCalmInNoise) {
  const RigCalibration rig = SyntheticRig();
  const SurfaceMap truth = TrueSurface(rig, Plane({0, 0, 600}, Eigen::Vector3d(0.3, -0.2, -1).normalized()));
  SurfaceMap rough = truth;
  Random random(5);
  for (int j = 0; j < rough.height(); ++j)
    for (int i = 0; i < rough.width(); ++i) {
      rough.depth_sigma_mm(i, j) = 0.1F;
      const auto scale = static_cast<float>(1.0 + 0.1 * random.Normal() / rough.Point(i, j).norm());
      for (int k = 0; k < 3; ++k) rough.point_mm(i, j, k) *= scale;
    }
  const auto rms_rad = [&](const SmoothOptions& options) {
    const SurfaceMap smooth = *SmoothSurface(rough, rough.depth_sigma_mm, rig, options);
    double squares = 0.0;
    int quads = 0;
    for (int j = 8; j + 8 < smooth.height(); ++j)
      for (int i = 8; i + 8 < smooth.width(); ++i) {
        const Eigen::Vector3d n = smooth.Normal(i, j);
        for (const Eigen::Vector3d& chord : {Eigen::Vector3d(smooth.Point(i + 1, j) - smooth.Point(i - 1, j)),
                                             Eigen::Vector3d(smooth.Point(i, j + 1) - smooth.Point(i, j - 1))})
          EXPECT_LT(std::abs(n.dot(chord.normalized())), 2e-3);
        squares += n.cross(truth.Normal(i, j)).squaredNorm();
        ++quads;
      }
    return std::sqrt(squares / quads);
  };
  const double narrow = rms_rad({.max_radius_quads = 2.0}), wide = rms_rad({});
  std::printf("normals of a plane: %.4f rad by the narrowest windows, %.4f by those that agree\n", narrow, wide);
  EXPECT_LT(wide, narrow / 5.0);
}

// Waves of eight quads and a calm side: a wide window flattens the one, a narrow one leaves noise on the other.
TEST(SmoothSurface, WindowsFollowTheSurface) {
  const RigCalibration rig = SyntheticRig();
  const auto waves = [](const Eigen::Vector3d& ray) {
    const Eigen::Vector3d at = ray / ray.z();
    const double z = 600.0 + (at.x() > 0.0 ? 0.5 * std::sin(300.0 * at.x()) : 0.0);
    return std::optional(Hit{at * z, {0, 0, -1}});
  };
  const SurfaceMap truth = TrueSurface(rig, waves);
  SurfaceMap rough = truth;
  Random random(3);
  constexpr double kNoise_mm = 0.1;
  for (int j = 0; j < rough.height(); ++j)
    for (int i = 0; i < rough.width(); ++i) {
      rough.depth_sigma_mm(i, j) = static_cast<float>(kNoise_mm);
      const auto scale = static_cast<float>(1.0 + kNoise_mm * random.Normal() / rough.Point(i, j).norm());
      for (int k = 0; k < 3; ++k) rough.point_mm(i, j, k) *= scale;
    }
  // On the calm side and among the waves.
  const auto errors = [&](double narrowest, double widest) -> std::array<double, 2> {
    SurfaceMap smooth =
        *SmoothSurface(rough, rough.depth_sigma_mm, rig, {.min_radius_quads = narrowest, .max_radius_quads = widest});
    std::array<double, 2> rms{};
    for (const bool calm : {true, false}) {
      SurfaceMap side = smooth;
      for (int j = 0; j < side.height(); ++j)
        for (int i = 0; i < side.width(); ++i)
          if ((i < 60) != calm) ForgetQuad(side, i, j);
      rms[calm ? 0 : 1] = RangeErrors(side, truth, 8).rms_mm;
    }
    return rms;
  };
  const SmoothOptions by_default;
  const auto adaptive = errors(by_default.min_radius_quads, by_default.max_radius_quads);
  const std::vector<double> radii = {2.0, 2.83, 4.0, 5.66, 8.0, 11.3, 16.0};
  std::vector<std::array<double, 2>> fixed;
  std::array<double, 2> best = {1.0, 1.0};
  for (const double radius : radii) {
    fixed.push_back(errors(radius, radius));
    for (int side : {0, 1}) best[side] = std::min(best[side], fixed.back()[side]);
  }
  // How many times the best window's error, on the side where that is worse.
  const auto regret = [&](const std::array<double, 2>& of) { return std::max(of[0] / best[0], of[1] / best[1]); };
  std::printf("calm %.4f, waves %.4f mm: regret %.2f\n", adaptive[0], adaptive[1], regret(adaptive));
  for (size_t k = 0; k < radii.size(); ++k) {
    std::printf("%.2f quads: calm %.4f, waves %.4f mm: regret %.2f\n", radii[k], fixed[k][0], fixed[k][1],
                regret(fixed[k]));
    EXPECT_LT(regret(adaptive), 0.85 * regret(fixed[k])) << radii[k];
  }
  EXPECT_LT(regret(adaptive), 2.0);
}

// Three quads between two edges have half of the smallest window, which is enough but at the strip's ends.
TEST(SmoothSurface, NarrowStripsKeepTheirQuads) {
  const RigCalibration rig = SyntheticRig();
  SurfaceMap strip = TrueSurface(rig, Plane({0, 0, 600}, {0, 0, -1}));
  for (int j = 0; j < strip.height(); ++j)
    for (int i = 0; i < strip.width(); ++i) {
      strip.depth_sigma_mm(i, j) = 0.1F;
      if (i < 60 || i > 62) ForgetQuad(strip, i, j);
    }
  int64_t dropped = -1;
  const auto smooth = SmoothSurface(strip, strip.depth_sigma_mm, rig, {}, &dropped);
  EXPECT_EQ(dropped, 6);  // its two ends
  for (int j = 1; j + 1 < strip.height(); ++j)
    for (int i = 60; i <= 62; ++i) EXPECT_NEAR(smooth->point_mm(i, j, 2), 600.0, 1e-3);
  // What is no surface at all is dropped, and counted.
  for (int j = 0; j < strip.height(); ++j)
    for (int i = 60; i <= 62; ++i)
      if (i != 61 || j % 8 != 0) ForgetQuad(strip, i, j);
  ASSERT_TRUE(SmoothSurface(strip, strip.depth_sigma_mm, rig, {}, &dropped).ok());
  EXPECT_EQ(dropped, 12);
}

TEST(OnOneSurface, IsAMatterOfSlopeAtAnyDistance) {
  for (const double distance_mm : {70.0, 700.0, 3400.0}) {
    const auto one = [&](double slope, double sigma) {
      const double across = 1e-3 * distance_mm;
      const Eigen::Vector3d a(0, 0, distance_mm), b(across, 0, distance_mm + slope * across);
      return OnOneSurface(a, b, sigma * across) && OnOneSurface(b, a, sigma * across);
    };
    EXPECT_TRUE(one(6.0, 0.0));
    EXPECT_FALSE(one(7.5, 0.0));
    EXPECT_TRUE(one(7.5, 0.5));
    EXPECT_TRUE(one(6.0, std::nan("")));
    EXPECT_FALSE(one(7.5, std::nan("")));
  }
}

// Where a ball turns away its neighbours are as far apart as those of two walls; tangents tell them from each other.
TEST(OnOneSurface, ASilhouetteIsNoStep) {
  SurfaceMap map{Image<float>(2, 1, 3), Image<float>(2, 1, 3), Image<float>(2, 1), Image<uint8_t>(2, 1, 1, 1)};
  const auto place = [&](int i, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
    for (int k = 0; k < 3; ++k) {
      map.point_mm(i, 0, k) = static_cast<float>(point[k]);
      map.normal(i, 0, k) = static_cast<float>(normal[k]);
    }
  };
  const auto on_ball = [&](int i, double degrees) {
    const double a = degrees * M_PI / 180.0;
    const Eigen::Vector3d normal(std::sin(a), 0.0, -std::cos(a));
    place(i, Eigen::Vector3d(0, 0, 680) + 80.0 * normal, normal);
  };
  on_ball(0, 83.0);
  on_ball(1, 89.0);
  ASSERT_FALSE(OnOneSurface(map.Point(0, 0), map.Point(1, 0), 0.0));
  EXPECT_TRUE(OnOneSurface(map, 0, 0, 1, 0));
  for (float& n : map.normal.pixels()) n = std::nanf("");
  EXPECT_FALSE(OnOneSurface(map, 0, 0, 1, 0));
  place(0, {0, 0, 600}, {0, 0, -1});
  place(1, {1, 0, 620}, {0, 0, -1});
  EXPECT_FALSE(OnOneSurface(map, 0, 0, 1, 0));
  place(0, {0, 0, 600}, {0.97, 0, -0.24});  // the nose's side before the cheek
  EXPECT_FALSE(OnOneSurface(map, 0, 0, 1, 0));
}

TEST(RemoveIslands, DropsSpeckleAndKeepsTheFace) {
  const RigCalibration rig = SyntheticRig();
  SurfaceMap map = TrueSurface(rig, Plane({0, 0, 600}, {0, 0, -1}));
  for (int k = 0; k < 3; ++k) map.point_mm(30, 30, k) *= 1.2F;
  EXPECT_EQ(RemoveIslands(map, 60), 1);
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
  const auto smooth = SmoothSurface(rough->surface, rough->noise_sigma_mm, rig);
  const Errors e = RangeErrors(*smooth, TrueSurface(rig, kBall), 8);
  EXPECT_GT(e.count, 1500);
  EXPECT_LT(e.rms_mm, 0.05);
}

}  // namespace
}  // namespace stratalux::fit
