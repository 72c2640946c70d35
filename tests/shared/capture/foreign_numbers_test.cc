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
