// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/calibrate_rig.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "fitter/calibration/initial_rig.h"
#include "shared/base/parallel_each.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

constexpr int kRejectRounds = 3;
constexpr size_t kLeastPoses = 3;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

BundleOptions BundleOptionsFor(const CalibrateOptions& options, DistortionModel model) {
  BundleOptions bundle;
  bundle.distortion = model;
  if (options.known_camera) bundle.known = Known::kCameraIntrinsics;
  return bundle;
}

// Largest residual of a corner, in standard deviations of the device.
double WorstSigmas(const CalibrationObservations& observations, const BundleReport& report, size_t k,
                   const CornerObservation& corner) {
  const RigGeometry& rig = report.bundle.rig;
  const Rigid3& board = report.bundle.camera_from_board[k];
  const Eigen::Vector2d mm = observations.board.CornerMm(corner.corner);
  const auto seen = rig.camera.Project(board * Eigen::Vector3d(mm.x(), mm.y(), 0.0));
  double worst = seen ? (*seen - corner.camera_px).norm() / report.sigma_px[0] : kInfinity;
  const Eigen::Vector3d normal = board.rotation * Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d ray = rig.camera.Unproject(corner.camera_px);
  const Eigen::Vector3d point = ray * (normal.dot(board.translation_mm) / normal.dot(ray));
  for (size_t p = 0; p < rig.projectors.size(); ++p) {
    if (!corner.projector_px[p]) continue;
    const ProjectorGeometry& projector = rig.projectors[p];
    const auto lit = projector.model.Project(projector.camera_from_projector.Inverse() * point);
    worst = std::max(worst, lit ? (*lit - *corner.projector_px[p]).norm() / report.sigma_px[1 + p] : kInfinity);
  }
  return worst;
}

// Takes the corners out whose residuals the noise cannot explain.
std::vector<RejectedCorner> Reject(const BundleReport& report, double limit_sigmas, CalibrationObservations& used) {
  std::vector<RejectedCorner> rejected;
  const CalibrationObservations before = used;
  for (size_t k = 0; k < used.poses.size(); ++k) {
    PoseObservation& pose = used.poses[k];
    std::erase_if(pose.corners, [&](const CornerObservation& corner) {
      const double sigmas = WorstSigmas(before, report, k, corner);
      if (sigmas <= limit_sigmas) return false;
      rejected.push_back({pose.name, corner.corner, sigmas});
      return true;
    });
  }
  return rejected;
}

// Poses of which too little is left to place their boards go, and the boards with them.
void LeaveOutPoses(CalibrationObservations& used, Bundle& bundle, std::vector<std::string>& left_out) {
  for (size_t k = used.poses.size(); k-- > 0;) {
    const PoseObservation& pose = used.poses[k];
    if (pose.corners.size() >= size_t{kLeastCorners}) continue;
    left_out.push_back(pose.name +
                       ": nearly all of its corners contradict the other poses; the board moved in it, or a "
                       "projector did: capture this pose again");
    used.poses.erase(used.poses.begin() + static_cast<std::ptrdiff_t>(k));
    bundle.camera_from_board.erase(bundle.camera_from_board.begin() + static_cast<std::ptrdiff_t>(k));
  }
}

// Adjusts, rejects, adjusts again until nothing more goes. What went is in `report`.
Result<BundleReport> AdjustWithRejection(const Bundle& start, const BundleOptions& bundle_options, double reject_sigmas,
                                         GeometryReport& report) {
  SLX_ASSIGN_OR_RETURN(BundleReport adjusted, AdjustBundle(report.used, start, bundle_options));
  for (int round = 0; round < kRejectRounds; ++round) {
    const auto more = Reject(adjusted, reject_sigmas, report.used);
    if (more.empty()) break;
    report.rejected.insert(report.rejected.end(), more.begin(), more.end());
    Bundle warm = adjusted.bundle;
    LeaveOutPoses(report.used, warm, report.left_out);
    if (report.used.poses.size() < kLeastPoses)
      return Status::Failed("the poses contradict each other; " + report.left_out.front());
    SLX_ASSIGN_OR_RETURN(adjusted, AdjustBundle(report.used, warm, bundle_options));
  }
  return adjusted;
}

