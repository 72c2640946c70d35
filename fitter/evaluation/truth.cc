// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/truth.h"

#include <cmath>

#include "shared/base/read_file.h"
#include "shared/capture/surface_class.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {

Result<std::optional<SceneTruth>> SceneTruth::Open(const std::filesystem::path& session_folder) {
  const std::filesystem::path file = session_folder / "truth.seg";
  if (!std::filesystem::exists(file)) return std::optional<SceneTruth>();
  SLX_ASSIGN_OR_RETURN(auto segment, db::TruthSegment::Open(file));
  const std::filesystem::path record = session_folder / "truth_calibration.json";
  std::optional<RigCalibration> exact;
  if (std::filesystem::exists(record)) {
    SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(record));
    SLX_ASSIGN_OR_RETURN(exact, RigCalibration::FromJson(text).WithContext(record.string()));
  }
  return std::optional(SceneTruth(std::move(segment), std::move(exact)));
}

Result<Image<float>> SceneTruth::Subsurface(const std::string& light, int projector) const {
  return segment_.Read("subsurface " + light + " " + std::to_string(projector));
}

Result<Image<uint8_t>> SceneTruth::Skin() const {
  SLX_ASSIGN_OR_RETURN(auto skin, SkinAtCentres());
  if (skin.empty()) return skin;
  const auto mixed = segment_.Read("mixed");
  if (mixed.status().code() == StatusCode::kNotFound) return skin;  // of an older simulation
  if (!mixed.ok()) return mixed.status();
  for (size_t i = 0; i < skin.size(); ++i)
    if (mixed->pixels()[i] != 0.0F) skin.pixels()[i] = 0;
  return skin;
}

Result<Image<uint8_t>> SceneTruth::SkinAtCentres() const {
  constexpr float kSkin = 1.0F;  // docs/simulated-rig.md, "truth.seg"
  auto material = segment_.Read("material");
  if (material.status().code() == StatusCode::kNotFound) return Image<uint8_t>();
  if (!material.ok()) return material.status();
  Image<uint8_t> skin(material->width(), material->height());
  for (size_t i = 0; i < skin.size(); ++i) skin.pixels()[i] = material->pixels()[i] == kSkin ? 1 : 0;
  return skin;
}

Result<Image<uint8_t>> SceneTruth::SkinOrStubble() const {
  SLX_ASSIGN_OR_RETURN(auto skin, SkinAtCentres());
  const auto part = segment_.Read("class");
  if (part.status().code() == StatusCode::kNotFound) return skin;
  if (!part.ok()) return part.status();
  for (size_t i = 0; i < skin.size(); ++i)
    if (part->pixels()[i] == static_cast<float>(SurfaceClass::kStubble)) skin.pixels()[i] = 1;
  return skin;
}

Result<Image<uint8_t>> SceneTruth::LitBy(int projector) const {
  auto direct = segment_.Read("direct white " + std::to_string(projector));
  if (direct.status().code() == StatusCode::kNotFound) return Image<uint8_t>();
  if (!direct.ok()) return direct.status();
  Image<uint8_t> lit(direct->width(), direct->height());
  for (int j = 0; j < lit.height(); ++j)
    for (int i = 0; i < lit.width(); ++i)
      for (int c = 0; c < direct->channels(); ++c)
        if ((*direct)(i, j, c) > 0.0F) lit(i, j) = 1;
  return lit;
}

Result<Image<float>> SceneTruth::ReadIfThere(const std::string& name) const {
  auto map = segment_.Read(name);
  if (map.status().code() == StatusCode::kNotFound) return Image<float>();
  return map;
}

Result<Image<float>> SceneTruth::Spread() const { return ReadIfThere("spread"); }

Result<Image<float>> SceneTruth::DiffuseNormal() const { return ReadIfThere("diffuse normal"); }

Result<SurfaceMap> SceneTruth::Surface(const RigCalibration& calibration) const {
  const RigCalibration& rig = exact_ ? *exact_ : calibration;
  SLX_ASSIGN_OR_RETURN(const auto depth, Depth());
  SLX_ASSIGN_OR_RETURN(auto normal, Normal());
  SurfaceMap s{Image<float>(depth.width(), depth.height(), 3, std::nanf("")), std::move(normal),
               Image<float>(depth.width(), depth.height()), Image<uint8_t>(depth.width(), depth.height())};
  for (int j = 0; j < depth.height(); ++j)
    for (int i = 0; i < depth.width(); ++i) {
      if (!std::isfinite(depth(i, j))) continue;
      const Eigen::Vector3d ray = rig.camera.model.Unproject(QuadCentre(rig.camera.cfa, i, j));
      const Eigen::Vector3d point = ray * (depth(i, j) / ray.z());
      for (int k = 0; k < 3; ++k) s.point_mm(i, j, k) = static_cast<float>(point[k]);
      s.mask(i, j) = 1;
    }
  return s;
}

Result<TrueSurface> SceneTruth::SurfaceInItsRig(const RigCalibration& calibration) const {
  TrueSurface truth;
  SLX_ASSIGN_OR_RETURN(truth.surface, Surface(calibration));
  truth.rig = exact_ ? *exact_ : calibration;
  for (int p = 0; p < static_cast<int>(truth.rig.projectors.size()); ++p) {
    SLX_ASSIGN_OR_RETURN(auto lit, LitBy(p));
    truth.lit_by.push_back(std::move(lit));
  }
  SLX_ASSIGN_OR_RETURN(truth.skin, Skin());
  SLX_ASSIGN_OR_RETURN(truth.spread_mm, Spread());
  SLX_ASSIGN_OR_RETURN(truth.diffuse_normal, DiffuseNormal());
  return truth;
}

}  // namespace stratalux::fit
