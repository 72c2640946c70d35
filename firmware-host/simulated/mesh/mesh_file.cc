// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/mesh/mesh_file.h"

#include <algorithm>
#include <cctype>

#include "shared/base/read_file.h"

namespace stratalux::rig {

Result<MeshData> ReadMeshFile(const std::filesystem::path& file) {
  std::string ending = file.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(), [](unsigned char c) { return std::tolower(c); });
  if (ending != ".obj" && ending != ".ply")
    return Status::Usage(file.string() + ": a mesh file is named *.obj or *.ply");
  const auto bytes = ReadFile(file, kMostMeshBytes);
  if (!bytes.ok()) return Status::Usage(bytes.status().message());
  return ending == ".obj" ? ParseObj(*bytes, file.string()) : ParsePly(*bytes, file.string());
}

}  // namespace stratalux::rig
