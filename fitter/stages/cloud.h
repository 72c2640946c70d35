// SPDX-License-Identifier: Apache-2.0
// Points from codes and a calibration alone: no separation, sweep or fit. `stratalux-fit cloud`.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "fitter/export/triangle_mesh.h"
#include "fitter/reconstruction/drift.h"
#include "fitter/reconstruction/triangulate.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/motion.h"

namespace stratalux::fit {

// Of the pixels with a code: beyond this share that contradict the calibration, it is another rig's.
inline constexpr double kMostContradicting = 0.5;

struct CodedCloud {
  PointCloud cloud;             // smoothed as a face's surface is (SmoothSurface), row by row
  std::vector<int> projectors;  // whose codes it rests on
  TriangulationCounts counts;
  int64_t unsmoothed = 0;  // quads dropped by SmoothSurface
  DriftReport drift;       // by the record's numbers of the projectors
  // Where the head moved, the points are those of its reference time, as in the shape stage.
  FaceMotion motion;
  std::string motion_unasked;  // why it was not looked for; empty: it was
};

// The poses of a session that have codes, of any projector or of one; -1 where they are not numbered.
[[nodiscard]] std::vector<int> CodedPoses(const SessionFrames& frames, std::optional<int> projector = {});

// Of one pose, by all projectors that show codes in it; frames may be crops of the calibrated camera's picture. Only
// the record's geometry is used: by what light the frames are read says `frames` (SessionFrames::UseRecord).
// kUsage: the record is of another rig, by its camera's or projectors' sizes or their number. kNotFound: a frame of the
// codes is missing. kFailed: no point is left, and what took them, or most contradict the record.
[[nodiscard]] Result<CodedCloud> CloudFromCodes(const SessionFrames& frames, int pose, const RigCalibration& record);

}  // namespace stratalux::fit