HeldOutPose Failed(const CalibrationObservations& observations, size_t k) {
  HeldOutPose pose{observations.poses[k].name, DeviceErrors(1 + observations.projectors.size()), kInfinity};
  pose.errors.squares[0] = kInfinity;
  pose.errors.counts[0] = 1;
  return pose;
}

std::vector<HeldOutPose> HoldOut(const CalibrationObservations& observations, const BundleReport& all,
                                 const BundleOptions& options) {
  std::vector<HeldOutPose> held_out(observations.poses.size());
  ParallelEach(held_out.size(), [&](size_t k) {
    CalibrationObservations others = observations;
    Bundle start = all.bundle;
    others.poses.erase(others.poses.begin() + static_cast<std::ptrdiff_t>(k));
    start.camera_from_board.erase(start.camera_from_board.begin() + static_cast<std::ptrdiff_t>(k));
    const auto without = AdjustBundle(others, start, options);
    std::optional<HeldOutPose> pose;
    if (without.ok()) pose = FitPose(without->bundle.rig, options.sigma_px, observations.board, observations.poses[k]);
    held_out[k] = pose ? *pose : Failed(observations, k);
  });
  return held_out;
}

double SurpriseOf(const std::vector<HeldOutPose>& held_out) {
  double sum = 0.0;
  for (const HeldOutPose& pose : held_out) sum += pose.surprise * pose.surprise;
  return std::sqrt(sum / static_cast<double>(held_out.size()));
}

DeviceErrors TotalOf(const std::vector<HeldOutPose>& held_out) {
  DeviceErrors total(held_out.front().errors.squares.size());
  for (const HeldOutPose& pose : held_out) total.Add(pose.errors);
  return total;
}

struct FittedModel {
  ModelTrial trial;
  BundleReport bundle;
  std::vector<HeldOutPose> held_out;
};

// The richest that predicts held-out poses about as well as the best: a term too many widens the standard deviations,
// which says so; a term too few moves the others away from the truth, and nothing says so.
const FittedModel& Choose(const std::vector<FittedModel>& fitted, double richer_within) {
  double least = kInfinity;
  for (const FittedModel& f : fitted) least = std::min(least, f.trial.held_out_sigmas);
  const FittedModel* chosen = &fitted.front();
  for (const FittedModel& f : fitted)
    if (f.trial.held_out_sigmas <= (1.0 + richer_within) * least) chosen = &f;
  return *chosen;
}

void CountCell(std::vector<int>& cells, const DeviceSize& size, const Eigen::Vector2d& pixel) {
  const int column = static_cast<int>((pixel.x() + 0.5) / size.width * kCoverageColumns);
  const int row = static_cast<int>((pixel.y() + 0.5) / size.height * kCoverageRows);
  if (column >= 0 && row >= 0 && column < kCoverageColumns && row < kCoverageRows)
    ++cells[row * kCoverageColumns + column];
}

void Cover(const CalibrationObservations& o, GeometryReport& report) {
  report.coverage_map.assign(1 + o.projectors.size(), std::vector<int>(kCoverageColumns * kCoverageRows, 0));
  for (const PoseObservation& pose : o.poses)
    for (const CornerObservation& corner : pose.corners) {
      ++report.corners;
      CountCell(report.coverage_map[0], o.camera, corner.camera_px);
      for (size_t p = 0; p < o.projectors.size(); ++p)
        if (corner.projector_px[p]) CountCell(report.coverage_map[1 + p], o.projectors[p], *corner.projector_px[p]);
    }
  for (const std::vector<int>& cells : report.coverage_map) {
    const auto covered = std::count_if(cells.begin(), cells.end(), [](int n) { return n > 0; });
    report.coverage.push_back(static_cast<double>(covered) / static_cast<double>(cells.size()));
  }
}

// Intrinsics of another picture size (binned, cropped) would be kept as they are, and all else bent to them.
Status CheckKnownCamera(const std::optional<Pinhole>& known, const DeviceSize& camera) {
  if (!known || (known->width == camera.width && known->height == camera.height)) return Status::Ok();
  return Status::Usage("known camera: its pictures have " + std::to_string(known->width) + "x" +
                       std::to_string(known->height) + " pixels, those of the sessions' camera " +
                       std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                       "; give the record of this camera");
}

