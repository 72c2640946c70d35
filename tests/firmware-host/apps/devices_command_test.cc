// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/devices_command.h"

#include <cerrno>
#include <fstream>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

V4l2Camera Camera() {
  V4l2Camera camera;
  camera.node = {"/dev/video0", "uvcvideo", "Mono camera", "usb-1"};
  camera.formats = {{1, "Y12", "12-bit grey", {{1392, 1042, 1392, 1042, 1, 1, {33.3, 40.0}, false}}},
                    {2, "YUYV", "YUYV 4:2:2", {}}};
  for (int i = 1; i < 20; ++i) camera.formats[0].sizes.push_back({64 * i, 48 * i, 64 * i, 48 * i, 1, 1, {40.0}, false});
  camera.controls = {{"exposure_control", "exposure_absolute", "Exposure Time", 1, 5000, 1, 100, 160}};
  return camera;
}

DeviceList SmallMachine() {
  DeviceList list;
  list.v4l2 = {Camera()};
  GpioChip chip{"/dev/gpiochip4", "pinctrl-rp1", std::vector<GpioLine>(4)};
  chip.lines[0] = {"GPIO17", LineDirection::kInput, false, ""};
  chip.lines[1] = {"GPIO27", LineDirection::kOutput, true, "spi0 CS0"};
  chip.lines[2].name = chip.lines[3].name = "TWICE";
  list.chips = {chip};
  list.cards = {{"/dev/dri/card1", "vc4", true, true, "Xorg (812)", {{"HDMI-A-1", true, {{1024, 768, 60.0}}}}}};
  return list;
}

RigConfig Config() {
  RigConfig config;
  config.camera.backend = CameraBackend::kV4l2;
  config.camera.driver = "uvcvideo";
  config.gpio.projectors.resize(1);
  config.gpio.projectors[0].enable = OutputWiring{{"GPIO17", "", -1}, ActiveLevel::kHigh};
  config.gpio.projectors[0].trigger = OutputWiring{{"GPIO27", "", -1}, ActiveLevel::kHigh};
  config.gpio.camera_trigger = OutputWiring{{"GPIO99", "", -1}, ActiveLevel::kHigh};
  config.projectors.resize(1);
  config.projectors[0].kind = ProjectorKind::kDisplay;
  config.projectors[0].display.connector = "HDMI-A-1";
  config.projectors[0].display.width = 1024;
  config.projectors[0].display.height = 768;
  return config;
}

const WiredDevice& Wired(const DeviceList& list, const std::string& key) {
  for (const WiredDevice& wired : list.wired)
    if (wired.key == key) return wired;
  ADD_FAILURE() << "nothing is wired as " << key;
  static const WiredDevice nothing;
  return nothing;
}

TEST(DevicesCommand, WhatTheConfigurationNamesIsHeldAgainstTheMachine) {
  DeviceList list = SmallMachine();
  AddWired(Config(), "rig.toml", list);
  EXPECT_TRUE(Wired(list, "[camera]").usable.ok()) << Wired(list, "[camera]").usable.message();
  EXPECT_EQ(Wired(list, "[camera]").device, "/dev/video0");
  EXPECT_EQ(Wired(list, "[[projector]] 0 enable").device, "/dev/gpiochip4:0");
  EXPECT_TRUE(Wired(list, "[[projector]] 0 enable").usable.ok());
  EXPECT_EQ(Wired(list, "[[projector]] 0 trigger").usable.code(), StatusCode::kBusy);
  EXPECT_THAT(Wired(list, "[[projector]] 0 trigger").usable.message(), HasSubstr("spi0 CS0"));
  EXPECT_EQ(Wired(list, "[gpio] camera_trigger").device, "");
  EXPECT_EQ(Wired(list, "[gpio] camera_trigger").usable.code(), StatusCode::kNotFound);
  EXPECT_THAT(Wired(list, "[[projector]] 0 display").usable.message(), HasSubstr("Xorg (812)"));
}

TEST(DevicesCommand, TheMachinesOwnBrokenConfigurationIsSaidAndEndsNothing) {
  const ScratchFolder scratch;
  const std::string file = (scratch / "broken-rig.toml").string();
  std::ofstream(file) << "[camera]\nwidht = 3\n";
  const auto asked = DevicesBeside(file, ConfigurationFrom::kAsked);
  EXPECT_EQ(asked.status().code(), StatusCode::kUsage);
  const auto list = DevicesBeside(file, ConfigurationFrom::kInstalled);
  ASSERT_TRUE(list.ok()) << list.status().message();
  EXPECT_THAT(DevicesAsText(*list), HasSubstr("Not compared with " + file));
  EXPECT_THAT(DevicesAsText(*list), HasSubstr("unknown key 'camera.widht'"));
  const auto json = nlohmann::json::parse(DevicesAsJson(*list));
  EXPECT_THAT(json["configuration_unreadable"].get<std::string>(), HasSubstr("widht"));
  EXPECT_TRUE(json["wired"].empty());
}

