// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/plan_command.h"

#include <fstream>
#include <iterator>
#include <set>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "shared/image/png.h"

namespace stratalux::rig {
namespace {

PlanOptions SmallOptions() {
  PlanOptions options;
  options.projectors = 2;
  options.projector_width = 64;
  options.projector_height = 48;
  options.comb_period = 16;
  options.spot_pitch = 24;
  return options;
}

CapturePlan SmallPlan() { return *BuildPlan(SmallOptions()); }
MemoryLayout SmallLayout() { return *LayOutMemories(SmallOptions()); }

TEST(PlanAsJson, NamesEveryStepAndItsOptionsBuildThePlanAgain) {
  const CapturePlan plan = SmallPlan();
  const auto json = nlohmann::json::parse(PlanAsJson(plan, {}, SmallLayout()));
  ASSERT_EQ(json["steps"].size(), plan.steps.size());
  for (size_t i = 0; i < plan.steps.size(); ++i)
    EXPECT_EQ(*Pattern::Parse(json["steps"][i]["pattern"].get<std::string>()), plan.steps[i].pattern);
  const Result<PlanOptions> options = PlanOptionsFromJson(json["options"].dump());
  ASSERT_TRUE(options.ok()) << options.status().message();
  EXPECT_EQ(BuildPlan(*options)->steps.size(), plan.steps.size());
}

TEST(PlanAsJson, ListsWhatThePatternMemoriesHold) {
  MemoryOptions options;
  options.capacity = 200;
  const MemoryLayout layout = *LayOutMemories(SmallOptions(), options);
  ASSERT_FALSE(layout.left_out.empty());
  const auto json = nlohmann::json::parse(PlanAsJson(SmallPlan(), {}, layout))["memory"];
  EXPECT_EQ(json["capacity"], 200);
  ASSERT_EQ(json["projectors"].size(), layout.projectors.size());
  for (size_t p = 0; p < layout.projectors.size(); ++p) {
    const ProjectorMemory& memory = layout.projectors[p];
    EXPECT_EQ(json["projectors"][p]["projector"], p);
    EXPECT_EQ(json["projectors"][p]["patterns"], memory.patterns.size());
    ASSERT_EQ(json["projectors"][p]["sections"].size(), memory.sections.size());
    for (size_t k = 0; k < memory.sections.size(); ++k) {
      const auto& section = json["projectors"][p]["sections"][k];
      EXPECT_EQ(section["section"], ToString(memory.sections[k].section));
      EXPECT_EQ(section["first"], memory.sections[k].first);
      EXPECT_EQ(section["count"], memory.sections[k].count);
    }
  }
  ASSERT_EQ(json["left_out"].size(), layout.left_out.size());
  EXPECT_NE(json["left_out"][0]["why"].get<std::string>().find("capacity"), std::string::npos);
  EXPECT_TRUE(nlohmann::json::parse(PlanAsJson(SmallPlan(), {}, SmallLayout()))["memory"]["capacity"].is_null());
}

TEST(PlanAsText, HasOneLineAStepAndOneASectionOfEachMemory) {
  MemoryOptions options;
  options.capacity = 250;
  const MemoryLayout layout = *LayOutMemories(SmallOptions(), options);
  size_t lines = SmallPlan().steps.size() + 2 + 2 + layout.left_out.size();  // heads, what is not held
  for (const ProjectorMemory& memory : layout.projectors) lines += memory.sections.size() + 1;
  const std::string text = PlanAsText(SmallPlan(), {}, layout);
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), static_cast<long>(lines));
  EXPECT_NE(text.find(std::to_string(layout.projectors[0].patterns.size()) + " of 250\n"), std::string::npos) << text;
}

TEST(RenderPlan, WritesThePatternsThatTheStepsName) {
  const CapturePlan plan = SmallPlan();
  const std::filesystem::path folder = std::filesystem::path(::testing::TempDir()) / "stratalux-plan-render";
  std::filesystem::remove_all(folder);
  ASSERT_TRUE(RenderPlan(plan, {}, SmallLayout(), folder).ok());
  std::ifstream in(folder / "plan.json");
  const auto json = nlohmann::json::parse(in);
  for (const PlanStep& step : plan.steps) {
    int bits = 0;
    const auto image = ReadPng(folder / json["steps"][step.index]["file"].get<std::string>(), &bits);
    ASSERT_TRUE(image.ok()) << image.status().message();
    ASSERT_EQ(bits, 8);
    ASSERT_EQ(image->width(), 64);
    for (int y = 0; y < 48; y += 7)
      for (int x = 0; x < 64; x += 3)
        ASSERT_NEAR((*image)(x, y), 255.0 * step.pattern.Intensity(x, y), 0.51) << step.pattern.ToString();
  }
  // The bit planes: 32 bytes of header, then patterns of 48 rows of 8 bytes; each step's memory entry is its pattern.
  std::ifstream memory(folder / "patterns-1bit.bin", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(memory)), {});
  EXPECT_EQ(bytes.substr(0, 6), "SLXPAT");
  for (const PlanStep& step : plan.steps) {
    const auto& entry = json["steps"][step.index]["memory"];
    if (entry["file"] != "patterns-1bit.bin") continue;
    const size_t row = 32 + entry["index"].get<size_t>() * 48 * 8 + 5 * 8;
    for (int x = 0; x < 64; ++x)
      ASSERT_EQ((static_cast<uint8_t>(bytes.at(row + x / 8)) >> (7 - x % 8)) & 1, step.pattern.Intensity(x, 5) > 0.5F)
          << step.pattern.ToString();
  }
  // What each TRIGGER pulse of each projector shows, all sections of its memory.
  const MemoryLayout layout = SmallLayout();
  std::set<std::string> distinct;
  for (const auto& pattern : json["patterns"]) EXPECT_TRUE(distinct.insert(pattern["pattern"]).second);
  for (size_t p = 0; p < layout.projectors.size(); ++p) {
    const auto& sequence = json["memory"]["projectors"][p]["sequence"];
    const std::vector<Pattern>& held = layout.projectors[p].patterns;
    ASSERT_EQ(sequence.size(), held.size());
    for (size_t k = 0; k < held.size(); ++k) {
      const auto& pattern = json["patterns"][sequence[k].get<size_t>()];
      ASSERT_EQ(pattern["pattern"], held[k].ToString());
      ASSERT_TRUE(std::filesystem::exists(folder / pattern["file"].get<std::string>()));
    }
  }
  std::filesystem::remove_all(folder);
}

TEST(RenderPlan, NamesAFolderItCannotMake) {
  const Status status = RenderPlan(SmallPlan(), {}, SmallLayout(), "/proc/no-such-place/patterns");
  EXPECT_EQ(status.code(), StatusCode::kFailed);
  EXPECT_NE(status.message().find("/proc/no-such-place/patterns"), std::string::npos);
}

}  // namespace
}  // namespace stratalux::rig
