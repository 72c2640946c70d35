// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/visit_cost.h"

#include <gtest/gtest.h>

namespace stratalux::fit {
namespace {

std::string Metrics(double seconds, double peak) {
  return R"({"stages": [{"name": "srd", "seconds": 1, "cpu_seconds": )" + std::to_string(seconds / 2) +
         R"(, "peak_rss_bytes": 5}, {"name": "fit", "cpu_seconds": )" + std::to_string(seconds / 2) +
         R"(, "peak_rss_bytes": )" + std::to_string(peak) + "}]}";
}

TEST(VisitCost, IsTheMedianTimeAndTheLargestMemoryInProportionToTheCamera) {
  CostHistory history;
  EXPECT_FALSE(history.Foresee(1000)) << "nothing is known";
  history.Add(Metrics(10, 3e6), 1000);
  history.Add(Metrics(40, 4e6), 2000);
  history.Add(Metrics(90, 5e6), 1000);
  const auto cost = history.Foresee(4000);
  ASSERT_TRUE(cost);
  EXPECT_NEAR(cost->cpu_seconds, 80.0, 1e-9);
  EXPECT_EQ(cost->peak_bytes, 20'000'000);
}

TEST(VisitCost, WhatTellsNothingIsLeftOut) {
  CostHistory history;
  for (const char* text : {"", "{", "[]", "{}", R"({"stages": 3})", R"({"stages": [7, {"cpu_seconds": "x"}]})"})
    history.Add(text, 1000);
  history.Add(Metrics(10, 1), 0);
  EXPECT_FALSE(history.Foresee(1000));
}

}  // namespace
}  // namespace stratalux::fit
