// SPDX-License-Identifier: Apache-2.0
// JSON of a hundred thousand levels, which ends a program that copies or writes it: in every file of a session whose
// hashes fit, and in what an index says of it.
#include <functional>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/manifest.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using Json = nlohmann::ordered_json;

const std::string& Deep() {
  static const std::string kDeep = R"({"a": )" + std::string(200'000, '[') + std::string(200'000, ']') + "}";
  return kDeep;
}

class DeepJson : public StoreTest {
 protected:
  // A manifest of this session whose member `key` is the deep one.
  void WriteManifestWith(const std::string& key) const {
    SessionInfo info = SimulatedVisit();
    info.id = "s000001-0badcafe";
    Json json = Json::parse(ManifestText(folder_, info, 0, {}));
    json.erase("hash");
    json[key] = "DEEP";
    std::string text = json.dump(1);
    text.replace(text.find("\"DEEP\""), 6, Deep());
    WriteText(folder_ / "manifest.json", WithOwnHash(text));
  }
};

TEST_F(DeepJson, AManifestIsRefused) {
  for (const char* key : {"plan", "calibration", "findings", "consent", "files", "of a later version"}) {
    WriteManifestWith(key);
    for (const Status& status : {ReadManifest(folder_).status(), ReadManifestContents(folder_).status(),
                                 ReplaceSegments(folder_, {"frames-0001.seg"})}) {
      EXPECT_EQ(status.code(), StatusCode::kIntegrity) << key;
      EXPECT_THAT(status.message(), HasSubstr("manifest.json: nests deeper than 64 levels")) << key;
    }
    EXPECT_EQ(LastingFacts(ReadText(folder_ / "manifest.json")), "");
  }
}

TEST_F(DeepJson, SoIsAFitOfAnyVersion) {
  const auto fit = folder_ / "fit";
  std::filesystem::create_directory(fit);
  WriteText(fit / "metrics.json", R"({"options": )" + Deep() + "}");
  EXPECT_THAT(ReadFitRecord(fit, "s").status().message(), HasSubstr("metrics.json: nests deeper"));
  for (const char* key : {"options_json", "metrics_json"}) {
    Json json = {{"schema", 1},          {"fit", "fit"},       {"session", "s"},
                 {"created_wall_ns", 1}, {"options_json", ""}, {"metrics_json", "{}"}};
    json[key] = Deep();
    WriteText(fit / "fit.json", json.dump(1));
    EXPECT_THAT(ReadFitRecord(fit, "s").status().message(), HasSubstr("fit.json: nests deeper")) << key;
  }
  WriteText(fit / "fit.json", R"({"schema": 1, "files": )" + Deep() + "}");
  EXPECT_THAT(CheckFitFiles(fit).message(), HasSubstr("fit.json: nests deeper"));
}

TEST_F(DeepJson, AReasonOfAnIndexIsNone) {
  EXPECT_TRUE(ReasonsFromJson("[" + Deep() + "]").empty());
  EXPECT_TRUE(ConsentFromJson(Deep()).text_version.empty());
  EXPECT_TRUE(FoundFromJson("[" + Deep() + "]", Deep()).findings.empty());
}

}  // namespace
}  // namespace stratalux::db
