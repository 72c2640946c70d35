// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/offset.h"

#include <algorithm>
#include <cmath>

#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

// Views beyond some 80 degrees carry no SRD (SrdOptions::min_cos), and none is moved farther than at that.
constexpr double kLeastCos = 0.15;

// Between the points of neighbouring quads of a row, median; 0 without any.
double SpacingOf(const SurfaceMap& surface) {
  std::vector<double> spacings;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 1; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0 && surface.mask(i - 1, j) != 0)
        spacings.push_back((surface.Point(i, j) - surface.Point(i - 1, j)).norm());
  if (spacings.empty()) return 0.0;
  const auto middle = spacings.begin() + std::ssize(spacings) / 2;
  std::nth_element(spacings.begin(), middle, spacings.end());
  return *middle;
}

std::string Describe(const SurfaceOffset& offset) {
  if (offset.pixels == 0)
    return "too few pixels are lit by two projectors to tell where the surface lies: it stays as it is";
  return Formatted("the surface lies %.3f +- %.3f mm below the reconstructed one (negative: above), by %lld pixels",
                   offset.depth_mm, offset.sigma_mm, static_cast<long long>(offset.pixels));
}

}  // namespace

Result<SurfaceOffset> FindOffset(const SrdSet& srds, const SurfaceMap& surface, int heldout, const FitOptions& options,
                                 Logger& logger, const std::string& label) {
  SLX_ASSIGN_OR_RETURN(const auto training, TrainingLightsOf(srds, heldout));
  SLX_ASSIGN_OR_RETURN(const EmOptions em, SharedOptions(options, training.batches, srds, logger, label));
  SLX_ASSIGN_OR_RETURN(auto offset, EstimateOffset(training.batches, training.projectors, srds.width, srds.channels,
                                                   std::max(SpacingOf(surface) * srds.pool, 1e-3), em));
  logger.Info(label + ": " + Describe(offset));
  if (offset.at_bound)
    logger.Warning(label + Formatted(": no offset up to %.1f mm is the best for the whole face: is the calibration "
                                     "the rig's? (`stratalux-fit report` shows the drift)",
                                     std::abs(offset.depth_mm)));
  return offset;
}

PlacedSrds::PlacedSrds(SrdSet as_read) : set_(std::move(as_read)) {
  for (const auto* batches : {&set_.batches, &set_.row_batches})
    for (const SrdBatch& batch : *batches) first_u_mm_.push_back(batch.first_u_mm);
}

void PlacedSrds::MoveTo(double depth_mm) {
  auto as_read = first_u_mm_.begin();
  for (auto* batches : {&set_.batches, &set_.row_batches})
    for (SrdBatch& batch : *batches) {
      batch.first_u_mm = *as_read++;
      MoveSurface(batch, depth_mm);
    }
}

FaceShape PlacedShape(FaceShape shape, const SurfaceOffset& offset) {
  SurfaceMap& surface = shape.surface;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const Eigen::Vector3d point = surface.Point(i, j), view = point.normalized();
      const double cos_out = std::max(-surface.Normal(i, j).dot(view), kLeastCos);
      const Eigen::Vector3d placed = point + offset.depth_mm / cos_out * view;
      for (int k = 0; k < 3; ++k) surface.point_mm(i, j, k) = static_cast<float>(placed[k]);
      surface.depth_sigma_mm(i, j) =
          std::hypot(surface.depth_sigma_mm(i, j), static_cast<float>(offset.sigma_mm / cos_out));
    }
  return shape;
}

Status SaveOffset(const std::filesystem::path& folder, const SurfaceOffset& offset) {
  return WriteJson(folder / "offset.json", {{"depth_mm", offset.depth_mm},
                                            {"sigma_mm", offset.sigma_mm},
                                            {"pixels", offset.pixels},
                                            {"at_bound", offset.at_bound}});
}

Result<SurfaceOffset> LoadOffset(const std::filesystem::path& folder) {
  SurfaceOffset offset;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "offset.json", [&](const nlohmann::json& json) {
    json.at("depth_mm").get_to(offset.depth_mm);
    json.at("sigma_mm").get_to(offset.sigma_mm);
    json.at("pixels").get_to(offset.pixels);
    json.at("at_bound").get_to(offset.at_bound);
  }));
  return offset;
}

}  // namespace stratalux::fit
