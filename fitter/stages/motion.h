// SPDX-License-Identifier: Apache-2.0
// How the head moved during the visit, and what of each projector was captured when: what shape, SRDs and comparisons
// need to speak of one moment, that of the visit's first white frame.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "fitter/motion/head_motion.h"
#include "fitter/motion/moved_surface.h"
#include "fitter/separation/separation_map.h"
#include "fitter/session/session_frames.h"
#include "fitter/structured_light/decoded_map.h"
#include "shared/units/time.h"

namespace stratalux::fit {

// Mean moments of a projector's frames, seconds after the reference time.
struct ProjectorMoments {
  double codes_s = 0.0, separation_s = 0.0, sweep_s = 0.0;
};

struct FaceMotion {
  HeadMotion head;
  MonotonicNs reference;                     // by the frames' trigger times
  std::vector<ProjectorMoments> projectors;  // empty: nothing was asked
  // White frames after each projector's first, all together; nullopt: nothing was asked, or an older fit does not say.
  std::optional<int> later_whites;

  [[nodiscard]] bool moved() const { return head.moved; }
  [[nodiscard]] double SecondsOf(MonotonicNs time) const { return ToMilliseconds(time - reference) / 1000.0; }
};

// Of the whites of all projectors that `lit` says they light, on the surface as it was reconstructed without regard to
// motion. No projector has two good whites: it is not known to have moved.
[[nodiscard]] Result<FaceMotion> FindMotion(const SessionFrames& frames, std::span<const DecodedMap> decoded,
                                            const SurfaceMap& surface, std::span<const Image<uint8_t>> lit);

// A rig whose projectors stand where they stood to the head at those moments, the head being where it is at the
// reference time. `moment`: which of them.
[[nodiscard]] RigCalibration RigAt(const RigCalibration& rig, const FaceMotion& motion,
                                   double ProjectorMoments::*moment);

// What each projector's codes and lights are on the quads of the reference time.
[[nodiscard]] std::vector<DecodedMap> AtReference(std::span<const DecodedMap> decoded, const SurfaceMap& surface,
                                                  const RigCalibration& rig, const FaceMotion& motion);
[[nodiscard]] std::vector<SeparationMap> AtReference(std::span<const SeparationMap> separation,
                                                     const SurfaceMap& surface, const RigCalibration& rig,
                                                     const FaceMotion& motion);

// For people: by how much it moved.
[[nodiscard]] std::string Describe(const FaceMotion& motion);
// What was lacking to find it, where there are no poses.
[[nodiscard]] std::string WhyUnknown(const FaceMotion& motion);

// motion.json; without it (a fit of an earlier version) nothing is known.
Status SaveMotion(const std::filesystem::path& folder, const FaceMotion& motion);
[[nodiscard]] Result<FaceMotion> LoadMotion(const std::filesystem::path& folder);

}  // namespace stratalux::fit
