// SPDX-License-Identifier: Apache-2.0
// The surface of a face, and what its fit says of it, as files that other programs read: `stratalux-fit export`.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "fitter/export/origin.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/base/result.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

enum class ExportFormat { kPly, kGlb, kCloud, kTiff, kExr };
// "ply", "glb", "cloud", "tiff", "exr", in this order.
[[nodiscard]] const std::vector<std::string>& ExportFormatNames();
// Of names that are among those.
[[nodiscard]] std::set<ExportFormat> ParseExportFormats(const std::vector<std::string>& names);
// The files that formats write.
[[nodiscard]] std::vector<std::string> SurfaceFiles(const std::set<ExportFormat>& formats);

// Maps on quads.
struct ExportedSurface {
  SurfaceMap surface;       // its normals with photometric detail where that is known
  Image<float> own_normal;  // without: they say what hangs together in the mesh; empty: those of `surface`
  CameraCalibration camera;
  Image<float> normal_sigma_rad;  // NaN where not known; empty: nowhere
  // Diffuse albedo, W x H x (1 or 3): the sum of the fitted weights, light that went through the skin over what a white
  // target would reflect, without the light of the surface itself. NaN where nothing was fitted; empty: nowhere.
  Image<float> albedo;
  Image<uint8_t> skin;  // W x H, 1: skin
  // Whether the skin stage told; else all of the surface counts as skin, as there.
  bool skin_told = false;
  Image<float> diffuse_normal = {};  // W x H x 3C (fitter/photometric/diffuse_normals.h); empty: not known
  double roughness = 1.0;            // glTF's, of the session's surface reflection
  double coat = 0.0;                 // its strength, over that of glTF's clear coat; 0: not known
  ExportOrigin origin;
};

// Of a fit's folder. kNotFound: it has no fit's files; kIntegrity: they do not belong together.
[[nodiscard]] Result<ExportedSurface> LoadFittedSurface(const std::filesystem::path& folder);
// Of the artifact of a shape stage: without albedo and skin mask, its normals the surface's own.
[[nodiscard]] Result<ExportedSurface> LoadBareSurface(const std::filesystem::path& folder);

struct SurfaceExportReport {
  int64_t points = 0, triangles = 0;
  int64_t skin = 0;            // of the points
  int64_t without_albedo = 0;  // of the points: coloured as the nearest one that was fitted
  int64_t too_far = 0;         // of the points: masked in depth.tif
};

// The files of `formats` into the folder; `writing` is told each one's name before. kNotFound: there is no surface.
[[nodiscard]] Result<SurfaceExportReport> WriteSurface(const std::filesystem::path& folder,
                                                       const ExportedSurface& exported,
                                                       const std::set<ExportFormat>& formats,
                                                       const std::function<void(const std::string&)>& writing);

// The albedo as a picture, 3 channels, sRGB, 1 is white; what lies outside the fitted quads is as the nearest of them,
// so that filters take in no colour that nobody has. Empty where there is no albedo.
[[nodiscard]] Image<uint8_t> AlbedoPicture(ImageView<const float> albedo);

}  // namespace stratalux::fit
