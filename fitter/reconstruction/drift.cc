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

struct Axes {
  bool columns = false, rows = false;
  [[nodiscard]] bool both() const { return columns && rows; }
};

// Where one axis alone was captured, the other's entries are 0, and the turn is that about the axis which moves it.
struct Point {
  Eigen::Vector2d residual;                // decoded less predicted, px
  Eigen::Matrix<double, 2, 3> by_turning;  // d predicted / d turn (rad), about the projector's own axes
  double sigma_px = 0.0;                   // of the codes, all captured axes together
};

bool IsValid(const DecodedMap& map, int x, int y) {
  return map.reason(x, y) == static_cast<uint8_t>(DecodeReason::kValid);
}

Axes AxesOf(const DecodedMap& map) {
  Axes axes;
  for (int y = 0; y < map.reason.height(); ++y)
    for (int x = 0; x < map.reason.width(); ++x) {
      if (!IsValid(map, x, y)) continue;
      axes.columns = axes.columns || std::isfinite(map.column(x, y));
      axes.rows = axes.rows || std::isfinite(map.row(x, y));
      if (axes.both()) return axes;
    }
  return axes;
}

// Mean of the decoded coordinates of a quad; false unless all of its sites are decoded.
bool DecodedQuad(const DecodedMap& map, const Axes& axes, int step, int i, int j, Eigen::Vector2d& at, double& sigma) {
  at.setZero();
  double variance = 0.0;
  for (int y = step * j; y < step * (j + 1); ++y)
    for (int x = step * i; x < step * (i + 1); ++x) {
      if (!IsValid(map, x, y)) return false;
      if (axes.columns) at.x() += map.column(x, y);
      if (axes.rows) at.y() += map.row(x, y);
      if (axes.columns) variance += map.column_sigma(x, y) * map.column_sigma(x, y);
      if (axes.rows) variance += map.row_sigma(x, y) * map.row_sigma(x, y);
    }
  const double sites = step * step;
  at /= sites;
  sigma = std::sqrt(variance) / sites;
  return (axes.columns || axes.rows) && at.allFinite();
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

// Turns about the other axes hardly move the captured coordinate, and noise would make much of them.
void KeepCaptured(const Axes& axes, Point& point) {
  if (axes.both()) return;
  const Eigen::Index kept = axes.columns ? 0 : 1, turn = 1 - kept;
  const double residual = point.residual[kept], slope = point.by_turning(kept, turn);
  point.residual.setZero();
  point.by_turning.setZero();
  point.residual[kept] = residual;
  point.by_turning(kept, turn) = slope;
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

// What all projectors say, and what is asked of one of them.
struct Scene {
  std::span<const DecodedMap> decoded;
  std::vector<Axes> axes;  // by projector
  const SurfaceMap& surface;
  const RigCalibration& rig;
  int step = 1;  // sites of a quad, along one side

  [[nodiscard]] bool Read(size_t p, int i, int j, Eigen::Vector2d& at, double& sigma) const {
    return DecodedQuad(decoded[p], axes[p], step, i, j, at, sigma);
  }
  [[nodiscard]] bool OthersReach(size_t p, int i, int j) const {
    Eigen::Vector2d at;
    double sigma = 0.0;
    for (size_t other = 0; other < decoded.size(); ++other)
      if (other != p && Read(other, i, j, at, sigma)) return true;
    return false;
  }
};

// Quads of the projector's light; `told` counts those whose codes say anything, on the surface or not.
std::vector<Point> PointsOf(const Scene& scene, size_t p, Against against, int stride, int64_t& told) {
  const ProjectorCalibration& projector = scene.rig.projectors[p];
  const CameraCalibration& camera = scene.rig.camera;
  std::vector<Point> points;
  told = 0;
  for (int j = 0; j < scene.surface.height(); j += stride)
    for (int i = 0; i < scene.surface.width(); i += stride) {
      Eigen::Vector2d read;
      double sigma = 0.0;
      if (!scene.Read(p, i, j, read, sigma)) continue;
      if (!scene.axes[p].both() && !scene.OthersReach(p, i, j)) continue;
      ++told;
      std::optional<Eigen::Vector3d> at;
      if (against == Against::kOwnDepth)
        at = AgreedPoint(projector, camera.model.Unproject(QuadCentre(camera.cfa, i, j)), read);
      else if (scene.surface.mask(i, j) != 0)
        at = scene.surface.Point(i, j);
      if (!at) continue;
      auto point = PointAt(projector, *at, read, sigma);
      if (!point) continue;
      KeepCaptured(scene.axes[p], *point);
      if (against == Against::kOwnDepth) KeepAcross(projector, *at, *point);
      points.push_back(*point);
    }
  return points;
}

// Against the surface; where that holds but a small part of what the projector's codes reach (a rig so far off that
// nothing fits together), against the epipolar lines alone. One axis says nothing of these.
std::vector<Point> PointsOf(const Scene& scene, size_t p, const DriftOptions& options) {
  const double quads = double(scene.surface.width()) * scene.surface.height();
  const int stride = std::max(1, static_cast<int>(std::sqrt(quads / options.max_points)));
  int64_t told = 0;
  std::vector<Point> points = PointsOf(scene, p, Against::kSurface, stride, told);
  if (static_cast<double>(points.size()) >= options.least_on_surface * static_cast<double>(told)) return points;
  if (!scene.axes[p].both()) return {};
  return PointsOf(scene, p, Against::kOwnDepth, stride, told);
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

ProjectorDrift DriftOf(int projector, const Axes& axes, const std::vector<Point>& points, const DriftOptions& options) {
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
  // Of a normal distribution half lies within 0.6745 standard deviations; of an isotropic one of two axes within 1.1774
  // of one axis'.
  drift.spread_px = Median(Distances(points, turn)) * (axes.both() ? std::sqrt(2.0) / 1.1774 : 1.0 / 0.6745);
  double squares = 0.0;
  for (const Point& point : points) squares += (point.by_turning * turn).squaredNorm();
  drift.shift_px = std::sqrt(squares / static_cast<double>(points.size()));
  return drift;
}

std::string DueOf(const std::vector<ProjectorDrift>& projectors) {
  std::string who;
  size_t moved = 0, judged = 0;
  for (const ProjectorDrift& drift : projectors) {
    judged += drift.judged() ? 1 : 0;
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

// Of the projectors that have too few points; empty: all were judged.
std::string NotJudged(const DriftReport& report) {
  std::string who;
  for (const ProjectorDrift& drift : report.projectors)
    if (!drift.judged())
      who += (who.empty() ? "projector " : ", projector ") + std::to_string(drift.projector) + " (" +
             std::to_string(drift.points) + " points)";
  return who.empty() ? ""
                     : "not judged: " + who + "; it takes " + std::to_string(DriftOptions().min_points) +
                           " points of the surface";
}

// With what the numbers of points do not tell.
std::string WhyNot(const DriftReport& report, const Scene& scene) {
  if (scene.decoded.size() == 1 && report.projectors[0].judged())
    return "not judged: what moves the light of projector " + std::to_string(report.projectors[0].projector) +
           " along its epipolar lines, for no other projector checks it";
  std::string why = NotJudged(report);
  bool one_axis = false;
  for (size_t p = 0; p < scene.axes.size(); ++p)
    one_axis = one_axis || (!report.projectors[p].judged() && scene.axes[p].columns != scene.axes[p].rows);
  if (one_axis) why += "; codes of one axis alone tell only where the surface rests on another projector too";
  return why;
}

}  // namespace

bool DriftReport::moved() const {
  return std::ranges::any_of(projectors, [](const ProjectorDrift& drift) { return drift.moved; });
}

std::string Describe(const DriftReport& report) {
  if (report.moved()) return "Warning: " + report.warning;
  const std::string why = report.warning.empty() ? NotJudged(report) : report.warning;
  if (std::ranges::none_of(report.projectors, &ProjectorDrift::judged))
    return "Whether the projectors' light falls where the calibration says is not known: " +
           (why.empty() ? "no codes were compared with the surface" : why);
  return "The projectors' light falls where the calibration says" +
         (why.empty() ? "" : ", as far as it is judged (" + why + ")");
}

Status DriftOptions::Validate() const {
  if (!(max_shift_px > 0.0) || !(least_of_worst >= 0.0 && least_of_worst <= 1.0))
    return Status::Usage("drift: max_shift_px must be positive, least_of_worst 0 .. 1");
  return min_points >= 10 && max_points >= min_points ? Status::Ok()
                                                      : Status::Usage("drift: min_points must be 10 or more");
}

Result<DriftReport> CheckDrift(std::span<const DecodedMap> decoded, const SurfaceMap& surface,
                               const RigCalibration& rig, const DriftOptions& options, std::span<const int> numbers) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const int step = QuadStep(rig.camera.cfa);
  if (decoded.size() != rig.projectors.size())
    return Status::Usage("drift: " + std::to_string(decoded.size()) + " decoded maps, but the calibration has " +
                         std::to_string(rig.projectors.size()) + " projectors");
  for (const DecodedMap& map : decoded)
    if (map.reason.width() / step != surface.width() || map.reason.height() / step != surface.height())
      return Status::Usage("drift: decoded maps and surface differ in size");
  if (!numbers.empty() && numbers.size() != decoded.size())
    return Status::Usage("drift: " + std::to_string(numbers.size()) + " numbers of " + std::to_string(decoded.size()) +
                         " projectors");
  Scene scene{decoded, {}, surface, rig, step};
  for (const DecodedMap& map : decoded) scene.axes.push_back(AxesOf(map));
  DriftReport report;
  double worst = 0.0;
  for (size_t p = 0; p < decoded.size(); ++p) {
    const int number = numbers.empty() ? static_cast<int>(p) : numbers[p];
    report.projectors.push_back(DriftOf(number, scene.axes[p], PointsOf(scene, p, options), options));
    worst = std::max(worst, report.projectors.back().shift_px);
  }
  for (ProjectorDrift& drift : report.projectors)
    drift.moved = drift.shift_px > options.max_shift_px && drift.shift_px > options.least_of_worst * worst;
  report.warning = DueOf(report.projectors);
  if (const std::string why = WhyNot(report, scene); !why.empty())
    report.warning += (report.warning.empty() ? "" : "; ") + why;
  return report;
}

}  // namespace stratalux::fit
