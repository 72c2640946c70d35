// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "firmware-host/simulated/scene/pits.h"
#include "shared/base/formatted.h"

namespace stratalux::rig {
namespace {

constexpr double kEverywhere = std::numeric_limits<double>::infinity();

std::vector<std::array<int, 3>> IndicesOf(const MeshData& mesh) {
  std::vector<std::array<int, 3>> indices;
  indices.reserve(mesh.triangles.size());
  for (const auto& t : mesh.triangles) indices.push_back(t.vertex);
  return indices;
}

double AreaOf(const MeshData& mesh, const MeshData::Triangle& t) {
  const auto& v = mesh.vertices;
  return 0.5 * (v[t.vertex[1]] - v[t.vertex[0]]).cross(v[t.vertex[2]] - v[t.vertex[0]]).norm();
}

// The file's coordinates become the rig's: right, down, away from the camera.
Status Place(const MeshDescription& description, MeshData& mesh) {
  const Eigen::Vector3d up = DirectionOf(description.up), front = DirectionOf(description.front);
  Eigen::Matrix3d rig_from_file;
  rig_from_file << up.cross(front).transpose(), -up.transpose(), -front.transpose();
  Eigen::AlignedBox3d box;
  for (Eigen::Vector3d& v : mesh.vertices) {
    v = description.unit_mm * (rig_from_file * v);
    box.extend(v);
  }
  for (Eigen::Vector3d& n : mesh.normals) n = rig_from_file * n;
  const double longest = box.sizes().maxCoeff();
  if (!(longest >= Mesh::kSmallestMm && longest <= Mesh::kLargestMm))
    return Status::Usage(
        Formatted("%g mm long at [mesh] unit_mm = %g; allowed: %g to %g mm (unit_mm is 10 for "
                  "centimetres, 1000 for metres)",
                  longest, description.unit_mm, Mesh::kSmallestMm, Mesh::kLargestMm));
  Eigen::Vector3d shift(-box.center().x(), -box.center().y(), Mesh::kFrontMm - box.min().z());
  if (description.origin_mm) {
    const auto& o = *description.origin_mm;
    shift = Eigen::Vector3d(0.0, 0.0, 700.0) - rig_from_file * Eigen::Vector3d(o[0], o[1], o[2]);
  }
  const double nearest = box.min().z() + shift.z();
  if (!(nearest >= Mesh::kNearestMm))
    return Status::Usage(
        Formatted("comes within %g mm of the camera at [mesh] origin_mm = [%g, %g, %g]; take a point "
                  "of the mesh, at least %g mm must be free",
                  nearest, (*description.origin_mm)[0], (*description.origin_mm)[1], (*description.origin_mm)[2],
                  Mesh::kNearestMm));
  for (Eigen::Vector3d& v : mesh.vertices) v += shift;
  return Status::Ok();
}

CornerNormals NormalsOf(const MeshData& mesh, const MeshDescription& description) {
  if (description.crease_deg) return AngleWeightedNormals(mesh, *description.crease_deg);
  if (description.subdivisions == 0)
    if (auto given = NormalsOfFile(mesh)) return std::move(*given);
  return AngleWeightedNormals(mesh, 180.0);
}

}  // namespace

Result<std::shared_ptr<const Mesh>> Mesh::Create(MeshData mesh, const MeshDescription& description, FaceSkin skin,
                                                 const FaceSurface& surface, uint64_t seed) {
  SLX_RETURN_IF_ERROR(Place(description, mesh));
  const auto most = static_cast<size_t>(kMostMeshTriangles >> (2 * description.subdivisions));
  if (mesh.triangles.size() > most)
    return Status::Usage(Formatted("%zu triangles become more than %lld by [mesh] subdivisions = %d; take fewer",
                                   mesh.triangles.size(), static_cast<long long>(kMostMeshTriangles),
                                   description.subdivisions));
  if (description.subdivisions > 0) mesh = Subdivide(mesh, description.subdivisions);
  CornerNormals normals = NormalsOf(mesh, description);
  std::shared_ptr<Mesh> shape(
      new Mesh(std::move(mesh), std::move(normals), description, std::move(skin), surface, seed));
  shape->FaceTheCamera();
  return std::shared_ptr<const Mesh>(std::move(shape));
}

Result<std::shared_ptr<const Mesh>> Mesh::Create(const MeshDescription& description, const SkinDescription& skin,
                                                 const FaceSurface& surface, uint64_t seed, const SkinTable* table) {
  SLX_ASSIGN_OR_RETURN(MeshData mesh, ReadMeshFile(description.file));
  const FaceSkin face(skin, FaceRegions(FaceFeatures::Of({}, seed)), seed);  // without regions: Validate()
  if (description.albedo.empty())
    return Create(std::move(mesh), description, face, surface, seed).WithContext(description.file);
  const bool textured = std::all_of(mesh.triangles.begin(), mesh.triangles.end(),
                                    [](const MeshData::Triangle& t) { return t.texture[0] != MeshData::kNone; });
  if (!textured)
    return Status::Usage(description.file +
                         ": some faces have no texture coordinates, which [mesh] albedo needs; leave it out");
  if (description.flip_v)
    for (Eigen::Vector2d& at : mesh.texture) at.y() = 1.0 - at.y();
  if (table == nullptr) return Status::Usage(description.albedo + ": [mesh] albedo is solved against a skin table");
  SLX_ASSIGN_OR_RETURN(auto shape,
                       Create(std::move(mesh), description, face, surface, seed).WithContext(description.file));
  const SkinAlbedo albedo(*table);
  SLX_ASSIGN_OR_RETURN(auto picture,
                       PictureSkin::Read(description.albedo, description.albedo_scale, albedo, skin.Of(seed)));
  std::const_pointer_cast<Mesh>(shape)->TakePicture(std::move(picture));
  return shape;
}

Mesh::Mesh(MeshData mesh, CornerNormals normals, const MeshDescription& description, FaceSkin skin,
           const FaceSurface& surface, uint64_t seed)
    : mesh_(std::move(mesh)),
      normals_(std::move(normals)),
      tree_(mesh_.vertices, IndicesOf(mesh_)),
      relief_mm_(description.relief_mm),
      seed_(seed),
      skin_(std::move(skin)),
      surface_(surface) {}

void Mesh::FaceTheCamera() {
  constexpr int kRays = 128;  // a side
  const Eigen::AlignedBox3d box = tree_.box();
  int fronts = 0, backs = 0;
  for (int k = 0; k < kRays * kRays; ++k) {
    const Eigen::Vector3d share((k % kRays + 0.5) / kRays, (k / kRays + 0.5) / kRays, 0.0);
    const Eigen::Vector3d from = box.min() + share.cwiseProduct(box.sizes()) - Eigen::Vector3d::UnitZ();
    const auto hit = tree_.FirstHit({from, Eigen::Vector3d::UnitZ()}, kEverywhere);
    if (hit) ++(SmoothNormal(hit->at).z() < 0.0 ? fronts : backs);
  }
  if (backs > fronts) {
    std::swap(backs, fronts);
    for (auto& corners : normals_)
      for (Eigen::Vector3d& n : corners) n = -n;
  }
  if (fronts > 0) backs_ = static_cast<double>(backs) / (backs + fronts);
}

void Mesh::TakePicture(PictureSkin picture) {
  picture_ = std::move(picture);
  constexpr int kSide = 4;  // samples of a triangle: the middles of 16 alike
  double area = 0.0, clamped = 0.0, squares = 0.0;
  for (size_t i = 0; i < mesh_.triangles.size(); ++i) {
    const double share = AreaOf(mesh_, mesh_.triangles[i]) / (kSide * kSide);
    for (int k = 0; k < kSide * kSide; ++k) {
      // A square of weights folded along its diagonal.
      Eigen::Vector2d w((k % kSide + 0.5) / kSide, (k / kSide + 0.5) / kSide);
      if (w.sum() > 1.0) w = Eigen::Vector2d::Ones() - w;
      const TrianglePoint at{static_cast<int>(i), {1.0 - w.sum(), w.x(), w.y()}};
      const SolvedSkin& solved = picture_->TexelAt(TextureAt(at));
      area += share;
      if (solved.clamped) clamped += share;
      squares += share * solved.deviation * solved.deviation;
    }
  }
  if (area > 0.0) report_ = {clamped / area, std::sqrt(squares / area)};
}

Eigen::Vector3d Mesh::SmoothNormal(const TrianglePoint& at) const {
  const auto& n = normals_[at.triangle];
  const Eigen::Vector3d sum = at.weights.x() * n[0] + at.weights.y() * n[1] + at.weights.z() * n[2];
  return sum.norm() > 1e-9 ? sum.normalized() : n[0];
}

Eigen::Vector2d Mesh::TextureAt(const TrianglePoint& at) const {
  const auto& index = mesh_.triangles[at.triangle].texture;
  Eigen::Vector2d sum(0.0, 0.0);
  for (int k = 0; k < 3; ++k) sum += at.weights[k] * mesh_.texture[index[k]];
  return sum;
}

// With pores the surface lies where the distance above the mesh is minus their depth, both taken in space; the mesh is
// near enough a plane within a pore.
double Mesh::IntoPores(const Ray3& ray, const TriangleTree::Hit& hit) const {
  constexpr double kStepMm = 0.02, kSteepest = 0.3;  // along a ray that grazes, pores are not seen into
  const Eigen::Vector3d on_mesh = ray.origin_mm + hit.distance * ray.direction;
  const Pits pits(on_mesh, seed_);
  const double sinking = std::max(-SmoothNormal(hit.at).dot(ray.direction), kSteepest);
  auto above = [&](double t) { return relief_mm_ * pits.At(on_mesh + t * ray.direction).depth - sinking * t; };
  if (!(above(0.0) > 0.0)) return hit.distance;
  double low = 0.0, high = 0.0;
  while (high < Pits::kReachMm) {
    high = std::min(high + kStepMm, Pits::kReachMm);
    if (above(high) <= 0.0) break;
    low = high;
  }
  for (int k = 0; k < 40 && high - low > 1e-12; ++k) {
    const double middle = 0.5 * (low + high);
    (above(middle) > 0.0 ? low : high) = middle;
  }
  return hit.distance + high;
}

std::optional<Eigen::Vector3d> Mesh::Intersect(const Ray3& ray) const {
  const auto hit = tree_.FirstHit(ray, kEverywhere);
  if (!hit) return std::nullopt;
  const double distance = relief_mm_ > 0.0 ? IntoPores(ray, *hit) : hit->distance;
  return ray.origin_mm + distance * ray.direction;
}

double Mesh::Height(double x, double y) const {
  const auto hit = Intersect({Eigen::Vector3d(x, y, 0.0), Eigen::Vector3d::UnitZ()});
  return hit ? hit->z() : std::numeric_limits<double>::quiet_NaN();
}

Eigen::Vector3d Mesh::Normal(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d normal = SmoothNormal(tree_.NearestTo(point).at);
  if (!(relief_mm_ > 0.0)) return normal;
  // The gradient of distance plus depth.
  return (normal + relief_mm_ * Pits(point, seed_).At(point).slope).normalized();
}

bool Mesh::Hides(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const {
  constexpr double kSkip = 1.5, kSlack = 0.05;  // near its ends a line touches the surface anyway
  const Eigen::Vector3d line = to - from;
  const double length = line.norm();
  if (length <= 2.0 * kSkip) return false;
  const Eigen::Vector3d along = line / length;
  // Into the body at one of its ends, the line is within it until it meets the surface again.
  const Eigen::Vector3d here = SmoothNormal(tree_.NearestTo(from).at), there = SmoothNormal(tree_.NearestTo(to).at);
  if (-kSkip * here.dot(along) > kSlack || kSkip * there.dot(along) > kSlack) return true;
  return tree_.FirstHit({from + kSkip * along, along}, length - 2.0 * kSkip).has_value();
}

Material Mesh::MaterialAt(const Eigen::Vector3d& point, EyeLids /*lids*/) const {
  const SurfaceReflection surface = surface_.At(point.x(), point.y());
  if (!picture_) return Material::Skin(skin_.At(point.x(), point.y()), surface);
  return Material::Skin(picture_->At(TextureAt(tree_.NearestTo(point).at)), surface);
}

std::vector<std::string> Mesh::Remarks() const {
  std::vector<std::string> remarks;
  if (backs_ > 0.01)
    remarks.push_back(
        Formatted("mesh: %.1f %% of what is seen from the front shows its back, which gives no light; "
                  "turn those faces round if it should not",
                  100.0 * backs_));
  if (picture_)
    remarks.push_back(
        Formatted("mesh: %.1f %% of the surface has a colour that is solved at an end of the table's melanin "
                  "or blood; colours are off by %.1f %% rms ([mesh] albedo_scale changes their exposure)",
                  100.0 * report_.clamped, 100.0 * report_.deviation));
  return remarks;
}

}  // namespace stratalux::rig
