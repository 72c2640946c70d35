// SPDX-License-Identifier: Apache-2.0
// A scene as its TOML file describes it (docs/simulated-rig.md lists every key). The defaults are the visitor of
// `--simulate`; lengths in mm, angles in degrees.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/simulated/skin/skin_optics.h"
#include "shared/base/result.h"

namespace stratalux {
class TomlTable;
}

namespace stratalux::rig {

enum class ShapeKind { kHead, kPlane, kSphere, kWhite, kRamp, kChart, kCheckerboard, kCharuco, kBowl, kSlab, kMesh };
[[nodiscard]] const char* ToString(ShapeKind kind);
[[nodiscard]] Result<ShapeKind> ParseShapeKind(const std::string& text);

enum class Eyes { kNone, kClosed, kOpen };  // kNone: lids without a slit

// Factors of an adult face's proportions.
struct HeadDescription {
  double width = 1.0, height = 1.0, depth = 1.0, nose = 1.0, brow = 1.0, cheekbones = 1.0, lips = 1.0, chin = 1.0;
  double variation = 0.1;    // how far the seed varies each length, relative
  double wrinkles_mm = 0.0;  // depth of forehead lines, crow's feet and the folds beside the nose
  double pores_mm = 0.0;     // depth
  Eyes eyes = Eyes::kOpen;
  bool nostrils = true;  // dark and shallow
  bool brows = true;
  bool hair = true;              // above the forehead
  double stubble_per_cm2 = 0.0;  // opaque hairs of a shaven beard
  double stubble_mm = 0.6;       // their length

  // Without eyes, nostrils, brows and hair, as a mannequin's.
  [[nodiscard]] static HeadDescription Bald();
};

enum class SkinBody { kTranslucent, kMatt };  // kMatt: opaque, of the same albedo

struct SkinDescription {
  SkinBody body = SkinBody::kTranslucent;
  std::optional<int> person;      // of the population (skin/population.h), for what is unset below; unset: the seed's
  std::optional<double> melanin;  // volume fraction in the epidermis
  std::optional<double> blood;    // volume fraction in the dermis
  std::optional<double> epidermis_mm;  // thickness
  std::optional<double> scattering;    // over that of tissue samples; within the skin table's nodes
  double subcutis_absorption = 1.0;    // over the skin baseline's; of everyone, regions or not, as what follows
  double skin_mm = kSkinMm;            // where the subcutis begins
  double patches = 1.0;                // strength of the patches of a few centimetres; 0: even skin
  std::optional<int> freckles;         // unset: by seed, 30 to 90
  int vessels = 1;                     // across forehead and temples
  double redness = 1.0;                // strength of the blood of cheeks, nose and lips
  bool scar = false;                   // across a cheek: pale, without melanin
  // Strength of what sets forehead, nose, lips, ... apart (face_regions.h); 1: as there.
  double regions = 1.0;

  // Of the cheek: the person's, but for what is set here.
  [[nodiscard]] SkinParameters Of(uint64_t seed) const;
};

enum class SkinSurface { kGgx, kBeckmann, kTwoLobes };

// The skin's surface itself (face_surface.h).
struct SurfaceDescription {
  SkinSurface form = SkinSurface::kTwoLobes;  // kGgx: the form that the fitter fits
  double oiliness = 0.5;                      // of forehead, nose and chin; 0: the surface is the same everywhere
  double fuzz = 1.0;                          // fine hairs over that of a grown face; 0: none

  [[nodiscard]] static SurfaceDescription Even() { return {SkinSurface::kGgx, 0.0, 0.0}; }
};

// Plates: boards, ramp, chart, white target, wax slab.
struct PlateDescription {
  double width_mm = 240.0, height_mm = 180.0;  // boards take their size from the squares
  int columns = 10, rows = 7;                  // squares of a board; steps of a ramp (columns)
  double square_mm = 20.0;
  double marker_mm = 15.0;  // side of a ChArUco marker
  double dark_albedo = 0.04, light_albedo = 0.9;
};

// Directions of a mesh file's axes.
enum class MeshAxis { kPlusX, kMinusX, kPlusY, kMinusY, kPlusZ, kMinusZ };
[[nodiscard]] Eigen::Vector3d DirectionOf(MeshAxis axis);

// A mesh file, as a subject.
struct MeshDescription {
  std::string file;                                // *.obj or *.ply; of a scene file, relative to it
  std::string albedo;                              // *.png by the mesh's texture coordinates; empty: skin by seed
  double albedo_scale = 1.0;                       // of the picture's linear values: a scan's exposure is nobody's
  bool flip_v = false;                             // the file's v runs down the picture, as glTF has it
  double unit_mm = 1.0;                            // of the file's coordinates
  MeshAxis up = MeshAxis::kPlusY;                  // in the file's axes
  MeshAxis front = MeshAxis::kPlusZ;               // out of the face, towards the camera
  std::optional<std::array<double, 3>> origin_mm;  // of the file, times unit_mm: goes to (0, 0, 700); unset: see Mesh
  std::optional<double> crease_deg;                // sharper edges stay; unset: the file's normals, else all smooth
  int subdivisions = 0;                            // halvings of the edges on curved patches
  double relief_mm = 0.0;                          // depth of pores
};

struct PoseDescription {
  std::array<double, 3> position_mm{};   // moves the subject from its place at the working distance
  std::array<double, 3> rotation_deg{};  // about x, then y, then z of the rig, through the point (0, 0, 700)
};

struct MotionDescription {
  std::array<double, 3> drift_mm_per_s{};
  std::array<double, 3> turn_deg_per_s{};  // meanwhile, about x, y, z through the pivot, as a pose's rotation
  double drift_start_s = 0.0;
  // It goes in steps, a turn measured kTurnLeverMm from the pivot: each costs a new light transport.
  double step_mm = 0.1;
  std::vector<double> blink_at_s;  // closes open eyes
  double blink_s = 0.15;
};

struct SceneDescription {
  std::string name = "head";
  ShapeKind shape = ShapeKind::kHead;
  std::optional<uint64_t> seed;  // unset: the session's
  HeadDescription head;
  SkinDescription skin;
  SurfaceDescription surface;
  PlateDescription plate;
  MeshDescription mesh;
  PoseDescription pose;
  std::vector<PoseDescription> poses;  // of a board, one a capture; each takes the subject's place
  MotionDescription motion;
  double ambient_dn_per_ms = 0.1;  // of a white target; a black box is nearly dark
  bool interreflection = false;    // one bounce between parts of the subject

  // What a scene of that shape is where it says nothing else: a head is a person's; other bodies are of a person's
  // skin without regions, under an even surface.
  [[nodiscard]] static SceneDescription Of(ShapeKind shape);
  [[nodiscard]] Status Validate() const;
  // Poses the subject as `poses[index]` says; -1, and scenes without a list, leave it. kUsage names what there is.
  [[nodiscard]] Status TakePose(int index);
};

// The plain scene of a shape's name, or of "bald", a head that is HeadDescription::Bald(); kUsage lists the names.
[[nodiscard]] Result<SceneDescription> SceneOfName(const std::string& name);
// "head, plane, ..., bald": without those that need a file.
[[nodiscard]] std::string PlainSceneNames();
// Reads the scene's own tables of `root` and leaves others to the caller.
[[nodiscard]] Result<SceneDescription> ReadScene(TomlTable& root);

}  // namespace stratalux::rig
