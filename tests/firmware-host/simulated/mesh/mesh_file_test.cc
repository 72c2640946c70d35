// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/mesh/mesh_file.h"

#include <cstring>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware-host/simulated/mesh/small_meshes.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

// A square in two triangles and one triangle beside it, as each way of writing says it.
void ExpectTheHouse(const Result<MeshData>& read, const char* how) {
  ASSERT_TRUE(read.ok()) << how << ": " << read.status().message();
  const MeshData& mesh = *read;
  ASSERT_EQ(mesh.vertices.size(), 5U) << how;
  EXPECT_EQ(mesh.vertices[2], Eigen::Vector3d(10.5, 10, -0.25)) << how;
  EXPECT_EQ(mesh.vertices[4], Eigen::Vector3d(5, 15, 0)) << how;
  ASSERT_EQ(mesh.triangles.size(), 3U) << how;
  EXPECT_EQ(mesh.triangles[0].vertex, (std::array<int, 3>{0, 1, 2})) << how;
  EXPECT_EQ(mesh.triangles[1].vertex, (std::array<int, 3>{0, 2, 3})) << how;
  EXPECT_EQ(mesh.triangles[2].vertex, (std::array<int, 3>{3, 2, 4})) << how;
}

void ExpectItsTexture(const MeshData& mesh, const char* how) {
  for (const auto& t : mesh.triangles)
    for (size_t k = 0; k < 3; ++k) {
      ASSERT_NE(t.texture[k], MeshData::kNone) << how;
      EXPECT_EQ(mesh.texture[t.texture[k]].x(), t.vertex[k] / 8.0) << how;
      EXPECT_EQ(mesh.texture[t.texture[k]].y(), 1.0 - t.vertex[k] / 8.0) << how;
    }
}

constexpr const char* kObjVertices = "v 0 0 0\nv 10 0 0\nv 10.5 10 -0.25\nv 0 1e1 0\nv 5 15 0\n";
constexpr const char* kObjTexture = "vt 0 1\nvt 0.125 0.875\nvt 0.25 0.75\nvt 0.375 0.625\nvt 0.5 0.5\n";

TEST(ObjFile, SaysOneMeshInManyWays) {
  const std::string v = kObjVertices, vt = kObjTexture, vn = "vn 0 0 1\n";
  ExpectTheHouse(ParseObj(v + "f 1 2 3 4\nf 4 3 5\n", "a"), "indices");
  ExpectTheHouse(ParseObj(v + "f -5 -4 -3 -2\nf -2 -3 -1", "a"), "backwards, without a last line end");
  ExpectTheHouse(ParseObj("# made by hand\r\nmtllib a.mtl\r\no house\r\nv  0\t0 0 1.0\r\nv +10 0 0 0.5 0.5 0.5\r\n"
                          "v 10.5 10 -0.25\r\ng roof\r\nv 0 10 0\r\nv 5 15 0\r\ns 1\r\n\r\nusemtl brick\r\n"
                          "  f 1 2 3 4 # wall\r\nl 1 2\r\nf 4 3 5\r\n",
                          "a"),
                 "with what else there may be");
  ExpectTheHouse(ParseObj(v + vn + "f 1//1 2//1 3//1 4//1\nf 4//-1 3//-1 5//-1\n", "a"), "normals");
  for (const std::string& faces : {std::string("f 1/1 2/2 3/3 4/4\nf 4/4 3/3 5/5\n"),
                                   std::string("vn 0 0 1\nf 1/1/1 2/2/1 3/3/1 4/4/1\nf 4/4/1 3/3/1 5/5/1\n")}) {
    const auto mesh = ParseObj(v + vt + faces, "a");
    ExpectTheHouse(mesh, faces.c_str());
    ExpectItsTexture(*mesh, faces.c_str());
  }
  const auto partly = ParseObj(v + vt + "f 1/1 2/2 3 4/4\nf 4/4 3/3 5/5\n", "a");
  ASSERT_TRUE(partly.ok());
  EXPECT_EQ(partly->triangles[0].texture[0], MeshData::kNone) << "of a face all corners have texture, or none";
  EXPECT_NE(partly->triangles[2].texture[0], MeshData::kNone);
}

