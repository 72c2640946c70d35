// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/finding.h"

#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(Finding, EveryKindHasAWordOfItsOwn) {
  std::set<std::string> words;
  for (int i = 0; i < kFindingKindCount; ++i) {
    const auto kind = static_cast<FindingKind>(i);
    words.insert(ToString(kind));
    const auto read = ParseFindingKind(ToString(kind));
    ASSERT_TRUE(read.ok()) << i;
    EXPECT_EQ(*read, kind);
  }
  EXPECT_EQ(words.size(), kFindingKindCount);
}

TEST(Finding, OfTheNextVersionIsCalledNewer) {
  EXPECT_EQ(ParseFindingKind("sneezed").status().code(), StatusCode::kNewerSchema);
  EXPECT_EQ(FindingsFromJson(R"([{"kind":"sneezed","value":1,"limit":0}])").status().code(), StatusCode::kNewerSchema);
}

TEST(Finding, ListsComeBackFromJson) {
  const std::vector<Finding> findings = {{FindingKind::kMoved, 2, 117, 0.0625, 0.03, ""},
                                         {FindingKind::kDevice, -1, -1, 0.0, 0.0, "/dev/video0: \"gone\"\n"}};
  const auto read = FindingsFromJson(FindingsToJson(findings));
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(*read, findings);
  const std::map<std::string, int64_t> faults = {{"lost frame", 2}, {"wrong level", 14}};
  const auto counts = FaultsFromJson(FaultsToJson(faults));
  ASSERT_TRUE(counts.ok()) << counts.status().message();
  EXPECT_EQ(*counts, faults);
}

TEST(Finding, WhatIsNoListOfThemIsRefused) {
  for (const char* text :
       {"", "{}", "[1]", R"([{"kind":"moved"}])", R"([{"kind":"moved","value":1e999,"limit":0}])",
        R"([{"kind":"moved","value":"1","limit":0}])", R"([{"kind":7,"value":1,"limit":0}])",
        R"([{"kind":"moved","value":1,"limit":0,"step":-4}])", R"([{"kind":"moved","value":1,"limit":0,"step":1.5}])",
        R"([{"kind":"watch","value":0,"limit":0,"detail":[]}])"})
    EXPECT_EQ(FindingsFromJson(text).status().code(), StatusCode::kIntegrity) << text;
  for (const char* text : {"", "[]", R"({"lost frame":-1})", R"({"lost frame":1.5})", R"({"lost frame":"2"})",
                           R"({"lost frame":18446744073709551615})"})
    EXPECT_EQ(FaultsFromJson(text).status().code(), StatusCode::kIntegrity) << text;
}

TEST(Finding, StepsOfOneKindShareALineAndOthersKeepTheirOrder) {
  EXPECT_THAT(ToText({{FindingKind::kNoProof, 0, 3},
                      {FindingKind::kMoved, 1, 40, 0.051, 0.03},
                      {FindingKind::kNoProof, 0, 17},
                      {FindingKind::kWrongPattern, 0, 9}}),
              ElementsAre("no proven frame for steps 3, 17",
                          "projector 1: step 40: differs by 5.1 % from what was there before (allowed 3.0 %); the "
                          "visitor moved",
                          "the level check failed for step 9"));
  std::vector<Finding> many;
  for (int step = 0; step < 20; ++step) many.push_back({FindingKind::kNoProof, 0, step});
  EXPECT_THAT(ToText(many), ElementsAre(HasSubstr("6, 7 and 12 more")));
}

TEST(Finding, OnlyWhatProvesAStepFalseWithdrawsItsFrames) {
  std::vector<Finding> all;
  for (int kind = 0; kind < kFindingKindCount; ++kind) all.push_back({static_cast<FindingKind>(kind), 0, kind});
  all.push_back({FindingKind::kNoProof, 0, -1});
  EXPECT_THAT(WithdrawnSteps(all),
              ElementsAre(static_cast<int>(FindingKind::kNoProof), static_cast<int>(FindingKind::kWrongPattern)));
  EXPECT_THAT(WithdrawnSteps({}), IsEmpty());
}

}  // namespace
}  // namespace stratalux
