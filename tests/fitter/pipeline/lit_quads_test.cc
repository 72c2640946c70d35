// SPDX-License-Identifier: Apache-2.0
// Which quads a projector lights: a plane in a known light, its codes and direct light as they would be captured, and
// what stands in the way.
#include "fitter/stages/lit_quads.h"

#include <cmath>
#include <functional>
#include <random>

#include <gtest/gtest.h>

#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kWidth = 96, kHeight = 64;  // sites
constexpr double kAlbedo = 0.4;

// Three projectors around the camera, 700 mm before the plane; the first one comes from the side.
RigCalibration ThreeLights() {
  RigCalibration rig;
  rig.camera.model = {kWidth, kHeight, 1600, 1600, (kWidth - 1) / 2.0, (kHeight - 1) / 2.0, {}};
  rig.camera.black_level_dn = 64;
  rig.camera.gain_e_per_dn = 4;
  rig.camera.read_noise_dn = 3;
  for (const Eigen::Vector3d& at : {Eigen::Vector3d(-500, -40, 0), Eigen::Vector3d(300, 60, 0), {20, -400, 0}}) {
    ProjectorCalibration p;
    p.model = {1024, 768, 2690, 2690, 511, 384, {}};
    p.camera_from_projector = LookAt(at, {0, 0, 700});
    p.white_dn_mm2_per_ms = {1.1e8, 1.2e8, 1.0e8};
    rig.projectors.push_back(p);
  }
  return rig;
}

struct Scene {
  RigCalibration rig = ThreeLights();
  SurfaceMap surface;
  std::vector<DecodedMap> decoded;
  std::vector<SeparationMap> separation;
  std::mt19937 random{7};

  // `depth_mm`: z of the plane piece that a quad sees.
  explicit Scene(const std::function<double(int, int)>& depth_mm = [](int, int) { return 700.0; }) {
    const int w = kWidth / 2, h = kHeight / 2;
    surface = {Image<float>(w, h, 3), Image<float>(w, h, 3), Image<float>(w, h, 1, 0.02F), Image<uint8_t>(w, h, 1, 1)};
    for (int j = 0; j < h; ++j)
      for (int i = 0; i < w; ++i) {
        const Eigen::Vector3d ray = rig.camera.model.Unproject(QuadCentre(Cfa::kRggb, i, j));
        const Eigen::Vector3d x = ray * (depth_mm(i, j) / ray.z());
        for (int k = 0; k < 3; ++k) {
          surface.point_mm(i, j, k) = static_cast<float>(x[k]);
          surface.normal(i, j, k) = k == 2 ? -1.0F : 0.0F;
        }
      }
    for (size_t p = 0; p < rig.projectors.size(); ++p) Capture(p);
  }

  void Capture(size_t p) {
    const int w = surface.width(), h = surface.height();
    decoded.push_back({Image<float>(kWidth, kHeight), Image<float>(kWidth, kHeight),
                       Image<float>(kWidth, kHeight, 1, 0.1F), Image<float>(kWidth, kHeight, 1, 0.1F),
                       Image<uint8_t>(kWidth, kHeight)});
    separation.push_back({Image<float>(w, h, 3), Image<float>(w, h, 3), Image<float>(w, h, 3), Image<float>(w, h, 3),
                          Image<uint8_t>(w, h)});
    for (int j = 0; j < h; ++j)
      for (int i = 0; i < w; ++i) {
        const auto at = rig.projectors[p].ProjectFromCamera(surface.Point(i, j));
        for (int k = 0; k < 4; ++k) {
          decoded[p].column(2 * i + k % 2, 2 * j + k / 2) = static_cast<float>(at->x());
          decoded[p].row(2 * i + k % 2, 2 * j + k / 2) = static_cast<float>(at->y());
        }
        Light(p, i, j, 1.0, 5.0);
      }
  }

  // The quad has `share` of the projector's direct light, and global light of a tenth of all.
  void Light(size_t p, int i, int j, double share, double sigma_dn) {
    std::normal_distribution<double> noise(0.0, sigma_dn);
    for (int c = 0; c < 3; ++c) {
      const double white = kAlbedo * rig.projectors[p].WhiteTargetDn(surface.Point(i, j), surface.Normal(i, j), c, 5.0);
      separation[p].direct(i, j, c) = static_cast<float>(share * white + noise(random));
      separation[p].direct_variance(i, j, c) = static_cast<float>(sigma_dn * sigma_dn);
      separation[p].white(i, j, c) = static_cast<float>((share + 0.1) * white + noise(random));
    }
  }

