// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/head_motion.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

namespace stratalux::fit {
namespace {

// E |displacement|^2 of the surface's quads is motion^T Spread motion, and trace(Spread C) where the motion has mean 0
// and covariance C.
Matrix6 SpreadOf(const SurfaceMap& surface, const Eigen::Vector3d& pivot) {
  Matrix6 sum = Matrix6::Zero();
  int64_t quads = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const Eigen::Vector3d arm = surface.Point(i, j) - pivot;
      Eigen::Matrix<double, 3, 6> displacement = Eigen::Matrix<double, 3, 6>::Zero();
      for (int axis = 0; axis < 3; ++axis) displacement.col(axis) = Eigen::Vector3d::Unit(axis).cross(arm);
      displacement.rightCols<3>().setIdentity();
      sum.noalias() += displacement.transpose() * displacement;
      ++quads;
    }
  return quads > 0 ? Matrix6(sum / static_cast<double>(quads)) : sum;
}

// Least squares of poses at given moments: 6 numbers each, weighted observations of differences.
class Track {
 public:
  explicit Track(std::vector<double> seconds)
      : seconds_(std::move(seconds)),
        normal_(Eigen::MatrixXd::Zero(6 * Size(), 6 * Size())),
        right_(Eigen::VectorXd::Zero(6 * Size())) {}

  [[nodiscard]] Eigen::Index Size() const { return static_cast<Eigen::Index>(seconds_.size()); }
  [[nodiscard]] const std::vector<double>& seconds() const { return seconds_; }
  [[nodiscard]] Eigen::Index At(double seconds) const {
    return std::ranges::lower_bound(seconds_, seconds) - seconds_.begin();
  }

  // sum_k factor_k pose(k) is `value`, with that information.
  void Observe(std::span<const std::pair<Eigen::Index, double>> terms, const Vector6& value,
               const Matrix6& information) {
    for (const auto& [k, a] : terms) {
      right_.segment<6>(6 * k) += a * information * value;
      for (const auto& [l, b] : terms) normal_.block<6, 6>(6 * k, 6 * l) += a * b * information;
    }
  }

  void Solve() {
    const Eigen::LDLT<Eigen::MatrixXd> solver(normal_);
    poses_ = solver.solve(right_);
    covariance_ = solver.solve(Eigen::MatrixXd::Identity(normal_.rows(), normal_.cols()));
  }
  [[nodiscard]] Vector6 Pose(Eigen::Index k) const { return poses_.segment<6>(6 * k); }
  [[nodiscard]] Matrix6 CovarianceOf(Eigen::Index k) const { return covariance_.block<6, 6>(6 * k, 6 * k); }

 private:
  std::vector<double> seconds_;
  Eigen::MatrixXd normal_, covariance_;
  Eigen::VectorXd right_, poses_;
};

std::vector<double> MomentsOf(std::span<const ProjectorFlows> whites, std::span<const CodesFlow> codes) {
  std::vector<double> seconds = {0.0};
  for (const ProjectorFlows& of : whites) {
    seconds.push_back(of.first_s);
    for (const WhiteFlow& white : of.later) seconds.push_back(white.seconds);
  }
  for (const CodesFlow& of : codes) seconds.insert(seconds.end(), {of.from_s, of.to_s});
  std::ranges::sort(seconds);
  const auto repeated = std::ranges::unique(seconds);
  seconds.erase(repeated.begin(), repeated.end());
  return seconds;
}

// Moments at which a jump is over.
std::set<double> JumpsOf(std::span<const ProjectorFlows> whites) {
  std::set<double> jumps;
  for (const ProjectorFlows& of : whites)
    for (const WhiteFlow& white : of.later)
      if (white.behind_jump) jumps.insert(white.seconds);
  return jumps;
}

// Whether only frames that a jump had shot again are of that moment: no pose of it carries anything.
bool IsBeforeJump(std::span<const ProjectorFlows> whites, double seconds) {
  return std::ranges::any_of(whites, [&](const ProjectorFlows& of) {
    return of.first_s <= seconds && std::ranges::any_of(of.later, [&](const WhiteFlow& white) {
             return white.behind_jump && seconds < white.seconds;
           });
  });
}

// 0 at the reference time; speeds that change little from one stretch to the next, but where the head jumped.
void AddPrior(const std::set<double>& jumps, const MotionOptions& options, Track& track) {
  Vector6 per_mm;  // of a shift 1, of a turn what goes as far
  per_mm << Eigen::Vector3d::Constant(options.lever_mm), Eigen::Vector3d::Ones();
  const Matrix6 scaled = per_mm.cwiseAbs2().asDiagonal();
  const std::pair<Eigen::Index, double> reference[] = {{track.At(0.0), 1.0}};
  track.Observe(reference, Vector6::Zero(), 1e8 * scaled);
  const std::vector<double>& t = track.seconds();
  for (Eigen::Index k = 0; k + 1 < track.Size(); ++k) {
    const double after = t[static_cast<size_t>(k + 1)] - t[static_cast<size_t>(k)];
    if (jumps.contains(t[static_cast<size_t>(k + 1)])) {
      const std::pair<Eigen::Index, double> jump[] = {{k, -1.0}, {k + 1, 1.0}};
      track.Observe(jump, Vector6::Zero(), scaled / (options.jump_mm * options.jump_mm));
      continue;
    }
    const std::pair<Eigen::Index, double> speed[] = {{k, -1.0 / after}, {k + 1, 1.0 / after}};
    track.Observe(speed, Vector6::Zero(),
                  scaled * (after / (options.speed_mm * options.speed_mm * (t.back() - t.front()))));
    if (k == 0 || jumps.contains(t[static_cast<size_t>(k)])) continue;
    const double before = t[static_cast<size_t>(k)] - t[static_cast<size_t>(k - 1)];
    const std::pair<Eigen::Index, double> change[] = {
        {k - 1, 1.0 / before}, {k, -1.0 / before - 1.0 / after}, {k + 1, 1.0 / after}};
    const double variance = options.speed_change_mm * options.speed_change_mm * 0.5 * (before + after);
    track.Observe(change, Vector6::Zero(), scaled / variance);
  }
}

}  // namespace

