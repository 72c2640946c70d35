// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/memory_layout.h"

#include <algorithm>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

constexpr SessionKind kKinds[] = {SessionKind::kVisitor, SessionKind::kCalibration, SessionKind::kDark,
                                  SessionKind::kFlat, SessionKind::kResponse};

CapturePlan PlanOf(SessionKind kind, PlanOptions options = {}) {
  options.kind = kind;
  return BuildPlan(options).value();
}

std::optional<SectionPlace> PlaceOf(const ProjectorMemory& memory, MemorySection section) {
  for (const SectionPlace& place : memory.sections)
    if (place.section == section) return place;
  return std::nullopt;
}

TEST(MemoryLayout, HoldsEveryKindOfCaptureAtOnceInTheOrderOfItsPulses) {
  const MemoryLayout layout = LayOutMemories({}).value();
  ASSERT_EQ(layout.projectors.size(), 4U);
  EXPECT_TRUE(layout.left_out.empty());
  for (const SessionKind kind : kKinds) {
    const CapturePlan plan = PlanOf(kind);
    for (int p = 0; p < 4; ++p) {
      EXPECT_TRUE(layout.CheckHeld(plan, p).ok());
      const ProjectorMemory& memory = layout.projectors[static_cast<size_t>(p)];
      const auto place = PlaceOf(memory, SectionOf(kind));
      ASSERT_TRUE(place) << ToString(kind);
      const std::vector<Pattern> sequence = SequenceOf(plan, p);
      ASSERT_EQ(place->count, std::ssize(sequence));
      for (int k = 0; k < place->count; ++k)
        ASSERT_EQ(memory.patterns.at(static_cast<size_t>(place->first + k)), sequence[static_cast<size_t>(k)])
            << ToString(kind) << " + " << k;
    }
  }
  for (const ProjectorMemory& memory : layout.projectors)
    for (const MemorySection section : {MemorySection::kPreview, MemorySection::kWhiteCard}) {
      const auto place = PlaceOf(memory, section);
      ASSERT_TRUE(place && place->count == 2);
      EXPECT_EQ(memory.patterns.at(static_cast<size_t>(place->first)).kind, PatternKind::kWhite);
      EXPECT_EQ(memory.patterns.at(static_cast<size_t>(place->first) + 1).kind, PatternKind::kBlack);
    }
}

// Docs tell these numbers to whoever chooses a module.
TEST(MemoryLayout, WhatASectionHasInCommonWithOnesBeforeIsStoredOnce) {
  const MemoryLayout layout = LayOutMemories({}).value();
  EXPECT_EQ(layout.projectors[0].patterns.size(), 385U);
  for (int p = 1; p < 4; ++p) EXPECT_EQ(layout.projectors[static_cast<size_t>(p)].patterns.size(), 290U);
  for (const ProjectorMemory& memory : layout.projectors) {
    EXPECT_EQ(memory.sections.front(), (SectionPlace{MemorySection::kVisitor, 0, 131})) << "where a memory rests";
    EXPECT_LT(PlaceOf(memory, MemorySection::kWhiteCard)->first, 131);
  }
  // Only projector 0 shows something in a dark session; the others have its pre-roll in the visit's.
  EXPECT_EQ(*PlaceOf(layout.projectors[1], MemorySection::kDark), (SectionPlace{MemorySection::kDark, 0, 8}));
}

TEST(MemoryLayout, HoldsWhatIsNamedInTheOrderOfTheMemory) {
  MemoryOptions options;
  options.sections = {MemorySection::kCalibration, MemorySection::kWhiteCard, MemorySection::kVisitor};
  const MemoryLayout layout = LayOutMemories({}, options).value();
  EXPECT_EQ(layout.projectors[0].patterns.size(), 131U + 52U);
  EXPECT_EQ(layout.projectors[0].sections.front().section, MemorySection::kVisitor);
  EXPECT_TRUE(layout.Holds(MemorySection::kCalibration));
  EXPECT_FALSE(layout.Holds(MemorySection::kFlat));
  options.sections = {MemorySection::kWhiteCard};
  EXPECT_EQ(LayOutMemories({}, options)->projectors[3].patterns.size(), 2U);
}

