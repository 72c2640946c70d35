// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/calibration_drawings.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "fitter/report/svg_drawing.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

using Point = SvgDrawing::Point;

constexpr double kSmall = 262.0, kWide = 540.0;  // widths of drawings, px

DeviceSize SizeOf(const GeometryReport& report, size_t device) {
  return device == 0 ? report.used.camera : report.used.projectors[device - 1];
}

// Pixel of the device -> the drawing.
struct PictureScale {
  double drawing_per_px;
  Point offset;
  [[nodiscard]] Point operator()(const Eigen::Vector2d& pixel) const {
    return offset + drawing_per_px * (pixel + Eigen::Vector2d(0.5, 0.5));
  }
};

struct Residual {
  size_t pose;
  Eigen::Vector2d seen_px, off_px;  // projected less seen
};

std::vector<Residual> ResidualsOf(const GeometryReport& report, size_t device) {
  std::vector<Residual> residuals;
  const RigGeometry& rig = report.bundle.rig;
  for (size_t k = 0; k < report.used.poses.size(); ++k)
    for (const CornerObservation& corner : report.used.poses[k].corners) {
      const Eigen::Vector2d* seen = corner.SeenBy(device);
      if (seen == nullptr) continue;
      const auto there =
          ProjectCorner(rig, device, report.used.board, report.bundle.camera_from_board[k], corner.corner);
      if (there) residuals.push_back({k, *seen, *there - *seen});
    }
  return residuals;
}

// A round number of pixels for the arrow that is drawn a 25th of the picture long: most arrows are about as long, and
// the longest stays in sight.
double RoundArrowPx(const std::vector<Residual>& residuals) {
  std::vector<double> lengths{0.0};
  for (const Residual& r : residuals) lengths.push_back(r.off_px.norm());
  std::sort(lengths.begin(), lengths.end());
  const double most = lengths[9 * (lengths.size() - 1) / 10];
  return RoundStep(4.0 * std::max({most, 0.1 * lengths.back(), 1e-4}));
}

void DrawRejected(const GeometryReport& report, const PictureScale& scale, SvgDrawing& svg) {
  for (const RejectedCorner& r : report.rejected)
    for (size_t k = 0; k < report.used.poses.size(); ++k) {
      if (report.used.poses[k].name != r.pose) continue;
      const auto at =
          ProjectCorner(report.bundle.rig, 0, report.used.board, report.bundle.camera_from_board[k], r.corner);
      if (!at) continue;
      const Point p = scale(*at);
      svg.Line(p - Point(4, 4), p + Point(4, 4), "#c8352b", 1.5);
      svg.Line(p - Point(4, -4), p + Point(4, -4), "#c8352b", 1.5);
    }
}

void DrawPoseLegend(const GeometryReport& report, double y, SvgDrawing& svg) {
  double x = 4.0;
  svg.Text({x, y}, "pose");
  x += 32.0;
  for (size_t k = 0; k < report.used.poses.size() && x < kWide - 20.0; ++k, x += 34.0) {
    svg.Circle({x, y - 4.0}, 4.0, HueColour(k, report.used.poses.size()));
    svg.Text({x + 7.0, y}, PoseMark(report, k));
  }
}

Eigen::Vector3d NormalTowardsCamera(const Rigid3& camera_from_board) {
  const Eigen::Vector3d normal = camera_from_board.rotation * Eigen::Vector3d::UnitZ();
  return normal.z() > 0.0 ? Eigen::Vector3d(-normal) : normal;
}

// Lines of the rig in space, with the marks that belong to them.
struct SpaceLine {
  std::vector<Eigen::Vector3d> points_mm;  // closed
  std::string colour;
};
struct SpaceMark {
  Eigen::Vector3d at_mm;
  std::string text, colour;
};
struct RigLines {
  std::vector<SpaceLine> lines;
  std::vector<SpaceMark> marks;
};

void AddDevice(const Pinhole& m, const Rigid3& camera_from_device, double length_mm, const std::string& name,
               const std::string& colour, RigLines& rig) {
  std::vector<Eigen::Vector3d> ring;
  for (const auto& [x, y] : {std::pair{0, 0}, {m.width - 1, 0}, {m.width - 1, m.height - 1}, {0, m.height - 1}}) {
    const Eigen::Vector3d ray = m.Unproject(Eigen::Vector2d(x, y));
    ring.push_back(camera_from_device * Eigen::Vector3d(length_mm / ray.z() * ray));
  }
  rig.lines.push_back({ring, colour});
  for (const Eigen::Vector3d& corner : ring) rig.lines.push_back({{camera_from_device.translation_mm, corner}, colour});
  rig.marks.push_back({camera_from_device.translation_mm, name, colour});
}

