// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/export/read_export.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <sstream>

#include <gtest/gtest.h>
#include <zlib.h>

#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

template <typename T>
T At(const std::string& bytes, size_t offset) {
  T value{};
  if (offset + sizeof value > bytes.size()) {
    ADD_FAILURE() << "offset " << offset << " of " << bytes.size();
    return value;
  }
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

template <typename T>
std::vector<T> Values(const std::string& bytes, size_t offset, size_t count) {
  std::vector<T> values(count);
  for (size_t i = 0; i < count; ++i) values[i] = At<T>(bytes, offset + i * sizeof(T));
  return values;
}

template <typename T>
std::vector<T> Accessor(const nlohmann::json& json, const std::string& binary, const nlohmann::json& index,
                        size_t per_element) {
  const auto& accessor = json.at("accessors").at(index.get<size_t>());
  const auto& view = json.at("bufferViews").at(accessor.at("bufferView").get<size_t>());
  const size_t count = accessor.at("count").get<size_t>() / per_element;
  EXPECT_EQ(view.at("byteLength"), count * sizeof(T));
  return Values<T>(binary, view.at("byteOffset"), count);
}

// Bytes of the picture that `owner` names its `kind`; none: empty.
std::string TextureOf(const nlohmann::json& json, const std::string& binary, const nlohmann::json& owner,
                      const char* kind) {
  if (!owner.contains(kind)) return {};
  const auto& texture = json.at("textures").at(owner.at(kind).at("index").get<size_t>());
  const auto& image = json.at("images").at(texture.at("source").get<size_t>());
  const auto& view = json.at("bufferViews").at(image.at("bufferView").get<size_t>());
  return binary.substr(view.at("byteOffset"), view.at("byteLength"));
}

Eigen::Vector3d VectorOf(const std::array<float, 3>& v) { return {v[0], v[1], v[2]}; }

// Entries of the first directory: tag -> type, count, value or offset.
struct TiffEntry {
  uint16_t type = 0;
  uint32_t count = 0, value = 0;
};

std::vector<uint32_t> NumbersOf(const std::string& bytes, const TiffEntry& entry) {
  if (entry.count == 1) return {entry.type == 3 ? entry.value & 0xFFFF : entry.value};
  std::vector<uint32_t> numbers;
  if (entry.type == 3 && entry.count == 2) return {entry.value & 0xFFFF, entry.value >> 16};
  for (uint32_t i = 0; i < entry.count; ++i)
    numbers.push_back(entry.type == 3 ? At<uint16_t>(bytes, entry.value + 2 * i)
                                      : At<uint32_t>(bytes, entry.value + 4 * i));
  return numbers;
}

std::vector<uint16_t> Inflated(const std::string& bytes, size_t offset, size_t size, size_t samples) {
  std::vector<uint16_t> strip(samples);
  uLongf length = samples * 2;
  EXPECT_EQ(uncompress(reinterpret_cast<Bytef*>(strip.data()), &length,
                       reinterpret_cast<const Bytef*>(bytes.data() + offset), size),
            Z_OK);
  EXPECT_EQ(length, samples * 2);
  return strip;
}

}  // namespace

PlyRead ReadPly(const std::filesystem::path& file) {
  const std::string bytes = ReadText(file);
  PlyRead ply;
  const size_t end = bytes.find("end_header\n");
  EXPECT_TRUE(bytes.starts_with("ply\nformat binary_little_endian 1.0\n") && end != std::string::npos) << file;
  std::istringstream header(bytes.substr(0, end));
  std::vector<std::string> types;
  size_t vertices = 0, faces = 0;
  for (std::string line; std::getline(header, line);) {
    std::istringstream words(line);
    std::string word, what;
    words >> word >> what;
    if (word == "comment") ply.comments.push_back(line.substr(8));
    if (word == "element") words >> (what == "vertex" ? vertices : faces);
    if (word != "property" || what == "list") continue;
    types.push_back(what);
    words >> word;
    ply.properties.push_back(word);
  }
  size_t at = end + std::strlen("end_header\n");
  for (size_t v = 0; v < vertices; ++v)
    for (size_t p = 0; p < types.size(); ++p) {
      const bool byte = types[p] == "uchar";
      ply.columns[ply.properties[p]].push_back(byte ? At<uint8_t>(bytes, at) : At<float>(bytes, at));
      at += byte ? 1 : 4;
    }
  for (size_t f = 0; f < faces; ++f, at += 13) {
    EXPECT_EQ(At<uint8_t>(bytes, at), 3);
    ply.faces.push_back(At<std::array<int32_t, 3>>(bytes, at + 1));
  }
  EXPECT_EQ(at, bytes.size()) << file;
  return ply;
}

