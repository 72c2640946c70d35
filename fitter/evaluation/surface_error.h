// SPDX-License-Identifier: Apache-2.0
// A reconstructed surface against the true one of a simulation, on the same quads.
#pragma once

#include <cstdint>
#include <vector>

#include "fitter/reconstruction/surface_map.h"
#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// How far off the columns are that SRDs are read at: where a projector shines on the surface's point of a quad, less
// where it shines on the true one. A hundredth of a millimetre of depth is some 0.02 columns.
struct ColumnError {
  int projector = 0;
  double mean_px = 0.0;  // what all of the face has in common
  double rms_px = 0.0;   // about the mean
  int64_t quads = 0;
};

struct SurfaceError {
  double depth_rms_mm = 0.0;  // after removing the bias
  double depth_bias_mm = 0.0;
  double normal_median_deg = 0.0;
  int64_t pixels = 0;
  std::vector<ColumnError> columns{};  // by projector, of those that light any of it
};

// The true surface and the rig that it stands in.
struct TrueSurface {
  SurfaceMap surface;
  RigCalibration rig;
  // By projector, what its light reaches; empty where an older simulation does not say.
  std::vector<Image<uint8_t>> lit_by;
  // Empty as lit_by, of older simulations.
  Image<uint8_t> skin = {};          // quads of skin alone
  Image<float> spread_mm = {};       // W x H x C (SceneTruth::Spread)
  Image<float> diffuse_normal = {};  // W x H x 3C (SceneTruth::DiffuseNormal)
};

// Of quads that are known to both. Without columns.
[[nodiscard]] SurfaceError CompareSurface(const SurfaceMap& surface, const SurfaceMap& truth);

// Of quads that are known to both and that the projector lights by the truth. Each surface stands in its own rig.
[[nodiscard]] ColumnError CompareColumns(const SurfaceMap& surface, const RigCalibration& rig, const TrueSurface& truth,
                                         int projector);

// Both, with the columns of all projectors whose light the truth knows.
[[nodiscard]] SurfaceError CompareWithTruth(const SurfaceMap& surface, const RigCalibration& rig,
                                            const TrueSurface& truth);

}  // namespace stratalux::fit
