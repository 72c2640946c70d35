// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/selftest_command.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "db/segment/frame_codec.h"
#include "firmware-host/session/learnt_deadlines.h"
#include "firmware-host/session/open_rig.h"
#include "firmware-host/session/store_disk.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

Result<CodecSpeed> MeasureCodec(StoreCodec codec, const RigCheckReport& rig) {
  db::FrameEncoder encoder(codec);
  CodecSpeed speed{codec};
  int frames = 0;
  const auto start = Clock::now();
  while (frames < 8 || SecondsSince(start) < 0.3) {
    const Image<uint16_t>& pixels = rig.samples[frames++ % rig.samples.size()];
    const db::FrameShape shape{rig.format, rig.cfa, pixels.width(), pixels.height(), pixels.channels()};
    SLX_ASSIGN_OR_RETURN(const db::EncodedFrame coded, encoder.Encode(shape, pixels.pixels()));
    speed.bytes_per_frame += static_cast<double>(coded.bytes.size());
  }
  speed.frames_per_s = frames / SecondsSince(start);
  speed.bytes_per_frame /= frames;
  return speed;
}

// The codec whose slower part, coding or writing, is the faster; the smaller one where both keep up with the camera.
StoreCodec Recommend(const std::vector<CodecSpeed>& codecs, double disk_bytes_per_s, double camera_frames_per_s) {
  auto pace = [&](const CodecSpeed& c) {
    return disk_bytes_per_s > 0.0 ? std::min(c.frames_per_s, disk_bytes_per_s / c.bytes_per_frame) : c.frames_per_s;
  };
  const CodecSpeed* best = &codecs.front();
  for (const CodecSpeed& c : codecs) {
    const bool both = pace(c) >= camera_frames_per_s && pace(*best) >= camera_frames_per_s;
    if (both ? c.bytes_per_frame < best->bytes_per_frame : pace(c) > pace(*best)) best = &c;
  }
  return best->codec;
}

std::string Number(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

void CheckDisk(const SelftestOptions& options, SelftestReport& report) {
  auto& items = report.rig.items;
  if (options.store.empty()) {
    items.push_back({"disk", CheckState::kSkipped, "no store given", ""});
    return;
  }
  const size_t frame_bytes = report.rig.samples.empty() ? 2175696 : report.rig.samples[0].size() * 3 / 2;
  const std::filesystem::path folder = ExistingFolder(options.store);
  const Result<double> speed = MeasureDisk(folder, frame_bytes);
  if (!speed.ok()) {
    items.push_back({"disk", CheckState::kFailed, speed.status().message(),
                     "allow the rig's user to write there, or give another --store"});
    return;
  }
  report.disk_bytes_per_s = *speed;
  const double needed = report.rig.frames_per_s * static_cast<double>(frame_bytes);
  const std::string found = Number("%.0f MB/s synced", 1e-6 * *speed) + " in " + folder.string() +
                            Number(", the camera gives up to %.0f MB/s packed", 1e-6 * needed);
  // Half: a queue and the delta codec stand between.
  if (*speed < 0.5 * needed)
    items.push_back(
        {"disk", CheckState::kFailed, found, "use a faster disk for the store: the capture would have to wait for it"});
  else
    items.push_back({"disk", CheckState::kPassed, found, ""});
}

void CheckCodecs(const SelftestOptions& options, SelftestReport& report) {
  auto& items = report.rig.items;
  if (report.rig.samples.empty()) {
    items.push_back({"codec", CheckState::kSkipped, "no frame to encode", ""});
    return;
  }
  std::string found;
  for (const StoreCodec codec : {StoreCodec::kRaw12, StoreCodec::kDelta}) {
    const Result<CodecSpeed> speed = MeasureCodec(codec, report.rig);
    if (!speed.ok()) {
      items.push_back(
          {"codec", CheckState::kFailed, speed.status().message(), "report this: the store cannot encode it"});
      return;
    }
    report.codecs.push_back(*speed);
    found += std::string(ToString(codec)) + Number(" %.0f frames/s, ", speed->frames_per_s) +
             Number("%.0f kB a frame; ", 1e-3 * speed->bytes_per_frame);
  }
  report.recommended = Recommend(report.codecs, report.disk_bytes_per_s, report.rig.frames_per_s);
  found += std::string("recommended: ") + ToString(report.recommended);
  if (report.recommended != options.codec) found += std::string(" (configured: ") + ToString(options.codec) + ")";
  items.push_back({"codec", CheckState::kPassed, found, ""});
}

// What captures go by from now on.
void KeepDeadlines(const SelftestOptions& options, SelftestReport& report) {
  if (!options.keep_delays) return;
  CheckItem item = {"deadlines", CheckState::kSkipped, "none are learnt from a rig that fails", ""};
  if (report.rig.delays) {
    const Result<std::string> kept = options.keep_delays(*report.rig.delays);
    item.found = DeadlinesAsText(DeadlinesFrom(*report.rig.delays, options.rig.deadline)) + "; ";
    item.found += kept.ok() ? "kept in " + *kept : "not kept: " + kept.status().message();
    if (kept.ok()) item.state = CheckState::kPassed;
  }
  report.rig.items.push_back(std::move(item));
}

Json FiguresJson(const DelayFigures& figures) {
  return {{"count", figures.count},
          {"median_ms", figures.median_ms},
          {"worst_ms", figures.worst_ms},
          {"spread_ms", figures.spread_ms}};
}

std::string FiguresAsText(const std::string& name, const DelayFigures& figures) {
  char line[200];
  std::snprintf(line, sizeof line, "%-30s median %.3f ms, worst %.3f ms, spread %.3f ms of %d\n", name.c_str(),
                figures.median_ms, figures.worst_ms, figures.spread_ms, figures.count);
  return line;
}

}  // namespace

