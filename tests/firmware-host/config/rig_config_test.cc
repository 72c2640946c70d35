// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/config/rig_config.h"

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

Status Parse(const std::string& text) { return ParseRigConfig(text, "rig.toml").status(); }

TEST(RigConfig, ShippedExampleSpellsOutTheDefaults) {
  const auto config = LoadRigConfig(STRATALUX_SOURCE_DIR "/docs/examples/rig.toml");
  ASSERT_TRUE(config.ok()) << config.status().message();
  EXPECT_EQ(PlanOptionsToJson(config->plan), PlanOptionsToJson({}));
  EXPECT_EQ(config->settle_ms, RigConfig{}.settle_ms);
  EXPECT_FALSE(config->deadline_ms || config->sync_delay_ms || config->camera.transfer_ms) << "as selftest learnt them";
  EXPECT_EQ(config->LongestDeadline(), std::chrono::milliseconds(500));
  EXPECT_EQ(config->store.codec, StoreConfig{}.codec);
  EXPECT_EQ(config->camera.width, CameraWiring{}.width);
  EXPECT_EQ(config->memory.sections, MemoryOptions{}.sections);
  EXPECT_EQ(config->memory.capacity, MemoryOptions{}.capacity);
  EXPECT_TRUE(config->projectors.empty()) << "the example wires no devices until its reader does";
}

TEST(RigConfig, NamesFileLineKeyAndRange) {
  const struct {
    const char* text;
    const char* says;
  } cases[] = {
      {"[plan]\ncomb_widht = 3\n", "rig.toml:2: unknown key 'plan.comb_widht'"},
      {"[capture]\ndeadline_ms = 0.5\n", "rig.toml:2: capture.deadline_ms: value 0.5"},
      {"[camera]\ntransfer_ms = -1\n", "rig.toml:2: camera.transfer_ms: value -1"},
      {"[plan]\nexposure_ms = -4\n", "rig.toml:2: plan.exposure_ms: value -4"},
      {"[plan]\nprojectors = \"four\"\n", "is not an integer"},
      {"[plan]\ncomb_step = 3\ncomb_width = 3\n", "must divide"},
      {"[plan]\ncomb_period = 4096\n", "exceeds the projector"},
      {"[camera]\nwidth = 1392\nwidth = 3\n", "rig.toml:3"},
      {"[plan]\nkind = \"visiter\"\n", "allowed: visitor"},
      {"[plan]\ncode = \"xor-8\"\n", "rig.toml:2: code 'xor-8' is unknown; allowed: gray, xor-2, xor-4, min-stripe"},
      {"[plan]\nbrackets = []\n", "non-empty"},
      {"nonsense", "rig.toml:1"},
      {"[rig]\nname = \"a\"\n[store]\ncodec = \"zip\"\n", "rig.toml:4: unknown codec 'zip' (allowed: raw12, delta)"},
      {"[cameras]\n", "unknown key 'cameras'"},
      {"[camera]\nbackend = \"usb\"\n", "rig.toml:2: camera.backend: value 'usb' is unknown, allowed: none, v4l2"},
      {"[camera]\nbackend = \"v4l2\"\n", "rig.toml:2: say which camera"},
      {"[camera]\nbackend = \"v4l2\"\ndevice = \"/dev/v4l/x\"\nexposure_control = \"none\"\n",
       "rig.toml:4: a camera without an exposure control needs `fixed_exposure_ms`"},
      {"[camera]\nbuffers = 2\n", "allowed: 4 .. 32"},
      {"[gpio]\ndoor = \"GPIO5\"\n", "rig.toml:2: gpio.door: must be a table"},
      {"[gpio]\ndoor = { line = \"GPIO5\", offset = 5 }\n", "rig.toml:2: give a line either by `line`"},
      {"[gpio]\ndoor = { active = \"low\" }\n", "rig.toml:2: give a line either by `line`"},
      {"[gpio]\ndoor = { offset = 5 }\n", "rig.toml:2: an offset needs the label of its chip"},
      {"[gpio]\ndoor = { line = \"GPIO5\", bias = \"up\" }\n", "allowed: as-is, disabled, pull-up, pull-down"},
      {"[gpio]\ncamera_trigger = { line = \"GPIO5\", bias = \"pull-up\" }\n", "unknown key 'gpio.camera_trigger.bias'"},
      {"[gpio]\nstrobe = { line = \"GPIO5\" }\ndoor = { line = \"GPIO5\" }\n", "GPIO5 carries two signals"},
      {"[plan]\nprojectors = 1\n[[projector]]\nenable = { line = \"A\" }\nsync = { line = \"B\" }\n",
       "projector[0].trigger: is missing"},
      {"[plan]\nprojectors = 1\n[[projector]]\nkind = \"display\"\n", "projector[0].connector: is missing"},
      {"[plan]\nprojectors = 1\n[[projector]]\nkind = \"display\"\nconnector = \"HDMI-A-1\"\nsync = { line = \"B\" }\n",
       "unknown key 'projector[0].sync'"},
      {"[memory]\nsection = [\"visitor\"]\n", "rig.toml:2: unknown key 'memory.section'"},
      {"[memory]\nsections = \"visitor\"\n", "rig.toml:2: memory.sections: must be a list"},
      {"[memory]\nsections = []\n", "rig.toml:2: memory.sections = []: name at least one"},
      {"[memory]\nsections = [\"visitor\", \"prescan\"]\n",
       "rig.toml:2: memory.sections: section 'prescan' is unknown; allowed: visitor, preview, white_card"},
      {"[memory]\ncapacity = -1\n", "rig.toml:2: memory.capacity: value -1"},
      {"[memory]\nsections = [\"visitor\", \"dark\"]\n\ncapacity = 150\n",
       "rig.toml:4: [memory] sections: no room for 'dark': memory.capacity = 150 patterns, but 187 are needed"},
      {"[memory]\ncapacity = 1\n", "rig.toml:2: memory.capacity = 1 patterns: no section fits"},
      {"[kiosk]\nopening = \"08:00\"\n", "rig.toml:2: unknown key 'kiosk.opening'"},
      {"[kiosk]\nopens = \"8:00\"\ncloses = \"18:00\"\n", "rig.toml:2: kiosk.opens = \"8:00\" is not a time of day"},
      {"[kiosk]\nopens = \"08:00\"\ncloses = \"25:00\"\n", "rig.toml:3: kiosk.closes = \"25:00\" is not a time of day"},
      {"[kiosk]\nopens = \"08:00\"\ncloses = \"08:00\"\n", "rig.toml:3: kiosk.closes is the same as kiosk.opens"},
      {"[kiosk]\nopens = \"08:00\"\n", "kiosk.closes: is missing"},
      {"[kiosk]\nattempts = 4\n", "rig.toml:2: kiosk.attempts: value 4"},
      {"[kiosk]\nlanguages = []\n", "rig.toml:2: kiosk.languages has 0 names"},
      {"[kiosk]\nretention = \"ever\"\n", "rig.toml:2: "},
      {"[kiosk]\nnearest_mm = 900\nfurthest_mm = 800\n", "rig.toml:3: kiosk.furthest_mm is not beyond"},
      {"[[projector]]\nkind = \"display\"\nconnector = \"HDMI-A-1\"\n",
       "1 [[projector]] tables, but the plan has projectors = 4"},
  };
  for (const auto& c : cases) {
    const Status status = Parse(c.text);
    EXPECT_EQ(status.code(), StatusCode::kUsage) << c.text;
    EXPECT_NE(status.message().find(c.says), std::string::npos) << status.message();
  }
}

