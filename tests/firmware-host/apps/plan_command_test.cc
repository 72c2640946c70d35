// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/plan_command.h"

#include <fstream>
#include <iterator>
#include <set>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "shared/image/png.h"
#include "tests/support/scratch_folder.h"

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
  const auto json = nlohmann::json::parse(PlanAsJson(plan, {}, SmallLayout(), {}));
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
  const auto json = nlohmann::json::parse(PlanAsJson(SmallPlan(), {}, layout, {}))["memory"];
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
  EXPECT_TRUE(nlohmann::json::parse(PlanAsJson(SmallPlan(), {}, SmallLayout(), {}))["memory"]["capacity"].is_null());
}

TEST(PlanAsText, HasOneLineAStepAndOneASectionOfEachMemory) {
  MemoryOptions options;
  options.capacity = 250;
  const MemoryLayout layout = *LayOutMemories(SmallOptions(), options);
  size_t lines = SmallPlan().steps.size() + 3 + 2 + layout.left_out.size();  // heads, what is not held
  for (const ProjectorMemory& memory : layout.projectors) lines += memory.sections.size() + 1;
  const std::string text = PlanAsText(SmallPlan(), {}, layout, {});
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), static_cast<long>(lines));
  EXPECT_NE(text.find(std::to_string(layout.projectors[0].patterns.size()) + " of 250\n"), std::string::npos) << text;
}

RigDeadlines Learnt() {
  RigDelays delays;
  delays.sync = {{64, 0.4, 0.5, 0.0}, {64, 0.6, 0.7, 0.0}};
  delays.frame = {60, 8.0, 9.0, 0.0};
  delays.transfer_ms = 7.9;
  delays.frame_period_ms = 24.0;
  RigDeadlines deadlines;
  deadlines.longest = std::chrono::milliseconds(500);
  deadlines.source = DeadlineSource::kLearnt;
  deadlines.learnt = DeadlinesFrom(delays, deadlines.longest);
  deadlines.delays = delays;
  deadlines.learnt_at = "2026-11-21T04:06:11Z";
  return deadlines;
}

TEST(PlanAsText, SaysWhereTheDeadlinesComeFrom) {
  const auto its_line = [](const RigDeadlines& deadlines) {
    const std::string text = PlanAsText(SmallPlan(), {}, SmallLayout(), deadlines);
    const size_t first = text.find("deadlines: ");
    return text.substr(first, text.find('\n', first) + 1 - first);
  };
  RigDeadlines deadlines = Learnt();
  EXPECT_EQ(its_line(deadlines),
            "deadlines: SYNC 97.5, 97.7 ms after TRIGGER, frames 34.0 ms after their exposure, learnt by selftest "
            "2026-11-21T04:06:11Z\n");
  const auto json = nlohmann::json::parse(PlanAsJson(SmallPlan(), {}, SmallLayout(), deadlines))["deadlines"];
  EXPECT_EQ(json["source"], "learnt");
  EXPECT_EQ(json["learnt_at"], deadlines.learnt_at);
  ASSERT_EQ(json["sync_ms"].size(), 2U);
  EXPECT_NEAR(json["sync_ms"][1].get<double>(), 97.7, 1e-6);
  EXPECT_NEAR(json["frame_ms"].get<double>(), 34.0, 1e-6);
  EXPECT_EQ(json["longest_ms"], 500.0);
  deadlines.learnt.reset();
  deadlines.source = DeadlineSource::kConfigured;
  EXPECT_EQ(its_line(deadlines), "deadlines: 500 ms for SYNC and for a frame, as [capture] deadline_ms says\n");
  deadlines.source = DeadlineSource::kFlag;
  EXPECT_EQ(its_line(deadlines), "deadlines: 500 ms for SYNC and for a frame, as --deadline says\n");
  deadlines.source = DeadlineSource::kDefault;
  deadlines.refused = "file of another rig";
  EXPECT_EQ(its_line(deadlines), "deadlines: 500 ms for SYNC and for a frame, the default: file of another rig\n");
  const auto refused = nlohmann::json::parse(PlanAsJson(SmallPlan(), {}, SmallLayout(), deadlines))["deadlines"];
  EXPECT_EQ(refused["refused"], deadlines.refused);
  EXPECT_FALSE(refused.contains("sync_ms"));
}

TEST(TimingOf, TakesWhatWasLearntWhereTheConfigurationIsSilent) {
  const RigDeadlines learnt = Learnt();
  RigConfig config;
  EXPECT_EQ(TimingOf(config).sync_delay, FromMilliseconds(kSyncDelayMs));
  EXPECT_EQ(TimingOf(config).transfer, FromMilliseconds(kTransferMs));
  EXPECT_EQ(TimingOf(config, &*learnt.delays).sync_delay, FromMilliseconds(0.5)) << "of two projectors";
  EXPECT_EQ(TimingOf(config, &*learnt.delays).transfer, FromMilliseconds(8.0));
  config.sync_delay_ms = 3.0;
  config.camera.transfer_ms = 4.0;
  EXPECT_EQ(TimingOf(config, &*learnt.delays).sync_delay, FromMilliseconds(3.0));
  EXPECT_EQ(TimingOf(config, &*learnt.delays).transfer, FromMilliseconds(4.0));
  config = {};
  config.plan.kind = SessionKind::kCalibration;
  EXPECT_GT(TimingOf(config).loading.count(), 0);
  RigDelays slow = *learnt.delays;
  slow.sync = {{64, 5.0, 5.0, 0.0}, {64, 5.0, 5.0, 0.0}, {64, 5.0, 5.0, 0.0}, {64, 5.0, 5.0, 0.0}};
  EXPECT_GT(TimingOf(config, &slow).loading, 8 * TimingOf(config).loading) << "the memories' way, at ten times a step";
  config.sync_delay_ms = kSyncDelayMs;
  EXPECT_EQ(TimingOf(config, &slow).loading, TimingOf(config).loading);
  config = {};
  config.plan.sync_mode = SyncMode::kFreeRunning;
  EXPECT_EQ(TimingOf(config, &*learnt.delays).transfer, FromMilliseconds(7.9));
  EXPECT_EQ(TimingOf(config, &*learnt.delays).frame_period, FromMilliseconds(24.0));
}

TEST(RenderPlan, WritesThePatternsThatTheStepsName) {
  const ScratchFolder scratch;
  const CapturePlan plan = SmallPlan();
  const std::filesystem::path folder = scratch / "patterns";
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
