// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_kernel.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "tests/fitter/mixture/simd_targets.h"

namespace stratalux::fit {
namespace {

struct Case {
  EmGrid grid;
  int layers = 0;
  LaneRows weight, mean, sigma, q;
};

// Layers of all widths, some lanes without some of them, means up to the grid's edge and beyond.
Case RandomCase(EmGrid grid, int layers, uint64_t seed) {
  Random random(seed);
  Case c{grid, layers, {}, {}, {}, {}};
  for (int i = 0; i < layers * kEmLanes; ++i) {
    c.weight.push_back(random.Uniform() < 0.1 ? 0.0F : static_cast<float>(random.Uniform(0.01, 0.2)));
    c.mean.push_back(static_cast<float>(random.Uniform(-0.1, 1.1) * grid.cells));
    c.sigma.push_back(
        static_cast<float>(kLeastSigmaCells * std::pow(0.3 * grid.cells / kLeastSigmaCells, random.Uniform())));
  }
  for (int i = 0; i < grid.cells * kEmLanes; ++i) c.q.push_back(static_cast<float>(random.Uniform(0.5, 1.5)));
  return c;
}

// weight N(z; mean, sigma) of the images that a wrapped grid shows.
double Gaussian(const Case& c, int layer, int lane, double z) {
  const size_t at = size_t(layer) * kEmLanes + lane;
  const double x = (z - c.mean[at]) / c.sigma[at];
  return c.weight[at] / c.sigma[at] / std::sqrt(2.0 * std::numbers::pi) * std::exp(-0.5 * x * x);
}

void ExpectAsDoubleLoop(const Case& c) {
  LaneRows mass(size_t(c.grid.cells) * kEmLanes), moments(size_t(c.layers) * 3 * kEmLanes);
  LayerTiles tiles;
  const LayersOnGrid layers{c.layers, c.weight.data(), c.mean.data(), c.sigma.data()};
  AddLayers(c.grid, layers, tiles, mass.data());
  LayerMoments(layers, tiles, c.q.data(), moments.data());
  const int images = c.grid.wrapped ? 1 : 0;
  for (int lane = 0; lane < kEmLanes; ++lane) {
    double peak = 0.0;
    std::vector<double> exact(c.grid.cells, 0.0);
    for (int l = 0; l < c.layers; ++l) {
      std::array<double, 3> sum{};
      for (int z = -images * c.grid.cells; z < (images + 1) * c.grid.cells; ++z) {
        const int cell = (z + c.grid.cells) % c.grid.cells;
        const double g = Gaussian(c, l, lane, z), x = z - double(c.mean[size_t(l) * kEmLanes + lane]);
        exact[cell] += g;
        const double photons = g * c.q[size_t(cell) * kEmLanes + lane];
        sum[0] += photons;
        sum[1] += photons * x;
        sum[2] += photons * x * x;
      }
      const size_t at = size_t(l) * kEmLanes + lane;
      const double weight = c.weight[at], sigma = c.sigma[at];
      const float* m = moments.data() + size_t(l) * 3 * kEmLanes + lane;
      EXPECT_NEAR(m[0], sum[0], 2e-5 * weight) << "layer " << l << " lane " << lane;
      EXPECT_NEAR(m[kEmLanes], sum[1], 3e-5 * weight * sigma);
      EXPECT_NEAR(m[2 * kEmLanes], sum[2], 1e-4 * weight * sigma * sigma);
    }
    for (double m : exact) peak = std::max(peak, m);
    for (int cell = 0; cell < c.grid.cells; ++cell)
      ASSERT_NEAR(mass[size_t(cell) * kEmLanes + lane], exact[cell], 1e-5 * peak) << cell << " lane " << lane;
  }
}

TEST(EmKernel, AddsLayersAndTheirMomentsAsADoubleLoopDoesOnEveryInstructionSet) {
  ForEachSimdTarget([](const char* name) {
    SCOPED_TRACE(name);
    ExpectAsDoubleLoop(RandomCase({256, true}, 20, 1));
    ExpectAsDoubleLoop(RandomCase({250, false}, 7, 2));
    ExpectAsDoubleLoop(RandomCase({61, true}, 32, 3));  // no whole number of tiles
    ExpectAsDoubleLoop(RandomCase({12, false}, 1, 4));  // smaller than a tile
  });
}

TEST(EmKernel, ALaneDoesNotDependOnItsNeighbours) {
  const Case all = RandomCase({256, true}, 20, 5);
  ForEachSimdTarget([&](const char* name) {
    SCOPED_TRACE(name);
    LaneRows mass(256 * kEmLanes), alone(256 * kEmLanes), moments(60 * kEmLanes), moments_alone(60 * kEmLanes);
    LayerTiles tiles;
    const LayersOnGrid layers{20, all.weight.data(), all.mean.data(), all.sigma.data()};
    AddLayers(all.grid, layers, tiles, mass.data());
    LayerMoments(layers, tiles, all.q.data(), moments.data());
    for (int lane : {0, 3, 9, 15}) {
      Case single = RandomCase({256, true}, 20, 6);
      for (int l = 0; l < 20; ++l) {
        const size_t at = size_t(l) * kEmLanes + lane;
        single.weight[at] = all.weight[at];
        single.mean[at] = all.mean[at];
        single.sigma[at] = all.sigma[at];
      }
      for (int cell = 0; cell < 256; ++cell)
        single.q[size_t(cell) * kEmLanes + lane] = all.q[size_t(cell) * kEmLanes + lane];
      const LayersOnGrid other{20, single.weight.data(), single.mean.data(), single.sigma.data()};
      AddLayers(single.grid, other, tiles, alone.data());
      LayerMoments(other, tiles, single.q.data(), moments_alone.data());
      for (size_t at = lane; at < alone.size(); at += kEmLanes) ASSERT_EQ(alone[at], mass[at]);
      for (size_t at = lane; at < moments.size(); at += kEmLanes) ASSERT_EQ(moments_alone[at], moments[at]);
    }
  });
}

}  // namespace
}  // namespace stratalux::fit
