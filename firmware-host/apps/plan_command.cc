// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/plan_command.h"

#include <cctype>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <optional>
#include <system_error>

#include <nlohmann/json.hpp>

#include "firmware-host/apps/pattern_memory_file.h"
#include "shared/image/png.h"
#include "shared/units/time.h"

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

nlohmann::ordered_json MemoryJson(const MemoryLayout& layout) {
  nlohmann::ordered_json json = {{"capacity", nullptr},
                                 {"projectors", nlohmann::ordered_json::array()},
                                 {"left_out", nlohmann::ordered_json::array()}};
  if (layout.capacity > 0) json["capacity"] = layout.capacity;
  for (size_t p = 0; p < layout.projectors.size(); ++p) {
    const ProjectorMemory& memory = layout.projectors[p];
    nlohmann::ordered_json sections = nlohmann::ordered_json::array();
    for (const SectionPlace& place : memory.sections)
      sections.push_back({{"section", ToString(place.section)}, {"first", place.first}, {"count", place.count}});
    json["projectors"].push_back({{"projector", p}, {"patterns", memory.patterns.size()}, {"sections", sections}});
  }
  for (const MemoryLayout::LeftOut& out : layout.left_out)
    json["left_out"].push_back({{"section", ToString(out.section)}, {"why", out.why}});
  return json;
}

std::string MemoryText(const MemoryLayout& layout) {
  std::string text = "pattern memories\n projector  section      first  count\n";
  char line[160];
  for (size_t p = 0; p < layout.projectors.size(); ++p) {
    const ProjectorMemory& memory = layout.projectors[p];
    for (const SectionPlace& place : memory.sections) {
      std::snprintf(line, sizeof line, "%10zu  %-11s  %5d  %5d\n", p, ToString(place.section), place.first,
                    place.count);
      text += line;
    }
    const std::string capacity =
        layout.capacity > 0 ? " of " + std::to_string(layout.capacity) : "; no [memory] capacity set";
    std::snprintf(line, sizeof line, "%10zu  total               %5zu%s\n", p, memory.patterns.size(),
                  capacity.c_str());
    text += line;
  }
  for (const MemoryLayout::LeftOut& out : layout.left_out)
    text += std::string("not held: ") + ToString(out.section) + ": " + out.why + "\n";
  return text;
}

nlohmann::ordered_json PlanJson(const CapturePlan& plan, const VisitTiming& timing, const MemoryLayout& layout) {
  nlohmann::ordered_json json = {{"options", nlohmann::ordered_json::parse(PlanOptionsToJson(plan.options))},
                                 {"frames", plan.steps.size()},
                                 {"seconds", Seconds(plan, timing)},
                                 {"memory", MemoryJson(layout)},
                                 {"steps", nlohmann::ordered_json::array()}};
  for (const PlanStep& step : plan.steps) json["steps"].push_back(StepJson(step));
  return json;
}

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
  nlohmann::ordered_json json = {{"source", WordOf(deadlines.source)},
                                 {"longest_ms", ToMilliseconds(deadlines.longest)}};
  if (!deadlines.refused.empty()) json["refused"] = deadlines.refused;
  if (!deadlines.learnt) return json;
  json["learnt_at"] = deadlines.learnt_at;
  json["sync_ms"] = nlohmann::ordered_json::array();
  for (const AnswerLimit& sync : deadlines.learnt->sync) json["sync_ms"].push_back(ToMilliseconds(sync.deadline));
  json["frame_ms"] = ToMilliseconds(deadlines.learnt->frame.deadline);
  return json;
}

