// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/selftest_command.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

SelftestReport OneFailure() {
  SelftestReport report;
  report.rig.items = {{"camera", CheckState::kPassed, "64x48", ""},
                      {"disk", CheckState::kFailed, "1 MB/s", "use a faster disk"},
                      {"codec", CheckState::kSkipped, "no frame", ""}};
  report.rig.frame_latency_ms = {1.0, 1.0, 1.5, 2.0};
  return report;
}

TEST(SelftestCommand, AFailedItemComesWithItsRemedy) {
  const SelftestReport report = OneFailure();
  EXPECT_FALSE(report.passed());
  EXPECT_THAT(SelftestAsText(report), HasSubstr("-> use a faster disk"));
  EXPECT_THAT(SelftestAsText(report), HasSubstr("selftest FAILED"));
  const auto json = nlohmann::json::parse(SelftestAsJson(report));
  EXPECT_FALSE(json["passed"]);
  EXPECT_EQ(json["items"][1]["state"], "failed");
  EXPECT_EQ(json["items"][1]["remedy"], "use a faster disk");
  EXPECT_EQ(json["frame_latency_ms"].size(), 4U);
}

TEST(SelftestCommand, SkippedItemsFailNothing) {
  SelftestReport report = OneFailure();
  report.rig.items.erase(report.rig.items.begin() + 1);
  EXPECT_TRUE(report.passed());
}

TEST(SelftestCommand, AHistogramCountsEveryValueOnce) {
  const std::string text = Histogram({1.0, 1.0, 1.5, 2.0});
  EXPECT_THAT(text, HasSubstr("1.000 ..    1.100 ms | ######################################## 2\n"));
  EXPECT_THAT(text, HasSubstr("1.900 ..    2.000 ms | ####################                     1\n"));
  EXPECT_EQ(Histogram({}), "");
}

}  // namespace
}  // namespace stratalux::rig
