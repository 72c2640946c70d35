// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/surface_export.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <span>
#include <utility>

#include "fitter/export/exr_file.h"
#include "fitter/export/glb_file.h"
#include "fitter/export/normal_texture.h"
#include "fitter/export/pictures.h"
#include "fitter/export/ply_file.h"
#include "fitter/export/tiff_maps.h"
#include "fitter/image/on_quads.h"
#include "fitter/reconstruction/mesh.h"
#include "fitter/reconstruction/point_cloud.h"
#include "fitter/stages/diffuse_normals.h"
#include "fitter/stages/layer_maps.h"
#include "fitter/stages/layers_file.h"
#include "fitter/stages/mesh_normals.h"
#include "fitter/stages/shape.h"
#include "fitter/stages/skin.h"
#include "shared/image/finite_at.h"

namespace stratalux::fit {
namespace {

constexpr std::array kMeshPly = {"mesh.ply"}, kMeshGlb = {"mesh.glb"}, kCloudPly = {"cloud.ply"};
constexpr std::array kTiffs = {"depth.tif", "normal.tif", "skin.tif"}, kExrs = {"depth.exr", "normal.exr", "skin.exr"};

std::span<const char* const> FilesOf(ExportFormat format) {
  switch (format) {
    case ExportFormat::kPly:
      return kMeshPly;
    case ExportFormat::kGlb:
      return kMeshGlb;
    case ExportFormat::kCloud:
      return kCloudPly;
    case ExportFormat::kTiff:
      return kTiffs;
    case ExportFormat::kExr:
      return kExrs;
  }
  return {};
}

// Where photometric stereo adds none, the surface's own stay.
Status TakeFusedNormals(const std::filesystem::path& folder, ExportedSurface& to) {
  SLX_ASSIGN_OR_RETURN(const auto fused, ReadExr(folder / "normal_fused.exr", {"X", "Y", "Z"}));
  if (auto sigma = ReadExr(folder / "photometric.exr", {"sigma_rad"}); sigma.ok())
    to.normal_sigma_rad = std::move(*sigma);
  else if (sigma.status().code() == StatusCode::kNotFound)  // of an older program, which did not tell
    to.normal_sigma_rad = Image<float>(fused.width(), fused.height(), 1, std::nanf(""));
  else
    return sigma.status();
  SurfaceMap& surface = to.surface;
  to.own_normal = surface.normal;
  for (const Image<float>* map : {&fused, &std::as_const(to.normal_sigma_rad)})
    if (map->width() != surface.width() || map->height() != surface.height())
      return Status::Integrity(folder.string() + ": its maps differ in size; fit again");
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      for (int c = 0; c < 3 && surface.mask(i, j) != 0 && FiniteAt(fused, i, j); ++c)
        surface.normal(i, j, c) = fused(i, j, c);
  return Status::Ok();
}

// A fit of a program before that stage has none.
Status TakeDiffuseNormals(const std::filesystem::path& folder, int colours, ExportedSurface& to) {
  auto diffuse = LoadDiffuseNormals(folder, colours);
  if (diffuse.status().code() == StatusCode::kNotFound) return Status::Ok();
  if (!diffuse.ok()) return diffuse.status();
  if (diffuse->width() != to.surface.width() || diffuse->height() != to.surface.height())
    return Status::Integrity(folder.string() + ": its diffuse normals and its surface differ in size; fit again");
  for (int j = 0; j < diffuse->height(); ++j)
    for (int i = 0; i < diffuse->width(); ++i)
      for (int c = 0; c < colours && to.surface.mask(i, j) != 0; ++c) {
        const Eigen::Map<const Eigen::Vector3f> n(&(*diffuse)(i, j, 3 * c));
        if (!(n.norm() > 0.5F) || !(n.norm() < 2.0F))
          return Status::Integrity(folder.string() + ": quad " + std::to_string(i) + ", " + std::to_string(j) +
                                   " of its surface has no diffuse normal; fit again");
      }
  to.diffuse_normal = std::move(*diffuse);
  return Status::Ok();
}

// What mirrors of a surface of that index along its normal [M 6, Fresnel].
double MirroredAlongNormal(double eta) { return std::pow((eta - 1.0) / (eta + 1.0), 2); }

// A fit of a program before the skin stage has none.
Status TakeSkin(const std::filesystem::path& folder, ExportedSurface& to) {
  auto mask = LoadSkin(folder);
  if (mask.status().code() == StatusCode::kNotFound) mask = AllSkin(to.surface.mask);
  if (!mask.ok()) return mask.status();
  if (mask->skin.width() != to.surface.width() || mask->skin.height() != to.surface.height())
    return Status::Integrity(folder.string() + ": its skin mask and its surface differ in size; fit again");
  to.skin = std::move(mask->skin);
  to.skin_told = mask->told;
  return Status::Ok();
}

// What files say is a surface: points before the camera, normals of length 1. Rounded to floats, they still are.
Status CheckSurface(SurfaceMap& surface, const std::string& where) {
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      if (surface.mask(i, j) == 0) continue;
      const Eigen::Vector3d normal = surface.Normal(i, j);
      if (!(surface.point_mm(i, j, 2) > 0.0F) || !surface.Point(i, j).allFinite() || !(normal.norm() > 0.5) ||
          !(normal.norm() < 2.0) || !(surface.depth_sigma_mm(i, j) >= 0.0F))
        return Status::Integrity(where + ": quad " + std::to_string(i) + ", " + std::to_string(j) +
                                 " of its surface has no place, no normal or no deviation");
      for (int c = 0; c < 3; ++c) surface.normal(i, j, c) = static_cast<float>(normal[c] / normal.norm());
    }
  return Status::Ok();
}

// Breadth first from all known pixels at once: each other one takes after its nearest, by steps of one pixel.
void FillFromNearest(Image<float>& map) {
  std::deque<std::array<int, 2>> front;
  Image<uint8_t> known(map.width(), map.height());
  for (int j = 0; j < map.height(); ++j)
    for (int i = 0; i < map.width(); ++i)
      if (FiniteAt(map, i, j)) {
        known(i, j) = 1;
        front.push_back({i, j});
      }
  for (; !front.empty(); front.pop_front()) {
    const auto [i, j] = front.front();
    for (const auto& [x, y] : {std::array{i - 1, j}, {i + 1, j}, {i, j - 1}, {i, j + 1}}) {
      if (!map.contains(x, y) || known(x, y) != 0) continue;
      known(x, y) = 1;
      for (int c = 0; c < map.channels(); ++c) map(x, y, c) = map(i, j, c);
      front.push_back({x, y});
    }
  }
}

// 1 and 0 on the surface, NaN outside.
Image<float> SkinMap(const ExportedSurface& exported) {
  const SurfaceMap& surface = exported.surface;
  Image<float> map(surface.width(), surface.height(), 1, std::nanf(""));
  for (size_t i = 0; i < map.size(); ++i)
    if (surface.mask.pixels()[i] != 0) map.pixels()[i] = exported.skin.pixels()[i] != 0 ? 1.0F : 0.0F;
  return map;
}

std::vector<uint8_t> SkinAt(const ExportedSurface& exported) {
  std::vector<uint8_t> skin;
  for (size_t i = 0; i < exported.skin.size(); ++i)
    if (exported.surface.mask.pixels()[i] != 0) skin.push_back(exported.skin.pixels()[i] != 0 ? 1 : 0);
  return skin;
}

std::vector<std::array<uint8_t, 3>> ColoursAt(const SurfaceMap& surface, const Image<uint8_t>& picture) {
  std::vector<std::array<uint8_t, 3>> colours;
  for (int j = 0; j < picture.height(); ++j)
    for (int i = 0; i < picture.width(); ++i)
      if (surface.mask(i, j) != 0) colours.push_back({picture(i, j, 0), picture(i, j, 1), picture(i, j, 2)});
  return colours;
}

// NaN outside the surface, whatever files hold there.
Image<float> Masked(const SurfaceMap& surface, const Image<float>& map, int first, int channels) {
  Image<float> masked(surface.width(), surface.height(), channels, std::nanf(""));
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      for (int c = 0; c < channels && surface.mask(i, j) != 0; ++c) masked(i, j, c) = map(i, j, first + c);
  return masked;
}

// Everything that files are written from, made once.
class Writer {
 public:
  Writer(const ExportedSurface& exported, const std::filesystem::path& folder)
      : exported_(exported), folder_(folder), picture_(AlbedoPicture(exported.albedo)) {
    const SurfaceMap& surface = exported.surface;
    SurfaceMap own = surface;
    if (!exported.own_normal.empty()) own.normal = exported.own_normal;
    mesh_ = MeshFromSurface(own);
    finer_normals_ = NormalsOnMesh(mesh_, surface, surface.normal);
    mesh_.colours = ColoursAt(surface, picture_);
    report_.points = static_cast<int64_t>(mesh_.positions_mm.size());
    skin_ = SkinAt(exported);
    report_.skin = std::ranges::count(skin_, 1);
    report_.triangles = static_cast<int64_t>(mesh_.triangles.size());
    for (int j = 0; j < surface.height() && !exported.albedo.empty(); ++j)
      for (int i = 0; i < surface.width(); ++i)
        report_.without_albedo += surface.mask(i, j) != 0 && !FiniteAt(exported.albedo, i, j) ? 1 : 0;
  }
  Status Write(const std::string& name) {
    const std::filesystem::path file = folder_ / name;
    const SurfaceMap& surface = exported_.surface;
    if (name == kMeshPly[0]) return WriteMeshPly(file);
    if (name == kMeshGlb[0]) return WriteMeshGlb(file);
    if (name == kCloudPly[0]) return WriteCloud(file);
    if (name == kTiffs[0]) return WriteDepth(file);
    if (name == kTiffs[1]) return WriteNormalTiff(file, Masked(surface, surface.normal, 0, 3), exported_.origin);
    if (name == kTiffs[2]) return WriteSkinTiff(file, SkinMap(exported_), exported_.origin);
    if (name == kExrs[2]) return WriteExr(file, SkinMap(exported_), {"skin"});
    if (name == kExrs[0]) return WriteExr(file, Masked(surface, surface.point_mm, 2, 1), {"Z"});
    return WriteNormalExr(file);
  }
  [[nodiscard]] const SurfaceExportReport& report() const { return report_; }