RigLines LinesOf(const GeometryReport& report) {
  RigLines rig;
  const BoardDescription& b = report.used.board;
  const size_t poses = report.bundle.camera_from_board.size();
  double distance_mm = 0.0;
  for (const Rigid3& pose : report.bundle.camera_from_board)
    distance_mm += pose.translation_mm.norm() / static_cast<double>(poses);
  for (size_t k = 0; k < poses; ++k) {
    SpaceLine outline{{}, HueColour(k, poses)};
    for (const auto& [x, y] : {std::pair{-1, -1}, {b.columns - 1, -1}, {b.columns - 1, b.rows - 1}, {-1, b.rows - 1}})
      outline.points_mm.push_back(report.bundle.camera_from_board[k] *
                                  Eigen::Vector3d(x * b.square_mm, y * b.square_mm, 0.0));
    rig.lines.push_back(std::move(outline));
  }
  AddDevice(report.bundle.rig.camera, {}, 0.15 * distance_mm, "camera", "var(--ink)", rig);
  for (size_t p = 0; p < report.bundle.rig.projectors.size(); ++p)
    AddDevice(report.bundle.rig.projectors[p].model, report.bundle.rig.projectors[p].camera_from_projector,
              0.15 * distance_mm, std::to_string(p), "var(--accent)", rig);
  return rig;
}

// Space (camera frame, +y down) -> the plane of the drawing.
Eigen::Matrix<double, 2, 3> ProjectionOf(RigView view) {
  Eigen::Matrix<double, 2, 3> projection;
  switch (view) {
    case RigView::kTop:  // from above: z upwards
      projection << 1, 0, 0, 0, 0, -1;
      break;
    case RigView::kSide:  // from the camera's left: z to the right
      projection << 0, 0, 1, 0, 1, 0;
      break;
    case RigView::kOblique: {
      const double yaw = RadFromDeg(-38.0), pitch = RadFromDeg(24.0);
      projection << std::cos(yaw), 0, std::sin(yaw), std::sin(pitch) * std::sin(yaw), std::cos(pitch),
          -std::sin(pitch) * std::cos(yaw);
      break;
    }
  }
  return projection;
}

// Sentences for an operator: what is shown, what good looks like, what to do if not.
const char* CaptionOf(RigView view) {
  switch (view) {
    case RigView::kTop:
      return "From above, the camera looks up the page. Is this your rig? A projector on the wrong side means "
             "exchanged "
             "cables; wrong distances mean a wrong size of the squares.";
    case RigView::kSide:
      return "From the side, the camera looks to the right. Boards should fill the room where faces will be, nearer "
             "and "
             "farther.";
    case RigView::kOblique:
      break;
  }
  return "The same at an angle. Numbers are projectors; each board has the colour of its pose.";
}

}  // namespace

std::string PoseMark(const GeometryReport& report, size_t pose) {
  const int number = report.used.poses[pose].pose;
  return number >= 0 ? std::to_string(number) : std::to_string(pose + 1) + ".";
}

ReportDrawing DrawResiduals(const GeometryReport& report, size_t device) {
  const DeviceSize size = SizeOf(report, device);
  const PictureScale scale{(kWide - 2.0) / size.width, {1.0, 1.0}};
  const double height = scale.drawing_per_px * size.height;
  SvgDrawing svg;
  svg.Rectangle({1, 1}, {kWide - 2.0, height}, "none", "var(--line)");
  const auto residuals = ResidualsOf(report, device);
  const double arrow_px = RoundArrowPx(residuals), drawn = kWide / 25.0;
  for (const Residual& r : residuals) {
    const Point from = scale(r.seen_px);
    svg.Arrow(from, from + drawn / arrow_px * r.off_px, HueColour(r.pose, report.used.poses.size()));
  }
  if (device == 0) DrawRejected(report, scale, svg);
  svg.Arrow({6, height + 14}, {6 + drawn, height + 14}, "var(--ink)");
  svg.Text({12 + drawn, height + 18}, ShortNumber(arrow_px) + " px");
  DrawPoseLegend(report, height + 36, svg);
  return {DeviceName(device) +
              ": error of each corner, magnified. Good: short arrows in all directions. Arrows of one pose that agree: "
              "the board moved; arrows that turn about the middle or point outwards everywhere: the distortion model "
              "does not fit, or the board is bent." +
              (device == 0 && !report.rejected.empty() ? " Crosses: corners left out." : ""),
          svg.Svg(kWide, height + 42), kWide};
}

