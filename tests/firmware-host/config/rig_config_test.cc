// SPDX-License-Identifier: Apache-2.0
#include "shared/config/rig_config.h"

#include <gtest/gtest.h>

namespace stratalux {
namespace {

Status Parse(const std::string& text) { return ParseRigConfig(text, "rig.toml").status(); }

TEST(RigConfig, ShippedExampleSpellsOutTheDefaults) {
  const auto config = LoadRigConfig(STRATALUX_SOURCE_DIR "/docs/examples/rig.toml");
  ASSERT_TRUE(config.ok()) << config.status().message();
  EXPECT_EQ(PlanOptionsToJson(config->plan), PlanOptionsToJson({}));
  EXPECT_EQ(config->settle_ms, RigConfig{}.settle_ms);
  EXPECT_EQ(config->codec, RigConfig{}.codec);
}

TEST(RigConfig, NamesFileLineKeyAndRange) {
  const struct {
    const char* text;
    const char* says;
  } cases[] = {
      {"[plan]\ncomb_widht = 3\n", "rig.toml:2: unknown key 'plan.comb_widht'"},
      {"[plan]\nexposure_ms = -4\n", "rig.toml:2: plan.exposure_ms: value -4"},
      {"[plan]\nprojectors = \"four\"\n", "is not an integer"},
      {"[plan]\ncomb_step = 3\ncomb_width = 3\n", "must divide"},
      {"[plan]\ncomb_period = 4096\n", "exceeds the projector"},
      {"[camera]\nwidth = 1392\nwidth = 3\n", "rig.toml:3"},
      {"[plan]\nkind = \"visiter\"\n", "allowed: visitor"},
      {"[plan]\nbrackets = []\n", "non-empty"},
      {"nonsense", "rig.toml:1"},
      {"[rig]\nname = \"a\"\n[store]\ncodec = \"zip\"\n", "rig.toml:4: unknown codec 'zip' (allowed: raw12, delta)"},
      {"[cameras]\n", "unknown key 'cameras'"},
  };
  for (const auto& c : cases) {
    const Status status = Parse(c.text);
    EXPECT_EQ(status.code(), StatusCode::kUsage) << c.text;
    EXPECT_NE(status.message().find(c.says), std::string::npos) << status.message();
  }
}

TEST(RigConfig, MissingFileIsAUsageErrorThatNamesIt) {
  const auto config = LoadRigConfig("/nowhere/rig.toml");
  EXPECT_EQ(config.status().code(), StatusCode::kUsage);
  EXPECT_NE(config.status().message().find("/nowhere/rig.toml"), std::string::npos);
}

}  // namespace
}  // namespace stratalux
