// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/normals.h"

#include <string>
#include <vector>

#include "fitter/export/exr_file.h"
#include "fitter/photometric/fuse_normals.h"
#include "fitter/stages/colours.h"

namespace stratalux::fit {

Result<FaceNormals> EstimateFaceNormals(std::span<const SeparationMap> separation, const SurfaceMap& surface,
                                        const RigCalibration& rig, double exposure_ms) {
  if (separation.size() != rig.projectors.size())
    return Status::Usage("normals: " + std::to_string(separation.size()) + " separations for " +
                         std::to_string(rig.projectors.size()) + " projectors; needs one each");
  if (!(exposure_ms > 0.0)) return Status::Usage("normals: the exposure must be positive");
  std::vector<Image<float>> direct;
  for (const SeparationMap& map : separation) direct.push_back(ValidDirect(map));
  std::vector<LitImage> images;
  for (size_t p = 0; p < separation.size(); ++p)
    images.push_back({LightOfProjector(rig.projectors[p], exposure_ms), direct[p], separation[p].direct_variance});
  FaceNormals normals;
  SLX_ASSIGN_OR_RETURN(normals.photometric, EstimateNormals(images, surface));
  SLX_ASSIGN_OR_RETURN(normals.fused, FuseNormals(surface, normals.photometric));
  return normals;
}

Status SaveNormals(const std::filesystem::path& folder, const FaceNormals& normals) {
  const PhotometricMap& map = normals.photometric;
  SLX_RETURN_IF_ERROR(WriteExr(folder / "normal_photometric.exr", map.normal, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "normal_fused.exr", normals.fused, {"X", "Y", "Z"}));
  SLX_RETURN_IF_ERROR(WriteExr(folder / "albedo.exr", map.albedo, Colours(map.albedo.channels())));
  Image<float> quality(map.reason.width(), map.reason.height(), 4);
  for (size_t i = 0; i < map.reason.size(); ++i) {
    float* quad = quality.data() + 4 * i;
    quad[0] = map.residual.pixels()[i];
    quad[1] = map.normal_sigma_rad.pixels()[i];
    quad[2] = map.usable.pixels()[i];
    quad[3] = map.reason.pixels()[i];
  }
  return WriteExr(folder / "photometric.exr", quality, {"residual", "sigma_rad", "sources", "reason"});
}

Result<FaceNormals> LoadNormals(const std::filesystem::path& folder, int channels) {
  FaceNormals normals;
  SLX_ASSIGN_OR_RETURN(normals.photometric.normal, ReadExr(folder / "normal_photometric.exr", {"X", "Y", "Z"}));
  SLX_ASSIGN_OR_RETURN(normals.photometric.albedo, ReadExr(folder / "albedo.exr", Colours(channels)));
  SLX_ASSIGN_OR_RETURN(normals.fused, ReadExr(folder / "normal_fused.exr", {"X", "Y", "Z"}));
  return normals;
}

}  // namespace stratalux::fit