  void SetReason(size_t p, int i, int j, DecodeReason reason) {
    for (int k = 0; k < 4; ++k) decoded[p].reason(2 * i + k % 2, 2 * j + k / 2) = static_cast<uint8_t>(reason);
  }

  [[nodiscard]] std::vector<Image<uint8_t>> Find() const {
    auto lit = LitQuads(decoded, separation, surface, rig);
    EXPECT_TRUE(lit.ok()) << lit.status().message();
    return std::move(lit).value();
  }
};

// Whether the picture holds `lit` at each quad but those at the picture's rim, which have no neighbours to be judged
// by.
void ExpectLit(const Image<uint8_t>& map, const std::function<bool(int, int)>& lit, const char* what) {
  int wrong = 0;
  for (int j = 1; j + 1 < map.height(); ++j)
    for (int i = 1; i + 1 < map.width(); ++i) wrong += (map(i, j) != 0) != lit(i, j) ? 1 : 0;
  EXPECT_EQ(wrong, 0) << what;
}
bool Everywhere(int /*i*/, int /*j*/) { return true; }
// Quads of the patch, and those around it.
bool InPatch(int i, int j, int rim = 0) { return std::abs(i - 20) <= 3 + rim && std::abs(j - 15) <= 2 + rim; }
bool OffPatch(int i, int j) { return !InPatch(i, j, 1); }
template <typename Visit>
void ForPatch(const Visit& visit) {
  for (int j = 0; j < kHeight / 2; ++j)
    for (int i = 0; i < kWidth / 2; ++i)
      if (InPatch(i, j)) visit(i, j);
}

TEST(LitQuads, APlaneIsLitByAllWhateverOfItsCodesIsMissing) {
  Scene scene;
  ForPatch([&](int i, int j) { scene.SetReason(0, i, j, DecodeReason::kAmbiguous); });
  const auto lit = scene.Find();
  for (const auto& map : lit) ExpectLit(map, Everywhere, "plane");
}

// A wall of seven quads' width, 20 mm before the plane: where its shadow falls follows from the two rays alone.
TEST(LitQuads, WhatStandsOnTheSurfaceThrowsItsShadow) {
  constexpr double kWall = 680.0;
  Scene scene([](int i, int /*j*/) { return i >= 28 && i <= 34 ? kWall : 700.0; });
  // Its light says nothing: all of it is there, as if what it falls on shone.
  const auto lit = scene.Find();
  int shadowed = 0;
  for (size_t p = 0; p < 3; ++p) {
    const Eigen::Vector3d lamp = scene.rig.projectors[p].CentreInCamera();
    const auto in_shadow = [&](int i, int j, double by_quads) {
      const Eigen::Vector3d x = scene.surface.Point(i, j);
      if (x.z() < 690.0) return false;
      const Eigen::Vector3d through = x + (lamp - x) * ((kWall - x.z()) / (lamp.z() - x.z()));
      const Eigen::Vector2d at = scene.rig.camera.model.Project(through).value();
      const double quad_x = (at.x() - 0.5) / 2.0, quad_y = (at.y() - 0.5) / 2.0;
      return quad_x > 28 - by_quads && quad_x < 34 + by_quads && quad_y > -by_quads && quad_y < kHeight / 2 + by_quads;
    };
    for (int j = 1; j + 1 < kHeight / 2; ++j)
      for (int i = 1; i + 1 < kWidth / 2; ++i) {
        if (in_shadow(i, j, -0.5)) {
          ++shadowed;
          EXPECT_EQ(lit[p](i, j), 0) << p << ": " << i << ", " << j;
        }
        bool near = false;
        for (int y = -1; y <= 1; ++y)
          for (int x = -1; x <= 1; ++x) near = near || in_shadow(i + x, j + y, 1.0);
        if (!near) {
          EXPECT_EQ(lit[p](i, j), 1) << p << ": " << i << ", " << j;
        }
      }
  }
  EXPECT_GT(shadowed, 100);
}