 private:
  Status WriteMeshPly(const std::filesystem::path& file) const {
    Mesh mesh = mesh_;
    mesh.normals = finer_normals_;
    return WritePly(file, mesh, exported_.origin);
  }
  Status WriteMeshGlb(const std::filesystem::path& file) const {
    const Image<uint8_t> colour = picture_.empty() ? Image<uint8_t>() : WithAlpha(picture_, exported_.surface.mask);
    if (exported_.own_normal.empty())  // nothing finer is known
      return WriteGlb(file, mesh_, {colour, exported_.roughness}, exported_.origin);
    Mesh mesh = mesh_;
    mesh.tangents = TangentsOf(mesh);
    const SurfaceMap& surface = exported_.surface;
    const Image<uint8_t> specular = NormalTexture(mesh, finer_normals_, surface.width(), surface.height());
    if (exported_.diffuse_normal.empty() || exported_.coat <= 0.0)
      return WriteGlb(file, mesh, {colour, exported_.roughness, specular}, exported_.origin);
    const auto scattered = NormalsOnMesh(mesh, surface, OneDiffuseNormal(exported_.diffuse_normal));
    const Image<uint8_t> diffuse = NormalTexture(mesh, scattered, surface.width(), surface.height());
    return WriteGlb(file, mesh, {colour, exported_.roughness, diffuse, GlbMaterial::Coat{exported_.coat, specular}},
                    exported_.origin);
  }
  // The surface's, and behind them the diffuse ones of each colour.
  Status WriteNormalExr(const std::filesystem::path& file) const {
    const SurfaceMap& surface = exported_.surface;
    const Image<float>& diffuse = exported_.diffuse_normal;
    const int more = diffuse.empty() ? 0 : diffuse.channels();
    Image<float> both(surface.width(), surface.height(), 3 + more, std::nanf(""));
    for (int j = 0; j < surface.height(); ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) == 0) continue;
        for (int c = 0; c < 3; ++c) both(i, j, c) = surface.normal(i, j, c);
        for (int c = 0; c < more; ++c) both(i, j, 3 + c) = diffuse(i, j, c);
      }
    std::vector<std::string> names = {"X", "Y", "Z"};
    for (const std::string& name : DiffuseNormalNames(more / 3)) names.push_back(name);
    return WriteExr(file, both, names);
  }
  Status WriteCloud(const std::filesystem::path& file) const {
    PointCloud cloud = CloudFromSurface(exported_.surface, exported_.camera, exported_.normal_sigma_rad);
    cloud.colours = mesh_.colours;
    cloud.skin = skin_;
    return WritePly(file, cloud, exported_.origin);
  }
  Status WriteDepth(const std::filesystem::path& file) {
    const Image<float> depth_mm = Masked(exported_.surface, exported_.surface.point_mm, 2, 1);
    SLX_ASSIGN_OR_RETURN(const DepthTiff made, WriteDepthTiff(file, depth_mm, exported_.origin));
    report_.too_far = made.out_of_range;
    return Status::Ok();
  }

  const ExportedSurface& exported_;
  const std::filesystem::path folder_;
  const Image<uint8_t> picture_;
  Mesh mesh_;  // with the surface's own normals
  std::vector<std::array<float, 3>> finer_normals_;
  std::vector<uint8_t> skin_;  // of each point
  SurfaceExportReport report_;
};

}  // namespace

