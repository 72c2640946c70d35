// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/surface_error.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "shared/base/check.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

struct MeanAndRms {
  double mean = 0.0;
  double rms = 0.0;  // about it
};
MeanAndRms Of(const std::vector<double>& values) {
  MeanAndRms of;
  for (double v : values) of.mean += v / static_cast<double>(values.size());
  double squares = 0.0;
  for (double v : values) squares += std::pow(v - of.mean, 2);
  if (!values.empty()) of.rms = std::sqrt(squares / static_cast<double>(values.size()));
  return of;
}

std::optional<double> ColumnOf(const ProjectorCalibration& projector, const Eigen::Vector3d& point_mm) {
  const auto seen = projector.model.Project(projector.camera_from_projector.Inverse() * point_mm);
  return seen ? std::optional(seen->x()) : std::nullopt;
}

}  // namespace

SurfaceError CompareSurface(const SurfaceMap& surface, const SurfaceMap& truth) {
  SLX_CHECK(surface.mask.size() == truth.mask.size());
  std::vector<double> depth, angle;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0 || truth.mask(i, j) == 0) continue;
      depth.push_back(double(surface.point_mm(i, j, 2)) - truth.point_mm(i, j, 2));
      angle.push_back(DegFromRad(std::acos(std::clamp(truth.Normal(i, j).dot(surface.Normal(i, j)), -1.0, 1.0))));
    }
  SurfaceError result;
  result.pixels = static_cast<int64_t>(depth.size());
  if (depth.empty()) return result;
  const MeanAndRms of_depth = Of(depth);
  result.depth_bias_mm = of_depth.mean;
  result.depth_rms_mm = of_depth.rms;
  std::nth_element(angle.begin(), angle.begin() + static_cast<int64_t>(angle.size() / 2), angle.end());
  result.normal_median_deg = angle[angle.size() / 2];
  return result;
}

ColumnError CompareColumns(const SurfaceMap& surface, const RigCalibration& rig, const TrueSurface& truth,
                           int projector) {
  const Image<uint8_t>& lit = truth.lit_by[projector];
  SLX_CHECK(surface.mask.size() == truth.surface.mask.size() && surface.mask.size() == lit.size());
  std::vector<double> errors;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0 || truth.surface.mask(i, j) == 0 || lit(i, j) == 0) continue;
      const auto column = ColumnOf(rig.projectors[projector], surface.Point(i, j)),
                 true_column = ColumnOf(truth.rig.projectors[projector], truth.surface.Point(i, j));
      if (column && true_column) errors.push_back(*column - *true_column);
    }
  const MeanAndRms of_columns = Of(errors);
  return {projector, of_columns.mean, of_columns.rms, static_cast<int64_t>(errors.size())};
}

SurfaceError CompareWithTruth(const SurfaceMap& surface, const RigCalibration& rig, const TrueSurface& truth) {
  SurfaceError error = CompareSurface(surface, truth.surface);
  for (int p = 0; p < static_cast<int>(truth.lit_by.size()); ++p)
    if (!truth.lit_by[p].empty()) error.columns.push_back(CompareColumns(surface, rig, truth, p));
  return error;
}

}  // namespace stratalux::fit