TEST(ObjFile, ARepeatedVertexIsOne) {
  const auto mesh = ParseObj("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 4 6 5\nf 2 4 6\n", "a");
  ASSERT_TRUE(mesh.ok());
  EXPECT_EQ(mesh->vertices.size(), 4U);
  ASSERT_EQ(mesh->triangles.size(), 2U) << "the third has two equal corners";
  EXPECT_EQ(mesh->triangles[1].vertex, (std::array<int, 3>{1, 3, 2}));
}

TEST(ObjFile, EveryComplaintNamesFileLineValueAndRemedy) {
  const std::string v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  const struct {
    std::string text;
    const char* complaint;
  } cases[] = {
      {"", "a.obj: no face among 0 vertices; export the mesh with its faces"},
      {v, "a.obj: no face among 3 vertices"},
      {v + "f 1 1 2\n", "a.obj: no face"},
      {"v 0 zero 0\n", "a.obj:1: 'zero' is not a number; a vertex is v X Y Z"},
      {"v 0 0\n", "a.obj:1: '' is not a number"},
      {"v 0 0 nan\n", "a.obj:1: 'nan' is not a number"},
      {"v 0 inf 0\n", "a.obj:1: 'inf' is not a number"},
      {"v 0 1e999 0\n", "a.obj:1: '1e999' is not a number"},
      {"v 0 1e300 0\n", "a.obj:1: vertex (0, 1e+300, 0) is not a position"},
      {"v 0 0x10 0\n", "a.obj:1: '0x10' is not a number"},
      {"v 0 1,5 0\n", "a.obj:1: '1,5' is not a number"},
      {"vt 0.5 left\n", "a.obj:1: 'left' is not a number; a texture coordinate is vt U V"},
      {"vt 1e9 0\n", "a.obj:1: texture coordinates (1e+09, 0)"},
      {"vn 0 0 up\n", "a.obj:1: 'up' is not a number; a normal is vn X Y Z"},
      {v + "f 1 2 4\n", "a.obj:4: index '4' is not among the 3 before this line; it counts from 1"},
      {v + "f 1 2 0\n", "a.obj:4: index '0'"},
      {v + "f 1 2 -4\n", "a.obj:4: index '-4'"},
      {v + "f 1 2 99999999999999999999\n", "a.obj:4: index '99999999999999999999'"},
      {v + "f 1 2 3.5\n", "a.obj:4: index '3.5'"},
      {v + "f 1 2\n", "a.obj:4: a face of 2 corners"},
      {v + "f 1/1 2/1 3/1\n", "a.obj:4: index '1' is not among the 0"},
      {v + "vt 0 0\nf 1/1 2/2 3/1\n", "a.obj:5: index '2' is not among the 1"},
      {v + "f 1//1 2//1 3//1\n", "a.obj:4: index '1' is not among the 0"},
      {v + "\n\nf 1 2 \x1b[31m\n", "a.obj:6: index '\\x1b[31m'"},
  };
  for (const auto& c : cases) {
    const auto mesh = ParseObj(c.text, "a.obj");
    ASSERT_FALSE(mesh.ok()) << c.text;
    EXPECT_EQ(mesh.status().code(), StatusCode::kUsage) << c.text;
    EXPECT_THAT(mesh.status().message(), HasSubstr(c.complaint)) << c.text;
  }
  std::string many = v + "f";
  for (int i = 0; i < 2000; ++i) many += " 1 2 3";
  EXPECT_THAT(ParseObj(many, "a.obj").status().message(), HasSubstr("a.obj:4: a face of more than 1024 corners"));
}

constexpr const char* kPlyVertexHead =
    "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n";
constexpr const char* kPlyFaceHead = "element face 2\nproperty list uchar int vertex_indices\nend_header\n";

