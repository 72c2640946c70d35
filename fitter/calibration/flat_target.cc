// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/flat_target.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>

#include "fitter/reconstruction/triangulate.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/decode.h"
#include "shared/base/parallel.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

constexpr int kTile = 8;  // sites
constexpr double kMaxPlaneRmsMm = 1.5;
constexpr double kMinOnPlane = 0.6;  // share of the triangulated points
constexpr float kMaxColumns = 1.5F;  // between the decoded place and the plane's
constexpr int kMinAgreeing = kTile * kTile / 4, kMaxAstray = kTile * kTile / 16;  // sites of a tile
constexpr double kLitShare = 0.15;                                                // of the brightest contrast

struct Plane {
  Eigen::Vector3d normal{0, 0, -1};  // towards the camera
  double offset_mm = 0.0;            // normal . x
  double rms_mm = 0.0, share = 0.0;
};

Plane FitOnce(const std::vector<Eigen::Vector3d>& points, const std::vector<bool>& used) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  int count = 0;
  for (size_t i = 0; i < points.size(); ++i)
    if (used[i]) {
      centre += points[i];
      ++count;
    }
  centre /= std::max(1, count);
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (size_t i = 0; i < points.size(); ++i)
    if (used[i]) scatter += (points[i] - centre) * (points[i] - centre).transpose();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(scatter);
  Plane plane;
  plane.normal = solver.eigenvectors().col(0);
  if (plane.normal.z() > 0.0) plane.normal = -plane.normal;
  plane.offset_mm = plane.normal.dot(centre);
  plane.rms_mm = std::sqrt(std::max(0.0, solver.eigenvalues()[0]) / std::max(1, count));
  plane.share = static_cast<double>(count) / static_cast<double>(points.size());
  return plane;
}

Result<Plane> FitPlane(const SurfaceMap& surface) {
  std::vector<Eigen::Vector3d> points;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0) points.push_back(surface.Point(i, j));
  if (points.size() < 500)
    return Status::Failed("only " + std::to_string(points.size()) +
                          " points of the target could be triangulated; bring it to the working distance, where all "
                          "projectors light it");
  std::vector<bool> used(points.size(), true);
  Plane plane = FitOnce(points, used);
  for (int round = 0; round < 6; ++round) {
    std::vector<double> distance(points.size());
    for (size_t i = 0; i < points.size(); ++i) distance[i] = std::abs(plane.normal.dot(points[i]) - plane.offset_mm);
    std::vector<double> sorted = distance;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    const double limit = std::max(0.05, 4.0 * *middle / 0.6745);
    for (size_t i = 0; i < points.size(); ++i) used[i] = distance[i] < limit;
    plane = FitOnce(points, used);
  }
  if (plane.rms_mm > kMaxPlaneRmsMm || plane.share < kMinOnPlane)
    return Status::Failed("the target is not flat where the codes see it (" +
                          std::to_string(static_cast<int>(100.0 * plane.share)) + " % of its points lie within " +
                          std::to_string(plane.rms_mm) +
                          " mm rms of a plane); show nothing but a flat target, and calibrate the geometry first");
  return plane;
}

// Places of the sites on the plane, and in each projector.
struct PlaneView {
  Plane plane;
  Image<float> point_mm;  // H x W x 3
  std::vector<Image<float>> column, row;

  PlaneView(const Plane& p, const RigCalibration& rig) : plane(p) {
    const Pinhole& camera = rig.camera.model;
    point_mm = Image<float>(camera.width, camera.height, 3, std::nanf(""));
    for (size_t k = 0; k < rig.projectors.size(); ++k) {
      column.emplace_back(camera.width, camera.height, 1, std::nanf(""));
      row.emplace_back(camera.width, camera.height, 1, std::nanf(""));
    }
    ParallelFor(camera.height, 16, [&](int64_t begin, int64_t end) {
      for (int y = static_cast<int>(begin); y < end; ++y)
        for (int x = 0; x < camera.width; ++x) Place(rig, x, y);
    });
  }

  [[nodiscard]] Eigen::Vector3d Point(int x, int y) const {
    return {point_mm(x, y, 0), point_mm(x, y, 1), point_mm(x, y, 2)};
  }
  // Squared columns that a step of one pixel moves by, along x and y together.
  [[nodiscard]] double ColumnsPerPx2(size_t p, int x, int y) const {
    const Image<float>& c = column[p];
    const double dx = 0.5 * (c(x + 1, y) - c(x - 1, y)), dy = 0.5 * (c(x, y + 1) - c(x, y - 1));
    return dx * dx + dy * dy;
  }

