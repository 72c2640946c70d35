// SPDX-License-Identifier: Apache-2.0
// Plans and calibration records of other hands: a number that is none of ours becomes no other number.
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "shared/capture/plan.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux {
namespace {

using Json = nlohmann::ordered_json;

Status Plan(const char* key, const Json& value) {
  Json json = Json::parse(PlanOptionsToJson({}));
  json[key] = value;
  return PlanOptionsFromJson(json.dump()).status();
}

TEST(PlanJson, ANumberThatIsNoneOfOursIsRefused) {
  EXPECT_EQ(Plan("projectors", 4).code(), StatusCode::kOk);
  EXPECT_EQ(Plan("schema", int64_t{4294967297}).code(), StatusCode::kNewerSchema);
  for (const Json& value : {Json(1e300), Json(4.5), Json(int64_t{4294967300}), Json(UINT64_MAX), Json(nullptr)}) {
    EXPECT_EQ(Plan("projectors", value).code(), StatusCode::kIntegrity) << value;
    EXPECT_EQ(Plan("comb_period", value).code(), StatusCode::kIntegrity) << value;
  }
}

// Whole and in range of an int, and yet no plan: nothing is built of them, neither in memory nor beyond an int.
TEST(PlanJson, NumbersBeyondAnyRigAreRefusedBeforeAStepIsMade) {
  for (const char* key : {"separation_period", "separation_shifts", "checkerboard_period", "checkerboard_shifts",
                          "comb_width", "comb_period", "spot_pitch", "spot_radius", "guards", "motion_whites"})
    for (const int value : {2147483647, 2000000000, 65536, 0x7ffffffe, -1, -2147483647 - 1}) {
      const Status refused = Plan(key, value);
      EXPECT_FALSE(refused.ok()) << key << " " << value;
      EXPECT_NE(refused.message().find(key), std::string::npos) << refused.message();
    }
}

TEST(PlanJson, APlanOfMillionsOfStepsIsRefused) {
  Json json = Json::parse(PlanOptionsToJson({}));
  json["projectors"] = 16;
  json["checkerboard"] = true;
  json["checkerboard_shifts"] = 64;
  json["checkerboard_period"] = 64;
  json["comb_period"] = 8192;
  json["comb_width"] = json["comb_step"] = 1;
  json["brackets"] = {1, 2, 3, 4, 5, 6, 7, 8};
  json["separation_brackets"] = {1, 2, 3, 4, 5, 6, 7, 8};
  const Status refused = PlanOptionsFromJson(json.dump()).status();
  EXPECT_NE(refused.message().find("steps"), std::string::npos) << refused.message();
}

TEST(CalibrationRecord, ALaterSchemaIsOneWhateverItsSize) {
  const auto code = [](const std::string& schema) {
    return RigCalibration::FromJson(R"({"schema": )" + schema + "}").status().code();
  };
  EXPECT_EQ(code("2"), StatusCode::kNewerSchema);
  EXPECT_EQ(code("4294967297"), StatusCode::kNewerSchema);
  EXPECT_EQ(code("1e300"), StatusCode::kIntegrity);
}

}  // namespace
}  // namespace stratalux
