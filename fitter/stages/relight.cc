// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/relight.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "db/privacy/export_marker.h"
#include "fitter/export/exr_file.h"
#include "fitter/export/pictures.h"
#include "fitter/image/pixelwise.h"
#include "fitter/render/mlsss.h"
#include "fitter/render/surface_light.h"
#include "fitter/render/surface_rim.h"
#include "fitter/sensor/linear_frame.h"
#include "fitter/stages/stage_json.h"
#include "shared/image/png.h"

namespace stratalux::fit {

namespace fs = std::filesystem;
namespace {

constexpr double kFarMm = 1e5;  // of a directional light: parallel to a thousandth over a face
constexpr double kNearestMm = 5.0;

struct Extent {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double nearest_mm = 0.0;  // to a position
};

Extent ExtentOf(const SurfaceMap& surface, const Eigen::Vector3d& position) {
  Extent extent;
  double count = 0.0, nearest2 = 1e300;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const Eigen::Vector3d point = surface.Point(i, j);
      extent.centre += point;
      count += 1.0;
      nearest2 = std::min(nearest2, (point - position).squaredNorm());
    }
  extent.centre /= std::max(count, 1.0);
  extent.nearest_mm = std::sqrt(nearest2);
  return extent;
}

Result<ProjectorCalibration> LightFor(const SavedFit& fit, const RigCalibration& rig, const VirtualLight& light,
                                      double& exposure_ms) {
  exposure_ms = 1.0;
  if (light.kind == VirtualLight::Kind::kProjector) {
    if (light.projector < 0 || light.projector >= static_cast<int>(rig.projectors.size()))
      return Status::Usage("projector " + std::to_string(light.projector) + " does not exist; the rig has " +
                           std::to_string(rig.projectors.size()));
    // Its own white at the middle of the face becomes 1.
    ProjectorCalibration projector = rig.projectors[light.projector];
    const Eigen::Vector3d centre = ExtentOf(fit.shape.surface, Eigen::Vector3d::Zero()).centre;
    const double distance2 = (projector.CentreInCamera() - centre).squaredNorm();
    for (int c = 0; c < 3; ++c) projector.white_dn_mm2_per_ms[c] = light.colour[c] * distance2;
    return projector;
  }
  Eigen::Vector3d position = light.vector;
  const Extent extent = ExtentOf(fit.shape.surface, position);
  if (light.kind == VirtualLight::Kind::kDirectional) {
    position = extent.centre + kFarMm * light.vector.normalized();
  } else if (extent.nearest_mm < kNearestMm) {
    return Status::Usage("the light stands " + std::to_string(extent.nearest_mm) +
                         " mm from the face; move it at least " + std::to_string(kNearestMm) + " mm away");
  }
  return MakePointLight(fit.shape.surface, position, light.colour);
}

// One channel more: 1 on the face, 0 outside.
Image<float> WithCoverage(const Image<float>& light, const Image<uint8_t>& covered) {
  Image<float> all(light.width(), light.height(), light.channels() + 1);
  for (int j = 0; j < all.height(); ++j)
    for (int i = 0; i < all.width(); ++i) {
      for (int c = 0; c < light.channels(); ++c) all(i, j, c) = light(i, j, c);
      all(i, j, light.channels()) = covered(i, j) != 0 ? 1.0F : 0.0F;
    }
  return all;
}

// RMS over RMS of the light, where both are known.
double RelativeHalfWidth(const Relit& relit) {
  double widths = 0.0, light = 0.0;
  for (size_t i = 0; i < relit.total.size(); ++i) {
    const double half = relit.half_width.pixels()[i], total = relit.total.pixels()[i];
    if (!std::isfinite(half) || !std::isfinite(total)) continue;
    widths += half * half;
    light += total * total;
  }
  return light > 0.0 ? std::sqrt(widths / light) : 0.0;
}

}  // namespace

Status VirtualLight::Validate() const {
  if (!vector.allFinite()) return Status::Usage("the light's position or direction must be finite numbers");
  if (kind == Kind::kDirectional && !(vector.norm() > 0.0)) return Status::Usage("a direction cannot be 0,0,0");
  for (double c : colour)
    if (!(c >= 0.0 && c <= 1e6)) return Status::Usage("the light's colour must lie in 0 .. 1e6");
  return Status::Ok();
}

