// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/offset.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "fitter/export/exr_file.h"
#include "fitter/srd/code_displacement.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

// Views beyond some 80 degrees carry no SRD (SrdOptions::min_cos), and none is moved farther than at that.
constexpr double kLeastCos = 0.15;

std::string Describe(const SurfaceOffset& offset) {
  if (offset.at_bound)
    return "no depth of the codes below the skin is best for the whole face: the surface stays as it is";
  if (offset.pixels == 0)
    return "too few pixels are lit by two projectors to tell where the surface lies: it stays as it is";
  return Formatted("codes are seen %.3f +- %.3f mm below the skin, according to %lld pixels", offset.code_depth_mm,
                   offset.sigma_mm, static_cast<long long>(offset.pixels));
}

// Means of pool x pool quads, as far as whole ones go.
std::vector<float> Pooled(const Image<float>& map, int pool) {
  const int width = map.width() / pool, height = map.height() / pool;
  std::vector<float> means;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      float sum = 0.0F;
      for (int j = 0; j < pool; ++j)
        for (int i = 0; i < pool; ++i) sum += map(x * pool + i, y * pool + j);
      means.push_back(sum / static_cast<float>(pool * pool));
    }
  return means;
}

}  // namespace

float FaceOffset::DeeperMm(int x, int y, int pool) const {
  float sum = 0.0F;
  for (int j = 0; j < pool; ++j)
    for (int i = 0; i < pool; ++i) sum += DeeperMm(x * pool + i, y * pool + j);
  return sum / static_cast<float>(pool * pool);
}

Result<FaceOffset> FindOffset(const SrdSet& srds, const FaceShape& shape, int heldout, const FitOptions& options,
                              const SharedLight& shared, Logger& logger, const std::string& label) {
  SLX_ASSIGN_OR_RETURN(const auto training, TrainingLightsOf(srds, heldout));
  SLX_ASSIGN_OR_RETURN(const EmOptions em, SharedOptions(options, training.batches, srds, shared, logger, label));
  FaceOffset offset;
  offset.displacement = CodeDisplacement(
      shape.surface, shape.code_weights,
      ScatteredShares(training.batches, srds.Grid(), srds.pool, shape.surface, shape.record, em.scattering),
      shape.record, em.scattering);
  SLX_ASSIGN_OR_RETURN(offset.found, EstimateOffset(training.batches, training.projectors, srds.width, srds.channels,
                                                    std::max(QuadSpacingMm(shape.surface) * srds.pool, 1e-3),
                                                    Pooled(offset.displacement, srds.pool), em));
  const std::string told = label + ": " + Describe(offset.found);
  if (offset.found.at_bound)
    logger.Warning(told + "; is the calibration the rig's? (the report shows its drift)");
  else
    logger.Info(told);
  return offset;
}

PlacedSrds::PlacedSrds(SrdSet as_read) : set_(std::move(as_read)) {
  for (const auto* batches : {&set_.batches, &set_.row_batches})
    for (const SrdBatch& batch : *batches) first_u_mm_.push_back(batch.first_u_mm);
}

void PlacedSrds::MoveTo(const FaceOffset* offset) {
  const std::vector<float> displacement =
      offset != nullptr ? Pooled(offset->displacement, set_.pool) : std::vector<float>{};
  auto as_read = first_u_mm_.begin();
  for (auto* batches : {&set_.batches, &set_.row_batches})
    for (SrdBatch& batch : *batches) {
      batch.first_u_mm = *as_read++;
      if (offset != nullptr) MoveSurface(batch, set_.channels, displacement, -offset->found.code_depth_mm);
    }
}

FaceShape PlacedShape(FaceShape shape, const FaceOffset& offset) {
  SurfaceMap& surface = shape.surface;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const Eigen::Vector3d point = surface.Point(i, j), view = point.normalized();
      const double cos_out = std::max(-surface.Normal(i, j).dot(view), kLeastCos);
      const Eigen::Vector3d placed = point + offset.DeeperMm(i, j) / cos_out * view;
      for (int k = 0; k < 3; ++k) surface.point_mm(i, j, k) = static_cast<float>(placed[k]);
      const double sigma = offset.found.sigma_mm * offset.displacement(i, j) / cos_out;
      surface.depth_sigma_mm(i, j) = std::hypot(surface.depth_sigma_mm(i, j), static_cast<float>(sigma));
    }
  return shape;
}

Status SaveOffset(const std::filesystem::path& folder, const FaceOffset& offset) {
  SLX_RETURN_IF_ERROR(WriteExr(folder / "offset.exr", offset.displacement, {"Y"}));
  return WriteJson(folder / "offset.json", {{"code_depth_mm", offset.found.code_depth_mm},
                                            {"sigma_mm", offset.found.sigma_mm},
                                            {"pixels", offset.found.pixels},
                                            {"at_bound", offset.found.at_bound}});
}

Result<FaceOffset> LoadOffset(const std::filesystem::path& folder) {
  FaceOffset offset;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "offset.json", [&](const nlohmann::json& json) {
    json.at("code_depth_mm").get_to(offset.found.code_depth_mm);
    json.at("sigma_mm").get_to(offset.found.sigma_mm);
    json.at("pixels").get_to(offset.found.pixels);
    json.at("at_bound").get_to(offset.found.at_bound);
  }));
  SLX_ASSIGN_OR_RETURN(offset.displacement, ReadExr(folder / "offset.exr", {"Y"}));
  return offset;
}

}  // namespace stratalux::fit
