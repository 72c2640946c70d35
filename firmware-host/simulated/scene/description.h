// SPDX-License-Identifier: Apache-2.0
// A scene as its TOML file describes it (docs/simulated-rig.md lists every key). The defaults are the plain head of
// `--simulate`; lengths in mm, angles in degrees.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux {
class TomlTable;
}

namespace stratalux::rig {

enum class ShapeKind { kHead, kPlane, kSphere, kWhite, kRamp, kChart, kCheckerboard, kCharuco, kBowl, kSlab };
[[nodiscard]] const char* ToString(ShapeKind kind);
[[nodiscard]] Result<ShapeKind> ParseShapeKind(const std::string& text);

enum class Eyes { kNone, kClosed, kOpen };  // kNone: lids without a slit

// Factors of an adult face's proportions.
struct HeadDescription {
  double width = 1.0, height = 1.0, depth = 1.0, nose = 1.0, brow = 1.0, cheekbones = 1.0, lips = 1.0, chin = 1.0;
  double variation = 0.1;    // how far the seed varies each length, relative
  double wrinkles_mm = 0.0;  // depth of forehead lines, crow's feet and the folds beside the nose
  double pores_mm = 0.0;     // depth
  Eyes eyes = Eyes::kNone;
  bool brows = false;
  bool hair = false;             // above the forehead
  double stubble_per_cm2 = 0.0;  // opaque hairs of a shaven beard
  double stubble_mm = 0.6;       // their length
};

enum class SkinBody { kTranslucent, kMatt };  // kMatt: opaque, of the same albedo

struct SkinDescription {
  SkinBody body = SkinBody::kTranslucent;
  std::optional<double> melanin;  // volume fraction in the epidermis; unset: by seed, 1.2 % to 10 %
  std::optional<double> blood;    // volume fraction in the dermis; unset: by seed
  double epidermis_mm = 0.08;     // thickness
  double patches = 1.0;           // strength of the patches of a few centimetres; 0: even skin
  std::optional<int> freckles;    // unset: by seed, 30 to 90
  int vessels = 1;                // across forehead and temples
  double redness = 1.0;           // strength of the blood of cheeks, nose and lips
  bool scar = false;              // across a cheek: pale, without melanin
};

// Plates: boards, ramp, chart, white target, wax slab.
struct PlateDescription {
  double width_mm = 240.0, height_mm = 180.0;  // boards take their size from the squares
  int columns = 10, rows = 7;                  // squares of a board; steps of a ramp (columns)
  double square_mm = 20.0;
  double marker_mm = 15.0;  // side of a ChArUco marker
  double dark_albedo = 0.04, light_albedo = 0.9;
};

struct PoseDescription {
  std::array<double, 3> position_mm{};   // moves the subject from its place at the working distance
  std::array<double, 3> rotation_deg{};  // about x, then y, then z of the rig, through the point (0, 0, 700)
};

struct MotionDescription {
  std::array<double, 3> drift_mm_per_s{};
  double drift_start_s = 0.0;
  double step_mm = 0.1;            // the drift goes in steps: each costs a new light transport
  std::vector<double> blink_at_s;  // closes open eyes
  double blink_s = 0.15;
};

struct SceneDescription {
  std::string name = "head";
  ShapeKind shape = ShapeKind::kHead;
  std::optional<uint64_t> seed;  // unset: the session's
  HeadDescription head;
  SkinDescription skin;
  PlateDescription plate;
  PoseDescription pose;
  std::vector<PoseDescription> poses;  // of a board, one a capture; each takes the subject's place
  MotionDescription motion;
  double ambient_dn_per_ms = 0.1;  // of a white target; a black box is nearly dark
  bool interreflection = false;    // one bounce between parts of the subject

  [[nodiscard]] Status Validate() const;
  // Poses the subject as `poses[index]` says; -1, and scenes without a list, leave it. kUsage names what there is.
  [[nodiscard]] Status TakePose(int index);
};

// The plain scene of a shape's name; kUsage lists the names.
[[nodiscard]] Result<SceneDescription> SceneOfName(const std::string& name);
// Reads the scene's own tables of `root` and leaves others to the caller.
[[nodiscard]] Result<SceneDescription> ReadScene(TomlTable& root);

}  // namespace stratalux::rig
