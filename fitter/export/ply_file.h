// SPDX-License-Identifier: Apache-2.0
// PLY files, binary little-endian, lengths in mm, camera frame.
#pragma once

#include <filesystem>

#include "fitter/export/origin.h"
#include "fitter/export/triangle_mesh.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Vertices x y z nx ny nz (float), red green blue (uchar) where the mesh has colours, and faces. kFailed: the file
// cannot be written.
Status WritePly(const std::filesystem::path& file, const Mesh& mesh, const ExportOrigin& origin = {});

// Vertices x y z nx ny nz normal_sigma_rad cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz (float; mm^2), colours as above,
// and skin (uchar) where the cloud has it.
Status WritePly(const std::filesystem::path& file, const PointCloud& cloud, const ExportOrigin& origin = {});

}  // namespace stratalux::fit
