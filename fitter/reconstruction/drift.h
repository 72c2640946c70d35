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
  // Of the surface that its light reaches, where its codes tell anything: of one axis alone those that another
  // projector reaches too, for a code by itself agrees with any depth. Below min_points the rest stays 0.
  int64_t points = 0;
  double shift_columns = 0;  // median of decoded less predicted, projector px; 0 of an axis that was not captured
  double shift_rows = 0;
  double shift_px = 0;  // root mean square displacement by the turn below: what is systematic
  // The turn about its own centre that explains the displacement best; of one axis alone about the axis that moves it.
  double turned_deg = 0;
  double spread_px = 0;    // standard deviation (robust) of a point about that turn
  double expected_px = 0;  // of a point, from the codes' own noise
  bool moved = false;

  [[nodiscard]] bool judged() const { return shift_px > 0.0; }
};

struct DriftReport {
  std::vector<ProjectorDrift> projectors;
  // "recalibration is due: ..." naming who moved, then "not judged: ..." naming of whom nothing can be said and why;
  // empty: the rig stands as calibrated.
  std::string warning;

  [[nodiscard]] bool moved() const;
};

// For people: whether the light falls where the calibration says, or of whom that is not known; also of a report that
// was written before warnings said who is not judged.
[[nodiscard]] std::string Describe(const DriftReport& report);

// `decoded[p]`: maps of projector p at the size of the camera's frames; `surface`: triangulated from them. Along its
// epipolar lines a projector's displacement moves the surface as well: where few projectors share a point, a part of
// the displacement stays hidden there, none of it across. Where hardly any surface could be triangulated, only what
// lies across the lines is judged; of codes of one axis nothing is. `numbers`: the projectors' in their record; empty:
// 0, 1, ... kUsage where the sizes do not belong together.
[[nodiscard]] Result<DriftReport> CheckDrift(std::span<const DecodedMap> decoded, const SurfaceMap& surface,
                                             const RigCalibration& rig, const DriftOptions& options = {},
                                             std::span<const int> numbers = {});

}  // namespace stratalux::fit
