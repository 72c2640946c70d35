// SPDX-License-Identifier: Apache-2.0
// Depth, normals and the skin mask as TIFF with 16-bit samples. What a sample means stands in the file itself, as JSON
// in its ImageDescription: "quantity", "unit", "scale", "offset" (value = offset + scale * sample), "no_surface" (the
// sample of quads without a surface), the frame, and where it comes from.
#pragma once

#include <cstdint>
#include <filesystem>

#include "fitter/export/origin.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

inline constexpr double kDepthTiffStepMm = 0.01;

struct DepthTiff {
  double offset_mm = 0.0;    // of sample 0, which says "no surface": the nearest quad is at least 1 mm farther
  int64_t out_of_range = 0;  // quads farther than the last sample, 655.35 mm behind that: masked
};

// z of the camera frame, mm, one sample a quad, NaN where no surface is.
[[nodiscard]] Result<DepthTiff> WriteDepthTiff(const std::filesystem::path& file, ImageView<const float> depth_mm,
                                               const ExportOrigin& origin = {});
// Unit vectors of the camera frame as R, G, B = (n + 1) / 2 * 65535, rounded; 0 0 0 where no surface is.
Status WriteNormalTiff(const std::filesystem::path& file, ImageView<const float> normals,
                       const ExportOrigin& origin = {});
// 1 where skin is, 0 where the surface is something else, NaN where none is, as samples 65534, 32767 and 0: a picture
// in white, grey and black.
Status WriteSkinTiff(const std::filesystem::path& file, ImageView<const float> skin, const ExportOrigin& origin = {});

}  // namespace stratalux::fit