TEST(PlyFile, SaysOneMeshInManyWays) {
  const std::string head = kPlyVertexHead, faces = kPlyFaceHead;
  const std::string rows = "0 0 0\n10 0 0\n10.5 10 -0.25\n0 10 0\n5 15 0\n", lists = "4 0 1 2 3\n3 3 2 4\n";
  ExpectTheHouse(ParsePly(head + faces + rows + lists, "a"), "plain");
  ExpectTheHouse(ParsePly(head + faces + "0 0 0 10 0 0 10.5 10 -0.25 0 10 0 5 15 0 4 0 1 2 3 3 3 2 4", "a"),
                 "one line");
  const auto own = ParsePly(head +
                                "element face 2\nproperty uchar flags\nproperty list uint8 uint32 vertex_index\n"
                                "property list uchar float texcoord\nelement edge 1\nproperty int a\nend_header\n" +
                                rows +
                                "7 4 0 1 2 3 8 0 1 0.125 0.875 0.25 0.75 0.375 0.625\n"
                                "7 3 3 2 4 6 0.375 0.625 0.25 0.75 0.5 0.5\n3\n",
                            "a");
  ExpectTheHouse(own, "texture of corners");
  ExpectItsTexture(*own, "texture of corners");
  const auto textured = ParsePly(
      "ply\nformat ascii 1.0\nelement vertex 5\nproperty double x\nproperty double y\nproperty double z\n"
      "property float s\nproperty float t\nproperty float nx\nproperty float ny\nproperty float nz\n" +
          faces +
          "0 0 0 0 1 0 0 1\n10 0 0 .125 .875 0 0 1\n10.5 10 -0.25 .25 .75 0 0 1\n0 10 0 .375 .625 0 0 1\n"
          "5 15 0 .5 .5 0 0 1\n" +
          lists,
      "a");
  ExpectTheHouse(textured, "texture of vertices");
  ExpectItsTexture(*textured, "texture of vertices");
  EXPECT_EQ(textured->normals[textured->triangles[2].normal[1]], Eigen::Vector3d(0, 0, 1));
}

template <typename T>
void Append(std::string& bytes, T value) {
  char raw[sizeof(T)];
  std::memcpy(raw, &value, sizeof(T));
  bytes.append(raw, sizeof(T));
}

std::string BinaryHouse() {
  std::string bytes =
      "ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\nproperty double y\nproperty float z\n"
      "property uchar red\nelement face 2\nproperty list uchar ushort vertex_indices\nproperty short "
      "quality\nend_header\n";
  constexpr double kPlaces[5][3] = {{0, 0, 0}, {10, 0, 0}, {10.5, 10, -0.25}, {0, 10, 0}, {5, 15, 0}};
  for (const auto& p : kPlaces) {
    Append(bytes, static_cast<float>(p[0]));
    Append(bytes, p[1]);
    Append(bytes, static_cast<float>(p[2]));
    Append(bytes, uint8_t{200});
  }
  for (const std::vector<uint16_t>& face : {std::vector<uint16_t>{0, 1, 2, 3}, {3, 2, 4}}) {
    Append(bytes, static_cast<uint8_t>(face.size()));
    for (const uint16_t index : face) Append(bytes, index);
    Append(bytes, int16_t{-1});
  }
  return bytes;
}

TEST(PlyFile, ReadsBinaryAndRefusesItCutAnywhere) {
  const std::string whole = BinaryHouse();
  ExpectTheHouse(ParsePly(whole, "a"), "binary");
  for (size_t length = 0; length < whole.size(); ++length)
    EXPECT_EQ(ParsePly(std::string_view(whole).substr(0, length), "a").status().code(), StatusCode::kUsage) << length;
  EXPECT_THAT(ParsePly(std::string_view(whole).substr(0, whole.size() - 1), "a.ply").status().message(),
              HasSubstr("a.ply: element face 1: the file ends here"));
}

