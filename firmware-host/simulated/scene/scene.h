// SPDX-License-Identifier: Apache-2.0
// The subject of the simulated rig in the rig frame (camera at the origin, +z forward), at one moment: where its
// surface lies and what it is made of. Cheap to copy; safe from any thread.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/scene/shape.h"
#include "firmware-host/simulated/skin/skin_table.h"
#include "shared/base/result.h"
#include "shared/geometry/rigid3.h"

namespace stratalux::rig {

// What changes while a subject is captured.
struct SubjectState {
  // From the described pose, in whole steps of the motion.
  Eigen::Vector3d offset_mm = Eigen::Vector3d::Zero(), turned_deg = Eigen::Vector3d::Zero();
  EyeLids lids = EyeLids::kAsDescribed;

  friend bool operator==(const SubjectState& a, const SubjectState& b) {
    return a.offset_mm == b.offset_mm && a.turned_deg == b.turned_deg && a.lids == b.lids;
  }
};

class Scene {
 public:
  // The description's seed, else `seed`. `table`: against which the colours of a mesh's picture are solved; null: such
  // a scene is refused. kUsage for what a description, or the files that it names, may not say.
  static Result<Scene> Create(const SceneDescription& description, uint64_t seed, const SkinTable* table = nullptr);
  // The plain scene of a shape's name.
  static Result<Scene> Create(const std::string& name, uint64_t seed);
  // The same skin everywhere, for subjects whose light can be computed by hand.
  void UseUniformSkin(const SkinParameters& skin) { uniform_skin_ = skin; }

  // As described, `seconds` after the session's start.
  [[nodiscard]] SubjectState StateAt(double seconds) const;
  [[nodiscard]] Scene In(const SubjectState& state) const;

  // Depth of the surface on the line parallel to the axis through (x, y), mm; NaN where there is none.
  [[nodiscard]] double Height(double x, double y) const;
  // First point of the ray on the surface; nullopt when it misses.
  [[nodiscard]] std::optional<Eigen::Vector3d> Intersect(const Ray3& ray) const;
  // Whether the subject itself stands between two of its points.
  [[nodiscard]] bool Hides(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const;
  // Unit normal at a surface point, towards the camera's side.
  [[nodiscard]] Eigen::Vector3d Normal(const Eigen::Vector3d& point) const;
  [[nodiscard]] Material MaterialAt(const Eigen::Vector3d& point) const;
  // Of the skin at a surface point; meaningless where the material is none.
  [[nodiscard]] SkinParameters Skin(const Eigen::Vector3d& point) const { return MaterialAt(point).skin; }
  // What whoever described the scene should be told, a line each.
  [[nodiscard]] std::vector<std::string> Remarks() const { return shape_->Remarks(); }
  [[nodiscard]] const std::string& name() const { return description_.name; }
  [[nodiscard]] const SceneDescription& description() const { return description_; }

 private:
  [[nodiscard]] Eigen::Vector3d ToShape(const Eigen::Vector3d& point) const {
    return resting_ ? point : shape_from_rig_ * point;
  }

  SceneDescription description_;
  std::shared_ptr<const Shape> shape_;
  std::optional<SkinParameters> uniform_skin_;
  SubjectState state_;
  Rigid3 shape_from_rig_, rig_from_shape_;
  bool resting_ = true;  // both are the identity
};

}  // namespace stratalux::rig
