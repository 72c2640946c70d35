// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/mesh/mesh_builder.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numeric>

#include "shared/base/formatted.h"

namespace stratalux::rig {
namespace {

// Far beyond any unit of a head (nanometres); its square is still a number.
constexpr double kLargestCoordinate = 1e12;
constexpr double kLargestTexture = 1e6;  // pictures that repeat so often

template <typename Number>
std::optional<Number> WholeWord(std::string_view word) {
  if (word.starts_with('+')) word.remove_prefix(1);  // from_chars knows none
  Number value{};
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc() || end != word.data() + word.size()) return std::nullopt;
  return value;
}

Status TooMany(const char* what, int64_t most) {
  return Status::Usage(
      Formatted("more than %lld %s; take fewer (a mesh program's decimation)", static_cast<long long>(most), what));
}

Status CheckIndex(const char* what, int64_t index, int64_t count) {
  if (index >= 0 && index < count) return Status::Ok();
  return Status::Usage(Formatted("a corner's %s %lld (from 0) is not among the %lld before it; write the mesh again",
                                 what, static_cast<long long>(index), static_cast<long long>(count)));
}

}  // namespace

std::optional<double> FiniteNumber(std::string_view word) {
  const auto value = WholeWord<double>(word);
  return value && std::isfinite(*value) ? value : std::nullopt;
}

std::optional<int64_t> WholeNumber(std::string_view word) { return WholeWord<int64_t>(word); }

Status MeshBuilder::AddVertex(const Eigen::Vector3d& vertex) {
  if (vertices() >= kMostMeshVertices) return TooMany("vertices", kMostMeshVertices);
  if (!vertex.allFinite() || vertex.cwiseAbs().maxCoeff() > kLargestCoordinate)
    return Status::Usage(Formatted("vertex (%g, %g, %g) is not a position; coordinates are numbers up to %g",
                                   vertex.x(), vertex.y(), vertex.z(), kLargestCoordinate));
  mesh_.vertices.push_back(vertex);
  return Status::Ok();
}

Status MeshBuilder::AddTexture(const Eigen::Vector2d& at) {
  if (texture() >= 3 * kMostMeshTriangles) return TooMany("texture coordinates", 3 * kMostMeshTriangles);
  if (!at.allFinite() || at.cwiseAbs().maxCoeff() > kLargestTexture)
    return Status::Usage(
        Formatted("texture coordinates (%g, %g) are not a place in a picture; 0 to 1 lies within it", at.x(), at.y()));
  mesh_.texture.push_back(at);
  return Status::Ok();
}

Status MeshBuilder::AddNormal(const Eigen::Vector3d& normal) {
  if (normals() >= 3 * kMostMeshTriangles) return TooMany("normals", 3 * kMostMeshTriangles);
  if (!normal.allFinite() || normal.cwiseAbs().maxCoeff() > kLargestCoordinate)
    return Status::Usage(Formatted("normal (%g, %g, %g) is not a direction", normal.x(), normal.y(), normal.z()));
  mesh_.normals.push_back(normal);
  return Status::Ok();
}

Status MeshBuilder::AddPolygon(const std::vector<Corner>& corners) {
  if (corners.size() < 3)
    return Status::Usage(Formatted("a face of %zu corners; it needs at least three", corners.size()));
  bool has_texture = true, has_normals = true;
  for (const Corner& corner : corners) {
    SLX_RETURN_IF_ERROR(CheckIndex("vertex", corner.vertex, vertices()));
    has_texture = has_texture && corner.texture != MeshData::kNone;
    has_normals = has_normals && corner.normal != MeshData::kNone;
    if (corner.texture != MeshData::kNone)
      SLX_RETURN_IF_ERROR(CheckIndex("texture coordinate", corner.texture, texture()));
    if (corner.normal != MeshData::kNone) SLX_RETURN_IF_ERROR(CheckIndex("normal", corner.normal, normals()));
  }
  if (static_cast<int64_t>(mesh_.triangles.size() + corners.size() - 2) > kMostMeshTriangles)
    return TooMany("triangles", kMostMeshTriangles);
  for (size_t k = 2; k < corners.size(); ++k) {
    MeshData::Triangle triangle;
    const std::array<const Corner*, 3> fan = {&corners[0], &corners[k - 1], &corners[k]};
    for (size_t i = 0; i < fan.size(); ++i) {
      triangle.vertex[i] = static_cast<int>(fan[i]->vertex);
      if (has_texture) triangle.texture[i] = static_cast<int>(fan[i]->texture);
      if (has_normals) triangle.normal[i] = static_cast<int>(fan[i]->normal);
    }
    mesh_.triangles.push_back(triangle);
  }
  return Status::Ok();
}

Result<MeshData> MeshBuilder::Finish() && {
  // Scanners and exporters repeat a vertex at each seam of the texture; the surface goes on there.
  std::vector<int> order(mesh_.vertices.size());
  std::iota(order.begin(), order.end(), 0);
  const auto& v = mesh_.vertices;
  auto before = [&](int a, int b) {
    return std::lexicographical_compare(v[a].data(), v[a].data() + 3, v[b].data(), v[b].data() + 3);
  };
  std::stable_sort(order.begin(), order.end(), before);
  std::vector<int> first_equal(order.size());
  for (size_t k = 0; k < order.size(); ++k)
    first_equal[order[k]] = k > 0 && v[order[k]] == v[order[k - 1]] ? first_equal[order[k - 1]] : order[k];
  std::vector<int> kept_as(order.size());
  std::vector<Eigen::Vector3d> kept;
  for (size_t i = 0; i < v.size(); ++i) {
    if (first_equal[i] == static_cast<int>(i)) kept.push_back(v[i]);
    kept_as[i] = first_equal[i] == static_cast<int>(i) ? static_cast<int>(kept.size()) - 1 : kept_as[first_equal[i]];
  }
  mesh_.vertices = std::move(kept);
  for (MeshData::Triangle& triangle : mesh_.triangles)
    for (int& corner : triangle.vertex) corner = kept_as[corner];
  std::erase_if(mesh_.triangles, [](const MeshData::Triangle& t) {
    return t.vertex[0] == t.vertex[1] || t.vertex[1] == t.vertex[2] || t.vertex[2] == t.vertex[0];
  });
  if (mesh_.triangles.empty())
    return Status::Usage(Formatted("no face among %zu vertices; export the mesh with its faces", v.size()));
  return std::move(mesh_);
}

}  // namespace stratalux::rig
