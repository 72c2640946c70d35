// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/shape.h"

#include <algorithm>
#include <cmath>

#include "fitter/export/exr_file.h"
#include "fitter/export/ply_file.h"
#include "fitter/reconstruction/mesh.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "fitter/sensor/linear_frame.h"
#include "fitter/stages/lit_quads.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/read_file.h"

namespace stratalux::fit {
namespace {

constexpr const char* kSmoothingFile = "smoothing.exr";

std::vector<std::string> MaskChannels(size_t projectors) {
  std::vector<std::string> names = {"surface"};
  for (const char* of : {"lit", "codes"})
    for (size_t p = 0; p < projectors; ++p) names.push_back(of + std::to_string(p));
  return names;
}

nlohmann::ordered_json JsonOf(const FaceShape& shape) {
  const TriangulationCounts& t = shape.triangulation;
  nlohmann::ordered_json drift = {{"warning", shape.drift.warning}, {"projectors", nlohmann::json::array()}};
  for (const ProjectorDrift& d : shape.drift.projectors)
    drift["projectors"].push_back({d.projector, d.points, d.shift_columns, d.shift_rows, d.shift_px, d.turned_deg,
                                   d.spread_px, d.expected_px, d.moved});
  return {{"projectors", shape.lit.size()},
          {"triangulation",
           {{"sites", t.sites},
            {"undecoded", t.undecoded},
            {"inconsistent", t.inconsistent},
            {"uncertain", t.uncertain},
            {"rejected_views", t.rejected_views},
            {"lone_quads", t.lone},
            {"mixed_quads", t.mixed},
            {"island_quads", t.islands},
            {"unsmoothed_quads", shape.unsmoothed}}},
          {"drift", drift}};
}

void FromJson(const nlohmann::json& json, FaceShape& shape) {
  TriangulationCounts& t = shape.triangulation;
  const auto& counts = json.at("triangulation");
  counts.at("sites").get_to(t.sites);
  counts.at("undecoded").get_to(t.undecoded);
  counts.at("inconsistent").get_to(t.inconsistent);
  counts.at("uncertain").get_to(t.uncertain);
  counts.at("rejected_views").get_to(t.rejected_views);
  counts.at("lone_quads").get_to(t.lone);
  counts.at("mixed_quads").get_to(t.mixed);
  counts.at("island_quads").get_to(t.islands);
  counts.at("unsmoothed_quads").get_to(shape.unsmoothed);
  json.at("drift").at("warning").get_to(shape.drift.warning);
  for (const auto& d : json.at("drift").at("projectors"))
    shape.drift.projectors.push_back({d.at(0), d.at(1), d.at(2), d.at(3), d.at(4), d.at(5), d.at(6), d.at(7), d.at(8)});
  shape.lit.resize(json.at("projectors").get<size_t>());
  shape.code_weights.resize(shape.lit.size());
}

}  // namespace

Result<FaceShape> ReconstructShape(std::span<const DecodedMap> decoded, std::span<const SeparationMap> separation,
                                   const RigCalibration& rig, const RigCalibration& record) {
  FaceShape shape;
  shape.record = record;
  SLX_ASSIGN_OR_RETURN(auto rough, Triangulate(decoded, rig));
  shape.triangulation = rough.counts;
  shape.code_weights = std::move(rough.weights);
  shape.disagreement_mm = std::move(rough.disagreement_mm);
  SLX_ASSIGN_OR_RETURN(shape.surface, SmoothSurface(rough.surface, rough.noise_sigma_mm, rig, {}, &shape.unsmoothed));
  const auto known = std::ranges::count(shape.surface.mask.pixels(), 1);
  if (known == 0) return Status::Failed("no surface was found: " + WhyNoSurface(shape.triangulation, shape.unsmoothed));
  for (size_t i = 0; i < shape.surface.mask.size(); ++i)
    if (shape.surface.mask.pixels()[i] == 0) shape.disagreement_mm.pixels()[i] = std::nanf("");
  SLX_ASSIGN_OR_RETURN(shape.lit, LitQuads(decoded, separation, shape.surface, rig));
  SLX_ASSIGN_OR_RETURN(shape.drift, CheckDrift(decoded, shape.surface, rig));
  return shape;
}

Result<FaceShape> ReconstructMovingShape(const SessionFrames& frames, std::span<const DecodedMap> decoded,
                                         std::span<const SeparationMap> separation, const RigCalibration& record,
                                         bool find_motion) {
  const RigCalibration rig = LinearRig(record);
  SLX_ASSIGN_OR_RETURN(FaceShape as_if_still, ReconstructShape(decoded, separation, rig, record));
  if (!find_motion) return as_if_still;
  SLX_ASSIGN_OR_RETURN(FaceMotion motion, FindMotion(frames, decoded, as_if_still.surface, as_if_still.lit));
  if (!motion.moved()) {
    as_if_still.motion = std::move(motion);
    return as_if_still;
  }
  const auto codes = AtReference(decoded, as_if_still.surface, rig, motion);
  const auto lights = AtReference(separation, as_if_still.surface, rig, motion);
  auto shape = ReconstructShape(codes, lights, RigAt(rig, motion, &ProjectorMoments::codes_s), record);
  if (shape.ok()) shape->motion = std::move(motion);
  return shape;
}

LightsOnShape LightsOn(const FaceShape& shape, std::span<const SeparationMap> separation) {
  LightsOnShape lights{{}, LinearRig(shape.record)};
  if (!shape.motion.moved()) return lights;
  lights.carried = AtReference(separation, shape.surface, lights.rig, shape.motion);
  lights.rig = RigAt(lights.rig, shape.motion, &ProjectorMoments::separation_s);
  return lights;
}

Status SaveShape(const std::filesystem::path& folder, const FaceShape& shape) {
  const SurfaceMap& surface = shape.surface;
  SLX_RETURN_IF_ERROR(WriteExr(folder / "position.exr", surface.point_mm, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "depth_sigma.exr", surface.depth_sigma_mm, {"Y"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "disagreement.exr", shape.disagreement_mm, {"Y"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "normal_surface.exr", surface.normal, {"X", "Y", "Z"}));
  if (!surface.smoothing_quads.empty()) {
    SLX_RETURN_IF_ERROR(WriteExr(folder / kSmoothingFile, surface.smoothing_quads, {"Y"}));
  }
  const size_t projectors = shape.lit.size(), channels = 1 + 2 * projectors;
  Image<float> masks(surface.width(), surface.height(), static_cast<int>(channels));
  for (size_t i = 0; i < surface.mask.size(); ++i) {
    float* quad = masks.data() + i * channels;
    quad[0] = surface.mask.pixels()[i];
    for (size_t p = 0; p < projectors; ++p) {
      quad[1 + p] = shape.lit[p].pixels()[i];
      quad[1 + projectors + p] = shape.code_weights[p].pixels()[i];
    }
  }
  SLX_RETURN_IF_ERROR(WriteExr(folder / "masks.exr", masks, MaskChannels(projectors)));
  SLX_RETURN_IF_ERROR(WritePly(folder / "mesh.ply", MeshFromSurface(surface)));
  SLX_RETURN_IF_ERROR(WriteText(folder / "rig.json", shape.record.ToJson()));
  SLX_RETURN_IF_ERROR(SaveMotion(folder, shape.motion));
  return WriteJson(folder / "shape.json", JsonOf(shape));
}

Result<FaceShape> LoadShape(const std::filesystem::path& folder) {
  FaceShape shape;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "shape.json", [&](const nlohmann::json& json) { FromJson(json, shape); }));
  SLX_ASSIGN_OR_RETURN(const std::string record, ReadFile(folder / "rig.json"));
  SLX_ASSIGN_OR_RETURN(shape.record, RigCalibration::FromJson(record).WithContext((folder / "rig.json").string()));
  SLX_ASSIGN_OR_RETURN(shape.motion, LoadMotion(folder));
  SLX_ASSIGN_OR_RETURN(shape.surface.point_mm, ReadExr(folder / "position.exr", {"X", "Y", "Z"}));
  SLX_ASSIGN_OR_RETURN(shape.surface.normal, ReadExr(folder / "normal_surface.exr", {"X", "Y", "Z"}));
  SLX_ASSIGN_OR_RETURN(shape.surface.depth_sigma_mm, ReadExr(folder / "depth_sigma.exr", {"Y"}));
  SLX_ASSIGN_OR_RETURN(shape.disagreement_mm, ReadExr(folder / "disagreement.exr", {"Y"}));
  // The truth is not smoothed, and older programs did not say.
  if (auto smoothing = ReadExr(folder / kSmoothingFile, {"Y"}); smoothing.ok())
    shape.surface.smoothing_quads = std::move(*smoothing);
  else if (smoothing.status().code() != StatusCode::kNotFound)
    return smoothing.status();
  const size_t projectors = shape.lit.size(), channels = 1 + 2 * projectors;
  SLX_ASSIGN_OR_RETURN(const auto masks, ReadExr(folder / "masks.exr", MaskChannels(projectors)));
  const int width = masks.width(), height = masks.height();
  const auto same = [&](const Image<float>& map) { return map.width() == width && map.height() == height; };
  if (!same(shape.surface.point_mm) || !same(shape.surface.normal) || !same(shape.surface.depth_sigma_mm) ||
      !same(shape.disagreement_mm) || (!shape.surface.smoothing_quads.empty() && !same(shape.surface.smoothing_quads)))
    return Status::Integrity(folder.string() + ": its maps differ in size");
  shape.surface.mask = Image<uint8_t>(width, height);
  for (auto& lit : shape.lit) lit = Image<uint8_t>(width, height);
  for (auto& weights : shape.code_weights) weights = Image<float>(width, height);
  for (size_t i = 0; i < shape.surface.mask.size(); ++i) {
    const float* quad = masks.data() + i * channels;
    shape.surface.mask.pixels()[i] = quad[0] != 0.0F ? 1 : 0;
    for (size_t p = 0; p < projectors; ++p) {
      shape.lit[p].pixels()[i] = quad[1 + p] != 0.0F ? 1 : 0;
      shape.code_weights[p].pixels()[i] = quad[1 + projectors + p];
    }
  }
  return shape;
}

}  // namespace stratalux::fit
