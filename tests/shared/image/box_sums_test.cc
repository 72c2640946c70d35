// SPDX-License-Identifier: Apache-2.0
#include "shared/image/box_sums.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "shared/base/random.h"

namespace stratalux {
namespace {

TEST(BoxSums, AreThePlainSumsOfEveryChannelAsFarAsTheImageGoes) {
  Random random(3);
  for (const auto& [width, height] : {std::pair{41, 23}, {1, 9}, {9, 1}, {130, 5}})
    for (const int radius : {0, 1, 4, 30}) {
      Image<double> values(width, height, 3);
      for (double& v : values.pixels()) v = random.Uniform(-1.0, 5.0);
      const Image<double> sums = BoxSums(values, radius);
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
          for (int c = 0; c < 3; ++c) {
            double sum = 0.0;
            for (int j = std::max(0, y - radius); j <= std::min(height - 1, y + radius); ++j)
              for (int i = std::max(0, x - radius); i <= std::min(width - 1, x + radius); ++i) sum += values(i, j, c);
            ASSERT_NEAR(sums(x, y, c), sum, 1e-9) << width << " x " << height << ", " << radius;
          }
    }
}

}  // namespace
}  // namespace stratalux