TEST(RigConfig, KioskIsOpenFromToAndOverMidnight) {
  const auto day = ParseRigConfig("[kiosk]\nopens = \"08:30\"\ncloses = \"18:00\"\n", "rig.toml");
  ASSERT_TRUE(day.ok() && day->kiosk.hours) << day.status().message();
  for (const auto& [minute, open] : {std::pair(509, false), {510, true}, {1079, true}, {1080, false}})
    EXPECT_EQ(day->kiosk.hours->IsOpenAt(minute), open) << minute;
  const auto night = ParseRigConfig("[kiosk]\nopens = \"20:00\"\ncloses = \"02:00\"\n", "rig.toml");
  ASSERT_TRUE(night.ok() && night->kiosk.hours);
  for (const auto& [minute, open] : {std::pair(1199, false), {1200, true}, {0, true}, {119, true}, {120, false}})
    EXPECT_EQ(night->kiosk.hours->IsOpenAt(minute), open) << minute;
  EXPECT_FALSE(ParseRigConfig("", "rig.toml")->kiosk.hours) << "always";
}

TEST(RigConfig, ReadsWhatThePatternMemoriesHold) {
  const auto config = ParseRigConfig("[memory]\nsections = [\"dark\", \"white_card\"]\ncapacity = 400\n", "rig.toml");
  ASSERT_TRUE(config.ok()) << config.status().message();
  EXPECT_EQ(config->memory.sections, (std::vector{MemorySection::kDark, MemorySection::kWhiteCard}));
  EXPECT_EQ(config->memory.capacity, 400);
  EXPECT_EQ(config->memory.where, "rig.toml:3");
}