GlbRead ReadGlb(const std::filesystem::path& file) {
  const std::string bytes = ReadText(file);
  GlbRead glb;
  EXPECT_EQ(bytes.substr(0, 4), "glTF") << file;
  EXPECT_EQ(At<uint32_t>(bytes, 4), 2U);
  EXPECT_EQ(At<uint32_t>(bytes, 8), bytes.size());
  const uint32_t text = At<uint32_t>(bytes, 12);
  EXPECT_EQ(bytes.substr(16, 4), "JSON");
  glb.json = nlohmann::json::parse(bytes.substr(20, text));
  const std::string binary = bytes.substr(28 + text);
  EXPECT_EQ(At<uint32_t>(bytes, 20 + text), binary.size());
  EXPECT_EQ(bytes.substr(24 + text, 4), std::string("BIN\0", 4));
  const auto& primitive = glb.json.at("meshes").at(0).at("primitives").at(0);
  const auto& attributes = primitive.at("attributes");
  glb.positions = Accessor<std::array<float, 3>>(glb.json, binary, attributes.at("POSITION"), 1);
  glb.normals = Accessor<std::array<float, 3>>(glb.json, binary, attributes.at("NORMAL"), 1);
  glb.triangles = Accessor<std::array<uint32_t, 3>>(glb.json, binary, primitive.at("indices"), 3);
  if (attributes.contains("TEXCOORD_0"))
    glb.uv = Accessor<std::array<float, 2>>(glb.json, binary, attributes.at("TEXCOORD_0"), 1);
  if (attributes.contains("TANGENT"))
    glb.tangents = Accessor<std::array<float, 4>>(glb.json, binary, attributes.at("TANGENT"), 1);
  const auto& material = glb.json.at("materials").at(0);
  glb.png = TextureOf(glb.json, binary, material.at("pbrMetallicRoughness"), "baseColorTexture");
  glb.normal_png = TextureOf(glb.json, binary, material, "normalTexture");
  if (material.contains("extensions"))
    glb.coat_normal_png =
        TextureOf(glb.json, binary, material.at("extensions").at("KHR_materials_clearcoat"), "clearcoatNormalTexture");
  return glb;
}

Eigen::Vector3d ShadedNormal(const GlbRead& glb, ImageView<const uint16_t> normal_texture, size_t v) {
  const int i = static_cast<int>(glb.uv[v][0] * static_cast<float>(normal_texture.width())),
            j = static_cast<int>(glb.uv[v][1] * static_cast<float>(normal_texture.height()));
  const auto component = [&](int c) { return 2.0 * normal_texture(i, j, c) / 255.0 - 1.0; };
  const auto& t = glb.tangents[v];
  const Eigen::Vector3d tangent(t[0], t[1], t[2]), normal = VectorOf(glb.normals[v]);
  return (component(0) * tangent + component(1) * t[3] * normal.cross(tangent) + component(2) * normal).normalized();
}

