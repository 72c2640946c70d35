// SPDX-License-Identifier: Apache-2.0
// Mesh files of scenes, as OBJ and as PLY; what is read becomes a subject, if it can.
#include <memory>

#include "firmware-host/simulated/scene/mesh.h"
#include "tests/fuzz/target.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  const std::string bytes = fuzz::TextOf(data, size);
  for (auto mesh : {rig::ParseObj(bytes, "a.obj"), rig::ParsePly(bytes, "a.ply")}) {
    if (!fuzz::Judge(mesh)) continue;
    for (const auto& t : mesh->triangles)
      for (size_t k = 0; k < 3; ++k)
        if (static_cast<size_t>(t.vertex[k]) >= mesh->vertices.size() ||
            (t.texture[k] != rig::MeshData::kNone && static_cast<size_t>(t.texture[k]) >= mesh->texture.size()) ||
            (t.normal[k] != rig::MeshData::kNone && static_cast<size_t>(t.normal[k]) >= mesh->normals.size()))
          fuzz::Fault("an index without its place");
    rig::MeshDescription description;
    description.subdivisions = mesh->triangles.size() < 100 ? 1 : 0;
    const auto shape = rig::Mesh::Create(std::move(*mesh), description,
                                         rig::FaceSkin({}, rig::FaceRegions(rig::FaceFeatures::Of({}, 1)), 1),
                                         rig::FaceSurface(rig::SurfaceDescription()), 1);
    if (!fuzz::Judge(shape)) continue;
    const auto hit = (*shape)->Intersect({Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitZ()});
    if (hit && !(*shape)->Normal(*hit).allFinite()) fuzz::Fault("a point without a normal");
  }
  return 0;
}