 private:
  void Place(const RigCalibration& rig, int x, int y) {
    const Eigen::Vector3d ray = rig.camera.model.Unproject({static_cast<double>(x), static_cast<double>(y)});
    const double along = plane.offset_mm / plane.normal.dot(ray);
    if (!(along > 0.0)) return;
    const Eigen::Vector3d point = along * ray;
    for (int k = 0; k < 3; ++k) point_mm(x, y, k) = static_cast<float>(point[k]);
    for (size_t p = 0; p < rig.projectors.size(); ++p)
      if (const auto at = rig.projectors[p].ProjectFromCamera(point); at && rig.projectors[p].model.Contains(*at)) {
        column[p](x, y) = static_cast<float>(at->x());
        row[p](x, y) = static_cast<float>(at->y());
      }
  }
};

// Millimetres between neighbouring columns on the plane, about one of its points.
double MmPerColumn(const ProjectorCalibration& projector, const Plane& plane, const Eigen::Vector3d& point) {
  const Eigen::Vector3d a = plane.normal.unitOrthogonal(), b = plane.normal.cross(a);
  double squares = 0.0;
  for (const Eigen::Vector3d& along : {a, b}) {
    const auto ahead = projector.ProjectFromCamera(point + 0.5 * along),
               behind = projector.ProjectFromCamera(point - 0.5 * along);
    if (!ahead || !behind) return std::nan("");
    squares += std::pow(ahead->x() - behind->x(), 2);
  }
  return 1.0 / std::sqrt(squares);
}

// What a site's codes say of the plane. Codes finer than a pixel leave many undecided.
enum class Place : uint8_t { kUndecided, kAgrees, kAstray };

// One projector's white and black, and where its codes agree with the plane.
struct LitTarget {
  Image<uint16_t> white;
  Image<float> black;
  Image<uint8_t> place;  // Place, by site
  double max_contrast_dn = 0.0;
  [[nodiscard]] double Contrast(int x, int y) const { return white(x, y) - black(x, y); }
  [[nodiscard]] bool Is(int x, int y, Place what) const { return place(x, y) == static_cast<uint8_t>(what); }
};

class FlatMeasurement {
 public:
  FlatMeasurement(const SessionFrames& frames, int pose_index)
      : frames_(frames), rig_(*frames.calibration()), pose_index_(pose_index) {}

  Result<FlatTarget> Run() {
    const std::vector<const db::FrameRow*> rows = GoodRows(frames_);
    for (const db::FrameRow* row : rows)
      if (row->record.phase == CapturePhase::kReference) pose_ = row->record.pose;
    SLX_ASSIGN_OR_RETURN(const PlaneView view, FindTarget());
    Describe(view);
    for (size_t p = 0; p < lit_.size(); ++p) {
      Weigh(view, p);
      Sample(view, p);
    }
    SLX_RETURN_IF_ERROR(SampleBlacks(view));
    for (const db::FrameRow* row : rows)
      if (row->record.phase == CapturePhase::kRadiometry && row->record.pattern.kind == PatternKind::kComb)
        SLX_RETURN_IF_ERROR(SampleLines(view, *row));
    return std::move(target_);
  }

 private:
  Result<PlaneView> FindTarget() {
    std::vector<DecodedMap> decoded;
    const SensorNoise noise = SensorNoise::From(rig_.camera);
    for (int p = 0; p < static_cast<int>(rig_.projectors.size()); ++p) {
      const Pinhole& model = rig_.projectors[p].model;
      auto report = DecodeProjector(frames_, p, pose_, model.width, model.height, noise);
      if (!report.ok()) return report.status().WithContext("projector " + std::to_string(p));
      decoded.push_back(std::move(report->map));
    }
    SLX_ASSIGN_OR_RETURN(const auto triangulation, Triangulate(decoded, rig_));
    SLX_ASSIGN_OR_RETURN(const Plane plane, FitPlane(triangulation.surface));
    PlaneView view(plane, rig_);
    for (int p = 0; p < static_cast<int>(decoded.size()); ++p) {
      SLX_ASSIGN_OR_RETURN(auto white, frames_.Read(p, CapturePhase::kReference, {.kind = PatternKind::kWhite}, pose_));
      SLX_ASSIGN_OR_RETURN(auto black, frames_.MeanBlack(p));
      LitTarget& lit = lit_.emplace_back(LitTarget{std::move(white), std::move(black),
                                                   Image<uint8_t>(view.column[p].width(), view.column[p].height())});
      for (size_t i = 0; i < lit.place.size(); ++i) {
        const bool saturated = decoded[p].reason.pixels()[i] == static_cast<uint8_t>(DecodeReason::kSaturated);
        const float off = std::abs(decoded[p].column.pixels()[i] - view.column[p].pixels()[i]);
        const Place place = saturated || std::isnan(off) ? Place::kUndecided
                            : off < kMaxColumns          ? Place::kAgrees
                                                         : Place::kAstray;
        lit.place.pixels()[i] = static_cast<uint8_t>(place);
      }
    }
    return view;
  }

