// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/separate.h"

#include <cmath>
#include <string>
#include <utility>

#include "fitter/export/exr_file.h"
#include "fitter/separation/separate.h"
#include "fitter/session/sinusoid_sets.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/parallel_each.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

SeparationMap NothingTold(const RigCalibration& rig) {
  const int step = QuadStep(rig.camera.cfa);
  const int width = rig.camera.model.width / step, height = rig.camera.model.height / step;
  const Image<float> unknown(width, height, QuadChannels(rig.camera.cfa), std::nanf(""));
  return {unknown, unknown, unknown, unknown,
          Image<uint8_t>(width, height, 1, static_cast<uint8_t>(SeparationReason::kNotTold))};
}

Result<SeparationMap> SeparateProjector(const SessionFrames& frames, int projector, const RigCalibration& rig,
                                        const SensorNoise& noise, Logger& logger) {
  const std::string name = "projector " + std::to_string(projector);
  const db::FrameRow* white_row = frames.FindWhite(projector);
  if (white_row == nullptr || !frames.HasBlack(projector)) {
    logger.Warning(name + ": its white or its black is missing (`stratalux-db show`); nothing is known of its light");
    return NothingTold(rig);
  }
  SLX_ASSIGN_OR_RETURN(const auto white, frames.ReadLinear(*white_row));
  SLX_ASSIGN_OR_RETURN(const auto black, frames.MeanBlack(projector));
  // Of equal steps: an axis that lacks a shift tells nothing, the other one is separated by itself.
  std::vector<const db::FrameRow*> rows;
  for (PatternAxis axis : frames.sinusoids()) {
    const SinusoidSet set = SinusoidSets(frames, projector, -1, axis).front();  // the plan has one
    if (set.IsWhole())
      rows.insert(rows.end(), set.rows.begin(), set.rows.end());
    else if (set.shifts > 0)
      logger.Warning(name + ": direct and global light are separated without the sinusoids along " + AxisName(axis) +
                     ", of which " + std::to_string(set.shifts - std::ssize(set.rows)) + " of " +
                     std::to_string(set.shifts) + " are missing (`stratalux-db show`)");
  }
  SLX_ASSIGN_OR_RETURN(const auto images, frames.ReadAll(rows));
  SeparationFrames input;
  input.white = white;
  input.black = black;
  for (size_t i = 0; i < images.size(); ++i)
    (rows[i]->record.pattern.axis == PatternAxis::kColumns ? input.column_shifts : input.row_shifts)
        .push_back(images[i]);
  SeparationOptions options;
  options.projector_black = rig.projectors[projector].black_level;
  options.sinusoid_amplitude = rig.projectors[projector].SinusoidAmplitude();
  SLX_ASSIGN_OR_RETURN(auto separated, rows.empty() ? WhiteAlone(input, rig.camera.cfa, noise, options)
                                                    : SeparateSinusoids(input, rig.camera.cfa, noise, options));
  return std::move(separated.map);
}

std::vector<std::string> DetailChannels(int channels) {
  std::vector<std::string> names = WithColours("variance.", channels);
  for (const std::string& name : WithColours("white.", channels)) names.push_back(name);
  names.push_back("reason");
  return names;
}

}  // namespace

Result<std::vector<SeparationMap>> SeparateFace(const SessionFrames& frames, Logger& logger) {
  const RigCalibration& rig = *frames.calibration();
  const SensorNoise noise = SensorNoise::From(rig.camera);
  std::vector<SeparationMap> maps;
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) {
    SLX_ASSIGN_OR_RETURN(maps.emplace_back(), SeparateProjector(frames, p, rig, noise, logger));
  }
  return maps;
}

Status SaveSeparation(const std::filesystem::path& folder, const std::vector<SeparationMap>& maps) {
  const auto write = [&](size_t p) -> Status {
    const SeparationMap& map = maps[p];
    const std::string number = std::to_string(p) + ".exr";
    const int channels = map.direct.channels(), all = 2 * channels + 1;
    SLX_RETURN_IF_ERROR(WriteExr(folder / ("direct_" + number), map.direct, Colours(channels)));
    SLX_RETURN_IF_ERROR(WriteExr(folder / ("global_" + number), map.global, Colours(channels)));
    Image<float> detail(map.reason.width(), map.reason.height(), all);
    for (size_t i = 0; i < map.reason.size(); ++i) {
      for (int c = 0; c < channels; ++c) {
        detail.data()[i * all + c] = map.direct_variance.data()[i * channels + c];
        detail.data()[i * all + channels + c] = map.white.data()[i * channels + c];
      }
      detail.data()[i * all + 2 * channels] = map.reason.pixels()[i];
    }
    return WriteExr(folder / ("separation_" + number), detail, DetailChannels(channels));
  };
  SLX_RETURN_IF_ERROR(ParallelTry(maps.size(), write));
  return WriteJson(folder / "separate.json",
                   {{"projectors", maps.size()}, {"channels", maps.empty() ? 0 : maps[0].direct.channels()}});
}

Result<std::vector<SeparationMap>> LoadSeparation(const std::filesystem::path& folder) {
  size_t projectors = 0;
  int channels = 0;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "separate.json", [&](const nlohmann::json& json) {
    json.at("projectors").get_to(projectors);
    json.at("channels").get_to(channels);
  }));
  std::vector<SeparationMap> maps(projectors);
  SLX_RETURN_IF_ERROR(ParallelTry(projectors, [&](size_t p) -> Status {
    SeparationMap& map = maps[p];
    const std::string number = std::to_string(p) + ".exr";
    SLX_ASSIGN_OR_RETURN(map.direct, ReadExr(folder / ("direct_" + number), Colours(channels)));
    SLX_ASSIGN_OR_RETURN(map.global, ReadExr(folder / ("global_" + number), Colours(channels)));
    SLX_ASSIGN_OR_RETURN(const auto detail, ReadExr(folder / ("separation_" + number), DetailChannels(channels)));
    if (map.direct.width() != detail.width() || map.direct.height() != detail.height())
      return Status::Integrity(folder.string() + ": its maps differ in size");
    const int all = detail.channels();
    map.direct_variance = map.white = map.direct;
    map.reason = Image<uint8_t>(detail.width(), detail.height());
    for (size_t i = 0; i < map.reason.size(); ++i) {
      for (int c = 0; c < channels; ++c) {
        map.direct_variance.data()[i * channels + c] = detail.data()[i * all + c];
        map.white.data()[i * channels + c] = detail.data()[i * all + channels + c];
      }
      map.reason.pixels()[i] = static_cast<uint8_t>(detail.data()[i * all + 2 * channels]);
    }
    return Status::Ok();
  }));
  return maps;
}

}  // namespace stratalux::fit