TiffRead ReadTiff(const std::filesystem::path& file) {
  const std::string bytes = ReadText(file);
  TiffRead tiff;
  EXPECT_EQ(bytes.substr(0, 4), std::string("II*\0", 4)) << file;
  const uint32_t directory = At<uint32_t>(bytes, 4);
  std::map<int, TiffEntry> entries;
  for (uint16_t e = 0; e < At<uint16_t>(bytes, directory); ++e) {
    const size_t at = directory + 2 + 12 * size_t{e};
    entries[At<uint16_t>(bytes, at)] = {At<uint16_t>(bytes, at + 2), At<uint32_t>(bytes, at + 4),
                                        At<uint32_t>(bytes, at + 8)};
  }
  const auto number = [&](int tag) { return static_cast<int>(NumbersOf(bytes, entries.at(tag)).front()); };
  tiff.width = number(256);
  tiff.height = number(257);
  tiff.channels = number(277);
  EXPECT_EQ(number(258), 16) << "bits";
  EXPECT_EQ(number(259), 8) << "deflate";
  EXPECT_EQ(number(317), 2) << "horizontal differences";
  EXPECT_EQ(number(262), tiff.channels == 1 ? 1 : 2) << "black is 0, or RGB";
  const auto offsets = NumbersOf(bytes, entries.at(273)), sizes = NumbersOf(bytes, entries.at(279));
  const size_t row = static_cast<size_t>(tiff.width) * tiff.channels, rows = static_cast<size_t>(number(278));
  for (size_t s = 0; s < offsets.size(); ++s) {
    const size_t here = std::min(rows, tiff.height - s * rows);
    auto strip = Inflated(bytes, offsets[s], sizes[s], here * row);
    for (size_t i = 0; i < strip.size(); ++i)
      if (i % row >= static_cast<size_t>(tiff.channels))
        strip[i] = static_cast<uint16_t>(strip[i] + strip[i - tiff.channels]);
    tiff.samples.insert(tiff.samples.end(), strip.begin(), strip.end());
  }
  const TiffEntry& text = entries.at(270);
  tiff.description = nlohmann::json::parse(bytes.substr(text.value, text.count - 1));
  return tiff;
}

std::vector<std::string> FaultsOf(const GlbRead& glb) {
  std::vector<std::string> faults;
  Eigen::AlignedBox3d box;
  for (const auto& p : glb.positions) box.extend(VectorOf(p));
  const auto& position =
      glb.json.at("accessors")
          .at(glb.json.at("meshes").at(0).at("primitives").at(0).at("attributes").at("POSITION").get<size_t>());
  for (int axis = 0; axis < 3; ++axis)
    if (position.at("min").at(axis) != box.min()[axis] || position.at("max").at(axis) != box.max()[axis])
      faults.push_back("bounds of axis " + std::to_string(axis));
  if (!(box.diagonal().norm() > 0.03) || !(box.diagonal().norm() < 0.6)) faults.emplace_back("size");
  if (!(box.max().z() < 0.0)) faults.emplace_back("behind the camera");
  size_t lengths = 0, backs = 0;
  for (const auto& n : glb.normals) lengths += std::abs(VectorOf(n).norm() - 1.0) > 1e-5 ? 1 : 0;
  for (const auto& t : glb.triangles) {
    const auto at = [&](int k) { return VectorOf(glb.positions.at(t[k])); };
    const Eigen::Vector3d turn = (at(1) - at(0)).cross(at(2) - at(0));
    for (const uint32_t v : t) backs += turn.dot(VectorOf(glb.normals.at(v))) <= 0.0 ? 1 : 0;
  }
  if (lengths > 0) faults.push_back(std::to_string(lengths) + " normals are no unit vectors");
  size_t tangents = 0;
  for (size_t v = 0; v < glb.tangents.size(); ++v) {
    const auto& t = glb.tangents[v];
    const Eigen::Vector3d along(t[0], t[1], t[2]);
    tangents += std::abs(along.norm() - 1.0) > 1e-5 || std::abs(along.dot(VectorOf(glb.normals.at(v)))) > 1e-5 ||
                        std::abs(t[3]) != 1.0F
                    ? 1
                    : 0;
  }
  if (tangents > 0) faults.push_back(std::to_string(tangents) + " tangents are no unit vectors across their normals");
  if (backs > 0) faults.push_back(std::to_string(backs) + " normals point into their triangles");
  return faults;
}

}  // namespace stratalux::fit