  void Describe(const PlaneView& view) {
    target_.report.session = frames_.info().id;
    target_.report.pose = pose_;
    target_.report.tilt_deg = DegFromRad(std::acos(std::min(1.0, -view.plane.normal.z())));
    target_.report.plane_rms_mm = view.plane.rms_mm;
    const int x = rig_.camera.model.width / 2, y = rig_.camera.model.height / 2;
    target_.report.distance_mm = view.Point(x, y).norm();
    for (const ProjectorCalibration& p : rig_.projectors)
      target_.mm_per_column.push_back(MmPerColumn(p, view.plane, view.Point(x, y)));
  }

  // How bright the target is, and how much of it too bright.
  void Weigh(const PlaneView& view, size_t p) {
    LitTarget& lit = lit_[p];
    std::vector<float> contrast;
    int64_t saturated = 0;
    for (int y = 0; y < lit.white.height(); ++y)
      for (int x = 0; x < lit.white.width(); ++x) {
        const bool too_bright = lit.white(x, y) >= rig_.camera.saturation_dn;
        if (!(lit.Is(x, y, Place::kAgrees) || too_bright) || std::isnan(view.column[p](x, y))) continue;
        contrast.push_back(static_cast<float>(lit.Contrast(x, y)));
        saturated += too_bright;
      }
    target_.saturated.push_back(
        contrast.empty() ? 0.0 : static_cast<double>(saturated) / static_cast<double>(contrast.size()));
    target_.report.lit_share +=
        static_cast<double>(contrast.size()) / static_cast<double>(lit.white.size() * lit_.size());
    target_.median_white_dn.push_back(0.0);
    if (contrast.empty()) return;
    std::sort(contrast.begin(), contrast.end());
    target_.median_white_dn.back() = contrast[contrast.size() / 2];
    lit.max_contrast_dn = contrast[contrast.size() * 98 / 100];
  }

  [[nodiscard]] bool Usable(size_t p, int x, int y) const {
    const LitTarget& lit = lit_[p];
    return lit.white(x, y) < rig_.camera.saturation_dn && lit.Contrast(x, y) > kLitShare * lit.max_contrast_dn;
  }
  [[nodiscard]] bool UsableTile(size_t p, int x0, int y0) const {
    int agreeing = 0, astray = 0;
    for (int y = y0; y < y0 + kTile; ++y)
      for (int x = x0; x < x0 + kTile; ++x) {
        if (!Usable(p, x, y)) return false;
        agreeing += lit_[p].Is(x, y, Place::kAgrees);
        astray += lit_[p].Is(x, y, Place::kAstray);
      }
    return agreeing >= kMinAgreeing && astray <= kMaxAstray;
  }
  // Calls visit(x0, y0) for the first site of every whole tile.
  template <typename Visit>
  void ForEachTile(const Visit& visit) const {
    for (int y = 0; y + kTile <= rig_.camera.model.height; y += kTile)
      for (int x = 0; x + kTile <= rig_.camera.model.width; x += kTile) visit(x, y);
  }

