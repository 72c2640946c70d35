// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/drift.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>

#include "shared/base/formatted.h"
#include "shared/base/median.h"
#include "shared/geometry/quad.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

struct Point {
  Eigen::Vector2d residual;                // decoded less predicted, px
  Eigen::Matrix<double, 2, 3> by_turning;  // d predicted / d turn (rad), about the projector's own axes
  double sigma_px = 0.0;                   // of the codes, both axes together
};

// Mean of the decoded coordinates of a quad; false unless all of its sites are decoded.
bool DecodedQuad(const DecodedMap& map, int step, int i, int j, Eigen::Vector2d& at, double& sigma) {
  at.setZero();
  double variance = 0.0;
  for (int y = step * j; y < step * (j + 1); ++y)
    for (int x = step * i; x < step * (i + 1); ++x) {
      if (map.reason(x, y) != static_cast<uint8_t>(DecodeReason::kValid)) return false;
      at += Eigen::Vector2d(map.column(x, y), map.row(x, y));
      variance += map.column_sigma(x, y) * map.column_sigma(x, y) + map.row_sigma(x, y) * map.row_sigma(x, y);
    }
  const double sites = step * step;
  at /= sites;
  sigma = std::sqrt(variance) / sites;
  return at.allFinite();  // not where one axis alone was captured
}

std::optional<Point> PointAt(const ProjectorCalibration& projector, const Eigen::Vector3d& x_in_camera,
                             const Eigen::Vector2d& decoded, double sigma) {
  constexpr double kTurn = 1e-5;
  const Eigen::Vector3d x = projector.camera_from_projector.Inverse() * x_in_camera;
  const auto predicted = projector.model.Project(x);
  if (!predicted) return std::nullopt;
  Point point{decoded - *predicted, {}, sigma};
  for (int axis = 0; axis < 3; ++axis) {
    // The projector turned by +t sees the point turned by -t.
    const auto turned = projector.model.Project(x - kTurn * Eigen::Vector3d::Unit(axis).cross(x));
    if (!turned) return std::nullopt;
    point.by_turning.col(axis) = (*turned - *predicted) / kTurn;
  }
  return point;
}

// Where the camera ray and the projector's ray through the decoded pixel come closest, in the camera's frame: linear
// least squares for the range, as triangulation begins. nullopt behind one of them.
std::optional<Eigen::Vector3d> AgreedPoint(const ProjectorCalibration& projector, const Eigen::Vector3d& ray,
                                           const Eigen::Vector2d& decoded) {
  const Rigid3 projector_from_camera = projector.camera_from_projector.Inverse();
  const Eigen::Vector3d direction = projector_from_camera.rotation * ray,
                        &origin = projector_from_camera.translation_mm;
  const Eigen::Vector3d light = projector.model.Unproject(decoded);
  const Eigen::Vector2d n = light.head<2>() / light.z();
  const Eigen::Vector2d a = direction.head<2>() - n * direction.z();
  const Eigen::Vector2d b = n * origin.z() - origin.head<2>();
  const double range = a.dot(b) / a.squaredNorm();
  return range > 0.0 ? std::optional<Eigen::Vector3d>(ray * range) : std::nullopt;
}

// Without a surface: only what lies across the epipolar line counts, the rest is depth.
void KeepAcross(const ProjectorCalibration& projector, const Eigen::Vector3d& x_in_camera, Point& point) {
  const Rigid3 projector_from_camera = projector.camera_from_projector.Inverse();
  const auto here = projector.model.Project(projector_from_camera * x_in_camera);
  const auto behind = projector.model.Project(projector_from_camera * (1.001 * x_in_camera));
  if (!here || !behind) return;
  const Eigen::Vector2d along = (*behind - *here).normalized();
  const Eigen::Matrix2d across = Eigen::Matrix2d::Identity() - along * along.transpose();
  point.residual = across * point.residual;
  point.by_turning = across * point.by_turning;
}

enum class Against { kSurface, kOwnDepth };

// Quads of the projector's light; `decoded` counts those that could be read, on the surface or not.
std::vector<Point> PointsOf(const DecodedMap& map, const SurfaceMap& surface, const RigCalibration& rig, size_t p,
                            Against against, int stride, int64_t& decoded) {
  const int step = QuadStep(rig.camera.cfa);
  std::vector<Point> points;
  decoded = 0;
  for (int j = 0; j < surface.height(); j += stride)
    for (int i = 0; i < surface.width(); i += stride) {
      Eigen::Vector2d read;
      double sigma = 0.0;
      if (!DecodedQuad(map, step, i, j, read, sigma)) continue;
      ++decoded;
      std::optional<Eigen::Vector3d> at;
      if (against == Against::kOwnDepth)
        at = AgreedPoint(rig.projectors[p], rig.camera.model.Unproject(QuadCentre(rig.camera.cfa, i, j)), read);
      else if (surface.mask(i, j) != 0)
        at = surface.Point(i, j);
      if (!at) continue;
      auto point = PointAt(rig.projectors[p], *at, read, sigma);
      if (!point) continue;
      if (against == Against::kOwnDepth) KeepAcross(rig.projectors[p], *at, *point);
      points.push_back(*point);
    }
  return points;
}

// Against the surface; where that holds but a small part of what the projector's codes reach (a rig so far off that
// nothing fits together), against the epipolar lines alone.
std::vector<Point> PointsOf(const DecodedMap& map, const SurfaceMap& surface, const RigCalibration& rig, size_t p,
                            const DriftOptions& options) {
  const double quads = double(surface.width()) * surface.height();
  const int stride = std::max(1, static_cast<int>(std::sqrt(quads / options.max_points)));
  int64_t decoded = 0;
  std::vector<Point> points = PointsOf(map, surface, rig, p, Against::kSurface, stride, decoded);
  if (static_cast<double>(points.size()) >= options.least_on_surface * static_cast<double>(decoded)) return points;
  return PointsOf(map, surface, rig, p, Against::kOwnDepth, stride, decoded);
}

