// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/last_lights.h"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <string>
#include <utility>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "firmware-host/gpio/gpio_lights.h"
#include "firmware-host/projector/kms_display.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kFile = "lights.json";
constexpr int kSchema = 1;
constexpr size_t kMostBytes = 64 * 1024;

Json JsonOf(const RigLights& lights) {
  Json enables = Json::array(), displays = Json::array();
  for (const OutputWiring& line : lights.enables)
    enables.push_back({{"name", line.at.name},
                       {"chip", line.at.chip},
                       {"offset", line.at.offset},
                       {"active", line.active == ActiveLevel::kLow ? "low" : "high"}});
  for (const DisplayWiring& display : lights.displays)
    displays.push_back({{"device", display.device}, {"connector", display.connector}});
  return {{"schema", kSchema}, {"enables", std::move(enables)}, {"displays", std::move(displays)}};
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

// The bytes of a file that nobody else could have written.
Result<std::string> ReadOwn(const fs::path& file) {
  const UniqueFd fd(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
  if (!fd.ok()) {
    const std::string why = file.string() + ": " + std::strerror(errno);
    return errno == ENOENT ? Status::NotFound(why) : Status::Failed(why);
  }
  struct stat info {};
  if (fstat(fd.get(), &info) != 0) return Status::Failed(file.string() + ": " + std::strerror(errno));
  if (!S_ISREG(info.st_mode)) return Status::Failed(file.string() + " is no plain file; remove it");
  if (info.st_uid != geteuid() && info.st_uid != 0)
    return Status::Failed(file.string() + " belongs to account " + std::to_string(info.st_uid) + ", this is " +
                          std::to_string(geteuid()) + "; run `stratalux-rig safe` as the service's account");
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0)
    return Status::Failed(file.string() +
                          " may be written by others than its owner; chmod 600 it once its lines are "
                          "known to be right, or remove it");
  std::string text(kMostBytes, '\0');
  const ssize_t bytes = read(fd.get(), text.data(), text.size());
  if (bytes < 0) return Status::Failed(file.string() + ": " + std::strerror(errno));
  text.resize(static_cast<size_t>(bytes));
  return text;
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

fs::path StateFolder() {
  const char* folder = std::getenv("STATE_DIRECTORY");
  const std::string all = folder != nullptr && *folder != '\0' ? folder : "/var/lib/stratalux";
  return all.substr(0, all.find(':'));
}

Status KeepLights(const fs::path& folder, const RigLights& lights) {
  const mode_t before = umask(0077);
  const Status kept = db::ReplaceFile(folder / kFile, JsonOf(lights).dump(2) + "\n");
  umask(before);
  return kept;
}

Result<RigLights> ReadLights(const fs::path& folder) {
  const fs::path file = folder / kFile;
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadOwn(file));
  try {
    const Json json = Json::parse(text);
    if (json.at("schema").get<int>() != kSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + json.at("schema").dump() +
                                                  ", this program knows " + std::to_string(kSchema));
    return LightsFrom(json);
  } catch (const Json::exception& error) {
    return Status::Failed(file.string() + " is not what `stratalux-rig` writes: " + error.what());
  }
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
