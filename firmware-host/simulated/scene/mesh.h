// SPDX-License-Identifier: Apache-2.0
// A head, or anything else, from a mesh file: triangles with smooth normals, whose skin is that of a picture or of a
// seed. The file's up and front become the rig's (-y and -z); its unit is `unit_mm`. Without an origin of the
// description's, the middle of its box lies on the camera's axis, its frontmost point 660 mm away, as a default head's
// nose does.
//
// Outside is the side that most of what is seen from the front shows. What shows its back (the inside of an open neck,
// faces wound the other way) hides what lies behind and gives no light.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/simulated/mesh/mesh_file.h"
#include "firmware-host/simulated/mesh/surface.h"
#include "firmware-host/simulated/mesh/triangle_tree.h"
#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/scene/face_skin.h"
#include "firmware-host/simulated/scene/face_surface.h"
#include "firmware-host/simulated/scene/picture_skin.h"
#include "firmware-host/simulated/scene/shape.h"

namespace stratalux::rig {

class Mesh : public Shape {
 public:
  static constexpr double kFrontMm = 660.0;
  static constexpr double kSmallestMm = 10.0, kLargestMm = 1000.0;  // its longest side
  static constexpr double kNearestMm = 300.0;                       // to the camera

  // Reads the files that the description names. `table`: against which a picture's colours are solved; null: a picture
  // is refused. kUsage for what a file or the description may not say, with the remedy.
  static Result<std::shared_ptr<const Mesh>> Create(const MeshDescription& description, const SkinDescription& skin,
                                                    const FaceSurface& surface, uint64_t seed, const SkinTable* table);
  // Of a mesh that is at hand, with skin by seed.
  static Result<std::shared_ptr<const Mesh>> Create(MeshData mesh, const MeshDescription& description, FaceSkin skin,
                                                    const FaceSurface& surface, uint64_t seed);

  [[nodiscard]] double Height(double x, double y) const override;
  [[nodiscard]] std::optional<Eigen::Vector3d> Intersect(const Ray3& ray) const override;
  [[nodiscard]] Eigen::Vector3d Normal(const Eigen::Vector3d& point) const override;
  [[nodiscard]] bool Hides(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const override;
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d& point, EyeLids lids) const override;
  [[nodiscard]] std::vector<std::string> Remarks() const override;

 private:
  // What of the surface the picture could not be followed at.
  struct PictureReport {
    double clamped = 0.0;    // share of the area
    double deviation = 0.0;  // rms of SolvedSkin::deviation over the area
  };
  Mesh(MeshData mesh, CornerNormals normals, const MeshDescription& description, FaceSkin skin,
       const FaceSurface& surface, uint64_t seed);
  // Turns the normals to the side that is seen from the front.
  void FaceTheCamera();
  void TakePicture(PictureSkin picture);
  [[nodiscard]] Eigen::Vector3d SmoothNormal(const TrianglePoint& at) const;
  [[nodiscard]] Eigen::Vector2d TextureAt(const TrianglePoint& at) const;
  // Where the ray that meets the surface at `hit` ends among its pores.
  [[nodiscard]] double IntoPores(const Ray3& ray, const TriangleTree::Hit& hit) const;

  MeshData mesh_;  // in the rig's axes, mm
  CornerNormals normals_;
  TriangleTree tree_;
  double relief_mm_;
  uint64_t seed_;
  FaceSkin skin_;
  FaceSurface surface_;
  std::optional<PictureSkin> picture_;
  PictureReport report_;
  double backs_ = 0.0;  // share of what is seen from the front
};

}  // namespace stratalux::rig