bool SelftestReport::passed() const {
  return std::none_of(rig.items.begin(), rig.items.end(),
                      [](const CheckItem& item) { return item.state == CheckState::kFailed; });
}

Result<SelftestReport> RunSelftest(const RigDevices& devices, const SelftestOptions& options) {
  SelftestReport report;
  SLX_ASSIGN_OR_RETURN(report.rig, CheckRig(devices, options.rig));
  KeepDeadlines(options, report);
  CheckDisk(options, report);
  CheckCodecs(options, report);
  return report;
}

std::string Histogram(const std::vector<double>& values_ms) {
  if (values_ms.empty()) return "";
  constexpr int kRows = 10, kWidest = 40;
  const auto [low, high] = std::minmax_element(values_ms.begin(), values_ms.end());
  const double step = std::max((*high - *low) / kRows, 0.001);
  std::array<int, kRows> counts{};
  for (double v : values_ms) ++counts[std::min(kRows - 1, static_cast<int>((v - *low) / step))];
  const int most = *std::max_element(counts.begin(), counts.end());
  std::string text;
  for (int r = 0; r < kRows; ++r) {
    if (counts[r] == 0) continue;
    const std::string bar(static_cast<size_t>(std::max(1, counts[r] * kWidest / most)), '#');
    char line[128];
    std::snprintf(line, sizeof line, "  %8.3f .. %8.3f ms | %-40s %d\n", *low + r * step, *low + (r + 1) * step,
                  bar.c_str(), counts[r]);
    text += line;
  }
  return text;
}

std::string SelftestAsText(const SelftestReport& report) {
  std::string text;
  for (const CheckItem& item : report.rig.items) {
    char line[64];
    std::snprintf(line, sizeof line, "%-30s %-8s ", item.name.c_str(), ToString(item.state));
    text += line + item.found + "\n";
    if (!item.remedy.empty()) text += std::string(31, ' ') + "-> " + item.remedy + "\n";
  }
  if (const auto& delays = report.rig.delays) {
    for (size_t p = 0; p < delays->sync.size(); ++p)
      text += FiguresAsText("TRIGGER to SYNC, projector " + std::to_string(p), delays->sync[p]);
    text += FiguresAsText("exposure to frame", delays->frame);
  }
  if (!report.rig.sync_latency_ms.empty()) text += "TRIGGER to SYNC\n" + Histogram(report.rig.sync_latency_ms);
  if (!report.rig.frame_latency_ms.empty()) text += "TRIGGER to frame\n" + Histogram(report.rig.frame_latency_ms);
  return text + (report.passed() ? "selftest passed\n" : "selftest FAILED\n");
}

std::string SelftestAsJson(const SelftestReport& report) {
  Json items = Json::array(), codecs = Json::array();
  for (const CheckItem& item : report.rig.items) {
    const char* state = item.state == CheckState::kPassed   ? "ok"
                        : item.state == CheckState::kFailed ? "failed"
                                                            : "skipped";
    items.push_back({{"name", item.name}, {"state", state}, {"found", item.found}, {"remedy", item.remedy}});
  }
  for (const CodecSpeed& c : report.codecs)
    codecs.push_back(
        {{"codec", ToString(c.codec)}, {"frames_per_s", c.frames_per_s}, {"bytes_per_frame", c.bytes_per_frame}});
  Json json = {{"passed", report.passed()},
               {"items", items},
               {"sync_latency_ms", report.rig.sync_latency_ms},
               {"frame_latency_ms", report.rig.frame_latency_ms},
               {"frames_asked", report.rig.frames_asked},
               {"frames_lost", report.rig.frames_lost},
               {"frames_doubled", report.rig.frames_doubled},
               {"frames_per_s", report.rig.frames_per_s},
               {"disk_bytes_per_s", report.disk_bytes_per_s},
               {"codecs", codecs}};
  if (const auto& delays = report.rig.delays) {
    Json sync = Json::array();
    for (const DelayFigures& one : delays->sync) sync.push_back(FiguresJson(one));
    json["delays"] = {{"sync", sync}, {"frame", FiguresJson(delays->frame)}};
  }
  if (!report.codecs.empty()) json["recommended_codec"] = ToString(report.recommended);
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

Result<SelftestReport> SelftestOf(const RigConfig& config, std::optional<SimulatedRigOptions> simulated,
                                  StopToken& stop, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(config.plan));
  // Lamps, cables and camera are what is looked at: what happens inside the skin is not worth the minutes.
  if (simulated) simulated->scattering = false;
  if (simulated) logger.Info("selftest of the simulated rig: " + simulated->scene + ", its skin without scattering");
  const Result<OpenedRig> rig = OpenRig(config, simulated, stop, logger);
  if (!rig.ok()) return rig.status();
  SelftestOptions options;
  options.store = config.store.folder;
  options.codec = config.store.codec;
  for (const PlanStep& step : plan.steps)
    if (step.phase == CapturePhase::kPreroll) options.rig.markers.push_back(step.pattern);
  options.rig.exposure_ms = config.plan.exposure_ms;
  options.rig.settle = FromMilliseconds(config.settle_ms);
  // What was learnt before is no measure for what is learnt now.
  options.rig.deadline = config.LongestDeadline();
  options.rig.max_on_time = FromMilliseconds(1e3 * config.max_on_time_s);
  options.rig.wait = rig->wait();
  options.keep_delays = [&](const RigDelays& delays) -> Result<std::string> {
    SLX_RETURN_IF_ERROR(KeepDelays(StateFolder(), config, simulated, delays));
    return DelaysFile(StateFolder(), simulated).string();
  };
  return RunSelftest(rig->devices(), options);
}

}  // namespace stratalux::rig
