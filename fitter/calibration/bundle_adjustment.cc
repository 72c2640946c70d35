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
      : observations_(observations),
        options_(options),
        start_(start),
        values_(kIntrinsics + (kIntrinsics + kPoseParameters) * start.rig.projectors.size() +
                kPoseParameters * start.camera_from_board.size()) {
    Store(ToVector(start.rig.camera), Camera());
    for (size_t p = 0; p < projectors(); ++p) {
      Store(ToVector(start.rig.projectors[p].model), Projector(p));
      Store(ToVector(start.rig.projectors[p].camera_from_projector), Place(p));
    }
    for (size_t k = 0; k < start.camera_from_board.size(); ++k) Store(ToVector(start.camera_from_board[k]), Board(k));
    if (options.known != Known::kWholeRig)
      for (size_t p = 0; p < projectors(); ++p) ZeroFixed(Projector(p));
    if (options.known == Known::kNothing) ZeroFixed(Camera());
  }

  // Residuals in units of `sigma_px`.
  void Build(const std::vector<double>& sigma_px) {
    problem_ = std::make_unique<ceres::Problem>();
    for (size_t k = 0; k < observations_.poses.size(); ++k)
      for (const CornerObservation& corner : observations_.poses[k].corners) AddCorner(corner, k, sigma_px);
    Hold(Camera(), options_.known != Known::kNothing);
    for (size_t p = 0; p < projectors(); ++p) {
      Hold(Projector(p), options_.known == Known::kWholeRig);
      if (options_.known == Known::kWholeRig && problem_->HasParameterBlock(Place(p)))
        problem_->SetParameterBlockConstant(Place(p));
    }
  }

  Status Solve(int& iterations, double& cost) {
    ceres::Solver::Options solver;
    solver.linear_solver_type = ceres::DENSE_SCHUR;
    solver.max_num_iterations = 100;
    solver.function_tolerance = 1e-10;
    solver.parameter_tolerance = 1e-10;
    solver.logging_type = ceres::SILENT;
    solver.num_threads = 1;  // more would add up in another order each time
    auto order = std::make_shared<ceres::ParameterBlockOrdering>();
    std::vector<double*> blocks;
    problem_->GetParameterBlocks(&blocks);
    for (double* block : blocks)
      order->AddElementToGroup(block, block >= Board(0) ? 0 : 1 + static_cast<int>(block - Camera()));
    solver.linear_solver_ordering = order;
    double start_cost = 0.0;
    if (!problem_->Evaluate({}, &start_cost, nullptr, nullptr, nullptr))
      return Status::Failed("bundle adjustment: part of a board lies behind a device");
    ceres::Solver::Summary summary;
    ceres::Solve(solver, problem_.get(), &summary);
    iterations += static_cast<int>(summary.iterations.size());
    cost = summary.final_cost;
    return summary.IsSolutionUsable() ? Status::Ok() : Status::Failed("bundle adjustment: " + summary.message);
  }

  [[nodiscard]] Bundle Result() {
    Bundle bundle = start_;
    bundle.rig.camera = ToPinhole(Load<kIntrinsics>(Camera()), start_.rig.camera);
    for (size_t p = 0; p < projectors(); ++p)
      bundle.rig.projectors[p] = {ToPinhole(Load<kIntrinsics>(Projector(p)), start_.rig.projectors[p].model),
                                  ToRigid(Load<kPoseParameters>(Place(p)))};
    for (size_t k = 0; k < bundle.camera_from_board.size(); ++k)
      bundle.camera_from_board[k] = ToRigid(Load<kPoseParameters>(Board(k)));
    return bundle;
  }

  // Robust standard deviations of the residuals, by device.
  [[nodiscard]] std::vector<double> Sigmas() {
    std::vector<std::vector<double>> absolute(1 + projectors());
    for (size_t k = 0; k < observations_.poses.size(); ++k)
      for (const CornerObservation& corner : observations_.poses[k].corners) {
        std::array<double, 2> r{};
        const CameraCornerResidual seen{observations_.board.CornerMm(corner.corner), corner.camera_px};
        if (!seen(Camera(), Board(k), r.data())) continue;
        for (double v : r) absolute[0].push_back(std::abs(v));
        for (size_t p = 0; p < projectors(); ++p) {
          if (!corner.projector_px[p]) continue;
          const TransferResidual transfer{corner.camera_px, *corner.projector_px[p]};
          if (!transfer(Camera(), Projector(p), Place(p), Board(k), r.data())) continue;
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
    if (options_.known == Known::kNothing) all.push_back(Camera());
    for (size_t p = 0; p < projectors(); ++p) {
      all.push_back(Projector(p));
      all.push_back(Place(p));
    }
    if (!covariance.Compute(all, problem_.get()))
      return Status::Failed(
          "the corners do not determine all parameters; capture more poses, tilted in different ways");
    std::vector<Eigen::MatrixXd> result;
    Eigen::Matrix<double, kIntrinsics, kIntrinsics, Eigen::RowMajor> camera;
    camera.setZero();
    if (options_.known == Known::kNothing) covariance.GetCovarianceMatrix({Camera()}, camera.data());
    result.emplace_back(camera);
    for (size_t p = 0; p < projectors(); ++p) {
      constexpr int kSize = kIntrinsics + kPoseParameters;
      Eigen::Matrix<double, kSize, kSize, Eigen::RowMajor> block;
      covariance.GetCovarianceMatrix({Projector(p), Place(p)}, block.data());
      result.emplace_back(block);
    }
    return result;
  }

 private:
  [[nodiscard]] size_t projectors() const { return start_.rig.projectors.size(); }
  double* Camera() { return values_.data(); }
  double* Projector(size_t p) { return values_.data() + kIntrinsics + (kIntrinsics + kPoseParameters) * p; }
  double* Place(size_t p) { return Projector(p) + kIntrinsics; }
  double* Board(size_t k) { return Projector(projectors()) + kPoseParameters * k; }
  template <size_t kSize>
  static void Store(const std::array<double, kSize>& from, double* to) {
    std::copy(from.begin(), from.end(), to);
  }
  template <size_t kSize>
  static std::array<double, kSize> Load(const double* from) {
    std::array<double, kSize> to;
    std::copy_n(from, kSize, to.begin());
    return to;
  }

  void ZeroFixed(double* v) const {
    for (int i : FixedIntrinsics(options_.distortion)) v[i] = 0.0;
  }

  void Hold(double* v, bool whole) {
    if (!problem_->HasParameterBlock(v)) return;
    const std::vector<int> fixed = FixedIntrinsics(options_.distortion);
    if (whole)
      problem_->SetParameterBlockConstant(v);
    else if (!fixed.empty())
      problem_->SetManifold(v, new ceres::SubsetManifold(kIntrinsics, fixed));
  }

  void AddCorner(const CornerObservation& corner, size_t k, const std::vector<double>& sigma_px) {
    problem_->AddResidualBlock(
        new ceres::AutoDiffCostFunction<CameraCornerResidual, 2, kIntrinsics, kPoseParameters>(
            new CameraCornerResidual{observations_.board.CornerMm(corner.corner), corner.camera_px, sigma_px[0]}),
        new ceres::HuberLoss(options_.outlier_sigmas), Camera(), Board(k));
    for (size_t p = 0; p < projectors(); ++p) {
      if (!corner.projector_px[p]) continue;
      problem_->AddResidualBlock(new ceres::AutoDiffCostFunction<TransferResidual, 2, kIntrinsics, kIntrinsics,
                                                                 kPoseParameters, kPoseParameters>(
                                     new TransferResidual{corner.camera_px, *corner.projector_px[p], sigma_px[1 + p]}),
                                 new ceres::HuberLoss(options_.outlier_sigmas), Camera(), Projector(p), Place(p),
                                 Board(k));
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
  // All parameters, in one piece: Ceres sorts blocks by address, and the same order gives the same bits.
  std::vector<double> values_;
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
