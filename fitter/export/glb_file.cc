// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/glb_file.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <span>
#include <string>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "shared/base/version.h"
#include "shared/image/png.h"

namespace stratalux::fit {
namespace {

static_assert(std::endian::native == std::endian::little, "glTF is written in the machine's own byte order");

using Json = nlohmann::ordered_json;

// Of the glTF 2.0 specification.
constexpr uint32_t kGlbMagic = 0x46546C67, kContainerVersion = 2, kJsonChunk = 0x4E4F534A, kBinaryChunk = 0x004E4942;
constexpr size_t kMostBytes = 4'000'000'000;  // of the buffer: sizes have 32 bits
constexpr int kFloat = 5126, kUnsignedInt = 5125, kVertices = 34962, kIndices = 34963;
constexpr int kLinear = 9729, kLinearMipmaps = 9987, kClampToEdge = 33071;

void AppendWord(std::string& bytes, uint32_t word) {
  char raw[sizeof word];
  std::memcpy(raw, &word, sizeof word);
  bytes.append(raw, sizeof word);
}

// The buffer and what describes it: views, and accessors of them.
class Buffer {
 public:
  // Its index. `target` 0: of no vertices (an image).
  int AddView(const void* data, size_t size, int target) {
    Json view = {{"buffer", 0}, {"byteOffset", bytes_.size()}, {"byteLength", size}};
    if (target != 0) view["target"] = target;
    views_.push_back(view);
    bytes_.append(static_cast<const char*>(data), size);
    bytes_.resize((bytes_.size() + 3) / 4 * 4, '\0');  // accessors start at multiples of their components
    return static_cast<int>(views_.size()) - 1;
  }
  template <typename T>
  int AddAccessor(const std::vector<T>& values, const char* type, int component, size_t count, int target) {
    const int view = AddView(values.data(), values.size() * sizeof(T), target);
    accessors_.push_back({{"bufferView", view}, {"componentType", component}, {"count", count}, {"type", type}});
    return static_cast<int>(accessors_.size()) - 1;
  }
  Json& accessor(int index) { return accessors_[static_cast<size_t>(index)]; }
  [[nodiscard]] const Json& views() const { return views_; }
  [[nodiscard]] const Json& accessors() const { return accessors_; }
  [[nodiscard]] const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
  Json views_ = Json::array(), accessors_ = Json::array();
};

std::vector<std::array<float, 3>> Turned(const std::vector<std::array<float, 3>>& from, double scale) {
  std::vector<std::array<float, 3>> to;
  to.reserve(from.size());
  for (const auto& v : from)
    to.push_back(
        {static_cast<float>(v[0] * scale), static_cast<float>(-v[1] * scale), static_cast<float>(-v[2] * scale)});
  return to;
}

// A rotation keeps the sense of a cross product, hence w.
std::vector<std::array<float, 4>> TurnedTangents(const std::vector<std::array<float, 4>>& from) {
  std::vector<std::array<float, 4>> to;
  to.reserve(from.size());
  for (const auto& t : from) to.push_back({t[0], -t[1], -t[2], t[3]});
  return to;
}

int AddPositions(Buffer& buffer, const Mesh& mesh) {
  const auto positions_m = Turned(mesh.positions_mm, 1e-3);
  const int index = buffer.AddAccessor(positions_m, "VEC3", kFloat, positions_m.size(), kVertices);
  std::array<float, 3> low{}, high{};
  low.fill(std::numeric_limits<float>::max());
  high.fill(std::numeric_limits<float>::lowest());
  for (const auto& p : positions_m)
    for (size_t axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], p[axis]);
      high[axis] = std::max(high[axis], p[axis]);
    }
  buffer.accessor(index)["min"] = low;
  buffer.accessor(index)["max"] = high;
  return index;
}

Json PrimitiveOf(Buffer& buffer, const Mesh& mesh, const GlbMaterial& material) {
  const size_t vertices = mesh.positions_mm.size();
  Json attributes;
  attributes["POSITION"] = AddPositions(buffer, mesh);
  attributes["NORMAL"] = buffer.AddAccessor(Turned(mesh.normals, 1.0), "VEC3", kFloat, vertices, kVertices);
  if (!material.normals.empty())
    attributes["TANGENT"] = buffer.AddAccessor(TurnedTangents(mesh.tangents), "VEC4", kFloat, vertices, kVertices);
  if (!material.base_colour.empty() || !material.normals.empty())
    attributes["TEXCOORD_0"] = buffer.AddAccessor(mesh.texture_uv, "VEC2", kFloat, vertices, kVertices);
  const int indices = buffer.AddAccessor(mesh.triangles, "SCALAR", kUnsignedInt, 3 * mesh.triangles.size(), kIndices);
  return {{"attributes", attributes}, {"indices", indices}, {"material", 0}, {"mode", 4}};
}

