// SPDX-License-Identifier: Apache-2.0
// How the head moved during a visit, from the white frames and the codes of each projector (docs/math/motion.md).
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "fitter/motion/depth_flow.h"

namespace stratalux::fit {

// Of a projector's whites after its first one: how the head had moved since that.
struct WhiteFlow {
  double seconds = 0.0;  // since the visit's reference time
  std::optional<RigidFlow> flow;
  bool behind_jump = false;  // of a subject who jumped since the white before (docs/capture-plan.md)
};

// A projector's whites, in their order; the first one is at `first_s`.
struct ProjectorFlows {
  int projector = 0;
  double first_s = 0.0;
  std::vector<WhiteFlow> later;
};

struct HeadPose {
  double seconds = 0.0;
  SmallMotion motion;  // since the reference time, about HeadMotion::pivot
};

// What is known of the head between the whites.
struct HeadMotion {
  Eigen::Vector3d pivot = Eigen::Vector3d::Zero();  // camera frame, mm: the middle of the face
  std::vector<HeadPose> poses;                      // by time, the reference's first; empty: nothing was found out
  bool moved = false;                               // beyond noise and MotionOptions::least_mm; else At is the identity
  double largest_mm = 0.0;                          // of the surface's quads, root mean square, at the worst pose
  double sigma_mm = 0.0;                            // of the least certain pose, its standard deviation over the quads
  // Of the logarithm of the skin's detail in a projector's whites, robust standard deviation, mean over them: of a head
  // that held still, and of one that moved as found.
  double detail_before = 0.0, detail_after = 0.0;

  // x now = At(seconds) * x at the reference time; between two poses in proportion, beyond the ends as at them.
  [[nodiscard]] Rigid3 At(double seconds) const;
};

// Between the codes of two projectors.
struct CodesFlow {
  double from_s = 0.0, to_s = 0.0;
  RigidFlow flow;
};

struct MotionOptions {
  // Less is not told from a head that held still: a tenth of a column of the projector, a fifth of what triangulation
  // leaves.
  double least_mm = 0.03;
  // Of any white against the projector's first one (RigidFlow::chi_squared); of 16 whites of a head at rest the largest
  // is above 60 once in 10^9 visits.
  double least_chi_squared = 60.0;
  // Prior of the track: speeds change by so much in the square root of a second, and are so large.
  double speed_change_mm = 0.3;
  double speed_mm = 1.0;
  double lever_mm = 100.0;  // at which a turn goes as far as a shift
  // Where the controller says that the subject jumped, speeds say nothing of the stretch: it goes about so far.
  double jump_mm = 5.0;
};

// The track that agrees best with all of them: shifts across the view are the whites' word, depth the codes'; between,
// and from one projector's last white to the next one's first, the head goes on at much the same speed, but for jumps.
// `surface`: its root mean square displacement tells how far the head moved.
[[nodiscard]] HeadMotion TrackHead(std::span<const ProjectorFlows> whites, std::span<const CodesFlow> codes,
                                   const Eigen::Vector3d& pivot, const SurfaceMap& surface,
                                   const MotionOptions& options = {});

// The middle of the surface's known quads.
[[nodiscard]] Eigen::Vector3d MiddleOf(const SurfaceMap& surface);

}  // namespace stratalux::fit
