// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/ply_file.h"

#include <bit>
#include <fstream>
#include <string>
#include <type_traits>

namespace stratalux::fit {
namespace {

static_assert(std::endian::native == std::endian::little, "PLY is written in the machine's own byte order");

template <typename T>
void Append(std::vector<char>& bytes, const T& value) {
  static_assert(std::is_trivially_copyable_v<T>);
  const char* data = reinterpret_cast<const char*>(&value);
  bytes.insert(bytes.end(), data, data + sizeof(T));
}

std::string Properties(const char* type, std::initializer_list<const char*> names) {
  std::string text;
  for (const char* name : names) text.append("property ").append(type).append(" ").append(name).append("\n");
  return text;
}

std::string HeaderOf(const ExportOrigin& origin, const std::string& comment, size_t vertices) {
  std::string text =
      "ply\nformat binary_little_endian 1.0\ncomment lengths in mm, camera frame (x right, y down, z forward)\n";
  for (const auto& [name, value] : origin.Named())
    text.append("comment ").append(name).append(" ").append(value).append("\n");
  return text + comment + "element vertex " + std::to_string(vertices) + "\n" + Properties("float", {"x", "y", "z"}) +
         Properties("float", {"nx", "ny", "nz"});
}

std::string ColourProperties(bool colours) { return colours ? Properties("uchar", {"red", "green", "blue"}) : ""; }

Status WriteBytes(const std::filesystem::path& file, const std::string& header, const std::vector<char>& bytes) {
  std::ofstream out(file, std::ios::binary);
  out << header << "end_header\n";
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out) return Status::Failed("cannot write " + file.string() + ": check the folder and the free space");
  return Status::Ok();
}

}  // namespace

Status WritePly(const std::filesystem::path& file, const Mesh& mesh, const ExportOrigin& origin) {
  const bool colours = !mesh.colours.empty();
  std::vector<char> bytes;
  bytes.reserve(mesh.positions_mm.size() * (colours ? 27 : 24) + mesh.triangles.size() * 13);
  for (size_t v = 0; v < mesh.positions_mm.size(); ++v) {
    Append(bytes, mesh.positions_mm[v]);
    Append(bytes, mesh.normals[v]);
    if (colours) Append(bytes, mesh.colours[v]);
  }
  for (const auto& triangle : mesh.triangles) {
    Append(bytes, uint8_t{3});
    Append(bytes, triangle);
  }
  return WriteBytes(file,
                    HeaderOf(origin, "", mesh.positions_mm.size()) + ColourProperties(colours) + "element face " +
                        std::to_string(mesh.triangles.size()) + "\nproperty list uchar int vertex_indices\n",
                    bytes);
}

Status WritePly(const std::filesystem::path& file, const PointCloud& cloud, const ExportOrigin& origin) {
  const bool colours = !cloud.colours.empty(), skin = !cloud.skin.empty();
  std::vector<char> bytes;
  bytes.reserve(cloud.positions_mm.size() * 56);
  for (size_t v = 0; v < cloud.positions_mm.size(); ++v) {
    Append(bytes, cloud.positions_mm[v]);
    Append(bytes, cloud.normals[v]);
    Append(bytes, cloud.normal_sigma_rad[v]);
    Append(bytes, cloud.covariance_mm2[v]);
    if (colours) Append(bytes, cloud.colours[v]);
    if (skin) Append(bytes, cloud.skin[v]);
  }
  const std::string comment =
      "comment cov_*: covariance of the position in mm^2; normal_sigma_rad: of the normal by light alone, not of nx ny "
      "nz; NaN where it is not known\n";
  return WriteBytes(file,
                    HeaderOf(origin, comment, cloud.positions_mm.size()) + Properties("float", {"normal_sigma_rad"}) +
                        Properties("float", {"cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"}) +
                        ColourProperties(colours) + (skin ? Properties("uchar", {"skin"}) : ""),
                    bytes);
}

}  // namespace stratalux::fit
