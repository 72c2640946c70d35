// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/findings_gate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using Worth = CaptureFacts::Worth;

CaptureFacts Facts(void (*set)(CaptureFacts&)) {
  CaptureFacts facts;
  facts.worth = Worth::kDegraded;
  set(facts);
  return facts;
}
Judgement First(const CaptureFacts& facts) { return JudgeCapture(facts, {1, 0, 16000}, {}); }
Judgement Last(const CaptureFacts& facts) { return JudgeCapture(facts, {3, 0, 16000}, {}); }

TEST(FindingsGate, ACompleteCaptureNeedsNobodysPatience) {
  EXPECT_EQ(First({}), (Judgement{Verdict::kAccept, Word::kNone}));
}

TEST(FindingsGate, WhatTheVisitorCanMendIsOfferedUntilTheLastAttempt) {
  const struct {
    CaptureFacts facts;
    Word word;
  } cases[] = {
      {Facts([](CaptureFacts& f) { f.moved = true; }), Word::kMoved},
      {Facts([](CaptureFacts& f) { f.mixed_up = true; }), Word::kMixedUp},
      {Facts([](CaptureFacts& f) { f.coverage_permille = 699; }), Word::kCoverage},
      {Facts([](CaptureFacts& f) { f.unproven = true; }), Word::kProof},
  };
  for (const auto& c : cases) {
    EXPECT_EQ(First(c.facts), (Judgement{Verdict::kOffer, c.word})) << ToString(c.word);
    EXPECT_EQ(Last(c.facts), (Judgement{Verdict::kAccept, c.word})) << ToString(c.word);
  }
}

TEST(FindingsGate, LimitsAreMet) {
  EXPECT_EQ(First(Facts([](CaptureFacts& f) { f.coverage_permille = 700; })).verdict, Verdict::kAccept);
  EXPECT_EQ(First(Facts([](CaptureFacts& f) { f.saturated_permille = 10; })).verdict, Verdict::kAccept);
  EXPECT_EQ(First(Facts([](CaptureFacts& f) { f.saturated_permille = 11; })).verdict, Verdict::kRetakeShorter);
}

TEST(FindingsGate, NoExposureBelowTheShortest) {
  const CaptureFacts bright = Facts([](CaptureFacts& f) { f.saturated_permille = 200; });
  EXPECT_EQ(JudgeCapture(bright, {1, 0, 1000}, {}).verdict, Verdict::kRetakeShorter);
  EXPECT_EQ(JudgeCapture(bright, {1, 0, 999}, {}).verdict, Verdict::kAccept);
}

TEST(FindingsGate, WhatNoRetakeMendsIsTheOperators) {
  const CaptureFacts lamp = Facts([](CaptureFacts& f) {
    f.lamp = true;
    f.moved = true;
  });
  EXPECT_EQ(First(lamp), (Judgement{Verdict::kAccept, Word::kLamp}));
}

TEST(FindingsGate, ARigThatCannotProveItselfTwiceIsNotTrusted) {
  for (const CaptureFacts& facts :
       {Facts([](CaptureFacts& f) { f.unproven = true; }), Facts([](CaptureFacts& f) { f.worth = Worth::kFailed; })}) {
    EXPECT_EQ(JudgeCapture(facts, {2, 0, 16000}, {}).verdict, Verdict::kOffer);
    EXPECT_EQ(JudgeCapture(facts, {2, 1, 16000}, {}), (Judgement{Verdict::kSafe, Word::kProof}));
    EXPECT_EQ(JudgeCapture(facts, {3, 1, 16000}, {}).verdict, Verdict::kSafe) << "also at the last attempt";
  }
  const CaptureFacts taken = Facts([](CaptureFacts& f) { f.light_taken = true; });
  EXPECT_EQ(First(taken), (Judgement{Verdict::kSafe, Word::kLight}));
}

event::Face At(FaceBox box, int distance_mm = 800, int level_permille = 1000) {
  return {box, distance_mm, level_permille, 16000};
}

TEST(FindingsGate, SaysWhereTheFaceShouldGo) {
  VisitRules rules;
  rules.nearest_mm = 700;
  rules.furthest_mm = 900;
  const FaceBox good = {300, 100, 700, 900};
  EXPECT_EQ(JudgeFace(At(good), rules), Word::kHold);
  EXPECT_EQ(JudgeFace(At(good, 0), rules), Word::kHold) << "no calibration tells the distance";
  EXPECT_EQ(JudgeFace(At(good, 699), rules), Word::kBack);
  EXPECT_EQ(JudgeFace(At(good, 901), rules), Word::kCloser);
  EXPECT_EQ(JudgeFace(At({450, 400, 550, 600}), rules), Word::kCloser) << "too small";
  EXPECT_EQ(JudgeFace(At({0, 100, 400, 900}), rules), Word::kCentre) << "cut off";
  EXPECT_EQ(JudgeFace(At({480, 100, 900, 900}), rules), Word::kCentre) << "beside the middle";
  EXPECT_EQ(JudgeFace(At(good, 800, 499), rules), Word::kBrighter);
}

TEST(VisitRulesTest, RefuseWhatLeavesNoWay) {
  EXPECT_TRUE(VisitRules{}.Validate().ok());
  VisitRules rules;
  rules.attempts = 4;
  EXPECT_THAT(rules.Validate().message(), ::testing::HasSubstr("kiosk.attempts: value 4, allowed: 1 .. 3"));
  rules = {};
  rules.nearest_mm = 900;
  rules.furthest_mm = 800;
  EXPECT_EQ(rules.Validate().code(), StatusCode::kUsage);
  rules = {};
  rules.paper_consent = true;
  rules.paper.fit = false;
  EXPECT_EQ(rules.Validate().code(), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::rig
