// SPDX-License-Identifier: Apache-2.0
// `stratalux-db import` of what is no picture, or says that it is a larger one than there can be: refused with exit
// code 2, file and limit named, without the time and memory that it claims.
#include <fstream>

#include <gmock/gmock.h>
#include <sys/stat.h>

#include "shared/image/png.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"
#include "tests/support/sanitized.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

class ImportLimits : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    std::filesystem::create_directories(Files());
  }
  [[nodiscard]] std::filesystem::path Files() const { return folder_ / "files"; }
  // In 1 GB of address space and 20 seconds, of which it needs a few.
  [[nodiscard]] Outcome Import(const std::string& manifest) const {
    const std::string limit = kUnderAddressSanitizer ? "" : "ulimit -v 1000000; ";  // it takes terabytes of addresses
    return Shell(limit + "STRATALUX_STORE=" + folder_.string() + " timeout 20 " + STRATALUX_BIN_DIR +
                 "/stratalux-db import --manifest " + manifest + " 2>&1 < /dev/null");
  }
  [[nodiscard]] Outcome ImportOf(const std::string& file, int side = 65536) const {
    WriteText(Files() / "m.toml",
              "[import]\nrig = \"r\"\ncamera_width = " + std::to_string(side) +
                  "\ncamera_height = " + std::to_string(side) +
                  "\nbit_depth = 8\nprojector_width = 64\nprojector_height = 48\n[[file]]\nfile = \"" + file +
                  "\"\npattern = \"white\"\n");
    return Import((Files() / "m.toml").string());
  }
  void ExpectRefused(const Outcome& outcome, const std::string& what, const std::string& name) const {
    EXPECT_EQ(outcome.code, 2) << name << ": " << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr(what)) << name;
    EXPECT_THAT(outcome.out, HasSubstr(name));
    EXPECT_TRUE(std::filesystem::is_empty(folder_ / "sessions")) << "nothing may be written";
  }
};

TEST_F(ImportLimits, DevicesPipesFoldersAndHugeFilesAreNoPictures) {
  ASSERT_EQ(mkfifo((Files() / "pipe").c_str(), 0600), 0);
  std::filesystem::create_directory(Files() / "folder");
  WriteText(Files() / "sparse.pgm", "P5 65536 65536 255\n");
  std::filesystem::resize_file(Files() / "sparse.pgm", uintmax_t{10} << 30);
  std::filesystem::create_symlink("/dev/zero", Files() / "zero.png");
  ExpectRefused(ImportOf("/dev/zero"), "a device", "/dev/zero");
  ExpectRefused(ImportOf("zero.png"), "a device", "zero.png");
  ExpectRefused(ImportOf("pipe"), "a pipe", "pipe");
  ExpectRefused(ImportOf("folder"), "a folder", "folder");
  ExpectRefused(ImportOf("sparse.pgm"), "10737418240 bytes, at most 1073741824", "sparse.pgm");
  ExpectRefused(ImportOf("none.png"), "No such file", "none.png");
  ExpectRefused(ImportOf("a\\u0000b.png"), "zero byte", "m.toml");
  ExpectRefused(ImportOf("a\\u001b[31m\\u009b.png"), "\\x1b[31m\\u009b", "No such file");
}

TEST_F(ImportLimits, PosesTimesPatternsAreNoFramesWithoutEnd) {
  std::string text =
      "[import]\nrig = \"r\"\ncamera_width = 4\ncamera_height = 4\nbit_depth = 8\n"
      "projector_width = 64\nprojector_height = 48\n[[file]]\nsequence = \"#.png\"\npatterns = [";
  for (int i = 0; i < 20000; ++i) text += "\"white\",";
  text += "]\n";
  for (int i = 0; i < 20000; ++i) text += "[[pose]]\nindex = " + std::to_string(i) + "\n";
  WriteText(Files() / "many.toml", text);  // 600 KB; 400 million frames
  ExpectRefused(Import((Files() / "many.toml").string()), "more than 250000 frames", "many.toml");
  ExpectRefused(Import((Files() / "many.toml").string() + " --pose 7"), "0.png", "many.toml");
}

TEST_F(ImportLimits, NorAreTheyManifests) {
  ASSERT_EQ(mkfifo((Files() / "pipe").c_str(), 0600), 0);
  WriteText(Files() / "sparse.toml", "x");
  std::filesystem::resize_file(Files() / "sparse.toml", uintmax_t{10} << 30);
  ExpectRefused(Import("/dev/zero"), "a device", "/dev/zero");
  ExpectRefused(Import((Files() / "pipe").string()), "a pipe", "pipe");
  ExpectRefused(Import(Files().string()), "a folder", "files");
  ExpectRefused(Import((Files() / "sparse.toml").string()), "10737418240 bytes", "sparse.toml");
  WriteText(Files() / "deep.toml", "a = " + std::string(1'000'000, '['));
  ExpectRefused(Import((Files() / "deep.toml").string()), "deep.toml", "deep.toml");
  WriteBytes(Files() / "bytes.toml", {'a', 0, 0xff, 0xc0, '\n', 0x1b});
  ExpectRefused(Import((Files() / "bytes.toml").string()), "bytes.toml", "bytes.toml");
  WriteText(Files() / "long.toml", "[import]\nrig = \"" + std::string(8'000'000, 'x') + "\"\n");
  ExpectRefused(Import((Files() / "long.toml").string()), "long.toml", "long.toml");
}

