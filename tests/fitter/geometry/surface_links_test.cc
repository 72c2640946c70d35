// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/surface_links.h"

#include <cmath>

#include <gtest/gtest.h>

#include "fitter/reconstruction/one_surface.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

// A rough surface with steps and holes, where pairs are linked and are not.
SurfaceMap Rough(int width, int height) {
  Random random(11);
  SurfaceMap surface;
  surface.point_mm = surface.normal = Image<float>(width, height, 3, std::nanf(""));
  surface.depth_sigma_mm = Image<float>(width, height, 1, std::nanf(""));
  surface.mask = Image<uint8_t>(width, height);
  for (int j = 0; j < height; ++j)
    for (int i = 0; i < width; ++i) {
      if (random.Bits() % 8 == 0) continue;
      const double z = 700.0 + (random.Bits() % 4 == 0 ? 12.0 : 0.0) + 3.0 * random.Uniform();
      surface.mask(i, j) = 1;
      surface.depth_sigma_mm(i, j) = 0.1F;
      const double at[3] = {z * 0.002 * i, z * 0.002 * j, z}, normal[3] = {random.Uniform() - 0.5, 0.2, -1.0};
      for (int k = 0; k < 3; ++k) {
        surface.point_mm(i, j, k) = static_cast<float>(at[k]);
        surface.normal(i, j, k) = static_cast<float>(normal[k] / std::hypot(normal[0], normal[1], normal[2]));
      }
    }
  return surface;
}

// Two points on a chord that one tangent plane holds and the other's normal is not known of.
TEST(OneSurface, IsNotWhereOneNormalIsNotKnownEitherWayRound) {
  SurfaceMap surface = Rough(2, 1);
  const float points[2][3] = {{0.0F, 0.0F, 700.0F}, {1.0F, 0.0F, 720.0F}};
  for (int i = 0; i < 2; ++i) {
    surface.mask(i, 0) = 1;
    surface.depth_sigma_mm(i, 0) = 0.1F;
    const float along_chord[3] = {-0.99875F, 0.0F, 0.04994F};
    for (int k = 0; k < 3; ++k) {
      surface.point_mm(i, 0, k) = points[i][k];
      surface.normal(i, 0, k) = along_chord[k];
    }
  }
  EXPECT_TRUE(OnOneSurface(surface, 0, 0, 1, 0));
  for (int k = 0; k < 3; ++k) surface.normal(1, 0, k) = std::nanf("");
  EXPECT_FALSE(OnOneSurface(surface, 0, 0, 1, 0));
  EXPECT_FALSE(OnOneSurface(surface, 1, 0, 0, 0));
}

TEST(SurfaceLinks, SayOfEachPairWhatTheRuleSaysEitherWayRound) {
  const SurfaceMap surface = Rough(37, 23);
  const SurfaceLinks links(surface);
  int linked = 0, apart = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      for (int y = j - 1; y <= j + 1; ++y)
        for (int x = i - 1; x <= i + 1; ++x) {
          if ((x == i && y == j) || !surface.mask.contains(x, y)) continue;
          const bool known = surface.mask(i, j) != 0 && surface.mask(x, y) != 0;
          const bool expected = known && OnOneSurface(surface, i, j, x, y);
          EXPECT_EQ(links.Linked(i, j, x, y), expected) << i << " " << j << " " << x << " " << y;
          linked += expected ? 1 : 0;
          apart += known && !expected ? 1 : 0;
        }
  EXPECT_GT(linked, 500);
  EXPECT_GT(apart, 500);
}

}  // namespace
}  // namespace stratalux::fit
