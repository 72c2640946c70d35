// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/description.h"

#include <algorithm>
#include <span>
#include <string_view>

#include "firmware-host/simulated/mesh/surface.h"
#include "firmware-host/simulated/skin/population.h"
#include "firmware-host/simulated/skin/subcutis_table.h"
#include "shared/config/toml_reader.h"

namespace stratalux::rig {
namespace {

constexpr std::array<std::string_view, 11> kShapes = {"head",         "plane",   "sphere", "white", "ramp", "chart",
                                                      "checkerboard", "charuco", "bowl",   "slab",  "mesh"};
constexpr std::array<std::string_view, 3> kEyes = {"none", "closed", "open"};
constexpr std::array<std::string_view, 3> kSurfaces = {"ggx", "beckmann", "two_lobes"};

std::string Names(const auto& names) {
  std::string list;
  for (const std::string_view name : names) list += (list.empty() ? "" : ", ") + std::string(name);
  return list;
}

template <typename Enum>
Result<Enum> ParseName(const std::string& what, const auto& names, const std::string& text) {
  for (size_t i = 0; i < names.size(); ++i)
    if (names[i] == text) return static_cast<Enum>(i);
  return Status::Usage(what + " '" + text + "' is unknown; allowed: " + Names(names));
}

template <typename T>
void GetOptional(TomlTable& table, const std::string& key, std::optional<T>& value, T low, T high) {
  if (!table.Has(key)) return;
  T read = low;
  table.Get(key, read, low, high);
  value = read;
}

Status GetVector(TomlTable& table, const std::string& key, std::array<double, 3>& value, double limit) {
  if (!table.Has(key)) return Status::Ok();
  std::vector<double> read;
  table.Get(key, read, -limit, limit);
  if (read.size() != 3) return Status::Usage(table.Where(key) + ": " + key + " takes three numbers, [x, y, z]");
  std::copy(read.begin(), read.end(), value.begin());
  return Status::Ok();
}

Status ReadHead(TomlTable t, HeadDescription& head) {
  bool bald = false;
  t.Get("bald", bald);
  if (bald) head = HeadDescription::Bald();  // before the keys that change it
  for (const auto& [key, value] : {std::pair{"width", &head.width},
                                   {"height", &head.height},
                                   {"depth", &head.depth},
                                   {"nose", &head.nose},
                                   {"brow", &head.brow},
                                   {"cheekbones", &head.cheekbones},
                                   {"lips", &head.lips},
                                   {"chin", &head.chin}})
    t.Get(key, *value, 0.5, 1.5);
  t.Get("variation", head.variation, 0.0, 0.2);
  t.Get("wrinkles_mm", head.wrinkles_mm, 0.0, 2.0);
  t.Get("pores_mm", head.pores_mm, 0.0, 0.3);
  std::string eyes(kEyes[static_cast<size_t>(head.eyes)]);
  t.Get("eyes", eyes);
  SLX_ASSIGN_OR_RETURN(head.eyes, ParseName<Eyes>("eyes", kEyes, eyes).WithContext(t.Where("eyes")));
  t.Get("nostrils", head.nostrils);
  t.Get("brows", head.brows);
  t.Get("hair", head.hair);
  t.Get("stubble_per_cm2", head.stubble_per_cm2, 0.0, 200.0);
  t.Get("stubble_mm", head.stubble_mm, 0.1, 5.0);
  return Status::Ok();
}

Status ReadSkin(TomlTable t, SkinDescription& skin) {
  bool opaque = skin.body == SkinBody::kMatt;
  t.Get("opaque", opaque);
  skin.body = opaque ? SkinBody::kMatt : SkinBody::kTranslucent;
  GetOptional(t, "person", skin.person, 0, kMostPeople - 1);
  GetOptional(t, "melanin", skin.melanin, 0.005, 0.3);
  GetOptional(t, "blood", skin.blood, 0.0005, 0.06);
  GetOptional(t, "epidermis_mm", skin.epidermis_mm, 0.05, 0.15);
  GetOptional(t, "scattering", skin.scattering, 0.1, 3.0);
  t.Get("subcutis_absorption", skin.subcutis_absorption, SubcutisGrid::kAbsorption.front(),
        SubcutisGrid::kAbsorption.back());
  t.Get("skin_mm", skin.skin_mm, SubcutisGrid::kSkinMm.back(), SubcutisGrid::kSkinMm.front());
  t.Get("patches", skin.patches, 0.0, 3.0);
  GetOptional(t, "freckles", skin.freckles, 0, 1000);
  t.Get("vessels", skin.vessels, 0, 20);
  t.Get("redness", skin.redness, 0.0, 4.0);
  t.Get("scar", skin.scar);
  t.Get("regions", skin.regions, 0.0, 2.0);
  return Status::Ok();
}

Status ReadSurface(TomlTable t, SurfaceDescription& surface) {
  std::string form(kSurfaces[static_cast<size_t>(surface.form)]);
  t.Get("form", form);
  SLX_ASSIGN_OR_RETURN(surface.form, ParseName<SkinSurface>("form", kSurfaces, form).WithContext(t.Where("form")));
  t.Get("oiliness", surface.oiliness, 0.0, 1.0);
  t.Get("fuzz", surface.fuzz, 0.0, 3.0);
  return Status::Ok();
}

void ReadPlate(TomlTable t, PlateDescription& plate) {
  t.Get("width_mm", plate.width_mm, 10.0, 600.0);
  t.Get("height_mm", plate.height_mm, 10.0, 600.0);
  t.Get("columns", plate.columns, 2, 64);
  t.Get("rows", plate.rows, 1, 64);
  t.Get("square_mm", plate.square_mm, 1.0, 100.0);
  t.Get("marker_mm", plate.marker_mm, 0.5, 100.0);
  t.Get("dark_albedo", plate.dark_albedo, 0.0, 1.0);
  t.Get("light_albedo", plate.light_albedo, 0.0, 1.0);
}

Status ReadMesh(TomlTable t, MeshDescription& mesh) {
  static const std::vector<std::string> kAxes = {"+x", "-x", "+y", "-y", "+z", "-z"};
  t.Get("file", mesh.file);
  t.Get("albedo", mesh.albedo);
  t.Get("albedo_scale", mesh.albedo_scale, 0.05, 20.0);
  t.Get("flip_v", mesh.flip_v);
  t.Get("unit_mm", mesh.unit_mm, 1e-6, 1e6);
  for (const auto& [key, axis] : {std::pair{"up", &mesh.up}, {"front", &mesh.front}}) {
    auto index = static_cast<size_t>(*axis);
    t.GetWord(key, index, kAxes);
    *axis = static_cast<MeshAxis>(index);
  }
  if (t.Has("origin_mm")) SLX_RETURN_IF_ERROR(GetVector(t, "origin_mm", mesh.origin_mm.emplace(), 1e6));
  GetOptional(t, "crease_deg", mesh.crease_deg, 0.0, 180.0);
  t.Get("subdivisions", mesh.subdivisions, 0, kMostSubdivisions);
  t.Get("relief_mm", mesh.relief_mm, 0.0, 0.1);
  return Status::Ok();
}

Status CheckMesh(const SceneDescription& scene) {
  if (scene.skin.regions > 0.0)
    return Status::Usage("scene " + scene.name +
                         ": [skin] regions follow the procedural head's face; a mesh has its picture, leave them out");
  const MeshDescription& mesh = scene.mesh;
  const std::string where = "scene " + scene.name + ": ";
  if (mesh.file.empty()) return Status::Usage(where + "shape mesh takes a scene file with [mesh] file = \"head.obj\"");
  if (DirectionOf(mesh.up).dot(DirectionOf(mesh.front)) != 0.0)
    return Status::Usage(where + "[mesh] up and front lie along the same axis; name two");
  if (mesh.subdivisions > 0 && mesh.crease_deg)
    return Status::Usage(where + "[mesh] subdivisions makes the whole surface smooth; leave crease_deg out");
  if (!mesh.albedo.empty() && scene.skin.person)
    return Status::Usage(where +
                         "[skin] person sets melanin and blood, which are solved from [mesh] albedo; leave one of "
                         "them out (epidermis_mm and scattering are keys of their own)");
  if (!mesh.albedo.empty() && (scene.skin.melanin || scene.skin.blood))
    return Status::Usage(where + "[skin] melanin and blood are solved from [mesh] albedo; leave one of them out");
  const SkinDescription usual;
  const SkinDescription& skin = scene.skin;
  if (!mesh.albedo.empty() && (skin.scar != usual.scar || skin.freckles || skin.vessels != usual.vessels ||
                               skin.patches != usual.patches || skin.redness != usual.redness))
    return Status::Usage(where +
                         "[skin] patches, freckles, vessels, redness and scar are of a face that is drawn; the one of "
                         "[mesh] albedo has its picture's, leave them out");
  return Status::Ok();
}

Status ReadPose(TomlTable& t, PoseDescription& pose) {
  SLX_RETURN_IF_ERROR(GetVector(t, "position_mm", pose.position_mm, 400.0));
  return GetVector(t, "rotation_deg", pose.rotation_deg, 75.0);
}

Status ReadMotion(TomlTable t, MotionDescription& motion) {
  SLX_RETURN_IF_ERROR(GetVector(t, "drift_mm_per_s", motion.drift_mm_per_s, 100.0));
  SLX_RETURN_IF_ERROR(GetVector(t, "turn_deg_per_s", motion.turn_deg_per_s, 45.0));
  t.Get("drift_start_s", motion.drift_start_s, 0.0, 3600.0);
  t.Get("step_mm", motion.step_mm, 0.01, 10.0);
  t.Get("blink_at_s", motion.blink_at_s, 0.0, 3600.0);
  t.Get("blink_s", motion.blink_s, 0.01, 10.0);
  return Status::Ok();
}

}  // namespace

HeadDescription HeadDescription::Bald() {
  HeadDescription head;
  head.eyes = Eyes::kNone;
  head.nostrils = head.brows = head.hair = false;
  return head;
}

SkinParameters SkinDescription::Of(uint64_t seed) const {
  SkinParameters skin = Person(person.value_or(static_cast<int>(seed % kMostPeople)));
  if (melanin) skin.melanin = static_cast<float>(*melanin);
  if (blood) skin.blood = static_cast<float>(*blood);
  if (epidermis_mm) skin.epidermis_mm = static_cast<float>(*epidermis_mm);
  if (scattering) skin.scattering = static_cast<float>(*scattering);
  skin.subcutis_absorption = static_cast<float>(subcutis_absorption);
  skin.skin_mm = skin_mm;
  return skin;
}

SceneDescription SceneDescription::Of(ShapeKind shape) {
  SceneDescription scene;
  scene.name = ToString(shape);
  scene.shape = shape;
  if (shape == ShapeKind::kHead) return scene;
  scene.skin.regions = 0.0;
  scene.surface = SurfaceDescription::Even();
  return scene;
}

const char* ToString(ShapeKind kind) { return kShapes[static_cast<size_t>(kind)].data(); }

Result<ShapeKind> ParseShapeKind(const std::string& text) { return ParseName<ShapeKind>("shape", kShapes, text); }

Eigen::Vector3d DirectionOf(MeshAxis axis) {
  const int index = static_cast<int>(axis);
  return (index % 2 == 0 ? 1.0 : -1.0) * Eigen::Vector3d::Unit(index / 2);
}

Status SceneDescription::Validate() const {
  if (shape == ShapeKind::kMesh) SLX_RETURN_IF_ERROR(CheckMesh(*this));
  if (shape == ShapeKind::kCharuco && plate.marker_mm >= plate.square_mm)
    return Status::Usage("scene " + name + ": marker_mm = " + std::to_string(plate.marker_mm) +
                         " must be smaller than square_mm = " + std::to_string(plate.square_mm));
  if (shape == ShapeKind::kCharuco && plate.columns * plate.rows / 2 > 50)
    return Status::Usage("scene " + name + ": " + std::to_string(plate.columns) + " x " + std::to_string(plate.rows) +
                         " squares need more than the dictionary's 50 markers");
  return Status::Ok();
}

Status SceneDescription::TakePose(int index) {
  if (index < 0 || poses.empty()) return Status::Ok();
  if (index >= static_cast<int>(poses.size()))
    return Status::Usage("pose " + std::to_string(index) + " does not exist; the scene has poses 0 .. " +
                         std::to_string(poses.size() - 1));
  pose = poses[static_cast<size_t>(index)];
  return Status::Ok();
}

Result<SceneDescription> ReadScene(TomlTable& root) {
  TomlTable subject = root.Table("subject");
  std::string shape = ToString(ShapeKind::kHead);
  subject.Get("shape", shape);
  SLX_ASSIGN_OR_RETURN(const ShapeKind kind, ParseShapeKind(shape).WithContext(subject.Where("shape")));
  SceneDescription scene = SceneDescription::Of(kind);
  root.Get("name", scene.name);
  if (subject.Has("seed")) {
    int seed = 0;
    subject.Get("seed", seed, 0, 1 << 30);
    scene.seed = static_cast<uint64_t>(seed);
  }
  SLX_RETURN_IF_ERROR(ReadPose(subject, scene.pose));
  for (TomlTable& table : root.Tables("pose")) SLX_RETURN_IF_ERROR(ReadPose(table, scene.poses.emplace_back()));
  subject.Get("interreflection", scene.interreflection);
  SLX_RETURN_IF_ERROR(ReadHead(root.Table("head"), scene.head));
  SLX_RETURN_IF_ERROR(ReadSkin(root.Table("skin"), scene.skin));
  SLX_RETURN_IF_ERROR(ReadSurface(root.Table("surface"), scene.surface));
  ReadPlate(root.Table("plate"), scene.plate);
  SLX_RETURN_IF_ERROR(ReadMesh(root.Table("mesh"), scene.mesh));
  SLX_RETURN_IF_ERROR(ReadMotion(root.Table("motion"), scene.motion));
  root.Table("ambient").Get("dn_per_ms", scene.ambient_dn_per_ms, 0.0, 1000.0);
  return scene;
}

Result<SceneDescription> SceneOfName(const std::string& name) {
  if (name == "bald") {
    SceneDescription scene;
    scene.name = name;
    scene.head = HeadDescription::Bald();
    return scene;
  }
  const auto shape = ParseShapeKind(name);
  if (!shape.ok())
    return Status::Usage("scene '" + name + "' is unknown; allowed: " + PlainSceneNames() +
                         ", or a scene file ending in .toml");
  return SceneDescription::Of(*shape);
}

std::string PlainSceneNames() {
  static_assert(kShapes.back() == "mesh");
  return Names(std::span(kShapes).first(kShapes.size() - 1)) + ", bald";
}

}  // namespace stratalux::rig
