// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/scene.h"

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <utility>

#include "firmware-host/simulated/scene/head.h"
#include "firmware-host/simulated/scene/mesh.h"
#include "firmware-host/simulated/scene/plate.h"
#include "firmware-host/simulated/scene/solids.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

const Eigen::Vector3d kPivotMm(0.0, 0.0, 700.0);

constexpr double kTurnLeverMm = 100.0;  // half a head's height: how far from the pivot a turn counts as a drift

Eigen::Quaterniond TurnOf(const Eigen::Vector3d& deg) {
  auto turn = [&](int axis) { return Eigen::AngleAxisd(RadFromDeg(deg[axis]), Eigen::Vector3d::Unit(axis)); };
  return turn(2) * turn(1) * turn(0);
}

Rigid3 PoseOf(const PoseDescription& pose, const SubjectState& state) {
  Rigid3 rig_from_shape;
  rig_from_shape.rotation = TurnOf(state.turned_deg) * TurnOf(Eigen::Vector3d(pose.rotation_deg.data()));
  const Eigen::Vector3d position(pose.position_mm.data());
  rig_from_shape.translation_mm = kPivotMm + position + state.offset_mm - rig_from_shape.rotation * kPivotMm;
  return rig_from_shape;
}

template <typename T, typename... Arguments>
std::shared_ptr<const Shape> Make(Arguments&&... arguments) {
  return std::make_shared<const T>(std::forward<Arguments>(arguments)...);
}

Result<std::shared_ptr<const Shape>> MakeShape(const SceneDescription& scene, uint64_t seed, const SkinTable* table) {
  const FaceFeatures features = FaceFeatures::Of(scene.head, seed);
  const FaceSkin skin(scene.skin, FaceRegions(features), seed);
  const FaceSurface surface(scene.surface);
  switch (scene.shape) {
    case ShapeKind::kHead:
      return Make<Head>(scene.head, features, skin, surface, seed);
    case ShapeKind::kPlane:
      return Make<TiltedPlane>(skin, surface);
    case ShapeKind::kSphere:
      return Make<Sphere>(skin, surface);
    case ShapeKind::kBowl:
      return Make<Bowl>(scene.plate.light_albedo);
    case ShapeKind::kMesh: {
      SLX_ASSIGN_OR_RETURN(std::shared_ptr<const Shape> mesh,
                           Mesh::Create(scene.mesh, scene.skin, surface, seed, table));
      return mesh;
    }
    default:
      return Make<Plate>(scene.shape, scene.plate);
  }
}

}  // namespace

Result<Scene> Scene::Create(const std::string& name, uint64_t seed) {
  SLX_ASSIGN_OR_RETURN(const SceneDescription description, SceneOfName(name));
  return Create(description, seed);
}

Result<Scene> Scene::Create(const SceneDescription& description, uint64_t seed, const SkinTable* table) {
  SLX_RETURN_IF_ERROR(description.Validate());
  Scene scene;
  scene.description_ = description;
  SLX_ASSIGN_OR_RETURN(scene.shape_, MakeShape(description, description.seed.value_or(seed), table));
  return scene.In({});
}

SubjectState Scene::StateAt(double seconds) const {
  const MotionDescription& motion = description_.motion;
  SubjectState state;
  const double moving = seconds - motion.drift_start_s;
  const Eigen::Vector3d drift(motion.drift_mm_per_s.data()), turn(motion.turn_deg_per_s.data());
  const double mm_per_s = std::max(drift.norm(), RadFromDeg(turn.norm()) * kTurnLeverMm);
  if (moving > 0.0 && mm_per_s > 0.0) {
    const double stepped_s = std::floor(moving * mm_per_s / motion.step_mm) * motion.step_mm / mm_per_s;
    state.offset_mm = stepped_s * drift;
    state.turned_deg = stepped_s * turn;
  }
  for (const double at : motion.blink_at_s)
    if (seconds >= at && seconds < at + motion.blink_s) state.lids = EyeLids::kClosed;
  return state;
}

Scene Scene::In(const SubjectState& state) const {
  Scene scene = *this;
  scene.state_ = state;
  const bool turned = description_.pose.rotation_deg != std::array<double, 3>{};
  const bool moved = description_.pose.position_mm != std::array<double, 3>{} || !state.offset_mm.isZero(0.0) ||
                     !state.turned_deg.isZero(0.0);
  scene.resting_ = !turned && !moved;
  scene.rig_from_shape_ = PoseOf(description_.pose, state);
  scene.shape_from_rig_ = scene.rig_from_shape_.Inverse();
  return scene;
}

double Scene::Height(double x, double y) const {
  if (resting_) return shape_->Height(x, y);
  // Parallel to the axis, from the camera's side.
  const auto hit = Intersect({Eigen::Vector3d(x, y, 0.0), Eigen::Vector3d::UnitZ()});
  return hit ? hit->z() : std::numeric_limits<double>::quiet_NaN();
}

std::optional<Eigen::Vector3d> Scene::Intersect(const Ray3& ray) const {
  if (resting_) return shape_->Intersect(ray);
  const auto hit = shape_->Intersect({shape_from_rig_ * ray.origin_mm, shape_from_rig_.rotation * ray.direction});
  if (!hit) return std::nullopt;
  return rig_from_shape_ * *hit;
}

bool Scene::Hides(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const {
  return shape_->Hides(ToShape(from), ToShape(to));
}

Eigen::Vector3d Scene::Normal(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d normal = shape_->Normal(ToShape(point));
  return resting_ ? normal : rig_from_shape_.rotation * normal;
}

Material Scene::MaterialAt(const Eigen::Vector3d& point) const {
  Material material = shape_->MaterialAt(ToShape(point), state_.lids);
  if (uniform_skin_)
    material =
        Material::Skin(*uniform_skin_, material.kind == MaterialKind::kSkin ? material.surface : SurfaceReflection{});
  return material;
}

}  // namespace stratalux::rig
