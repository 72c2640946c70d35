// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/last_lights.h"

#include <string>
#include <utility>

#include <nlohmann/json.hpp>

#include "firmware-host/gpio/gpio_lights.h"
#include "firmware-host/projector/kms_display.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kFile = "lights.json";
constexpr int kLightsSchema = 1;

Json JsonOf(const RigLights& lights) {
  Json enables = Json::array(), displays = Json::array();
  for (const OutputWiring& line : lights.enables)
    enables.push_back({{"name", line.at.name},
                       {"chip", line.at.chip},
                       {"offset", line.at.offset},
                       {"active", line.active == ActiveLevel::kLow ? "low" : "high"}});
  for (const DisplayWiring& display : lights.displays)
    displays.push_back({{"device", display.device}, {"connector", display.connector}});
  return {{"schema", kLightsSchema}, {"enables", std::move(enables)}, {"displays", std::move(displays)}};
}

RigLights LightsFrom(const Json& json) {
  RigLights lights;
  for (const Json& line : json.at("enables")) {
    OutputWiring& enable = lights.enables.emplace_back();
    enable.at = {line.at("name").get<std::string>(), line.at("chip").get<std::string>(), line.at("offset").get<int>()};
    enable.active = line.at("active").get<std::string>() == "low" ? ActiveLevel::kLow : ActiveLevel::kHigh;
  }
  for (const Json& one : json.at("displays")) {
    DisplayWiring& display = lights.displays.emplace_back();
    display.device = one.at("device").get<std::string>();
    display.connector = one.at("connector").get<std::string>();
  }
  return lights;
}

}  // namespace

RigLights LightsOf(const RigConfig& config) {
  RigLights lights;
  for (const ProjectorLines& projector : config.gpio.projectors)
    if (projector.enable) lights.enables.push_back(*projector.enable);
  for (const ProjectorWiring& projector : config.projectors) {
    if (projector.kind != ProjectorKind::kDisplay) continue;
    DisplayWiring& display = lights.displays.emplace_back();
    display.device = projector.display.device;
    display.connector = projector.display.connector;
  }
  return lights;
}

Status KeepLights(const fs::path& folder, const RigLights& lights) {
  return KeepState(folder / kFile, JsonOf(lights).dump(2) + "\n");
}

Result<RigLights> ReadLights(const fs::path& folder) {
  RigLights lights;
  SLX_RETURN_IF_ERROR(ReadState(folder / kFile, kLightsSchema,
                                [&](const std::string& json) { lights = LightsFrom(Json::parse(json)); }));
  return lights;
}

Status TakeLights(const RigLights& lights) {
  Status first;
  const auto note = [&first](const Status& status) {
    if (first.ok()) first = status;
  };
  if (!lights.enables.empty()) note(DriveEnablesOff(lights.enables));
  for (const DisplayWiring& display : lights.displays) note(BlankDisplay(display));
  if (lights.enables.empty() && lights.displays.empty())
    return Status::Usage("the configuration wires no light ([[projector]] enable or a display)");
  return first;
}

}  // namespace stratalux::rig
