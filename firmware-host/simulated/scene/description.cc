// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/description.h"

#include <algorithm>
#include <string_view>

#include "shared/config/toml_reader.h"

namespace stratalux::rig {
namespace {

constexpr std::array<std::string_view, 10> kShapes = {"head",  "plane",        "sphere",  "white", "ramp",
                                                      "chart", "checkerboard", "charuco", "bowl",  "slab"};
constexpr std::array<std::string_view, 3> kEyes = {"none", "closed", "open"};

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
  GetOptional(t, "melanin", skin.melanin, 0.005, 0.3);
  GetOptional(t, "blood", skin.blood, 0.0005, 0.06);
  t.Get("epidermis_mm", skin.epidermis_mm, 0.05, 0.15);
  t.Get("patches", skin.patches, 0.0, 3.0);
  GetOptional(t, "freckles", skin.freckles, 0, 1000);
  t.Get("vessels", skin.vessels, 0, 20);
  t.Get("redness", skin.redness, 0.0, 4.0);
  t.Get("scar", skin.scar);
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

Status ReadPose(TomlTable& t, PoseDescription& pose) {
  SLX_RETURN_IF_ERROR(GetVector(t, "position_mm", pose.position_mm, 400.0));
  return GetVector(t, "rotation_deg", pose.rotation_deg, 75.0);
}

Status ReadMotion(TomlTable t, MotionDescription& motion) {
  SLX_RETURN_IF_ERROR(GetVector(t, "drift_mm_per_s", motion.drift_mm_per_s, 100.0));
  t.Get("drift_start_s", motion.drift_start_s, 0.0, 3600.0);
  t.Get("step_mm", motion.step_mm, 0.01, 10.0);
  t.Get("blink_at_s", motion.blink_at_s, 0.0, 3600.0);
  t.Get("blink_s", motion.blink_s, 0.01, 10.0);
  return Status::Ok();
}

}  // namespace

const char* ToString(ShapeKind kind) { return kShapes[static_cast<size_t>(kind)].data(); }

Result<ShapeKind> ParseShapeKind(const std::string& text) { return ParseName<ShapeKind>("shape", kShapes, text); }

Status SceneDescription::Validate() const {
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
    return Status::Usage("pose " + std::to_string(index) + " is not there; the scene has poses 0 .. " +
                         std::to_string(poses.size() - 1));
  pose = poses[static_cast<size_t>(index)];
  return Status::Ok();
}

Result<SceneDescription> ReadScene(TomlTable& root) {
  SceneDescription scene;
  TomlTable subject = root.Table("subject");
  root.Get("name", scene.name);
  std::string shape = ToString(scene.shape);
  subject.Get("shape", shape);
  SLX_ASSIGN_OR_RETURN(scene.shape, ParseShapeKind(shape).WithContext(subject.Where("shape")));
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
  ReadPlate(root.Table("plate"), scene.plate);
  SLX_RETURN_IF_ERROR(ReadMotion(root.Table("motion"), scene.motion));
  root.Table("ambient").Get("dn_per_ms", scene.ambient_dn_per_ms, 0.0, 1000.0);
  return scene;
}

Result<SceneDescription> SceneOfName(const std::string& name) {
  const auto shape = ParseShapeKind(name);
  if (!shape.ok())
    return Status::Usage("scene '" + name + "' is unknown; allowed: " + Names(kShapes) +
                         ", or a scene file ending in .toml");
  SceneDescription scene;
  scene.name = name;
  scene.shape = *shape;
  return scene;
}

}  // namespace stratalux::rig