Rigid3 HeadMotion::At(double seconds) const {
  if (!moved || poses.empty()) return {};
  const auto after = std::ranges::upper_bound(poses, seconds, {}, [](const HeadPose& pose) { return pose.seconds; });
  if (after == poses.begin()) return poses.front().motion.About(pivot);
  if (after == poses.end()) return poses.back().motion.About(pivot);
  const HeadPose& before = *(after - 1);
  const double share = (seconds - before.seconds) / (after->seconds - before.seconds);
  const Vector6 motion = (1.0 - share) * before.motion.Vector() + share * after->motion.Vector();
  return SmallMotion::From(motion).About(pivot);
}

HeadMotion TrackHead(std::span<const ProjectorFlows> whites, std::span<const CodesFlow> codes,
                     const Eigen::Vector3d& pivot, const SurfaceMap& surface, const MotionOptions& options) {
  HeadMotion head;
  head.pivot = pivot;
  Track track(MomentsOf(whites, codes));
  double before = 0.0, after = 0.0, chi_squared = 0.0;
  int compared = 0;
  const auto observe = [&](double from_s, double to_s, const RigidFlow& flow) {
    const std::pair<Eigen::Index, double> between[] = {{track.At(from_s), -1.0}, {track.At(to_s), 1.0}};
    track.Observe(between, flow.motion.Vector(), flow.covariance.inverse());
  };
  for (const ProjectorFlows& of : whites)
    for (const WhiteFlow& white : of.later) {
      if (!white.flow) continue;
      observe(of.first_s, white.seconds, *white.flow);
      before += white.flow->residual_still;
      after += white.flow->residual;
      chi_squared = std::max(chi_squared, white.flow->chi_squared);
      ++compared;
    }
  if (compared == 0) return head;
  head.detail_before = before / compared;
  head.detail_after = after / compared;
  for (const CodesFlow& of : codes) observe(of.from_s, of.to_s, of.flow);
  AddPrior(JumpsOf(whites), options, track);
  track.Solve();
  const Matrix6 spread = SpreadOf(surface, pivot);
  for (Eigen::Index k = 0; k < track.Size(); ++k) {
    const Vector6 pose = track.Pose(k);
    head.poses.push_back({track.seconds()[static_cast<size_t>(k)], SmallMotion::From(pose)});
    if (IsBeforeJump(whites, track.seconds()[static_cast<size_t>(k)])) continue;
    head.largest_mm = std::max(head.largest_mm, std::sqrt(std::max(0.0, pose.dot(spread * pose))));
    head.sigma_mm = std::max(head.sigma_mm, std::sqrt(std::max(0.0, (spread * track.CovarianceOf(k)).trace())));
  }
  head.moved = chi_squared > options.least_chi_squared && head.largest_mm > options.least_mm;
  return head;
}

Eigen::Vector3d MiddleOf(const SurfaceMap& surface) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int64_t quads = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0) {
        sum += surface.Point(i, j);
        ++quads;
      }
  return quads > 0 ? Eigen::Vector3d(sum / static_cast<double>(quads)) : sum;
}

}  // namespace stratalux::fit