  void Sample(const PlaneView& view, size_t p) {
    const ProjectorCalibration& projector = rig_.projectors[p];
    const SensorNoise noise = SensorNoise::From(rig_.camera);
    const double exposure_ms = frames_.plan()->exposure_ms;
    ForEachTile([&](int x0, int y0) {
      if (!UsableTile(p, x0, y0)) return;
      std::array<double, 3> light{}, variance{};
      std::array<Eigen::Vector2d, 3> at;
      at.fill(Eigen::Vector2d::Zero());
      std::array<int, 3> count{};
      for (int y = y0; y < y0 + kTile; ++y)
        for (int x = x0; x < x0 + kTile; ++x) {
          const int c = CfaColour(rig_.camera.cfa, x, y);
          light[c] += lit_[p].Contrast(x, y);
          variance[c] += noise.VarianceDn2(lit_[p].white(x, y));
          at[c] += Eigen::Vector2d(x, y);
          ++count[c];
        }
      for (int c = 0; c < 3; ++c) {
        if (count[c] == 0 || !(light[c] > 0.0)) continue;
        const Eigen::Vector2d px = at[c] / count[c];
        const Eigen::Vector3d ray = rig_.camera.model.Unproject(px);
        const Eigen::Vector3d point = ray * (view.plane.offset_mm / view.plane.normal.dot(ray));
        const Eigen::Vector3d to_light = projector.CentreInCamera() - point;
        const double cosine = view.plane.normal.dot(to_light) / to_light.norm();
        const auto column_row = projector.ProjectFromCamera(point);
        if (!(cosine > 0.1) || !column_row) continue;
        target_.samples.push_back({static_cast<int>(p), c, pose_index_, px, *column_row,
                                   exposure_ms * cosine / to_light.squaredNorm(), light[c] / count[c],
                                   std::sqrt(variance[c]) / count[c]});
      }
    });
  }

  Status SampleBlacks(const PlaneView& view) {
    const auto all = frames_.MeanBlack(-1);
    if (!all.ok()) return all.status().code() == StatusCode::kNotFound ? Status::Ok() : all.status();
    const auto n = static_cast<Eigen::Index>(lit_.size());
    ForEachTile([&](int x0, int y0) {
      for (size_t p = 0; p < lit_.size(); ++p)
        if (std::isnan(view.column[p](x0, y0)) || !UsableTile(p, x0, y0)) return;
      BlackSample s{0.0, Eigen::VectorXd::Zero(n), Eigen::VectorXd::Zero(n)};
      for (int y = y0; y < y0 + kTile; ++y)
        for (int x = x0; x < x0 + kTile; ++x) {
          s.all_black_dn += (*all)(x, y) / (kTile * kTile);
          for (Eigen::Index p = 0; p < n; ++p) {
            s.black_dn[p] += lit_[p].black(x, y) / (kTile * kTile);
            s.contrast_dn[p] += lit_[p].Contrast(x, y) / (kTile * kTile);
          }
        }
      target_.blacks.push_back(std::move(s));
    });
    return Status::Ok();
  }

  Status SampleLines(const PlaneView& view, const db::FrameRow& row) {
    const Pattern& comb = row.record.pattern;
    const auto p = static_cast<size_t>(row.record.projector);
    if (comb.axis != PatternAxis::kColumns || p >= lit_.size()) return Status::Ok();
    SLX_ASSIGN_OR_RETURN(const auto image, frames_.ReadLinear(row));
    if (target_.lines.empty()) target_.lines.assign(2 * lit_.size(), LineSamples(comb.width, comb.period));
    if (target_.lines[0].width_px() != comb.width || target_.lines[0].period_px() != comb.period) return Status::Ok();
    const int step = 1 + image.width() / 700;  // a tenth of a million sites tells enough
    const double middle = view.ColumnsPerPx2(p, image.width() / 2, image.height() / 2);
    for (int y = 1; y + 1 < image.height(); ++y)
      for (int x = 1 + y % step; x + 1 < image.width(); x += step) {
        if (!Usable(p, x, y) || lit_[p].Is(x, y, Place::kAstray) || image(x, y) >= rig_.camera.saturation_dn) continue;
        const double moved = view.ColumnsPerPx2(p, x, y);
        if (!std::isfinite(moved)) continue;
        target_.lines[2 * p + (moved > middle ? 1 : 0)].Add(
            view.column[p](x, y), comb.shift, (image(x, y) - lit_[p].black(x, y)) / lit_[p].Contrast(x, y), moved);
      }
    return Status::Ok();
  }

  const SessionFrames& frames_;
  const RigCalibration& rig_;
  int pose_index_, pose_ = -1;
  std::vector<LitTarget> lit_;
  FlatTarget target_;
};

}  // namespace

std::vector<const db::FrameRow*> GoodRows(const SessionFrames& frames) {
  std::map<int, const db::FrameRow*> by_step;
  for (const db::FrameRow& row : frames.rows())
    if (row.record.level_check != LevelCheck::kFailed) by_step[row.record.step] = &row;
  std::vector<const db::FrameRow*> rows;
  for (const auto& [step, row] : by_step) rows.push_back(row);
  return rows;
}

Result<FlatTarget> MeasureFlat(const SessionFrames& frames, int pose_index) {
  return FlatMeasurement(frames, pose_index).Run();
}

}  // namespace stratalux::fit
