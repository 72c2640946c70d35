// SPDX-License-Identifier: Apache-2.0
// What both readers of mesh files do alike: finite numbers, indices within their lists, fans, limits.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "firmware-host/simulated/mesh/mesh_file.h"

namespace stratalux::rig {

// A whole number or a decimal one without anything behind it; nullopt for any other word, infinities and NaN included.
[[nodiscard]] std::optional<double> FiniteNumber(std::string_view word);
[[nodiscard]] std::optional<int64_t> WholeNumber(std::string_view word);

class MeshBuilder {
 public:
  struct Corner {
    int64_t vertex = 0, texture = MeshData::kNone, normal = MeshData::kNone;  // from 0
  };

  // Each message is for the caller to put a place before.
  [[nodiscard]] Status AddVertex(const Eigen::Vector3d& vertex);
  [[nodiscard]] Status AddTexture(const Eigen::Vector2d& at);
  [[nodiscard]] Status AddNormal(const Eigen::Vector3d& normal);
  // A polygon of three corners or more, all of whose points are there already. Corners of which some have texture
  // coordinates (or normals) have none.
  [[nodiscard]] Status AddPolygon(const std::vector<Corner>& corners);
  [[nodiscard]] int64_t vertices() const { return static_cast<int64_t>(mesh_.vertices.size()); }
  [[nodiscard]] int64_t texture() const { return static_cast<int64_t>(mesh_.texture.size()); }
  [[nodiscard]] int64_t normals() const { return static_cast<int64_t>(mesh_.normals.size()); }
  // Makes equal vertices one and drops triangles that then have two equal corners; kUsage where none is left.
  [[nodiscard]] Result<MeshData> Finish() &&;

 private:
  MeshData mesh_;
};

}  // namespace stratalux::rig
