// SPDX-License-Identifier: Apache-2.0
// Normals finer than a mesh's own, as glTF's normal texture: tangent space, +X along u, +Y up in the picture (OpenGL's
// sense), +Z the mesh's normal.
//
// With T a vertex' tangent, N its normal, B = w (N x T) and n the finer normal, all unit,
//   texel = round(((n.T, n.B, n.N) + 1) / 2 * 255),   n.N > 0
// B points against v, which runs down the picture; w is 1 where the picture is not mirrored on the mesh.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "fitter/export/triangle_mesh.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// Of each vertex, as MikkTSpace has them, glTF's default: the mean over its triangles of the direction of +u, each laid
// across the vertex' normal, to unit length, and weighted by the triangle's angle there. A vertex without a triangle
// has any direction across its normal. `mesh`: texture_uv of each vertex.
[[nodiscard]] std::vector<std::array<float, 4>> TangentsOf(const Mesh& mesh);

// RGB, `width` x `height`, the vertices at texel centres. `finer`: a unit normal, camera frame, of each vertex; what
// equals the vertex' own, or points behind its tangent plane, and texels without a vertex, are flat: 128 128 255.
// `mesh`: with tangents.
[[nodiscard]] Image<uint8_t> NormalTexture(const Mesh& mesh, std::span<const std::array<float, 3>> finer, int width,
                                           int height);

}  // namespace stratalux::fit
