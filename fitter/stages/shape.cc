// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/shape.h"

#include <cmath>

#include "fitter/export/exr_file.h"
#include "fitter/reconstruction/mesh.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/read_file.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

std::vector<std::string> MaskChannels(size_t projectors) {
  std::vector<std::string> names = {"surface"};
  for (size_t p = 0; p < projectors; ++p) names.push_back("lit" + std::to_string(p));
  return names;
}

nlohmann::ordered_json JsonOf(const FaceShape& shape) {
  const TriangulationCounts& t = shape.triangulation;
  nlohmann::ordered_json drift = {{"warning", shape.drift.warning}, {"projectors", nlohmann::json::array()}};
  for (const ProjectorDrift& d : shape.drift.projectors)
    drift["projectors"].push_back({d.projector, d.points, d.shift_columns, d.shift_rows, d.shift_px, d.turned_deg,
                                   d.spread_px, d.expected_px, d.moved});
  return {{"projectors", shape.lit.size()},
          {"triangulation", {t.sites, t.undecoded, t.inconsistent, t.rejected_views, t.islands}},
          {"drift", drift}};
}

void FromJson(const nlohmann::json& json, FaceShape& shape) {
  TriangulationCounts& t = shape.triangulation;
  const auto& counts = json.at("triangulation");
  t = {counts.at(0), counts.at(1), counts.at(2), counts.at(3), counts.at(4)};
  json.at("drift").at("warning").get_to(shape.drift.warning);
  for (const auto& d : json.at("drift").at("projectors"))
    shape.drift.projectors.push_back({d.at(0), d.at(1), d.at(2), d.at(3), d.at(4), d.at(5), d.at(6), d.at(7), d.at(8)});
  shape.lit.resize(json.at("projectors").get<size_t>());
}

}  // namespace

Image<uint8_t> LitQuads(const DecodedMap& decoded, const SurfaceMap& surface, const RigCalibration& rig,
                        int projector) {
  constexpr double kMaxColumns = 3.0;  // scattering displaces a decoded column by less than one
  const int step = QuadStep(rig.camera.cfa);
  Image<uint8_t> lit(surface.width(), surface.height()), eroded(surface.width(), surface.height());
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const auto at = rig.projectors[projector].ProjectFromCamera(surface.Point(i, j));
      if (!at) continue;
      int agreeing = 0;
      for (int y = j * step; y < (j + 1) * step; ++y)
        for (int x = i * step; x < (i + 1) * step; ++x)
          agreeing += decoded.reason(x, y) == 0 && std::abs(decoded.column(x, y) - at->x()) < kMaxColumns ? 1 : 0;
      lit(i, j) = 2 * agreeing >= step * step ? 1 : 0;
    }
  for (int j = 1; j + 1 < lit.height(); ++j)
    for (int i = 1; i + 1 < lit.width(); ++i) {
      bool inside = true;
      for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) inside = inside && lit(i + x, j + y) != 0;
      eroded(i, j) = inside ? 1 : 0;
    }
  return eroded;
}

Result<FaceShape> ReconstructShape(std::span<const DecodedMap> decoded, const RigCalibration& rig,
                                   const RigCalibration& record) {
  FaceShape shape;
  shape.record = record;
  SLX_ASSIGN_OR_RETURN(const auto rough, Triangulate(decoded, rig));
  shape.triangulation = rough.counts;
  SLX_ASSIGN_OR_RETURN(shape.surface, SmoothSurface(rough.surface, rig));
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p)
    shape.lit.push_back(LitQuads(decoded[p], shape.surface, rig, p));
  SLX_ASSIGN_OR_RETURN(shape.drift, CheckDrift(decoded, shape.surface, rig));
  return shape;
}

Status SaveShape(const std::filesystem::path& folder, const FaceShape& shape) {
  const SurfaceMap& surface = shape.surface;
  SLX_RETURN_IF_ERROR(WriteExr(folder / "position.exr", surface.point_mm, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "depth_sigma.exr", surface.depth_sigma_mm, {"Y"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "normal_surface.exr", surface.normal, {"X", "Y", "Z"}));
  const int channels = 1 + static_cast<int>(shape.lit.size());
  Image<float> masks(surface.width(), surface.height(), channels);
  for (int c = 0; c < channels; ++c) {
    const Image<uint8_t>& mask = c == 0 ? surface.mask : shape.lit[c - 1];
    for (size_t i = 0; i < mask.size(); ++i) masks.data()[i * channels + c] = mask.pixels()[i];
  }
  SLX_RETURN_IF_ERROR(WriteExr(folder / "masks.exr", masks, MaskChannels(shape.lit.size())));
  SLX_RETURN_IF_ERROR(WritePly(folder / "mesh.ply", MeshFromSurface(surface)));
  SLX_RETURN_IF_ERROR(WriteText(folder / "rig.json", shape.record.ToJson()));
  return WriteJson(folder / "shape.json", JsonOf(shape));
}

Result<FaceShape> LoadShape(const std::filesystem::path& folder) {
  FaceShape shape;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "shape.json", [&](const nlohmann::json& json) { FromJson(json, shape); }));
  SLX_ASSIGN_OR_RETURN(const std::string record, ReadFile(folder / "rig.json"));
  SLX_ASSIGN_OR_RETURN(shape.record, RigCalibration::FromJson(record).WithContext((folder / "rig.json").string()));
  SLX_ASSIGN_OR_RETURN(shape.surface.point_mm, ReadExr(folder / "position.exr", {"X", "Y", "Z"}));
  SLX_ASSIGN_OR_RETURN(shape.surface.normal, ReadExr(folder / "normal_surface.exr", {"X", "Y", "Z"}));
  SLX_ASSIGN_OR_RETURN(shape.surface.depth_sigma_mm, ReadExr(folder / "depth_sigma.exr", {"Y"}));
  SLX_ASSIGN_OR_RETURN(const auto masks, ReadExr(folder / "masks.exr", MaskChannels(shape.lit.size())));
  const int width = masks.width(), height = masks.height();
  const auto same = [&](const Image<float>& map) { return map.width() == width && map.height() == height; };
  if (!same(shape.surface.point_mm) || !same(shape.surface.normal) || !same(shape.surface.depth_sigma_mm))
    return Status::Integrity(folder.string() + ": its maps differ in size");
  for (int c = 0; c < masks.channels(); ++c) {
    Image<uint8_t>& mask = c == 0 ? shape.surface.mask : shape.lit[c - 1];
    mask = Image<uint8_t>(width, height);
    for (size_t i = 0; i < mask.size(); ++i) mask.pixels()[i] = masks.data()[i * masks.channels() + c] != 0.0F ? 1 : 0;
  }
  return shape;
}

}  // namespace stratalux::fit