uint32_t Crc(const std::string& bytes) {
  uint32_t crc = 0xffffffffU;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int k = 0; k < 8; ++k) crc = (crc & 1U) != 0 ? 0xedb88320U ^ (crc >> 1U) : crc >> 1U;
  }
  return crc ^ 0xffffffffU;
}
std::string BigEndian(uint32_t value) {
  std::string bytes;
  for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(value >> shift);
  return bytes;
}
std::string Chunk(const std::string& type, const std::string& data) {
  return BigEndian(static_cast<uint32_t>(data.size())) + type + data + BigEndian(Crc(type + data));
}
// A header of that size and `filler` bytes of what claims to be its pixels.
std::string Png(uint32_t width, uint32_t height, size_t filler) {
  return "\x89PNG\r\n\x1a\n" + Chunk("IHDR", BigEndian(width) + BigEndian(height) + std::string("\x08\0\0\0\0", 5)) +
         Chunk("IDAT", std::string(filler, 'x')) + Chunk("IEND", "");
}
std::string Little(uint32_t value, int bytes) {
  std::string text;
  for (int i = 0; i < bytes; ++i) text += static_cast<char>(value >> (8 * i));
  return text;
}
std::string Tiff(uint32_t width, uint32_t height) {
  struct Entry {
    uint32_t tag, type, value;
  };
  const Entry entries[] = {{256, 4, width}, {257, 4, height}, {258, 3, 8},      {259, 3, 8}, {262, 3, 1},
                           {273, 4, 200},   {277, 3, 1},      {278, 4, height}, {279, 4, 8}};
  std::string file = "II*" + std::string(1, '\0') + Little(8, 4) + Little(9, 2);
  for (const Entry& e : entries) file += Little(e.tag, 2) + Little(e.type, 2) + Little(1, 4) + Little(e.value, 4);
  file += Little(0, 4);
  file.resize(200 + 4'000'000, 'x');
  return file;
}

TEST_F(ImportLimits, AHeaderThatLiesGetsNoMemory) {
  constexpr uint32_t kHuge = 1'000'000'000;
  WriteText(Files() / "a.png", Png(kHuge, kHuge, 100));
  WriteText(Files() / "b.png", Png(60'000, 60'000, 5'000'000));  // within what deflate could make of its bytes
  WriteText(Files() / "c.tif", Tiff(kHuge, kHuge));
  WriteText(Files() / "d.tif", Tiff(60'000, 60'000));
  WriteText(Files() / "e.pgm", "P5 1000000000 1000000000 255\nxxxx");
  WriteText(Files() / "f.pgm", "P2 99999999999999999999999999 1 255\n1");
  WriteText(Files() / "g.pgm", "P5 65536 65536 255\nxxxx");
  std::string tga(18, '\0');
  tga[2] = 11;
  tga[12] = tga[13] = tga[14] = tga[15] = '\xff';
  tga[16] = 8;
  WriteText(Files() / "h.tga", tga + std::string(40'000'000, '\xff'));
  for (const char* name : {"a.png", "b.png", "c.tif", "d.tif", "e.pgm", "f.pgm", "g.pgm", "h.tga"})
    ExpectRefused(ImportOf(name), "m.toml:", name);
  ExpectRefused(ImportOf("b.png"), "268435456", "b.png");
  ExpectRefused(ImportOf("d.tif"), "60000x60000 pixels, at most 268435456", "d.tif");
  ExpectRefused(ImportOf("g.pgm"), "65536x65536 pixels, at most 268435456", "g.pgm");
  ExpectRefused(ImportOf("h.tga"), "65535x65535 pixels, at most 268435456", "h.tga");
}

// Such a session would lie there, and no index that is built again would take it.
TEST_F(ImportLimits, WhatNoIndexTakesDoesNotBegin) {
  const Image<uint8_t> image(30, 20, 1, 7);
  ASSERT_TRUE(WritePng8(Files() / "ok.png", image.view()).ok());
  const auto import = [&](const std::string& rig, const std::string& exposure) {
    WriteText(Files() / "m.toml", "[import]\nrig = \"" + rig + "\"\nexposure_ms = " + exposure +
                                      "\ncamera_width = 30\ncamera_height = 20\nbit_depth = 8\n"
                                      "projector_width = 64\nprojector_height = 48\n[[file]]\nfile = \"ok.png\"\n"
                                      "pattern = \"white\"\n");
    return Import((Files() / "m.toml").string());
  };
  ExpectRefused(import("a\\u0000b", "1.0"), "rig holds a zero byte", "stratalux-db");
  for (const char* exposure : {"nan", "inf", "-inf", "-1.0"})
    ExpectRefused(import("r", exposure), "exposure_ms", "m.toml");
  EXPECT_EQ(import("r", "1.0").code, 0);
}

TEST_F(ImportLimits, WhatIsWithinThemIsRead) {
  const Image<uint8_t> image(300, 200, 1, 7);
  ASSERT_TRUE(WritePng8(Files() / "ok.png", image.view()).ok());
  const Outcome outcome = ImportOf("ok.png", 300);
  EXPECT_EQ(outcome.code, 0) << outcome.out;
}

}  // namespace
}  // namespace stratalux::db