std::string DeadlinesLine(const RigDeadlines& deadlines) {
  char longest[64];
  std::snprintf(longest, sizeof longest, "deadlines: %g ms for SYNC and for a frame, ",
                ToMilliseconds(deadlines.longest));
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

// Of a plan that the memories do not hold none: its capture is refused.
std::chrono::nanoseconds LoadingTimeOf(const RigConfig& config,
                                       const std::vector<std::optional<MemoryTiming>>& timings) {
  const Result<CapturePlan> plan = BuildPlan(config.plan);
  const Result<MemoryLayout> layout = LayOutMemories(config.plan, config.memory);
  return plan.ok() && layout.ok() ? LoadingTime(*plan, *layout, timings) : std::chrono::nanoseconds(0);
}

// The distinct patterns of a rig, as files.
class PatternFiles {
 public:
  explicit PatternFiles(const PlanOptions& plan) : width_(plan.projector_width), height_(plan.projector_height) {}

  // Its number among the distinct ones; writes the PNG of a new one.
  Result<size_t> Add(const Pattern& pattern, const std::filesystem::path& folder) {
    const auto [entry, fresh] = numbers_.try_emplace(pattern.ToString(), numbers_.size());
    if (!fresh) return entry->second;
    const bool binary = PlanesOf(pattern) == 1;
    std::vector<Pattern>& memory = binary ? bits_ : grey_;
    const std::string png = FileName(entry->second, pattern);
    json_.push_back({{"pattern", pattern.ToString()},
                     {"file", png},
                     {"memory", {{"file", binary ? kBitFile : kGreyFile}, {"index", memory.size()}}}});
    memory.push_back(pattern);
    SLX_RETURN_IF_ERROR(WritePng8(folder / png, Render8(pattern, width_, height_).view()));
    return entry->second;
  }
  [[nodiscard]] const nlohmann::ordered_json& json() const { return json_; }
  Status WriteMemories(const std::filesystem::path& folder) const {
    SLX_RETURN_IF_ERROR(WritePatternMemory(folder / kBitFile, bits_, 1, width_, height_));
    return grey_.empty() ? Status::Ok() : WritePatternMemory(folder / kGreyFile, grey_, 8, width_, height_);
  }

 private:
  int width_, height_;
  std::map<std::string, size_t> numbers_;  // by the pattern's text
  std::vector<Pattern> bits_, grey_;
  nlohmann::ordered_json json_ = nlohmann::ordered_json::array();
};

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
  std::vector<std::optional<MemoryTiming>> memories = MemoryTimingsOf(config);
  if (learnt != nullptr && !config.sync_delay_ms)
    for (size_t p = 0; p < std::min(memories.size(), learnt->sync.size()); ++p)
      if (memories[p]) memories[p]->step = FromMilliseconds(learnt->sync[p].median_ms);
  timing.loading = LoadingTimeOf(config, memories);
  return timing;
}

VisitTiming TimingOf(const RigConfig& config, const RigTiming& simulated) {
  VisitTiming timing;
  timing.settle = FromMilliseconds(config.settle_ms);
  timing.camera = CameraTimingOf(simulated, CameraTimingOf(config.camera));
  timing.sync_delay = FromMilliseconds(simulated.sync_delay_ms);
  timing.transfer = FromMilliseconds(simulated.shutter_delay_ms + simulated.readout_ms);  // after the planned end
  timing.frame_period = FromMilliseconds(simulated.frame_period_ms);
  const std::vector<std::optional<MemoryTiming>> memories(config.plan.projectors, MemoryTimingOf(simulated));
  timing.loading = LoadingTimeOf(config, memories);
  return timing;
}

std::string PlanAsText(const CapturePlan& plan, const VisitTiming& timing, const MemoryLayout& layout,
                       const RigDeadlines& deadlines) {
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
  return text + line + DeadlinesLine(deadlines) + MemoryText(layout);
}

std::string PlanAsJson(const CapturePlan& plan, const VisitTiming& timing, const MemoryLayout& layout,
                       const RigDeadlines& deadlines) {
  nlohmann::ordered_json json = PlanJson(plan, timing, layout);
  json["deadlines"] = DeadlinesJson(deadlines);
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

Status RenderPlan(const CapturePlan& plan, const VisitTiming& timing, const MemoryLayout& layout,
                  const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  nlohmann::ordered_json json = PlanJson(plan, timing, layout);
  PatternFiles files(plan.options);
  for (const PlanStep& step : plan.steps) {
    SLX_ASSIGN_OR_RETURN(const size_t number, files.Add(step.pattern, folder));
    auto& entry = json["steps"][static_cast<size_t>(step.index)];
    for (const char* key : {"file", "memory"}) entry[key] = files.json()[number][key];
  }
  for (size_t p = 0; p < layout.projectors.size(); ++p) {
    nlohmann::ordered_json sequence = nlohmann::ordered_json::array();
    for (const Pattern& pattern : layout.projectors[p].patterns) {
      SLX_ASSIGN_OR_RETURN(const size_t number, files.Add(pattern, folder));
      sequence.push_back(number);
    }
    json["memory"]["projectors"][p]["sequence"] = sequence;
  }
  json["patterns"] = files.json();
  SLX_RETURN_IF_ERROR(files.WriteMemories(folder));
  std::ofstream out(folder / "plan.json");
  out << json.dump(2) << "\n";
  out.close();
  return out ? Status::Ok() : Status::Failed("cannot write " + (folder / "plan.json").string());
}

}  // namespace stratalux::rig
