// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/plan_command.h"

#include <cctype>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <system_error>

#include <nlohmann/json.hpp>

#include "firmware-host/apps/pattern_memory_file.h"
#include "shared/image/png.h"

namespace stratalux::rig {
namespace {

double Seconds(const CapturePlan& plan, const VisitTiming& timing) {
  return 1e-9 * static_cast<double>(VisitTime(plan, timing).count());
}

nlohmann::ordered_json StepJson(const PlanStep& step) {
  return {{"step", step.index},
          {"projector", step.projector},
          {"phase", ToString(step.phase)},
          {"pattern", step.pattern.ToString()},
          {"exposure_ms", step.exposure_ms},
          {"bracket", step.bracket}};
}

nlohmann::ordered_json PlanJson(const CapturePlan& plan, const VisitTiming& timing) {
  nlohmann::ordered_json json = {{"options", nlohmann::ordered_json::parse(PlanOptionsToJson(plan.options))},
                                 {"frames", plan.steps.size()},
                                 {"seconds", Seconds(plan, timing)},
                                 {"steps", nlohmann::ordered_json::array()}};
  for (const PlanStep& step : plan.steps) json["steps"].push_back(StepJson(step));
  return json;
}

double Ms(std::chrono::nanoseconds time) { return 1e-6 * static_cast<double>(time.count()); }

const char* WordOf(DeadlineSource source) {
  switch (source) {
    case DeadlineSource::kDefault:
      return "default";
    case DeadlineSource::kLearnt:
      return "learnt";
    case DeadlineSource::kConfigured:
      return "configured";
    case DeadlineSource::kFlag:
      return "flag";
  }
  return "unknown";
}

nlohmann::ordered_json DeadlinesJson(const RigDeadlines& deadlines) {
  nlohmann::ordered_json json = {{"source", WordOf(deadlines.source)}, {"longest_ms", Ms(deadlines.longest)}};
  if (!deadlines.refused.empty()) json["refused"] = deadlines.refused;
  if (!deadlines.learnt) return json;
  json["learnt_at"] = deadlines.learnt_at;
  json["sync_ms"] = nlohmann::ordered_json::array();
  for (const AnswerLimit& sync : deadlines.learnt->sync) json["sync_ms"].push_back(Ms(sync.deadline));
  json["frame_ms"] = Ms(deadlines.learnt->frame.deadline);
  return json;
}

std::string DeadlinesLine(const RigDeadlines& deadlines) {
  char longest[64];
  std::snprintf(longest, sizeof longest, "deadlines: %g ms for SYNC and for a frame, ", Ms(deadlines.longest));
  switch (deadlines.source) {
    case DeadlineSource::kLearnt:
      return "deadlines: " + DeadlinesAsText(*deadlines.learnt) + ", learnt by selftest " + deadlines.learnt_at + "\n";
    case DeadlineSource::kConfigured:
      return std::string(longest) + "as [capture] deadline_ms says\n";
    case DeadlineSource::kFlag:
      return std::string(longest) + "as --deadline says\n";
    case DeadlineSource::kDefault:
      break;
  }
  return std::string(longest) +
         (deadlines.refused.empty() ? "the default: `stratalux-rig selftest` learns shorter ones"
                                    : "the default: " + deadlines.refused) +
         "\n";
}

// "003-gray-columns-bit-3-10-inverse.png".
std::string FileName(size_t number, const Pattern& pattern) {
  char prefix[16];
  std::snprintf(prefix, sizeof prefix, "%03zu-", number);
  std::string name = prefix;
  for (char c : pattern.ToString()) name += std::isalnum(static_cast<unsigned char>(c)) != 0 ? c : '-';
  return name + ".png";
}

constexpr const char* kBitFile = "patterns-1bit.bin";
constexpr const char* kGreyFile = "patterns-8bit.bin";

Image<uint8_t> Render8(const Pattern& pattern, int width, int height) {
  const Image<float> linear = pattern.Render(width, height);
  Image<uint8_t> image(width, height);
  for (size_t i = 0; i < image.size(); ++i)
    image.data()[i] = static_cast<uint8_t>(std::lround(255.0F * linear.data()[i]));
  return image;
}

}  // namespace

VisitTiming TimingOf(const RigConfig& config, const RigDelays* learnt) {
  const bool triggered = config.plan.sync_mode == SyncMode::kTriggered;
  double sync_ms = kSyncDelayMs, transfer_ms = kTransferMs;
  VisitTiming timing;
  if (learnt != nullptr && !learnt->sync.empty()) {
    sync_ms = 0.0;  // of as many steps each
    for (const DelayFigures& sync : learnt->sync) sync_ms += sync.median_ms / static_cast<double>(learnt->sync.size());
    transfer_ms = triggered ? learnt->frame.median_ms : learnt->transfer_ms;
    timing.frame_period = FromMilliseconds(triggered ? 0.0 : learnt->frame_period_ms);
  }
  timing.settle = FromMilliseconds(config.settle_ms);
  timing.camera = CameraTimingOf(config.camera);
  timing.sync_delay = FromMilliseconds(config.sync_delay_ms.value_or(sync_ms));
  timing.transfer = FromMilliseconds(config.camera.transfer_ms.value_or(transfer_ms));
  if (config.camera.frame_rate_hz > 0.0) timing.frame_period = FromMilliseconds(1e3 / config.camera.frame_rate_hz);
  return timing;
}

VisitTiming TimingOf(const RigConfig& config, const RigTiming& simulated) {
  VisitTiming timing;
  timing.settle = FromMilliseconds(config.settle_ms);
  timing.camera = CameraTimingOf(simulated, CameraTimingOf(config.camera));
  timing.sync_delay = FromMilliseconds(simulated.sync_delay_ms);
  timing.transfer = FromMilliseconds(simulated.shutter_delay_ms + simulated.readout_ms);  // after the planned end
  timing.frame_period = FromMilliseconds(simulated.frame_period_ms);
  return timing;
}

std::string PlanAsText(const CapturePlan& plan, const VisitTiming& timing, const RigDeadlines& deadlines) {
  std::string text = " step  projector  phase           exposure  pattern\n";
  char line[160];
  for (const PlanStep& step : plan.steps) {
    const std::string projector = step.projector < 0 ? "all" : std::to_string(step.projector);
    std::snprintf(line, sizeof line, "%5d  %9s  %-14s %6.1f ms  ", step.index, projector.c_str(), ToString(step.phase),
                  step.exposure_ms);
    text += line + step.pattern.ToString() + "\n";
  }
  const CameraTiming& camera = timing.camera;
  std::snprintf(line, sizeof line, "%zu frames, %.1f s (%.1f ms of settling, %s read-out)\n", plan.steps.size(),
                Seconds(plan, timing), 1e-6 * static_cast<double>(timing.settle.count()),
                camera.read_out == ReadOut::kOverlapped ? "overlapped" : "serial");
  return text + line + DeadlinesLine(deadlines);
}

std::string PlanAsJson(const CapturePlan& plan, const VisitTiming& timing, const RigDeadlines& deadlines) {
  nlohmann::ordered_json json = PlanJson(plan, timing);
  json["deadlines"] = DeadlinesJson(deadlines);
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

Status RenderPlan(const CapturePlan& plan, const VisitTiming& timing, const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  nlohmann::ordered_json json = PlanJson(plan, timing);
  const int width = plan.options.projector_width, height = plan.options.projector_height;
  struct Files {
    std::string png, memory;
    size_t index = 0;  // in `memory`
  };
  std::map<std::string, Files> files;  // by the pattern's text
  std::vector<Pattern> bits, grey;
  for (const PlanStep& step : plan.steps) {
    const auto [entry, fresh] = files.try_emplace(step.pattern.ToString());
    Files& of = entry->second;
    if (fresh) {
      const bool binary = PlanesOf(step.pattern) == 1;
      std::vector<Pattern>& memory = binary ? bits : grey;
      of = {FileName(files.size() - 1, step.pattern), binary ? kBitFile : kGreyFile, memory.size()};
      memory.push_back(step.pattern);
      const Image<uint8_t> image = Render8(step.pattern, width, height);
      SLX_RETURN_IF_ERROR(WritePng8(folder / of.png, image.view()));
    }
    auto& entry_json = json["steps"][step.index];
    entry_json["file"] = of.png;
    entry_json["memory"] = {{"file", of.memory}, {"index", of.index}};
  }
  SLX_RETURN_IF_ERROR(WritePatternMemory(folder / kBitFile, bits, 1, width, height));
  if (!grey.empty()) SLX_RETURN_IF_ERROR(WritePatternMemory(folder / kGreyFile, grey, 8, width, height));
  // What each TRIGGER pulse shows, projector by projector.
  json["sequences"] = nlohmann::ordered_json::array();
  for (int p = 0; p < plan.options.projectors; ++p) {
    nlohmann::ordered_json sequence = nlohmann::ordered_json::array();
    for (const PlanStep& step : plan.steps)
      if (step.projector < 0 || step.projector == p) sequence.push_back(step.index);
    json["sequences"].push_back({{"projector", p}, {"steps", sequence}});
  }
  std::ofstream out(folder / "plan.json");
  out << json.dump(2) << "\n";
  out.close();
  return out ? Status::Ok() : Status::Failed("cannot write " + (folder / "plan.json").string());
}

}  // namespace stratalux::rig