TEST(PlyFile, EveryComplaintNamesFileLineValueAndRemedy) {
  const std::string head = kPlyVertexHead, faces = kPlyFaceHead;
  const std::string rows = "0 0 0\n10 0 0\n10 10 0\n0 10 0\n5 15 0\n";
  const struct {
    std::string text;
    const char* complaint;
  } cases[] = {
      {"", "the header has no end_header"},
      {"solid cube\n", "a.ply:1: not a PLY file"},
      {"ply\nformat binary_big_endian 1.0\n",
       "a.ply:2: format binary_big_endian; allowed: ascii, binary_little_endian"},
      {"ply\nelement vertex 1\nproperty float x\nend_header\n", "a.ply:4: no line gives the format"},
      {"ply\nformat ascii 1.0\nelement vertex many\n", "a.ply:3: element of 'many' rows"},
      {"ply\nformat ascii 1.0\nproperty float x\n", "a.ply:3: 'property ...' is not a line"},
      {"ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\n", "a.ply:4: 'property ...'"},
      {"ply\nformat ascii 1.0\nelement face 1\nproperty list float int vertex_indices\n", "a.ply:4: 'property ...'"},
      {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n",
       "a.ply: element vertex: lacks the properties x, y and z"},
      {head + "element face 1\nproperty int vertex_indices\nend_header\n" + rows + "3\n",
       "lacks a list vertex_indices"},
      {head + "end_header\n" + rows, "a.ply: no face among 5 vertices"},
      {"ply\nformat ascii 1.0\nelement vertex 4000000000000\nproperty float x\nproperty float y\nproperty float z\n" +
           faces + "0 0 0\n",
       "a.ply: element vertex claims 4000000000000 rows, more than the file holds"},
      {"ply\nformat ascii 1.0\nelement nothing 4000000000000\nend_header\n", "element nothing claims"},
      {head + faces + "0 0 0\n10 nil 0\n10 10 0\n0 10 0\n5 15 0\n4 0 1 2 3\n3 3 2 4\n",
       "a.ply:12: 'nil' is not a number"},
      {head + faces + "0 0 0\n10 nan 0\n10 10 0\n0 10 0\n5 15 0\n4 0 1 2 3\n3 3 2 4\n",
       "a.ply:12: 'nan' is not a number"},
      {head + faces + rows + "4 0 1 2 5\n3 3 2 4\n", "a.ply:16: vertex 5 is not among the 5"},
      {head + faces + rows + "4 0 1 2 -1\n3 3 2 4\n", "a.ply:16: vertex -1 is not among the 5"},
      {head + faces + rows + "2 0 1\n3 3 2 4\n", "a.ply:16: a face of 2 corners"},
      {head + faces + rows + "9999 0 1\n3 3 2 4\n", "a.ply:16: a list of 9999"},
      {head + faces + rows + "4 0 1 2 3\n3 3 2\n", "a.ply:18: the file ends here"},
      {"ply\nformat ascii 1.0\n" + faces + "3 0 1 2\n3 0 1 2\n", "vertex 0 is not among the 0"},
  };
  for (const auto& c : cases) {
    const auto mesh = ParsePly(c.text, "a.ply");
    ASSERT_FALSE(mesh.ok()) << c.text;
    EXPECT_EQ(mesh.status().code(), StatusCode::kUsage) << c.text;
    EXPECT_THAT(mesh.status().message(), HasSubstr(c.complaint)) << c.text;
  }
  std::string broken = BinaryHouse();
  const float not_a_number = std::nanf("");
  std::memcpy(broken.data() + broken.find("end_header\n") + 11, &not_a_number, 4);
  EXPECT_THAT(ParsePly(broken, "a.ply").status().message(), HasSubstr("a.ply: element vertex 0: vertex (nan, 0, 0)"));
}

using MeshFile = ScratchFolderTest;

TEST_F(MeshFile, GoesByTheEndingOfItsName) {
  const std::string house = std::string(kObjVertices) + "f 1 2 3 4\nf 4 3 5\n";
  WriteText(folder_ / "house.OBJ", house);
  WriteText(folder_ / "house.ply", BinaryHouse());
  WriteText(folder_ / "house.stl", house);
  ExpectTheHouse(ReadMeshFile(folder_ / "house.OBJ"), "obj");
  ExpectTheHouse(ReadMeshFile(folder_ / "house.ply"), "ply");
  for (const char* name : {"house.stl", "nobody.obj"}) {
    const auto mesh = ReadMeshFile(folder_ / name);
    EXPECT_EQ(mesh.status().code(), StatusCode::kUsage);
    EXPECT_THAT(mesh.status().message(), HasSubstr((folder_ / name).string()));
  }
}

}  // namespace
}  // namespace stratalux::rig
