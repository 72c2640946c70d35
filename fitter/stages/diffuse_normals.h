// SPDX-License-Identifier: Apache-2.0
// The diffuse_normals stage: normals of light that scattered, by the spread of the fitted layers; those of the very
// surface are the normals stage's (fitter/stages/normals.h).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "fitter/stages/layers_file.h"
#include "fitter/stages/shape.h"

namespace stratalux::fit {

inline constexpr int kDiffuseNormalsVersion = 2;

// `specular`: W x H x 3, FaceNormals::fused. As DiffuseNormals, rho being the mean of the layers' Gaussians, each as
// heavy as its layer and narrower by the blur s that smoothing has done to the surface; of that mean as much as makes
// the blur of a wave of 1 / s, the finest that such a surface shows, the skin's, and the rest is the quad's own.
[[nodiscard]] Result<Image<float>> FilterNormals(const FaceShape& shape, const Image<float>& specular,
                                                 const FittedLayers& layers);

// Channels of such maps in files, of as many colours; none of none.
[[nodiscard]] std::vector<std::string> DiffuseNormalNames(int colours);
// normal_diffuse.exr: R.X, R.Y, R.Z, G.X ... (of a mono camera Y.X, Y.Y, Y.Z).
Status SaveDiffuseNormals(const std::filesystem::path& folder, const Image<float>& diffuse);
// kNotFound: none there, as in fits of older programs.
[[nodiscard]] Result<Image<float>> LoadDiffuseNormals(const std::filesystem::path& folder, int colours);
// Of the colour that a picture's brightness is mostly of, where there is one normal for all: green.
[[nodiscard]] Image<float> OneDiffuseNormal(const Image<float>& diffuse);

}  // namespace stratalux::fit
