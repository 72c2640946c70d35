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

TEST(SelftestCommand, StatesMedianWorstAndSpreadOfTheDelays) {
  SelftestReport report = OneFailure();
  EXPECT_FALSE(nlohmann::json::parse(SelftestAsJson(report)).contains("delays"));
  RigDelays& delays = report.rig.delays.emplace();
  delays.sync = {{64, 0.4, 0.5, 0.05}};
  delays.frame = {60, 8.0, 9.0, 0.25};
  EXPECT_THAT(SelftestAsText(report),
              HasSubstr("TRIGGER to SYNC, projector 0   median 0.400 ms, worst 0.500 ms, spread 0.050 ms of 64\n"
                        "exposure to frame              median 8.000 ms, worst 9.000 ms, spread 0.250 ms of 60\n"));
  const auto json = nlohmann::json::parse(SelftestAsJson(report))["delays"];
  EXPECT_EQ(json["sync"][0]["worst_ms"], 0.5);
  EXPECT_EQ(json["frame"]["spread_ms"], 0.25);
  EXPECT_EQ(json["frame"]["count"], 60);
}

TEST(SelftestCommand, AHistogramCountsEveryValueOnce) {
  const std::string text = Histogram({1.0, 1.0, 1.5, 2.0});
  EXPECT_THAT(text, HasSubstr("1.000 ..    1.100 ms | ######################################## 2\n"));
  EXPECT_THAT(text, HasSubstr("1.900 ..    2.000 ms | ####################                     1\n"));
  EXPECT_EQ(Histogram({}), "");
}

}  // namespace
}  // namespace stratalux::rig