TEST(MemoryLayout, AKindThatIsLeftOutIsRefusedWithTheRemedy) {
  MemoryOptions options;
  options.where = "rig.toml:7";
  options.sections = {MemorySection::kVisitor};
  const Status named = LayOutMemories({}, options)->CheckHeld(PlanOf(SessionKind::kDark), 0);
  EXPECT_EQ(named.code(), StatusCode::kUsage);
  for (const char* part : {"rig.toml:7", "'dark'", "[memory] sections", "plan render"})
    EXPECT_THAT(named.message(), HasSubstr(part));
  // All that fit: of what does not, the refusal tells the numbers.
  options.sections.clear();
  options.capacity = 200;
  const MemoryLayout small = LayOutMemories({}, options).value();
  EXPECT_TRUE(small.CheckHeld(PlanOf(SessionKind::kCalibration), 0).ok());
  const Status fits_not = small.CheckHeld(PlanOf(SessionKind::kFlat), 1);
  EXPECT_EQ(fits_not.code(), StatusCode::kUsage);
  for (const char* part : {"rig.toml:7", "'flat'", "memory.capacity = 200", "282"})
    EXPECT_THAT(fits_not.message(), HasSubstr(part));
  for (const ProjectorMemory& memory : small.projectors) EXPECT_LE(memory.patterns.size(), 200U);
}

TEST(MemoryLayout, ACapacityExceededNamesFileKeyValueAndRemedy) {
  MemoryOptions options;
  options.where = "rig.toml:7";
  options.sections = {MemorySection::kVisitor, MemorySection::kFlat};
  options.capacity = 230;
  EXPECT_TRUE(LayOutMemories({}, options)->Holds(MemorySection::kFlat)) << "131 and 99: just so";
  --options.capacity;
  const Status status = LayOutMemories({}, options).status();
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  for (const char* part : {"rig.toml:7", "memory.capacity = 229", "230", "'flat'", "raise it", "memory.sections"})
    EXPECT_THAT(status.message(), HasSubstr(part));
  options.sections.clear();
  options.capacity = 1;
  EXPECT_EQ(LayOutMemories({}, options).status().code(), StatusCode::kUsage) << "nothing fits";
}

TEST(MemoryLayout, ASectionThatCannotBePlannedIsLeftOutUnlessItIsNamed) {
  PlanOptions plan;
  plan.preroll_markers = 0;
  ASSERT_TRUE(BuildPlan(plan).ok());
  EXPECT_TRUE(LayOutMemories(plan)->Holds(MemorySection::kVisitor));
  plan.separation_period = 4096;  // no projector's: neither can any visit be
  ASSERT_FALSE(BuildPlan(plan).ok());
  MemoryOptions options;
  options.sections = {MemorySection::kVisitor};
  EXPECT_THAT(LayOutMemories(plan, options).status().message(), HasSubstr("sections: visitor"));
}

TEST(MemoryLayout, APlanOfOtherOptionsIsRefusedUnlessItsPatternsStandThere) {
  const MemoryLayout layout = LayOutMemories({}).value();
  PlanOptions other;
  other.exposure_ms = 40.0;
  EXPECT_TRUE(layout.CheckHeld(PlanOf(SessionKind::kVisitor, other), 2).ok()) << "patterns alone are held";
  other.comb_period = 64;
  const Status status = layout.CheckHeld(PlanOf(SessionKind::kVisitor, other), 2);
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("[plan]"));
  EXPECT_EQ(layout.CheckHeld(PlanOf(SessionKind::kVisitor), 4).code(), StatusCode::kUsage);
}

TEST(MemorySection, NamesAreReadBack) {
  std::set<std::string> seen;
  for (const std::string& name : MemorySectionNames()) {
    const auto section = ParseMemorySection(name);
    ASSERT_TRUE(section.ok());
    EXPECT_EQ(ToString(*section), name);
    EXPECT_TRUE(seen.insert(name).second);
  }
  for (const SessionKind kind : kKinds) EXPECT_STREQ(ToString(SectionOf(kind)), ToString(kind));
  const Status status = ParseMemorySection("whitecard").status();
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("white_card"));
}

}  // namespace
}  // namespace stratalux::rig
