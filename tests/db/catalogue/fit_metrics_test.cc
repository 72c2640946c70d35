// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/fit_metrics.h"

#include <gmock/gmock.h>

namespace stratalux::db {
namespace {

using ::testing::IsEmpty;
using ::testing::Pair;
using ::testing::UnorderedElementsAre;

TEST(FitMetrics, NamesNumbersByTheirPath) {
  EXPECT_THAT(FlattenMetrics(R"({"rms": 0.25, "fit": {"tau": 2, "masked": {"no light": 7}}, "name": "x", "on": true})"),
              UnorderedElementsAre(Pair("rms", 0.25), Pair("fit.tau", 2.0), Pair("fit.masked.no light", 7.0)));
}

TEST(FitMetrics, NamesEntriesByTheirTextsAndAveragesOverProjectors) {
  EXPECT_THAT(FlattenMetrics(R"({"schema": 1, "options": {"layers": 20}, "heldout": [
      {"projector": 0, "light": "stripe", "model": "tied", "pool": 1, "nrmse": 0.2, "nrmse_rgb": [1, 2, 3]},
      {"projector": 1, "light": "stripe", "model": "tied", "pool": 1, "nrmse": 0.4, "nrmse_rgb": [1, 2, 3]},
      {"projector": 1, "light": "white", "model": "tied", "pool": 1, "nrmse": 0.5},
      {"projector": 1, "light": "white", "model": "tied", "pool": 4, "nrmse": 0.1}],
      "stages": [{"name": "srd", "seconds": 3}]})"),
              UnorderedElementsAre(Pair("heldout.stripe.tied.nrmse", ::testing::DoubleEq(0.3)),
                                   Pair("heldout.white.tied.nrmse", 0.5), Pair("heldout.white.tied.pool4.nrmse", 0.1),
                                   Pair("stages.srd.seconds", 3.0)));
}

TEST(FitMetrics, TakesNothingFromWhatIsNoObject) {
  for (const char* text : {"", "{", "[1]", "7", "null", "{}", "\xff", R"({"a": null, "b": "1", "c": 1e999})"})
    EXPECT_THAT(FlattenMetrics(text), IsEmpty()) << text;
  std::string deep;
  for (int i = 0; i < 2000; ++i) deep += R"({"a":)";
  EXPECT_THAT(FlattenMetrics(deep + "1" + std::string(2000, '}')), IsEmpty()) << "2000 levels";
}

}  // namespace
}  // namespace stratalux::db
