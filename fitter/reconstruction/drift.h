// SPDX-License-Identifier: Apache-2.0
// Does the rig still stand as it was calibrated? A visitor's own codes tell: what one projector says of the face must
// agree with the surface that all of them triangulate together (docs/math/calibration.md, "Drift").
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "fitter/reconstruction/surface_map.h"
#include "fitter/structured_light/decoded_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

struct DriftOptions {
  // Recalibration is due beyond: the layers' fit needs a projector's columns to a fraction of one (model section 6).
  double max_shift_px = 0.5;
  // A projector that is displaced so much less than the worst one may owe it to that one's pull on the surface.
  double least_of_worst = 0.4;
  double least_on_surface = 0.3;  // of a projector's decoded points; fewer: judged against the epipolar lines alone
  int min_points = 200;
  int max_points = 20000;  // of a projector, spread over the face
  [[nodiscard]] Status Validate() const;
};

struct ProjectorDrift {
  int projector = 0;
  int64_t points = 0;        // of the surface that its light reaches; below min_points the rest stays 0
  double shift_columns = 0;  // median of decoded less predicted, projector px
  double shift_rows = 0;
  double shift_px = 0;     // root mean square displacement by the turn below: what is systematic
  double turned_deg = 0;   // the turn about its own centre that explains the displacement best
  double spread_px = 0;    // standard deviation (robust) of a point about that turn
  double expected_px = 0;  // of a point, from the codes' own noise
  bool moved = false;
};

struct DriftReport {
  std::vector<ProjectorDrift> projectors;
  // "recalibration is due: ..." naming who moved; empty: the rig stands as calibrated, as far as can be told.
  std::string warning;
};

// `decoded[p]`: maps of projector p at the size of the camera's frames; `surface`: triangulated from them. Along its
// epipolar lines a projector's displacement moves the surface as well: where few projectors share a point, a part of
// the displacement stays hidden there, none of it across. Where hardly any surface could be triangulated, only what
// lies across the lines is judged. kUsage where the sizes do not belong together.
[[nodiscard]] Result<DriftReport> CheckDrift(std::span<const DecodedMap> decoded, const SurfaceMap& surface,
                                             const RigCalibration& rig, const DriftOptions& options = {});

}  // namespace stratalux::fit