// Distances left when the projector is turned by `turn`.
std::vector<double> Distances(const std::vector<Point>& points, const Eigen::Vector3d& turn) {
  std::vector<double> distances;
  distances.reserve(points.size());
  for (const Point& point : points) distances.push_back((point.residual - point.by_turning * turn).norm());
  return distances;
}

// Iterated least squares with Geman-McClure weights of the scale at hand: points whose surface is another's mistake do
// not count. The scale starts at the median residual, so that a turn of any size is found.
Eigen::Vector3d FitTurn(const std::vector<Point>& points) {
  constexpr int kIterations = 12;
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const std::vector<double> distances = Distances(points, turn);
    const double scale = 2.0 * std::max(1e-6, Median(distances));
    // A turn that moves the light along the epipolar lines does not show without a surface: it is left at none.
    constexpr double kLeastInformation = 1.0;
    Eigen::Matrix3d normal = kLeastInformation * Eigen::Matrix3d::Identity();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (size_t k = 0; k < points.size(); ++k) {
      const double damping = 1.0 / (1.0 + std::pow(distances[k] / scale, 2));
      const double weight = damping * damping;
      normal += weight * points[k].by_turning.transpose() * points[k].by_turning;
      right += weight * points[k].by_turning.transpose() * points[k].residual;
    }
    const Eigen::LDLT<Eigen::Matrix3d> solver(normal);
    if (solver.info() != Eigen::Success || !solver.isPositive()) return Eigen::Vector3d::Zero();
    const Eigen::Vector3d next = solver.solve(right);
    if (!next.allFinite()) return Eigen::Vector3d::Zero();
    turn = next;
  }
  return turn;
}

ProjectorDrift DriftOf(int projector, const std::vector<Point>& points, const DriftOptions& options) {
  ProjectorDrift drift;
  drift.projector = projector;
  drift.points = static_cast<int64_t>(points.size());
  if (drift.points < options.min_points) return drift;
  std::vector<double> columns, rows, sigmas;
  for (const Point& point : points) {
    columns.push_back(point.residual.x());
    rows.push_back(point.residual.y());
    sigmas.push_back(point.sigma_px);
  }
  drift.shift_columns = Median(columns);
  drift.shift_rows = Median(rows);
  drift.expected_px = Median(sigmas);
  const Eigen::Vector3d turn = FitTurn(points);
  drift.turned_deg = DegFromRad(turn.norm());
  // Of an isotropic normal distribution half lies within 1.1774 standard deviations of an axis.
  drift.spread_px = Median(Distances(points, turn)) / 1.1774 * std::sqrt(2.0);
  double squares = 0.0;
  for (const Point& point : points) squares += (point.by_turning * turn).squaredNorm();
  drift.shift_px = std::sqrt(squares / static_cast<double>(points.size()));
  return drift;
}

std::string WarningOf(const std::vector<ProjectorDrift>& projectors) {
  std::string who;
  size_t moved = 0, judged = 0;
  for (const ProjectorDrift& drift : projectors) {
    judged += drift.shift_px > 0.0 ? 1 : 0;
    if (!drift.moved) continue;
    ++moved;
    who += (who.empty() ? "" : "; ") + std::string("the light of projector ") + std::to_string(drift.projector) +
           " falls " + Formatted("%.1f", drift.shift_px) +
           " px from where the calibration says, as if it were turned by " + Formatted("%.2f", drift.turned_deg) +
           " degrees";
  }
  if (moved == 0) return "";
  if (moved > 1 && moved == judged) who += "; all of them together: more likely the camera moved";
  return "recalibration is due: " + who;
}

}  // namespace

Status DriftOptions::Validate() const {
  if (!(max_shift_px > 0.0) || !(least_of_worst >= 0.0 && least_of_worst <= 1.0))
    return Status::Usage("drift: max_shift_px must be positive, least_of_worst 0 .. 1");
  return min_points >= 10 && max_points >= min_points ? Status::Ok()
                                                      : Status::Usage("drift: min_points must be 10 or more");
}

Result<DriftReport> CheckDrift(std::span<const DecodedMap> decoded, const SurfaceMap& surface,
                               const RigCalibration& rig, const DriftOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const int step = QuadStep(rig.camera.cfa);
  if (decoded.size() != rig.projectors.size())
    return Status::Usage("drift: " + std::to_string(decoded.size()) + " decoded maps, but the calibration has " +
                         std::to_string(rig.projectors.size()) + " projectors");
  for (const DecodedMap& map : decoded)
    if (map.reason.width() / step != surface.width() || map.reason.height() / step != surface.height())
      return Status::Usage("drift: decoded maps and surface differ in size");
  DriftReport report;
  double worst = 0.0;
  for (size_t p = 0; p < decoded.size(); ++p) {
    report.projectors.push_back(DriftOf(static_cast<int>(p), PointsOf(decoded[p], surface, rig, p, options), options));
    worst = std::max(worst, report.projectors.back().shift_px);
  }
  for (ProjectorDrift& drift : report.projectors)
    drift.moved = drift.shift_px > options.max_shift_px && drift.shift_px > options.least_of_worst * worst;
  report.warning = WarningOf(report.projectors);
  return report;
}

}  // namespace stratalux::fit