TEST(RigConfig, AMemorysMovementsFollowFromItsLines) {
  const auto config = ParseRigConfig(R"([gpio]
reset_pulse_us = 5000
[capture]
sync_delay_ms = 2.0
[plan]
projectors = 3
[[projector]]
enable = { line = "E0" }
trigger = { line = "T0" }
sync = { line = "S0" }
reset = { line = "R0" }
[[projector]]
kind = "display"
connector = "HDMI-A-1"
[[projector]]
enable = { line = "E2" }
trigger = { line = "T2" }
sync = { line = "S2" }
)",
                                     "rig.toml");
  ASSERT_TRUE(config.ok()) << config.status().message();
  const auto timings = MemoryTimingsOf(*config);
  ASSERT_EQ(timings.size(), 3U);
  ASSERT_TRUE(timings[0] && timings[2]);
  EXPECT_FALSE(timings[1]) << "a display has no memory";
  EXPECT_EQ(timings[0]->step, std::chrono::milliseconds(2));
  EXPECT_EQ(timings[0]->reset, std::optional<std::chrono::nanoseconds>(std::chrono::milliseconds(5)));
  EXPECT_FALSE(timings[2]->reset) << "no RESET line: over the end";
  EXPECT_EQ(MemoryTimingsOf(RigConfig{}).size(), 4U);
}

TEST(RigConfig, ShippedWiringIsWhole) {
  const auto config = LoadRigConfig(STRATALUX_SOURCE_DIR "/docs/examples/rig-raspberry-pi-5.toml");
  ASSERT_TRUE(config.ok()) << config.status().message();
  EXPECT_EQ(config->projectors.size(), 4U);
  for (const ProjectorLines& lines : config->gpio.projectors)
    EXPECT_TRUE(lines.enable && lines.trigger && lines.sync && lines.reset);
  EXPECT_TRUE(config->gpio.camera_trigger && config->gpio.emergency_stop && config->gpio.door);
}

TEST(RigConfig, ReadsTheWiring) {
  const auto config = ParseRigConfig(R"(
[gpio]
chip = "pinctrl-rp1"
projector_pulse_us = 50
camera_trigger = { line = "GPIO24", active = "low" }
emergency_stop = { offset = 5, bias = "pull-up", debounce_us = 500 }
door = { line = "DOOR", chip = "expander" }
[camera]
backend = "v4l2"
card = "Industrial"
format = "Y12P"
exposure_control = "exposure"
exposure_unit_us = 12.5
[plan]
projectors = 2
[[projector]]
enable = { line = "GPIO17" }
trigger = { line = "GPIO27" }
sync = { line = "GPIO22", active = "low" }
reset = { line = "GPIO23" }
[[projector]]
kind = "display"
connector = "HDMI-A-1"
refresh_hz = 60
enable = { line = "GPIO16" }
)",
                                     "rig.toml");
  ASSERT_TRUE(config.ok()) << config.status().message();
  const GpioWiring& gpio = config->gpio;
  EXPECT_EQ(gpio.projector_pulse, std::chrono::microseconds(50));
  EXPECT_EQ(gpio.camera_trigger->at, (LineAddress{"GPIO24", "pinctrl-rp1", -1}));
  EXPECT_EQ(gpio.camera_trigger->active, ActiveLevel::kLow);
  EXPECT_EQ(gpio.emergency_stop->at, (LineAddress{"", "pinctrl-rp1", 5}));
  EXPECT_EQ(gpio.emergency_stop->bias, LineBias::kPullUp);
  EXPECT_EQ(gpio.emergency_stop->debounce, std::chrono::microseconds(500));
  EXPECT_EQ(gpio.door->at.chip, "expander");
  EXPECT_FALSE(gpio.start.has_value());
  EXPECT_EQ(config->camera.backend, CameraBackend::kV4l2);
  EXPECT_EQ(config->camera.exposure_control, ExposureControl::kExposure);
  ASSERT_EQ(config->projectors.size(), 2U);
  ASSERT_EQ(gpio.projectors.size(), 2U);
  EXPECT_EQ(config->projectors[0].kind, ProjectorKind::kMemory);
  EXPECT_TRUE(gpio.projectors[0].reset.has_value());
  EXPECT_EQ(gpio.projectors[0].sync->active, ActiveLevel::kLow);
  EXPECT_EQ(config->projectors[1].kind, ProjectorKind::kDisplay);
  EXPECT_EQ(config->projectors[1].display.connector, "HDMI-A-1");
  EXPECT_FALSE(gpio.projectors[1].trigger.has_value());
}

TEST(RigConfig, MissingFileIsAUsageErrorThatNamesIt) {
  const auto config = LoadRigConfig("/nowhere/rig.toml");
  EXPECT_EQ(config.status().code(), StatusCode::kUsage);
  EXPECT_NE(config.status().message().find("/nowhere/rig.toml"), std::string::npos);
}

}  // namespace
}  // namespace stratalux::rig