// An embedded PNG; its index among the textures.
Result<int> AddTexture(Buffer& buffer, Json& json, ImageView<const uint8_t> picture) {
  SLX_ASSIGN_OR_RETURN(const auto png, EncodePng8(picture));
  const int view = buffer.AddView(png.data(), png.size(), 0);
  json["samplers"] = Json::array(
      {Json{{"magFilter", kLinear}, {"minFilter", kLinearMipmaps}, {"wrapS", kClampToEdge}, {"wrapT", kClampToEdge}}});
  const size_t index = json["images"].size();
  json["images"].push_back({{"bufferView", view}, {"mimeType", "image/png"}});
  json["textures"].push_back({{"sampler", 0}, {"source", index}});
  return static_cast<int>(index);
}

// Seen from both sides: a face without a back has an inside.
Result<Json> MaterialOf(Buffer& buffer, Json& json, const GlbMaterial& material) {
  Json surface = {{"metallicFactor", 0.0}, {"roughnessFactor", std::clamp(material.roughness, 0.0, 1.0)}};
  Json made = {{"name", "skin"}};
  if (material.base_colour.empty()) {
    surface["baseColorFactor"] = {0.5, 0.5, 0.5, 1.0};
  } else {
    SLX_ASSIGN_OR_RETURN(const int index, AddTexture(buffer, json, material.base_colour));
    surface["baseColorTexture"] = {{"index", index}};
  }
  made["pbrMetallicRoughness"] = surface;
  if (!material.normals.empty()) {
    SLX_ASSIGN_OR_RETURN(const int index, AddTexture(buffer, json, material.normals));
    made["normalTexture"] = {{"index", index}};
  }
  if (material.coat) {
    // Of a viewer that knows one of the two extensions see docs/file-formats.md.
    SLX_ASSIGN_OR_RETURN(const int index, AddTexture(buffer, json, material.coat->normals));
    made["extensions"] = {{"KHR_materials_clearcoat",
                           {{"clearcoatFactor", std::clamp(material.coat->strength, 0.0, 1.0)},
                            {"clearcoatRoughnessFactor", std::clamp(material.roughness, 0.0, 1.0)},
                            {"clearcoatNormalTexture", {{"index", index}}}}},
                          {"KHR_materials_specular", {{"specularFactor", 0.0}}}};
    json["extensionsUsed"] = {"KHR_materials_clearcoat", "KHR_materials_specular"};
  }
  made["doubleSided"] = true;
  return made;
}

Json AssetOf(const ExportOrigin& origin) {
  Json extras;
  for (const auto& [name, value] : origin.Named()) extras[name] = value;
  extras["length_unit"] = "m";
  extras["frame"] =
      "the capturing camera's, turned by half a turn about x: +x right, +y up, the camera at the origin "
      "looks along -z";
  return {{"version", "2.0"}, {"generator", std::string("Stratalux ") + kVersion}, {"extras", extras}};
}

std::string Container(const Json& json, const std::string& binary) {
  std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  text.resize((text.size() + 3) / 4 * 4, ' ');
  const size_t all = 12 + 8 + text.size() + 8 + binary.size();
  std::string bytes;
  bytes.reserve(all);
  for (const uint32_t word : {kGlbMagic, kContainerVersion, static_cast<uint32_t>(all)}) AppendWord(bytes, word);
  AppendWord(bytes, static_cast<uint32_t>(text.size()));
  AppendWord(bytes, kJsonChunk);
  bytes += text;
  AppendWord(bytes, static_cast<uint32_t>(binary.size()));
  AppendWord(bytes, kBinaryChunk);
  return bytes + binary;
}

}  // namespace

Status WriteGlb(const std::filesystem::path& file, const Mesh& mesh, const GlbMaterial& material,
                const ExportOrigin& origin) {
  if (mesh.triangles.empty()) return Status::NotFound(file.string() + ": the surface has no triangle");
  if (!material.normals.empty() && mesh.tangents.size() != mesh.positions_mm.size())
    return Status::Usage(file.string() + ": a normal texture needs a tangent for each vertex");
  Buffer buffer;
  Json json = {{"asset", AssetOf(origin)}, {"scene", 0}};
  json["scenes"] = Json::array({Json{{"nodes", Json::array({0})}}});
  json["nodes"] = Json::array({Json{{"name", "face"}, {"mesh", 0}}});
  json["meshes"] =
      Json::array({Json{{"name", "face"}, {"primitives", Json::array({PrimitiveOf(buffer, mesh, material)})}}});
  SLX_ASSIGN_OR_RETURN(const Json made, MaterialOf(buffer, json, material));
  json["materials"] = Json::array({made});
  json["accessors"] = buffer.accessors();
  json["bufferViews"] = buffer.views();
  json["buffers"] = Json::array({Json{{"byteLength", buffer.bytes().size()}}});
  if (buffer.bytes().size() > kMostBytes)
    return Status::Usage(file.string() + ": a glTF container holds 4 GiB at most");
  return db::ReplaceFile(file, Container(json, buffer.bytes()));
}

}  // namespace stratalux::fit