TEST(LitQuads, WhatTheSurfaceDoesNotKnowOfShowsInTheLight) {
  Scene scene;
  ForPatch([&](int i, int j) { scene.Light(0, i, j, 0.0, 5.0); });
  const auto lit = scene.Find();
  ExpectLit(lit[0], OffPatch, "in the shadow of a hair");
  ExpectLit(lit[1], Everywhere, "the others");
  // Too faint to be told apart: then all light, of which global light is a tenth, tells.
  Scene faint;
  ForPatch([&](int i, int j) {
    faint.Light(0, i, j, 0.0, 5.0);
    faint.separation[0].reason(i, j) = static_cast<uint8_t>(SeparationReason::kUnlit);
    for (int c = 0; c < 3; ++c)
      faint.separation[0].direct(i, j, c) = faint.separation[0].direct_variance(i, j, c) = std::nanf("");
  });
  ExpectLit(faint.Find()[0], OffPatch, "faint");
  // A quarter and more of a shadow is an edge that the surface's own test or the next quad tells.
  Scene half;
  ForPatch([&](int i, int j) { half.Light(0, i, j, 0.5, 5.0); });
  ExpectLit(half.Find()[0], Everywhere, "half of it");
  // Three times as bright in one light: a highlight, in which the others are no shadows.
  Scene highlight;
  ForPatch([&](int i, int j) { highlight.Light(1, i, j, 6.0, 5.0); });
  for (const auto& map : highlight.Find()) ExpectLit(map, Everywhere, "highlight");
}

TEST(LitQuads, DarkSkinIsLitAlthoughItsNoiseHidesThat) {
  Scene scene;
  for (int j = 0; j < kHeight / 2; ++j)
    for (int i = 0; i < kWidth / 2; ++i)
      for (size_t p = 0; p < 3; ++p) {
        scene.Light(p, i, j, 0.01, 40.0);
        scene.SetReason(p, i, j, DecodeReason::kAmbiguous);
      }
  for (const auto& lit : scene.Find()) ExpectLit(lit, Everywhere, "dark");
}

TEST(LitQuads, CodesOfAnotherSurfaceAreContradicted) {
  Scene scene;
  ForPatch([&](int i, int j) {
    for (int k = 0; k < 4; ++k) scene.decoded[2].column(2 * i + k % 2, 2 * j + k / 2) += 12.0F;
  });
  const auto lit = scene.Find();
  ExpectLit(lit[2], OffPatch, "contradicted");
}

TEST(LitQuads, HolesAreEdgesInTheDarkAlone) {
  for (const bool dark : {false, true}) {
    Scene scene;
    ForPatch([&](int i, int j) {
      scene.surface.mask(i, j) = 0;
      if (!dark) return;
      for (auto& map : scene.separation)
        for (int c = 0; c < 3; ++c) map.white(i, j, c) = 1.0F;
    });
    for (const auto& lit : scene.Find())
      ExpectLit(
          lit, [&](int i, int j) { return dark ? OffPatch(i, j) : !InPatch(i, j); }, dark ? "dark" : "bright");
  }
}

TEST(LitQuads, OutsideOfThePictureAndBehindTheSurfaceIsNoLight) {
  Scene scene;
  scene.rig.projectors[0].camera_from_projector = LookAt({-500, -40, 0}, {2000, 0, 700});
  scene.rig.projectors[1].camera_from_projector = LookAt({0, 0, 1400}, {0, 0, 700});
  const auto lit = scene.Find();
  for (const size_t p : {0, 1})
    ExpectLit(
        lit[p], [](int, int) { return false; }, "away");
  ExpectLit(lit[2], Everywhere, "the third");
}

TEST(LitQuads, WithoutASeparationTheWhiteFrameTells) {
  Scene scene;
  scene.separation.clear();
  ForPatch([&](int i, int j) { scene.SetReason(0, i, j, DecodeReason::kUnlit); });
  const auto lit = scene.Find();
  ExpectLit(lit[0], OffPatch, "unlit");
  ExpectLit(lit[1], Everywhere, "the others");
}

TEST(LitQuads, WhatDoesNotFitIsRefused) {
  const Scene scene;
  const auto code = [&](std::span<const DecodedMap> decoded, std::span<const SeparationMap> separation,
                        const LitOptions& options = {}) {
    return LitQuads(decoded, separation, scene.surface, scene.rig, options).status().code();
  };
  const std::span<const DecodedMap> decoded = scene.decoded;
  const std::span<const SeparationMap> separation = scene.separation;
  EXPECT_EQ(code(decoded, separation), StatusCode::kOk);
  EXPECT_EQ(code(decoded.first(2), separation), StatusCode::kUsage);
  EXPECT_EQ(code(decoded, separation.first(2)), StatusCode::kUsage);
  EXPECT_EQ(code(decoded, separation, {.min_share = 1.0}), StatusCode::kUsage);
  EXPECT_EQ(code(decoded, separation, {.sigmas = std::nan("")}), StatusCode::kUsage);
  std::vector<DecodedMap> small = scene.decoded;
  small[1].reason = Image<uint8_t>(kWidth - 2, kHeight);
  EXPECT_EQ(code(small, separation), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
