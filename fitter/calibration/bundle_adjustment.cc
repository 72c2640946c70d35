// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/bundle_adjustment.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include <ceres/ceres.h>

#include "fitter/calibration/corner_residuals.h"

namespace stratalux::fit {
namespace {

constexpr std::array<const char*, 3> kModels = {"k1", "k1k2", "full"};
constexpr std::array<const char*, kIntrinsics + kPoseParameters> kParameters = {
    "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "rx", "ry", "rz", "tx", "ty", "tz"};
constexpr double kLeastSigmaPx = 0.005;
constexpr int kSigmaRounds = 4;

using Intrinsics = std::array<double, kIntrinsics>;
using PoseVector = std::array<double, kPoseParameters>;

Intrinsics ToVector(const Pinhole& m) {
  Intrinsics v{m.fx, m.fy, m.cx, m.cy};
  std::copy(m.distortion.begin(), m.distortion.end(), v.begin() + 4);
  return v;
}

Pinhole ToPinhole(const Intrinsics& v, Pinhole m) {
  m.fx = v[0];
  m.fy = v[1];
  m.cx = v[2];
  m.cy = v[3];
  std::copy(v.begin() + 4, v.end(), m.distortion.begin());
  return m;
}

PoseVector ToVector(const Rigid3& pose) {
  const Eigen::AngleAxisd turn(pose.rotation);
  const Eigen::Vector3d w = turn.angle() * turn.axis();
  const Eigen::Vector3d& t = pose.translation_mm;
  return {w.x(), w.y(), w.z(), t.x(), t.y(), t.z()};
}

Rigid3 ToRigid(const PoseVector& v) {
  const Eigen::Vector3d w(v[0], v[1], v[2]);
  const double angle = w.norm();
  Rigid3 pose;
  if (angle > 0.0) pose.rotation = Eigen::AngleAxisd(angle, w / angle);
  pose.translation_mm = {v[3], v[4], v[5]};
  return pose;
}

// Indices of the intrinsics that stay.
std::vector<int> FixedIntrinsics(DistortionModel model) {
  switch (model) {
    case DistortionModel::kK1:
      return {5, 6, 7, 8};
    case DistortionModel::kK1K2:
      return {6, 7, 8};
    case DistortionModel::kFull:
      break;
  }
  return {};
}

// The parameters in the shape Ceres wants them, and the problem over them.
class BundleProblem {
 public:
  BundleProblem(const CalibrationObservations& observations, const Bundle& start, const BundleOptions& options)
      : observations_(observations), options_(options), start_(start), camera_(ToVector(start.rig.camera)) {
    for (const ProjectorGeometry& p : start.rig.projectors) {
      projectors_.push_back(ToVector(p.model));
      places_.push_back(ToVector(p.camera_from_projector));
    }
    for (const Rigid3& pose : start.camera_from_board) boards_.push_back(ToVector(pose));
    if (options.known != Known::kWholeRig)
      for (Intrinsics& p : projectors_) ZeroFixed(p);
    if (options.known == Known::kNothing) ZeroFixed(camera_);
  }

  // Residuals in units of `sigma_px`.
  void Build(const std::vector<double>& sigma_px) {
    problem_ = std::make_unique<ceres::Problem>();
    for (size_t k = 0; k < observations_.poses.size(); ++k)
      for (const CornerObservation& corner : observations_.poses[k].corners) AddCorner(corner, k, sigma_px);
    Hold(camera_, options_.known != Known::kNothing);
    for (Intrinsics& p : projectors_) Hold(p, options_.known == Known::kWholeRig);
    if (options_.known == Known::kWholeRig)
      for (PoseVector& place : places_)
        if (problem_->HasParameterBlock(place.data())) problem_->SetParameterBlockConstant(place.data());
  }

  Status Solve(int& iterations, double& cost) {
    ceres::Solver::Options solver;
    solver.linear_solver_type = ceres::DENSE_SCHUR;
    solver.max_num_iterations = 100;
    solver.function_tolerance = 1e-10;
    solver.parameter_tolerance = 1e-10;
    solver.logging_type = ceres::SILENT;
    solver.num_threads = 1;  // more would add up in another order each time
    double start_cost = 0.0;
    if (!problem_->Evaluate({}, &start_cost, nullptr, nullptr, nullptr))
      return Status::Failed("bundle adjustment: part of a board lies behind a device");
    ceres::Solver::Summary summary;
    ceres::Solve(solver, problem_.get(), &summary);
    iterations += static_cast<int>(summary.iterations.size());
    cost = summary.final_cost;
    return summary.IsSolutionUsable() ? Status::Ok() : Status::Failed("bundle adjustment: " + summary.message);
  }

  [[nodiscard]] Bundle Result() const {
    Bundle bundle = start_;
    bundle.rig.camera = ToPinhole(camera_, start_.rig.camera);
    for (size_t p = 0; p < projectors_.size(); ++p)
      bundle.rig.projectors[p] = {ToPinhole(projectors_[p], start_.rig.projectors[p].model), ToRigid(places_[p])};
    for (size_t k = 0; k < boards_.size(); ++k) bundle.camera_from_board[k] = ToRigid(boards_[k]);
    return bundle;
  }

  // Robust standard deviations of the residuals, by device.
  [[nodiscard]] std::vector<double> Sigmas() const {
    std::vector<std::vector<double>> absolute(1 + projectors_.size());
    for (size_t k = 0; k < observations_.poses.size(); ++k)
      for (const CornerObservation& corner : observations_.poses[k].corners) {
        std::array<double, 2> r{};
        const CameraCornerResidual seen{observations_.board.CornerMm(corner.corner), corner.camera_px};
        if (!seen(camera_.data(), boards_[k].data(), r.data())) continue;
        for (double v : r) absolute[0].push_back(std::abs(v));
        for (size_t p = 0; p < projectors_.size(); ++p) {
          if (!corner.projector_px[p]) continue;
          const TransferResidual transfer{corner.camera_px, *corner.projector_px[p]};
          if (!transfer(camera_.data(), projectors_[p].data(), places_[p].data(), boards_[k].data(), r.data()))
            continue;
          for (double v : r) absolute[1 + p].push_back(std::abs(v));
        }
      }
    std::vector<double> sigmas;
    for (std::vector<double>& values : absolute) sigmas.push_back(FromAbsolute(values));
    return sigmas;
  }

  [[nodiscard]] ::stratalux::Result<std::vector<Eigen::MatrixXd>> Covariances() {
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::DENSE_SVD;
    options.min_reciprocal_condition_number = 1e-22;
    ceres::Covariance covariance(options);
    std::vector<const double*> all;
    if (options_.known == Known::kNothing) all.push_back(camera_.data());
    for (size_t p = 0; p < projectors_.size(); ++p) {
      all.push_back(projectors_[p].data());
      all.push_back(places_[p].data());
    }
    if (!covariance.Compute(all, problem_.get()))
      return Status::Failed(
          "the corners do not determine all parameters; capture more poses, tilted in different ways");
    std::vector<Eigen::MatrixXd> result;
    Eigen::Matrix<double, kIntrinsics, kIntrinsics, Eigen::RowMajor> camera;
    camera.setZero();
    if (options_.known == Known::kNothing) covariance.GetCovarianceMatrix({camera_.data()}, camera.data());
    result.emplace_back(camera);
    for (size_t p = 0; p < projectors_.size(); ++p) {
      constexpr int kSize = kIntrinsics + kPoseParameters;
      Eigen::Matrix<double, kSize, kSize, Eigen::RowMajor> block;
      covariance.GetCovarianceMatrix({projectors_[p].data(), places_[p].data()}, block.data());
      result.emplace_back(block);
    }
    return result;
  }

 private:
  void ZeroFixed(Intrinsics& v) const {
    for (int i : FixedIntrinsics(options_.distortion)) v[i] = 0.0;
  }

  void Hold(Intrinsics& v, bool whole) {
    if (!problem_->HasParameterBlock(v.data())) return;
    const std::vector<int> fixed = FixedIntrinsics(options_.distortion);
    if (whole)
      problem_->SetParameterBlockConstant(v.data());
    else if (!fixed.empty())
      problem_->SetManifold(v.data(), new ceres::SubsetManifold(kIntrinsics, fixed));
  }

  void AddCorner(const CornerObservation& corner, size_t k, const std::vector<double>& sigma_px) {
    problem_->AddResidualBlock(
        new ceres::AutoDiffCostFunction<CameraCornerResidual, 2, kIntrinsics, kPoseParameters>(
            new CameraCornerResidual{observations_.board.CornerMm(corner.corner), corner.camera_px, sigma_px[0]}),
        new ceres::HuberLoss(options_.outlier_sigmas), camera_.data(), boards_[k].data());
    for (size_t p = 0; p < projectors_.size(); ++p) {
      if (!corner.projector_px[p]) continue;
      problem_->AddResidualBlock(new ceres::AutoDiffCostFunction<TransferResidual, 2, kIntrinsics, kIntrinsics,
                                                                 kPoseParameters, kPoseParameters>(
                                     new TransferResidual{corner.camera_px, *corner.projector_px[p], sigma_px[1 + p]}),
                                 new ceres::HuberLoss(options_.outlier_sigmas), camera_.data(), projectors_[p].data(),
                                 places_[p].data(), boards_[k].data());
    }
  }

  static double FromAbsolute(std::vector<double>& values) {
    if (values.empty()) return 1.0;
    // Of 2-D noise: the median would ignore a third of bad corners, the mean none; the mean of the lower 95 % bends
    // little either way.
    std::sort(values.begin(), values.end());
    const size_t kept = std::max<size_t>(values.size() * 95 / 100, 1);
    double sum = 0.0;
    for (size_t i = 0; i < kept; ++i) sum += values[i] * values[i];
    constexpr double kTrimmedVariance = 0.7588;  // of a unit normal, its 95 % of least size
    return std::max(std::sqrt(sum / static_cast<double>(kept) / kTrimmedVariance), kLeastSigmaPx);
  }

  const CalibrationObservations& observations_;
  const BundleOptions& options_;
  const Bundle& start_;
  Intrinsics camera_;
  std::vector<Intrinsics> projectors_;
  std::vector<PoseVector> places_, boards_;
  std::unique_ptr<ceres::Problem> problem_;
};

}  // namespace

const char* ToString(DistortionModel model) { return kModels[static_cast<size_t>(model)]; }

Result<DistortionModel> ParseDistortionModel(const std::string& text) {
  for (size_t i = 0; i < kModels.size(); ++i)
    if (text == kModels[i]) return static_cast<DistortionModel>(i);
  return Status::Usage("distortion model '" + text + "' is unknown; allowed: k1, k1k2, full");
}

const char* ParameterName(int index) { return kParameters[static_cast<size_t>(index)]; }

Result<BundleReport> AdjustBundle(const CalibrationObservations& observations, const Bundle& start,
                                  const BundleOptions& options) {
  BundleProblem problem(observations, start, options);
  BundleReport report;
  const bool known = !options.sigma_px.empty();
  // The weights follow the residuals, the residuals the weights: a few rounds settle both.
  report.sigma_px = known ? options.sigma_px : std::vector<double>(1 + start.rig.projectors.size(), 1.0);
  for (int round = 0; round < (known ? 1 : kSigmaRounds); ++round) {
    if (round > 0) report.sigma_px = problem.Sigmas();
    problem.Build(report.sigma_px);
    SLX_RETURN_IF_ERROR(problem.Solve(report.iterations, report.cost));
  }
  report.bundle = problem.Result();
  return report;
}

Result<std::vector<Eigen::MatrixXd>> DeviceCovariances(const CalibrationObservations& observations,
                                                       const BundleReport& adjusted, const BundleOptions& options) {
  BundleProblem problem(observations, adjusted.bundle, options);
  problem.Build(adjusted.sigma_px);
  return problem.Covariances();
}

}  // namespace stratalux::fit