Result<Relit> Relight(const SavedFit& fit, const VirtualLight& light) {
  const RigCalibration rig = LinearRig(fit.shape.record);
  SLX_RETURN_IF_ERROR(light.Validate());
  double exposure_ms = 1.0;
  SLX_ASSIGN_OR_RETURN(const auto projector, LightFor(fit, rig, light, exposure_ms));
  if (light.kind == VirtualLight::Kind::kProjector) {
    SLX_RETURN_IF_ERROR(light.pattern.Validate(projector.model.width, projector.model.height));
  }
  const LitSurface lit = BuildLitSurface(WithRim(fit.shape.surface), projector, exposure_ms);
  std::vector<LitPyramid> pyramids = {LightWith(lit, light.pattern)};
  if (light.pattern.kind != PatternKind::kWhite) pyramids.push_back(LightWith(lit, {.kind = PatternKind::kWhite}));
  const std::vector<Image<float>> subsurface =
      RenderSubsurface(fit.map, fit.shape.surface, rig, lit, pyramids, {fit.pool});
  const std::vector<Image<float>> irradiance = SurfaceIrradiance(fit.shape.surface, rig, lit, pyramids);
  const Image<float> reflectance = SurfaceReflectance(fit.map, fit.shape.surface, projector, fit.pool);
  Relit relit;
  relit.provenance = fit.provenance;
  relit.light_mm = projector.CentreInCamera();
  relit.subsurface = subsurface.front();
  relit.surface = ReflectedLight(reflectance, irradiance.front());
  relit.total = Sum(relit.subsurface, relit.surface);
  if (pyramids.size() > 1) relit.white = Sum(subsurface.back(), ReflectedLight(reflectance, irradiance.back()));
  const SurfaceMap& surface = fit.shape.surface;
  relit.covered = surface.mask;
  relit.face =
      std::count_if(surface.mask.pixels().begin(), surface.mask.pixels().end(), [](uint8_t m) { return m != 0; });
  relit.incomplete =
      MarkUnfitted(fit.map, surface, fit.pool, std::array{&relit.subsurface, &relit.surface, &relit.total});
  return relit;
}

std::vector<std::string> Relit::Notes() const {
  std::vector<std::string> notes;
  if (face == 0) notes.push_back("the fit has no face: the picture is black");
  const bool lit = std::any_of(total.pixels().begin(), total.pixels().end(), [](float v) { return v > 0.0F; });
  if (face > 0 && !lit)
    notes.push_back(
        "no light reaches the face: the picture is black (+z points away from the camera, so a light before the face "
        "has a smaller z than the face, and a direction towards one a negative z)");
  if (incomplete > 0)
    notes.push_back(std::to_string(incomplete) + " of " + std::to_string(face) +
                    " quads of the face lack a colour that was not fitted: NaN in the EXR files, black in the PNGs");
  return notes;
}

std::vector<std::string> RelitFiles() {
  return {"subsurface.exr", "surface.exr", "total.exr",    "subsurface.png",
          "surface.png",    "total.png",   "interval.exr", "relit.json"};
}

Status WriteRelit(const std::filesystem::path& folder, const Relit& relit, double white, const std::string& session,
                  const std::string& fit) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  // The record last, and none before: where it lies, the pictures are those that it names.
  for (const char* earlier : {"relit.json", "interval.exr"}) {
    fs::remove(folder / earlier, error);
    if (error) return Status::Failed("cannot replace " + (folder / earlier).string() + ": " + error.message());
  }
  if (!(white > 0.0)) {
    Image<float> lit = relit.total;
    for (float& v : lit.pixels())
      if (!(v > 0.0F)) v = std::nanf("");  // outside the face
    white = std::max(Percentile(lit, 0.995), 1e-6);
  }
  const std::vector<std::string> channels =
      relit.total.channels() == 1 ? std::vector<std::string>{"Y", "A"} : std::vector<std::string>{"R", "G", "B", "A"};
  for (const auto& [name, image] :
       {std::pair("subsurface", &relit.subsurface), {"surface", &relit.surface}, {"total", &relit.total}}) {
    SLX_RETURN_IF_ERROR(db::WriteExportedFile(folder / (std::string(name) + ".exr"), [&](const fs::path& beside) {
      return WriteExr(beside, WithCoverage(*image, relit.covered), channels);
    }));
    SLX_RETURN_IF_ERROR(db::WriteExportedFile(folder / (std::string(name) + ".png"), [&](const fs::path& beside) {
      return WritePng8(beside, WithAlpha(ToSrgb(*image, white), relit.covered));
    }));
  }
  nlohmann::ordered_json json = {{"schema", 1}, {"session", session}, {"fit", fit}, {"layers", relit.provenance}};
  if (!relit.half_width.empty()) {
    SLX_RETURN_IF_ERROR(db::WriteExportedFile(folder / "interval.exr", [&](const fs::path& beside) {
      return WriteExr(beside, WithCoverage(relit.half_width, relit.covered), channels);
    }));
    json["interval"] = {{"half_width", RelativeHalfWidth(relit)}};
  }
  return db::WriteExportedFile(folder / "relit.json", [&](const fs::path& beside) { return WriteJson(beside, json); });
}

}  // namespace stratalux::fit