void Measure(GeometryReport& report) {
  const CalibrationObservations& o = report.used;
  report.training_total = report.epipolar = DeviceErrors(1 + o.projectors.size());
  for (size_t k = 0; k < o.poses.size(); ++k) {
    const Rigid3& board = report.bundle.camera_from_board[k];
    report.training.push_back(ReprojectionErrors(report.bundle.rig, o.board, board, o.poses[k]));
    report.training_total.Add(report.training.back());
    report.epipolar.Add(EpipolarErrors(report.bundle.rig, o.poses[k]));
    const double cosine = std::abs((board.rotation * Eigen::Vector3d::UnitZ()).z());
    report.tilt_deg.push_back(DegFromRad(std::acos(std::min(cosine, 1.0))));
  }
  Cover(o, report);
}

}  // namespace

Status CalibrateOptions::Validate() const {
  if (known_camera) SLX_RETURN_IF_ERROR(known_camera->Validate().WithContext("known camera"));
  if (!(reject_sigmas >= 3.0))
    return Status::Usage("reject_sigmas = " + std::to_string(reject_sigmas) +
                         " would reject good corners; allowed: at least 3");
  return Status::Ok();
}

std::optional<HeldOutPose> FitPose(const RigGeometry& rig, const std::vector<double>& sigma_px,
                                   const BoardDescription& board, const PoseObservation& pose) {
  const auto start = BoardPoseFromCamera(rig.camera, board, pose);
  if (!start) return std::nullopt;
  CalibrationObservations one;
  one.board = board;
  one.projectors.resize(rig.projectors.size());
  one.poses = {pose};
  BundleOptions options;
  options.known = Known::kWholeRig;
  options.sigma_px = sigma_px;
  const auto fitted = AdjustBundle(one, {rig, {*start}}, options);
  if (!fitted.ok()) return std::nullopt;
  HeldOutPose result{pose.name, ReprojectionErrors(rig, board, fitted->bundle.camera_from_board[0], pose), 0.0};
  const int pairs = std::accumulate(result.errors.counts.begin(), result.errors.counts.end(), 0);
  result.surprise = std::sqrt(fitted->cost / pairs);  // half the sum of squares, over half the number of residuals
  return result;
}

Result<GeometryReport> CalibrateRig(const CalibrationObservations& observations, const CalibrateOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckKnownCamera(options.known_camera, observations.camera));
  SLX_ASSIGN_OR_RETURN(const Bundle start, StartBundle(observations, options.known_camera));
  GeometryReport report;
  report.used = observations;
  // Bad corners go by the richest model, which no good corner contradicts; then all models see the same ones.
  const DistortionModel richest = options.distortion.value_or(DistortionModel::kFull);
  SLX_ASSIGN_OR_RETURN(BundleReport adjusted,
                       AdjustWithRejection(start, BundleOptionsFor(options, richest), options.reject_sigmas, report));
  std::vector<FittedModel> fitted;
  for (const DistortionModel model : {DistortionModel::kK1, DistortionModel::kK1K2, DistortionModel::kFull}) {
    if (options.distortion && *options.distortion != model) continue;
    BundleOptions bundle_options = BundleOptionsFor(options, model);
    auto bundle = AdjustBundle(report.used, adjusted.bundle, bundle_options);
    if (!bundle.ok()) {
      report.trials.push_back({model, kInfinity, kInfinity});
      continue;
    }
    bundle_options.sigma_px = adjusted.sigma_px;  // one measure for all models
    std::vector<HeldOutPose> held_out = HoldOut(report.used, *bundle, bundle_options);
    report.trials.push_back({model, SurpriseOf(held_out), TotalOf(held_out).JointRms()});
    fitted.push_back({report.trials.back(), std::move(bundle).value(), std::move(held_out)});
  }
  if (fitted.empty()) return Status::Failed("no distortion model could be fitted to the corners");
  const FittedModel& best = Choose(fitted, options.richer_within);
  report.bundle = best.bundle.bundle;
  report.sigma_px = best.bundle.sigma_px;
  report.distortion = best.trial.model;
  report.held_out = best.held_out;
  report.held_out_total = TotalOf(best.held_out);
  BundleReport chosen{report.bundle, report.sigma_px, 0, 0.0};
  if (auto covariances = DeviceCovariances(report.used, chosen, BundleOptionsFor(options, report.distortion));
      covariances.ok())
    report.covariances = std::move(covariances).value();
  Measure(report);
  return report;
}

}  // namespace stratalux::fit
