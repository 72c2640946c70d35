// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/learnt_deadlines.h"

#include <cmath>
#include <system_error>
#include <utility>

#include <nlohmann/json.hpp>

#include "shared/base/json_number.h"
#include "shared/base/printable.h"
#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int kDeadlinesSchema = 1;
constexpr int kFewest = 30;  // delays that a worst one is taken from

Json TextOf(const std::optional<InputWiring>& line) { return line ? Json(line->at.ToString()) : Json(nullptr); }
Json TextOf(const std::optional<OutputWiring>& line) { return line ? Json(line->at.ToString()) : Json(nullptr); }

const char* ToString(CameraBackend backend) {
  return backend == CameraBackend::kV4l2 ? "v4l2" : backend == CameraBackend::kLibcamera ? "libcamera" : "none";
}

Json SimulatedJson(const RigConfig& config, const SimulatedRigOptions& simulated) {
  std::error_code error;
  const fs::path file = fs::canonical(simulated.scene, error);
  return {{"simulated", error ? simulated.scene : file.string()},
          {"sync_mode", stratalux::ToString(config.plan.sync_mode)},
          {"camera", {{"width", simulated.camera_width}, {"height", simulated.camera_height}}},
          {"projectors", config.plan.projectors},
          {"projector_width", simulated.projector_width},
          {"projector_height", simulated.projector_height}};
}

Json ProjectorJson(const ProjectorWiring& projector, const ProjectorLines& lines) {
  if (projector.kind == ProjectorKind::kDisplay)
    return {{"kind", "display"},
            {"device", projector.display.device},
            {"connector", projector.display.connector},
            {"refresh_hz", projector.display.refresh_hz},
            {"latency_ms", projector.display.latency_ms}};
  return {{"kind", "memory"}, {"trigger", TextOf(lines.trigger)}, {"sync", TextOf(lines.sync)}};
}

Json RigJson(const RigConfig& config, const std::optional<SimulatedRigOptions>& simulated) {
  if (simulated) return SimulatedJson(config, *simulated);
  const CameraWiring& camera = config.camera;
  Json json = {{"simulated", nullptr},
               {"sync_mode", stratalux::ToString(config.plan.sync_mode)},
               {"camera",
                {{"backend", ToString(camera.backend)},
                 {"device", camera.device},
                 {"driver", camera.driver},
                 {"card", camera.card},
                 {"bus", camera.bus},
                 {"format", camera.format},
                 {"width", camera.width},
                 {"height", camera.height},
                 {"frame_rate_hz", camera.frame_rate_hz},
                 {"trigger", TextOf(config.gpio.camera_trigger)}}},
               {"projectors", Json::array()}};
  for (size_t p = 0; p < config.projectors.size(); ++p)
    json["projectors"].push_back(ProjectorJson(config.projectors[p], config.gpio.projectors[p]));
  return json;
}

// Where two rigs differ first: "camera.width".
std::string FirstDifference(const Json& a, const Json& b, const std::string& within = "") {
  if (!a.is_structured() || a.type() != b.type() || a.size() != b.size()) return within.empty() ? "rig" : within;
  for (const auto& [key, value] : a.items()) {
    const std::string name = within + (within.empty() ? "" : ".") + key;
    if (a.is_object() && !b.contains(key)) return name;
    const Json& other = a.is_object() ? b.at(key) : b.at(std::stoul(key));
    if (value != other) return FirstDifference(value, other, name);
  }
  return within;
}

Json JsonOf(const DelayFigures& figures) {
  return {{"count", figures.count},
          {"median_ms", figures.median_ms},
          {"worst_ms", figures.worst_ms},
          {"spread_ms", figures.spread_ms}};
}

DelayFigures FiguresFrom(const Json& json) {
  DelayFigures figures;
  figures.count = WholeAt<int>(json, "count");
  figures.median_ms = json.at("median_ms").get<double>();
  figures.worst_ms = json.at("worst_ms").get<double>();
  figures.spread_ms = json.at("spread_ms").get<double>();
  return figures;
}