TEST(DevicesCommand, AModeThatTheDisplayLacksIsNoReasonToEndAProgram) {
  DeviceList list = SmallMachine();
  list.cards[0].mastered = false;
  RigConfig config = Config();
  AddWired(config, "rig.toml", list);
  EXPECT_TRUE(Wired(list, "[[projector]] 0 display").usable.ok());
  config.projectors[0].display.width = 1025;
  AddWired(config, "rig.toml", list);
  EXPECT_EQ(Wired(list, "[[projector]] 0 display").usable.code(), StatusCode::kUsage);
  list.cards[0].connectors[0].connected = false;
  AddWired(config, "rig.toml", list);
  EXPECT_EQ(Wired(list, "[[projector]] 0 display").usable.code(), StatusCode::kNotFound);
}

TEST(DevicesCommand, TwoCamerasThatFitAreNotUsable) {
  DeviceList list = SmallMachine();
  list.v4l2.push_back(Camera());
  list.v4l2[1].node.path = "/dev/video2";
  AddWired(Config(), "rig.toml", list);
  EXPECT_THAT(Wired(list, "[camera]").usable.message(), HasSubstr("/dev/video0 and /dev/video2 both match"));
}

TEST(DevicesCommand, ADeviceThatMayNotBeOpenedComesWithReasonAndRemedy) {
  DeviceList list;
  list.refused = {Refusal("/dev/null", EACCES)};
  EXPECT_THAT(list.refused[0].remedy, HasSubstr("udev rule"));
  EXPECT_THAT(list.refused[0].remedy, HasSubstr("group root"));
  RigConfig config;
  config.camera.backend = CameraBackend::kV4l2;
  config.camera.device = "/dev/null";
  AddWired(config, "rig.toml", list);
  EXPECT_THAT(Wired(list, "[camera]").usable.message(), HasSubstr("Permission denied"));
  EXPECT_THAT(DevicesAsText(list), HasSubstr("Permission denied"));
  EXPECT_EQ(nlohmann::json::parse(DevicesAsJson(list))["refused"][0]["path"], "/dev/null");
}

TEST(DevicesCommand, ALineIsNamedSoThatItIsFoundAlone) {
  const DeviceList list = SmallMachine();
  EXPECT_EQ(LineInToml(list.chips, list.chips[0], 0), "{ line = \"GPIO17\" }");
  EXPECT_EQ(LineInToml(list.chips, list.chips[0], 2), "{ chip = \"pinctrl-rp1\", offset = 2 }");
}

TEST(DevicesCommand, TablesKeepToAHundredColumns) {
  DeviceList list = SmallMachine();
  AddWired(Config(), "rig.toml", list);
  list.refused = {Refusal("/dev/video7", EACCES)};
  const std::string text = DevicesAsText(list);
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 100U) << line;
  for (const char* part : {"1392x1042 33.3..40 ms", "not raw: YUYV", "used by spi0 CS0", "exposure_control = ",
                           "its screens are held by Xorg (812)", "1024x768@60", "Named in rig.toml but not here"})
    EXPECT_THAT(text, HasSubstr(part));
}

TEST(DevicesCommand, AnEmptyMachineSaysWhatToCheck) {
  const std::string text = DevicesAsText({});
  EXPECT_THAT(text, HasSubstr("check cable and power"));
  EXPECT_THAT(text, HasSubstr("ribbon cable"));
  EXPECT_THAT(text, HasSubstr("the chip's driver is loaded"));
  EXPECT_THAT(text, HasSubstr("ls /dev/dri"));
}

TEST(DevicesCommand, NamesFromDevicesDoNotSteerTheTerminal) {
  DeviceList list = SmallMachine();
  list.v4l2[0].node.card = "\x1b[2J";
  EXPECT_THAT(DevicesAsText(list), Not(HasSubstr("\x1b")));
}

TEST(DevicesCommand, JsonHoldsEveryLineAndWhatIsWired) {
  DeviceList list = SmallMachine();
  AddWired(Config(), "rig.toml", list);
  const auto json = nlohmann::json::parse(DevicesAsJson(list));
  EXPECT_EQ(json["v4l2"][0]["formats"][0]["bits"], 12);
  EXPECT_FALSE(json["v4l2"][0]["formats"][1]["raw"]);
  EXPECT_EQ(json["v4l2"][0]["formats"][0]["sizes"].size(), 20U);
  EXPECT_EQ(json["v4l2"][0]["controls"][0]["maximum"], 5000);
  EXPECT_EQ(json["chips"][0]["lines"].size(), 4U);
  EXPECT_EQ(json["chips"][0]["lines"][1]["consumer"], "spi0 CS0");
  EXPECT_EQ(json["cards"][0]["connectors"][0]["modes"][0]["height"], 768);
  EXPECT_EQ(json["wired"].size(), 5U);
  EXPECT_EQ(json["wired"][0]["device"], json["v4l2"][0]["path"]);
}

TEST(KmsMaster, IsReadFromTheKernelsListOfClients) {
  const std::string head = "             command   tgid dev master a   uid      magic\n";
  EXPECT_EQ(MasterAmongClients(head + "  systemd-logind   501   0   n    y     0          0\n"
                                      "  cage with blank  812   0   y    y  1000          1\n"),
            "cage with blank (812)");
  EXPECT_EQ(MasterAmongClients(head + "  Xorg   812   0   n    y     0          0\n"), "");
  EXPECT_EQ(MasterAmongClients(""), "");
}

}  // namespace
}  // namespace stratalux::rig
