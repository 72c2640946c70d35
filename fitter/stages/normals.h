// SPDX-License-Identifier: Apache-2.0
// The normals stage: photometric stereo on the direct light of all projectors, fused with the surface's.
#pragma once

#include <filesystem>

#include "fitter/photometric/photometric_stereo.h"
#include "fitter/separation/separation_map.h"

namespace stratalux::fit {

inline constexpr int kNormalsVersion = 7;

struct FaceNormals {
  PhotometricMap photometric;
  Image<float> fused;  // photometric detail on the surface's low frequencies
};

// `separation`: of each projector of the rig, in its order. Of fewer than three no normal rests on light alone
// (kTooFewSources), and the fused ones are the surface's. kUsage: as many are not there.
[[nodiscard]] Result<FaceNormals> EstimateFaceNormals(std::span<const SeparationMap> separation,
                                                      const SurfaceMap& surface, const RigCalibration& rig,
                                                      double exposure_ms);

// normal_photometric.exr, normal_fused.exr, albedo.exr, photometric.exr (residual, sigma, sources used, reason: see
// docs/file-formats.md).
Status SaveNormals(const std::filesystem::path& folder, const FaceNormals& normals);
// What the report shows of them: normals and albedo.
[[nodiscard]] Result<FaceNormals> LoadNormals(const std::filesystem::path& folder, int channels);

}  // namespace stratalux::fit
