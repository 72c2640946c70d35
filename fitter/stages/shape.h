// SPDX-License-Identifier: Apache-2.0
// The shape stage: the surface that all projectors triangulate together, and which of it each of them lights.
#pragma once

#include <filesystem>
#include <vector>

#include "fitter/reconstruction/drift.h"
#include "fitter/reconstruction/surface_map.h"
#include "fitter/reconstruction/triangulate.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

inline constexpr int kShapeVersion = 3;

struct FaceShape {
  RigCalibration record;            // of the rig that it stands in, as a manifest has it
  SurfaceMap surface;               // smoothed
  std::vector<Image<uint8_t>> lit;  // by projector, on quads: it reaches the point
  TriangulationCounts triangulation;
  DriftReport drift;
};

// `rig`: what the frames were decoded by (SessionFrames::calibration()); `record`: that it was made from.
[[nodiscard]] Result<FaceShape> ReconstructShape(std::span<const DecodedMap> decoded, const RigCalibration& rig,
                                                 const RigCalibration& record);

// Quads that a projector lights: decoded where the surface says so, one quad away from any shadow's edge.
[[nodiscard]] Image<uint8_t> LitQuads(const DecodedMap& decoded, const SurfaceMap& surface, const RigCalibration& rig,
                                      int projector);

// position.exr, depth_sigma.exr, normal_surface.exr, masks.exr, mesh.ply, rig.json, shape.json.
Status SaveShape(const std::filesystem::path& folder, const FaceShape& shape);
[[nodiscard]] Result<FaceShape> LoadShape(const std::filesystem::path& folder);

}  // namespace stratalux::fit
