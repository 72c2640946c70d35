// SPDX-License-Identifier: Apache-2.0
// Wavefront OBJ: v, vt, vn, f. Groups, materials, lines and points are passed over.
#include "firmware-host/simulated/mesh/mesh_builder.h"
#include "shared/base/formatted.h"
#include "shared/base/printable.h"

namespace stratalux::rig {
namespace {

constexpr size_t kMostCorners = 1024;  // of a face

// The next word of `line`, which loses it; empty at the end.
std::string_view TakeWord(std::string_view& line) {
  constexpr std::string_view kBlank = " \t\r";
  const size_t begin = std::min(line.find_first_not_of(kBlank), line.size());
  const size_t end = std::min(line.find_first_of(kBlank, begin), line.size());
  const std::string_view word = line.substr(begin, end - begin);
  line.remove_prefix(end);
  return word;
}

Status NoNumber(std::string_view word, const char* what) {
  return Status::Usage("'" + Printable(word.substr(0, 40)) + "' is not a number; " + what);
}

// The first `count` numbers of a line; what follows them (weights, colours) is somebody else's.
template <int count>
Result<Eigen::Matrix<double, count, 1>> TakeNumbers(std::string_view line, const char* what) {
  Eigen::Matrix<double, count, 1> numbers;
  for (int k = 0; k < count; ++k) {
    const std::string_view word = TakeWord(line);
    const auto value = FiniteNumber(word);
    if (!value) return NoNumber(word, what);
    numbers[k] = *value;
  }
  return numbers;
}

// From 1, or from -1 backwards, as OBJ counts; 0-based.
Result<int64_t> TakeIndex(std::string_view word, int64_t count) {
  const auto index = WholeNumber(word);
  if (!index || *index == 0 || *index > count || *index < -count)
    return Status::Usage("index '" + Printable(word.substr(0, 40)) +
                         Formatted("' is not among the %lld before this line; it counts from 1, or backwards from -1",
                                   static_cast<long long>(count)));
  return *index > 0 ? *index - 1 : count + *index;
}

// V, V/T, V//N or V/T/N.
Result<MeshBuilder::Corner> TakeCorner(std::string_view word, const MeshBuilder& mesh) {
  MeshBuilder::Corner corner;
  const size_t first = word.find('/');
  SLX_ASSIGN_OR_RETURN(corner.vertex, TakeIndex(word.substr(0, first), mesh.vertices()));
  if (first == std::string_view::npos) return corner;
  word.remove_prefix(first + 1);
  const size_t second = word.find('/');
  if (const std::string_view texture = word.substr(0, second); !texture.empty()) {
    SLX_ASSIGN_OR_RETURN(corner.texture, TakeIndex(texture, mesh.texture()));
  }
  if (second == std::string_view::npos) return corner;
  SLX_ASSIGN_OR_RETURN(corner.normal, TakeIndex(word.substr(second + 1), mesh.normals()));
  return corner;
}

Status TakeFace(std::string_view line, MeshBuilder& mesh) {
  std::vector<MeshBuilder::Corner> corners;
  for (std::string_view word = TakeWord(line); !word.empty() && !word.starts_with('#'); word = TakeWord(line)) {
    if (corners.size() == kMostCorners)
      return Status::Usage(Formatted("a face of more than %zu corners; export triangles", kMostCorners));
    SLX_ASSIGN_OR_RETURN(corners.emplace_back(), TakeCorner(word, mesh));
  }
  return mesh.AddPolygon(corners);
}

Status TakeLine(std::string_view line, MeshBuilder& mesh) {
  const std::string_view kind = TakeWord(line);
  if (kind == "v") {
    SLX_ASSIGN_OR_RETURN(const Eigen::Vector3d vertex, TakeNumbers<3>(line, "a vertex is v X Y Z"));
    return mesh.AddVertex(vertex);
  }
  if (kind == "vt") {
    SLX_ASSIGN_OR_RETURN(const Eigen::Vector2d at, TakeNumbers<2>(line, "a texture coordinate is vt U V"));
    return mesh.AddTexture(at);
  }
  if (kind == "vn") {
    SLX_ASSIGN_OR_RETURN(const Eigen::Vector3d normal, TakeNumbers<3>(line, "a normal is vn X Y Z"));
    return mesh.AddNormal(normal);
  }
  return kind == "f" ? TakeFace(line, mesh) : Status::Ok();
}

}  // namespace

Result<MeshData> ParseObj(std::string_view text, const std::string& name) {
  MeshBuilder mesh;
  int64_t number = 0;
  while (!text.empty()) {
    ++number;
    const size_t end = std::min(text.find('\n'), text.size());
    const Status line = TakeLine(text.substr(0, end), mesh);
    if (!line.ok()) return line.WithContext(name + ":" + std::to_string(number));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return std::move(mesh).Finish().WithContext(name);
}

}  // namespace stratalux::rig
