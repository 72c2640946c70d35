// SPDX-License-Identifier: Apache-2.0
// glTF 2.0 in its binary container (.glb): one mesh with one material.
//
// glTF has metres and Y up. The camera frame (mm; x right, y down, z forward) is turned by half a turn about x:
//   x_gltf = x / 1000,  y_gltf = -y / 1000,  z_gltf = -z / 1000
// so that the camera stands at the origin and looks along -z as glTF's own cameras do, and the face looks along +z,
// glTF's front. It is a rotation: triangles keep their sense, and normals follow it without the scale.
#pragma once

#include <filesystem>
#include <optional>

#include "fitter/export/origin.h"
#include "fitter/export/triangle_mesh.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// The material is opaque whatever alpha says: the mesh's own outline is the surface's, and a cut by filtered alpha
// would eat into it where a viewer shrinks the picture. Alpha is for programs that paint on it.
struct GlbMaterial {
  ImageView<const uint8_t> base_colour =
      {};                                 // RGB or RGBA, sRGB-coded, over texture_uv; empty: none, the material is grey
  double roughness = 1.0;                 // glTF's, the square root of GGX's alpha
  ImageView<const uint8_t> normals = {};  // RGB of NormalTexture, over texture_uv; empty: none
  // A clear coat (KHR_materials_clearcoat) by normals of its own, on a base that then does not mirror
  // (KHR_materials_specular): light that scattered follows `normals`, light of the surface itself those of the coat.
  struct Coat {
    double strength = 1.0;  // of a bare surface of index 1.5, glTF's coat; 1 at most
    ImageView<const uint8_t> normals = {};
  };
  std::optional<Coat> coat = {};
};

// POSITION with its bounds, NORMAL, 32-bit indices; with a picture TEXCOORD_0 and that as an embedded PNG; with
// normals the mesh's tangents as TANGENT. `origin` and the units are the asset's extras. kNotFound: the mesh has no
// triangle (glTF knows no empty one). kUsage: normals without a tangent for each vertex. kFailed: it cannot be written.
Status WriteGlb(const std::filesystem::path& file, const Mesh& mesh, const GlbMaterial& material,
                const ExportOrigin& origin = {});

}  // namespace stratalux::fit