ReportDrawing DrawCoverage(const GeometryReport& report, size_t device) {
  const DeviceSize size = SizeOf(report, device);
  const double height = kSmall * size.height / size.width;
  const std::vector<int>& cells = report.coverage_map[device];
  const int most = std::max(*std::max_element(cells.begin(), cells.end()), 1);
  SvgDrawing svg;
  const Point step(kSmall / kCoverageColumns, height / kCoverageRows);
  for (int row = 0; row < kCoverageRows; ++row)
    for (int column = 0; column < kCoverageColumns; ++column) {
      const int n = cells[static_cast<size_t>(row * kCoverageColumns + column)];
      const double light = n == 0 ? 0.0 : 0.25 + 0.6 * n / most;
      const Point corner(column * step.x(), row * step.y());
      svg.Rectangle(corner, step, "rgba(59,111,212," + ShortNumber(light) + ")", "var(--line)");
      if (n > 0) svg.Text(corner + 0.5 * step + Point(0, 4), std::to_string(n), TextAnchor::kMiddle, "var(--ink)");
    }
  return {DeviceName(device) + ": corners in each part of its picture, " +
              ShortNumber(std::round(100.0 * report.coverage[device])) + " % covered.",
          svg.Svg(kSmall, height), kSmall};
}

ReportDrawing DrawTilts(const GeometryReport& report) {
  const size_t poses = report.bundle.camera_from_board.size();
  double most_deg = 30.0;
  for (double tilt : report.tilt_deg) most_deg = std::max(most_deg, tilt);
  const double middle = 0.5 * kWide, drawing_per_deg = 0.44 * kWide / most_deg;
  SvgDrawing svg;
  for (double ring = 10.0; ring <= most_deg + 0.1; ring += 10.0) {
    svg.Ring({middle, middle}, ring * drawing_per_deg, "var(--line)");
    svg.Text({middle + 3.0, middle - ring * drawing_per_deg - 2.0}, ShortNumber(ring) + "°");
  }
  svg.Line({middle, 10}, {middle, kWide - 10}, "var(--line)");
  svg.Line({10, middle}, {kWide - 10, middle}, "var(--line)");
  for (size_t k = 0; k < poses; ++k) {
    const Eigen::Vector3d n = NormalTowardsCamera(report.bundle.camera_from_board[k]);
    const Eigen::Vector2d direction = n.head<2>().norm() > 0.0 ? n.head<2>().normalized() : n.head<2>();
    const Point at = Point(middle, middle) + drawing_per_deg * report.tilt_deg[k] * direction;
    svg.Circle(at, 5.0, HueColour(k, poses));
    svg.Text(at + Point(8, 4), PoseMark(report, k));
  }
  return {
      "Where each board looks, seen from the camera. Good: dots all around, most of them 15 to 35 degrees from the "
      "middle. All in the middle, or along one line: the focal lengths are not determined; tilt the board in the "
      "directions that are empty.",
      svg.Svg(kWide, kWide), kWide};
}

ReportDrawing DrawRig(const GeometryReport& report, RigView view) {
  const RigLines rig = LinesOf(report);
  const Eigen::Matrix<double, 2, 3> projection = ProjectionOf(view);
  Eigen::Vector2d low(1e300, 1e300), high(-1e300, -1e300);
  for (const SpaceLine& line : rig.lines)
    for (const Eigen::Vector3d& x : line.points_mm) {
      low = low.cwiseMin(projection * x);
      high = high.cwiseMax(projection * x);
    }
  const double margin = 22.0, room = kWide - 2.0 * margin;
  const double drawing_per_mm = room / std::max((high - low).maxCoeff(), 1e-9);
  const Point size = drawing_per_mm * (high - low) + Point(2.0 * margin, 2.0 * margin);
  auto place = [&](const Eigen::Vector3d& x) -> Point {
    return Point(margin + 0.5 * (kWide - size.x()), margin) + drawing_per_mm * (projection * x - low);
  };
  SvgDrawing svg;
  for (const SpaceLine& line : rig.lines) {
    std::vector<Point> points;
    for (const Eigen::Vector3d& x : line.points_mm) points.push_back(place(x));
    svg.Polygon(points, line.colour);
  }
  for (const SpaceMark& mark : rig.marks) {
    svg.Circle(place(mark.at_mm), 3.5, mark.colour);
    svg.Text(place(mark.at_mm) + Point(6, -5), mark.text, TextAnchor::kStart, mark.colour);
  }
  const double bar_mm = RoundStep((high - low).maxCoeff());
  svg.Line({margin, size.y() + 4}, {margin + drawing_per_mm * bar_mm, size.y() + 4}, "var(--ink)", 2.0);
  svg.Text({margin + drawing_per_mm * bar_mm + 6, size.y() + 8}, ShortNumber(bar_mm) + " mm");
  return {CaptionOf(view), svg.Svg(kWide, size.y() + 14), kWide};
}

}  // namespace stratalux::fit