const std::vector<std::string>& ExportFormatNames() {
  static const std::vector<std::string> names = {"ply", "glb", "cloud", "tiff", "exr"};
  return names;
}

std::set<ExportFormat> ParseExportFormats(const std::vector<std::string>& names) {
  std::set<ExportFormat> formats;
  for (size_t f = 0; f < ExportFormatNames().size(); ++f)
    if (std::find(names.begin(), names.end(), ExportFormatNames()[f]) != names.end())
      formats.insert(static_cast<ExportFormat>(f));
  return formats;
}

std::vector<std::string> SurfaceFiles(const std::set<ExportFormat>& formats) {
  std::vector<std::string> names;
  for (const ExportFormat format : formats)
    for (const char* name : FilesOf(format)) names.emplace_back(name);
  return names;
}

Result<ExportedSurface> LoadFittedSurface(const std::filesystem::path& folder) {
  SLX_ASSIGN_OR_RETURN(SavedFit fit, LoadFit(folder));
  ExportedSurface exported;
  exported.surface = std::move(fit.shape.surface);
  exported.camera = fit.shape.record.camera;
  exported.origin.layers = fit.provenance;
  // The second time for the fused normals.
  SLX_RETURN_IF_ERROR(CheckSurface(exported.surface, folder.string()));
  SLX_RETURN_IF_ERROR(TakeFusedNormals(folder, exported));
  SLX_RETURN_IF_ERROR(CheckSurface(exported.surface, folder.string()));
  SLX_RETURN_IF_ERROR(TakeSkin(folder, exported));
  exported.albedo =
      OnQuads(SummariseLayers(fit.map).total_weight, fit.pool, exported.surface.width(), exported.surface.height());
  const SurfaceReflection& reflection = fit.map.scattering.reflection;
  if (reflection.Known()) {
    constexpr double kCoatEta = 1.5;  // of glTF's clear coat
    exported.roughness = std::sqrt(reflection.roughness);
    exported.coat = reflection.strength * MirroredAlongNormal(fit.map.scattering.eta) / MirroredAlongNormal(kCoatEta);
  }
  SLX_RETURN_IF_ERROR(TakeDiffuseNormals(folder, fit.map.channels, exported));
  return exported;
}

