// SPDX-License-Identifier: Apache-2.0
// PLY (Turk 1994), ascii and binary little-endian: x, y, z of vertices, their texture coordinates (s t, u v, texture_u
// texture_v) and normals; lists of faces, with the texture coordinates of their corners (texcoord) where they have
// them.
#include <algorithm>
#include <cstring>
#include <optional>

#include "firmware-host/simulated/mesh/mesh_builder.h"
#include "shared/base/formatted.h"
#include "shared/base/printable.h"

namespace stratalux::rig {
namespace {

enum class Scalar { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };
constexpr std::array<size_t, 8> kScalarBytes = {1, 1, 2, 2, 4, 4, 4, 8};

std::optional<Scalar> ScalarOf(std::string_view word) {
  constexpr std::array<std::string_view, 8> kNames = {"char", "uchar", "short", "ushort",
                                                      "int",  "uint",  "float", "double"};
  constexpr std::array<std::string_view, 8> kOtherNames = {"int8",  "uint8",  "int16",   "uint16",
                                                           "int32", "uint32", "float32", "float64"};
  for (size_t i = 0; i < kNames.size(); ++i)
    if (word == kNames[i] || word == kOtherNames[i]) return static_cast<Scalar>(i);
  return std::nullopt;
}

struct Property {
  std::string name;
  std::optional<Scalar> count;  // of a list
  Scalar type = Scalar::kFloat;
};
struct Element {
  std::string name;
  int64_t rows = 0;
  std::vector<Property> properties;
  [[nodiscard]] int Find(std::initializer_list<std::string_view> names) const {
    for (size_t i = 0; i < properties.size(); ++i)
      for (const std::string_view wanted : names)
        if (properties[i].name == wanted) return static_cast<int>(i);
    return -1;
  }
  // No row is shorter: in a text a number and what parts it from the next take two bytes.
  [[nodiscard]] int64_t FewestBytes(bool binary) const {
    size_t bytes = 0;
    for (const Property& p : properties)
      bytes += !binary ? 2 : kScalarBytes[static_cast<size_t>(p.count.value_or(p.type))];
    return static_cast<int64_t>(bytes);
  }
};

// What follows "end_header".
class Body {
 public:
  Body(std::string_view bytes, bool binary, int64_t line) : bytes_(bytes), binary_(binary), line_(line) {}
  [[nodiscard]] int64_t left() const { return static_cast<int64_t>(bytes_.size()); }
  // In a text; 0 in a binary file.
  [[nodiscard]] int64_t line() const { return binary_ ? 0 : line_; }
  [[nodiscard]] bool binary() const { return binary_; }

  Result<double> Take(Scalar type) { return binary_ ? TakeBinary(type) : TakeText(); }
  Result<int64_t> TakeCount(Scalar type) {
    SLX_ASSIGN_OR_RETURN(const double count, Take(type));
    if (!(count >= 0.0 && count <= kMostListed && count == static_cast<double>(static_cast<int64_t>(count))))
      return Status::Usage(Formatted("a list of %g; 0 to %g are allowed", count, kMostListed));
    return static_cast<int64_t>(count);
  }

 private:
  static constexpr double kMostListed = 4096;

  template <typename T>
  Result<double> TakeAs() {
    if (bytes_.size() < sizeof(T)) return Status::Usage("the file ends here; write it again");
    T value;
    std::memcpy(&value, bytes_.data(), sizeof(T));  // every machine of ours is little-endian
    bytes_.remove_prefix(sizeof(T));
    return static_cast<double>(value);
  }
  Result<double> TakeBinary(Scalar type) {
    switch (type) {
      case Scalar::kInt8:
        return TakeAs<int8_t>();
      case Scalar::kUint8:
        return TakeAs<uint8_t>();
      case Scalar::kInt16:
        return TakeAs<int16_t>();
      case Scalar::kUint16:
        return TakeAs<uint16_t>();
      case Scalar::kInt32:
        return TakeAs<int32_t>();
      case Scalar::kUint32:
        return TakeAs<uint32_t>();
      case Scalar::kFloat:
        return TakeAs<float>();
      default:
        return TakeAs<double>();
    }
  }
  Result<double> TakeText() {
    constexpr std::string_view kBlank = " \t\r\n";
    const size_t begin = std::min(bytes_.find_first_not_of(kBlank), bytes_.size());
    line_ += std::count(bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(begin), '\n');
    const size_t end = std::min(bytes_.find_first_of(kBlank, begin), bytes_.size());
    const std::string_view word = bytes_.substr(begin, end - begin);
    bytes_.remove_prefix(end);
    if (word.empty()) return Status::Usage("the file ends here; write it again");
    const auto value = FiniteNumber(word);
    if (!value) return Status::Usage("'" + Printable(word.substr(0, 40)) + "' is not a number");
    return *value;
  }

