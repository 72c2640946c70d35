// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/calibration/light_watch.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace stratalux::rig {
namespace {

constexpr int kBlocksPerRow = 32;

std::string Text(const char* format, double value) {
  char text[32];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

double Percentile(std::vector<double>& values, double share) {
  const auto at = values.begin() + static_cast<int64_t>(std::lround(share * static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace

LightWatch::LightWatch(const LightWatchOptions& options)
    : options_(options),
      white_(static_cast<size_t>(options.projectors)),
      black_(static_cast<size_t>(options.projectors)) {}

LightWatch::Levels LightWatch::LevelsOf(const Image<uint16_t>& pixels) const {
  Levels levels;
  levels.seen = true;
  // Means of blocks: no noise, no hot pixel and no colour of the mosaic passes for structure.
  const int block = std::max(2, pixels.width() / kBlocksPerRow / 2 * 2);
  std::vector<double> means, singles;
  double saturated = 0.0;
  for (int y = 0; y + block <= pixels.height(); y += block)
    for (int x = 0; x + block <= pixels.width(); x += block) {
      double sum = 0.0;
      for (int j = 0; j < block; ++j)
        for (int i = 0; i < block; ++i) {
          const uint16_t value = pixels(x + i, y + j);
          sum += value;
          saturated += value >= 0.975 * options_.saturation_dn ? 1.0 : 0.0;
          if (((i ^ j) & 3) == 0) singles.push_back(value);
        }
      means.push_back(sum / (block * block));
    }
  if (means.empty()) return levels;
  levels.saturated = saturated / (static_cast<double>(means.size()) * block * block);
  levels.bright = Percentile(singles, 0.99);
  levels.low = Percentile(means, 0.01);
  levels.middle = Percentile(means, 0.5);
  levels.high = Percentile(means, 0.99);
  return levels;
}

void LightWatch::OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) {
  if (record.projector < 0 || record.projector >= options_.projectors || record.bracket != 0 ||
      record.level_check == LevelCheck::kFailed)
    return;
  std::vector<Levels>* const levels = record.pattern.kind == PatternKind::kWhite   ? &white_
                                      : record.pattern.kind == PatternKind::kBlack ? &black_
                                                                                   : nullptr;
  if (levels == nullptr || (*levels)[static_cast<size_t>(record.projector)].seen) return;
  (*levels)[static_cast<size_t>(record.projector)] = LevelsOf(pixels);
}

void LightWatch::JudgeDark(std::vector<CaptureFault>& faults) const {
  for (const Levels& levels : black_) {
    if (!levels.seen) continue;
    const double level = levels.middle / options_.saturation_dn;
    const double structure = (levels.high - levels.low) / options_.saturation_dn;
    if (level <= options_.max_dark && structure <= options_.max_structure) continue;
    faults.push_back({"it is not dark: the middle of the picture's levels is " + Text("%.0f", levels.middle) +
                          " DN, its parts differ by " + Text("%.0f", levels.high - levels.low) + " DN",
                      "cap the lens, close the door, switch off other lamps", false});
    return;
  }
}

void LightWatch::JudgeWhite(int projector, std::vector<CaptureFault>& faults) const {
  const Levels& white = white_[static_cast<size_t>(projector)];
  if (!white.seen) return;
  const Levels& black = black_[static_cast<size_t>(projector)];
  const double floor = black.seen ? black.middle : 0.0, range = options_.saturation_dn - floor;
  const std::string name = "projector " + std::to_string(projector);
  const std::string now = " (now " + Text("%.3g", options_.exposure_ms) + " ms)";
  if (white.saturated > options_.max_saturated) {
    faults.push_back({Text("%.1f", 100.0 * white.saturated) + " % of the white of " + name + " is saturated",
                      "--exposure " + Text("%.3g", 0.6 * options_.exposure_ms) + now, false});
    return;
  }
  const double signal = white.bright - floor;
  if (signal >= options_.least_white * range) return;
  if (signal < 0.01 * range) {
    faults.push_back({name + " lights nothing", "is the target there, the lens cap off, the projector on?", false});
    return;
  }
  faults.push_back(
      {"the white of " + name + " reaches only " + Text("%.0f", 100.0 * signal / range) + " % of the camera's range",
       "--exposure " + Text("%.3g", options_.exposure_ms * options_.wanted_white * range / signal) + now, false});
}

std::vector<CaptureFault> LightWatch::Faults() const {
  std::vector<CaptureFault> faults;
  if (options_.kind == SessionKind::kDark) JudgeDark(faults);
  if (options_.kind == SessionKind::kFlat || options_.kind == SessionKind::kResponse)
    for (int p = 0; p < options_.projectors; ++p) JudgeWhite(p, faults);
  return faults;
}

}  // namespace stratalux::rig