Result<ExportedSurface> LoadBareSurface(const std::filesystem::path& folder) {
  SLX_ASSIGN_OR_RETURN(FaceShape shape, LoadShape(folder));
  ExportedSurface exported;
  exported.surface = std::move(shape.surface);
  exported.camera = shape.record.camera;
  SLX_RETURN_IF_ERROR(CheckSurface(exported.surface, folder.string()));
  exported.skin = AllSkin(exported.surface.mask).skin;
  return exported;
}

Image<uint8_t> AlbedoPicture(ImageView<const float> albedo) {
  if (albedo.empty()) return {};
  Image<float> filled(albedo.width(), albedo.height(), 3);
  for (int j = 0; j < albedo.height(); ++j)
    for (int i = 0; i < albedo.width(); ++i)
      for (int c = 0; c < 3; ++c) filled(i, j, c) = albedo(i, j, std::min(c, albedo.channels() - 1));
  FillFromNearest(filled);
  return ToSrgb(filled, 1.0);
}

Result<SurfaceExportReport> WriteSurface(const std::filesystem::path& folder, const ExportedSurface& exported,
                                         const std::set<ExportFormat>& formats,
                                         const std::function<void(const std::string&)>& writing) {
  Writer writer(exported, folder);
  if (writer.report().points == 0) return Status::NotFound("there is no surface to export: no quad was reconstructed");
  for (const std::string& name : SurfaceFiles(formats)) {
    writing(name);
    SLX_RETURN_IF_ERROR(writer.Write(name));
  }
  return writer.report();
}

}  // namespace stratalux::fit