  std::string_view bytes_;
  bool binary_;
  int64_t line_;
};

struct Header {
  bool binary = false;
  std::vector<Element> elements;
  size_t bytes = 0;
  int64_t lines = 0;
};

std::vector<std::string> WordsOf(std::string_view line) {
  std::vector<std::string> words;
  constexpr std::string_view kBlank = " \t\r";
  while (words.size() < 8) {
    const size_t begin = std::min(line.find_first_not_of(kBlank), line.size());
    const size_t end = std::min(line.find_first_of(kBlank, begin), line.size());
    if (begin == end) break;
    words.emplace_back(line.substr(begin, end - begin));
    line.remove_prefix(end);
  }
  return words;
}

Status TakeHeaderLine(const std::vector<std::string>& words, Header& header) {
  if (words.empty() || words[0] == "comment" || words[0] == "obj_info") return Status::Ok();
  if (words[0] == "format" && words.size() == 3) {
    header.binary = words[1] == "binary_little_endian";
    if (header.binary || words[1] == "ascii") return Status::Ok();
    return Status::Usage("format " + Printable(words[1]) + "; allowed: ascii, binary_little_endian");
  }
  if (words[0] == "element" && words.size() == 3) {
    const auto rows = WholeNumber(words[2]);
    if (!rows || *rows < 0) return Status::Usage("element of '" + Printable(words[2]) + "' rows");
    header.elements.push_back({words[1], *rows, {}});
    return Status::Ok();
  }
  const bool list = words.size() == 5 && words[1] == "list";
  if (words[0] == "property" && !header.elements.empty() && (list || words.size() == 3)) {
    Property property{words.back(), std::nullopt, Scalar::kFloat};
    const auto type = ScalarOf(words[words.size() - 2]);
    if (list) property.count = ScalarOf(words[2]);
    if (type && (!list || (property.count && *property.count < Scalar::kFloat))) {
      property.type = *type;
      header.elements.back().properties.push_back(std::move(property));
      return Status::Ok();
    }
  }
  return Status::Usage("'" + Printable(words[0]) + " ...' is not a line of a PLY header");
}

Result<Header> TakeHeader(std::string_view bytes, const std::string& name) {
  constexpr int64_t kMostLines = 1000;
  Header header;
  bool formatted = false;
  while (header.bytes < bytes.size() && header.lines < kMostLines) {
    const size_t end = std::min(bytes.find('\n', header.bytes), bytes.size());
    const auto words = WordsOf(bytes.substr(header.bytes, std::min<size_t>(end - header.bytes, 1000)));
    header.bytes = std::min(end + 1, bytes.size());
    ++header.lines;
    const std::string where = name + ":" + std::to_string(header.lines);
    if (header.lines == 1) {
      if (words.size() != 1 || words[0] != "ply") return Status::Usage(where + ": not a PLY file");
      continue;
    }
    if (words.size() == 1 && words[0] == "end_header") {
      if (!formatted) return Status::Usage(where + ": no line gives the format");
      return header;
    }
    formatted = formatted || (!words.empty() && words[0] == "format");
    SLX_RETURN_IF_ERROR(TakeHeaderLine(words, header).WithContext(where));
  }
  return Status::Usage(name + ": the header has no end_header");
}

// One row at a time; `lists` of list properties, `values` of the others.
struct Row {
  std::vector<double> values;
  std::vector<std::vector<double>> lists;
};

Status TakeRow(const Element& element, Body& body, Row& row) {
  row.values.resize(element.properties.size());
  row.lists.resize(element.properties.size());
  for (size_t i = 0; i < element.properties.size(); ++i) {
    const Property& property = element.properties[i];
    if (!property.count) {
      SLX_ASSIGN_OR_RETURN(row.values[i], body.Take(property.type));
      continue;
    }
    SLX_ASSIGN_OR_RETURN(const int64_t count, body.TakeCount(*property.count));
    row.lists[i].clear();
    for (int64_t k = 0; k < count; ++k) {
      SLX_ASSIGN_OR_RETURN(const double value, body.Take(property.type));
      row.lists[i].push_back(value);
    }
  }
  return Status::Ok();
}

// Where an element keeps what a mesh needs; -1: nowhere.
struct Columns {
  std::array<int, 3> place, normal;
  std::array<int, 2> texture;
  int corners, corner_texture;
  explicit Columns(const Element& e)
      : place{e.Find({"x"}), e.Find({"y"}), e.Find({"z"})},
        normal{e.Find({"nx"}), e.Find({"ny"}), e.Find({"nz"})},
        texture{e.Find({"s", "u", "texture_u"}), e.Find({"t", "v", "texture_v"})},
        corners(e.Find({"vertex_indices", "vertex_index"})),
        corner_texture(e.Find({"texcoord"})) {}
  template <size_t n>
  static bool AllScalars(const std::array<int, n>& columns, const Element& e) {
    return std::all_of(columns.begin(), columns.end(), [&](int c) { return c >= 0 && !e.properties[c].count; });
  }
};

Status TakeVertex(const Columns& columns, const Element& element, const Row& row, MeshBuilder& mesh) {
  const auto& v = row.values;
  SLX_RETURN_IF_ERROR(mesh.AddVertex({v[columns.place[0]], v[columns.place[1]], v[columns.place[2]]}));
  if (Columns::AllScalars(columns.texture, element))
    SLX_RETURN_IF_ERROR(mesh.AddTexture({v[columns.texture[0]], v[columns.texture[1]]}));
  if (Columns::AllScalars(columns.normal, element))
    SLX_RETURN_IF_ERROR(mesh.AddNormal({v[columns.normal[0]], v[columns.normal[1]], v[columns.normal[2]]}));
  return Status::Ok();
}

// Vertices bring their texture coordinates and normals one each, if any.
Status TakePlyFace(const Columns& columns, const Row& row, bool texture, bool normals, MeshBuilder& mesh) {
  const std::vector<double>& indices = row.lists[columns.corners];
  static const std::vector<double> kNoTexture;
  const std::vector<double>& own = columns.corner_texture >= 0 ? row.lists[columns.corner_texture] : kNoTexture;
  const bool has_own = !own.empty() && own.size() == 2 * indices.size();
  std::vector<MeshBuilder::Corner> corners;
  for (size_t k = 0; k < indices.size(); ++k) {
    if (!(indices[k] >= 0.0 && indices[k] < static_cast<double>(mesh.vertices())))
      return Status::Usage(Formatted("vertex %g is not among the %lld of the file", indices[k],
                                     static_cast<long long>(mesh.vertices())));
    MeshBuilder::Corner corner{static_cast<int64_t>(indices[k])};
    if (texture) corner.texture = corner.vertex;
    if (normals) corner.normal = corner.vertex;
    if (has_own) {
      corner.texture = mesh.texture();
      SLX_RETURN_IF_ERROR(mesh.AddTexture({own[2 * k], own[2 * k + 1]}));
    }
    corners.push_back(corner);
  }
  return mesh.AddPolygon(corners);
}

}  // namespace

Result<MeshData> ParsePly(std::string_view bytes, const std::string& name) {
  SLX_ASSIGN_OR_RETURN(const Header header, TakeHeader(bytes, name));
  Body body(bytes.substr(header.bytes), header.binary, header.lines + 1);
  MeshBuilder mesh;
  bool texture = false, normals = false;
  for (const Element& element : header.elements) {
    const std::string what = name + ": element " + Printable(element.name);
    const Columns columns(element);
    const bool vertex = element.name == "vertex", face = element.name == "face";
    const int64_t fewest = element.FewestBytes(header.binary);
    if (element.rows > 0 && (fewest == 0 || element.rows > body.left() / fewest + 1))
      return Status::Usage(what + Formatted(" claims %lld rows, more than the file holds; write it again",
                                            static_cast<long long>(element.rows)));
    if (vertex && !Columns::AllScalars(columns.place, element))
      return Status::Usage(what + ": lacks the properties x, y and z");
    if (face && (columns.corners < 0 || !element.properties[columns.corners].count))
      return Status::Usage(what + ": lacks a list vertex_indices");
    if (face && columns.corner_texture >= 0 && !element.properties[columns.corner_texture].count)
      return Status::Usage(what + ": texcoord is a list");
    if (vertex) {
      texture = Columns::AllScalars(columns.texture, element);
      normals = Columns::AllScalars(columns.normal, element);
    }
    Row row;
    for (int64_t i = 0; i < element.rows; ++i) {
      Status taken = TakeRow(element, body, row);
      if (taken.ok() && vertex) taken = TakeVertex(columns, element, row, mesh);
      if (taken.ok() && face) taken = TakePlyFace(columns, row, texture, normals, mesh);
      if (taken.ok()) continue;
      const std::string where =
          header.binary ? what + " " + std::to_string(i) : name + ":" + std::to_string(body.line());
      return taken.WithContext(where);
    }
  }
  return std::move(mesh).Finish().WithContext(name);
}

}  // namespace stratalux::rig
