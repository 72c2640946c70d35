// SPDX-License-Identifier: Apache-2.0
// The shape stage: the surface that all projectors triangulate together, and which of it each of them lights.
#pragma once

#include <filesystem>
#include <vector>

#include "fitter/reconstruction/drift.h"
#include "fitter/reconstruction/surface_map.h"
#include "fitter/reconstruction/triangulate.h"
#include "fitter/stages/lit_quads.h"
#include "fitter/stages/motion.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

inline constexpr int kShapeVersion = 11;

struct FaceShape {
  RigCalibration record;  // of the rig that it stands in, as a manifest has it
  SurfaceMap surface;     // smoothed
  // By projector, on quads.
  std::vector<Image<uint8_t>> lit;         // 1: its direct light falls there (LitQuads)
  std::vector<Image<float>> code_weights;  // what its codes weigh in the surface (Triangulation::weights)
  Image<float> disagreement_mm;            // on quads (Triangulation::disagreement_mm); NaN off the surface
  TriangulationCounts triangulation;
  int64_t unsmoothed = 0;  // quads dropped by SmoothSurface
  DriftReport drift;
  // The surface is that of its reference time.
  FaceMotion motion;
};

// `rig`: what the frames were decoded by (SessionFrames::calibration()); `record`: that it was made from. `separation`:
// of each projector, for what it lights (LitQuads); empty where none was captured. kFailed, with what took it, where no
// surface is left.
[[nodiscard]] Result<FaceShape> ReconstructShape(std::span<const DecodedMap> decoded,
                                                 std::span<const SeparationMap> separation, const RigCalibration& rig,
                                                 const RigCalibration& record);

// The same of a head that may have moved: where the whites say so, codes and lights are carried to the reference time
// and the surface is reconstructed once more. `frames`: that the maps were made of; `find_motion` false: it is taken to
// have held still.
[[nodiscard]] Result<FaceShape> ReconstructMovingShape(const SessionFrames& frames, std::span<const DecodedMap> decoded,
                                                       std::span<const SeparationMap> separation,
                                                       const RigCalibration& record, bool find_motion);

// The lights of each projector on the shape's quads, and the rig that they come from: as captured where nothing moved.
struct LightsOnShape {
  std::vector<SeparationMap> carried;  // empty: as captured
  RigCalibration rig;                  // linear
};
[[nodiscard]] LightsOnShape LightsOn(const FaceShape& shape, std::span<const SeparationMap> separation);

// position.exr, depth_sigma.exr, disagreement.exr, normal_surface.exr, smoothing.exr, masks.exr, mesh.ply, rig.json,
// motion.json, shape.json.
Status SaveShape(const std::filesystem::path& folder, const FaceShape& shape);
[[nodiscard]] Result<FaceShape> LoadShape(const std::filesystem::path& folder);

}  // namespace stratalux::fit