RigDelays DelaysFrom(const Json& json) {
  RigDelays delays;
  for (const Json& sync : json.at("sync")) delays.sync.push_back(FiguresFrom(sync));
  delays.frame = FiguresFrom(json.at("frame"));
  delays.transfer_ms = json.at("transfer_ms").get<double>();
  delays.frame_period_ms = json.at("frame_period_ms").get<double>();
  delays.exposure_ms = json.at("exposure_ms").get<double>();
  return delays;
}

bool InRange(double ms) { return ms >= 0.0 && ms <= kLongestDeadlineMs; }

// Whether a deadline can follow from it.
bool Usable(const DelayFigures& figures) {
  return figures.count >= kFewest && InRange(figures.worst_ms) && InRange(figures.spread_ms) &&
         InRange(figures.median_ms) && figures.median_ms <= figures.worst_ms;
}
bool Usable(const RigDelays& delays, int projectors) {
  for (const DelayFigures& sync : delays.sync)
    if (!Usable(sync)) return false;
  return static_cast<int>(delays.sync.size()) == projectors && Usable(delays.frame) && InRange(delays.transfer_ms) &&
         InRange(delays.frame_period_ms) && InRange(delays.exposure_ms);
}

}  // namespace

fs::path DelaysFile(const fs::path& folder, const std::optional<SimulatedRigOptions>& simulated) {
  return folder / (simulated ? "deadlines-simulated.json" : "deadlines.json");
}

Status KeepDelays(const fs::path& folder, const RigConfig& config, const std::optional<SimulatedRigOptions>& simulated,
                  const RigDelays& delays) {
  if (!Usable(delays, config.plan.projectors))
    return Status::Failed("the delays are too few or too long to take deadlines from");
  Json json = {{"schema", kDeadlinesSchema},
               {"rig", RigJson(config, simulated)},
               {"learnt", ToIso8601(WallNow())},
               {"exposure_ms", delays.exposure_ms},
               {"frame_period_ms", delays.frame_period_ms},
               {"transfer_ms", delays.transfer_ms},
               {"frame", JsonOf(delays.frame)},
               {"sync", Json::array()}};
  for (const DelayFigures& sync : delays.sync) json["sync"].push_back(JsonOf(sync));
  return KeepState(DelaysFile(folder, simulated), json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

RigDeadlines ChooseDeadlines(const fs::path& folder, const RigConfig& config,
                             const std::optional<SimulatedRigOptions>& simulated) {
  RigDeadlines deadlines;
  deadlines.longest = config.LongestDeadline();
  if (config.deadline_ms) deadlines.source = DeadlineSource::kConfigured;
  const fs::path file = DelaysFile(folder, simulated);
  RigDelays delays;
  std::string learnt_at, difference;
  const Status read = ReadState(file, kDeadlinesSchema, [&](const std::string& text) {
    const Json json = Json::parse(text);
    const Json rig = RigJson(config, simulated);
    if (json.at("rig") != rig) difference = FirstDifference(rig, json.at("rig"));
    learnt_at = Printable(json.at("learnt").get<std::string>());
    delays = DelaysFrom(json);
  });
  if (read.code() == StatusCode::kNotFound) return deadlines;
  if (!read.ok()) {
    deadlines.refused = read.message();
  } else if (!difference.empty()) {
    deadlines.refused = file.string() + " was learnt from another rig (" + difference + " differs)";
  } else if (!Usable(delays, config.plan.projectors)) {
    deadlines.refused = file.string() + ": no deadline can be derived from its delays";
  } else {
    deadlines.delays = std::move(delays);
    deadlines.learnt_at = std::move(learnt_at);
    if (!config.deadline_ms) {
      deadlines.source = DeadlineSource::kLearnt;
      deadlines.learnt = DeadlinesFrom(*deadlines.delays, deadlines.longest);
    }
  }
  return deadlines;
}

}  // namespace stratalux::rig
