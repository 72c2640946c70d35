// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "shared/image/png.h"
#include "shared/image/raw12.h"
#include "tests/support/png_rgba.h"
#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

TEST(Raw12, PacksAsMipiDoes) {
  const uint16_t pixels[3] = {0xABC, 0x123, 0xFED};
  uint8_t bytes[5] = {};
  ASSERT_EQ(Raw12RowBytes(3), 5U);
  PackRaw12Row(pixels, 3, bytes);
  const uint8_t expected[5] = {0xAB, 0x12, 0x3C, 0xFE, 0x0D};
  for (int i = 0; i < 5; ++i) EXPECT_EQ(bytes[i], expected[i]) << i;
}

TEST(Raw12, UnpackInvertsPackForAnyWidth) {
  Random random(3);
  for (int width = 1; width < 70; ++width) {
    std::vector<uint16_t> pixels(width), back(width);
    for (auto& p : pixels) p = static_cast<uint16_t>(random.Bits() & 4095U);
    std::vector<uint8_t> bytes(Raw12RowBytes(width));
    PackRaw12Row(pixels.data(), width, bytes.data());
    UnpackRaw12Row(bytes.data(), width, back.data());
    EXPECT_EQ(back, pixels);
  }
}

class PngFile : public ScratchFolderTest {
 protected:
  std::filesystem::path file_ = folder_ / "picture.png";
};

TEST_F(PngFile, KeepsAlphaOfEightBitsAndNoneOfSixteen) {
  for (int channels : {2, 4}) {
    Image<uint8_t> a(5, 4, channels);
    for (size_t i = 0; i < a.size(); ++i) a.pixels()[i] = static_cast<uint8_t>(i * 3);
    ASSERT_TRUE(WritePng8(file_, a).ok());
    const Image<uint8_t> read = ReadPngRgba(file_);
    for (int y = 0; y < 4; ++y)
      for (int x = 0; x < 5; ++x) {
        for (int c = 0; c < 3; ++c) EXPECT_EQ(read(x, y, c), a(x, y, channels == 2 ? 0 : c));
        EXPECT_EQ(read(x, y, 3), a(x, y, channels - 1));
      }
    EXPECT_EQ(WritePng16(file_, Image<uint16_t>(5, 4, channels)).code(), StatusCode::kFailed);
  }
}

TEST_F(PngFile, KeepsEverySampleAtBothDepths) {
  for (int channels : {1, 3}) {
    Image<uint8_t> a(5, 4, channels);
    Image<uint16_t> b(5, 4, channels);
    for (size_t i = 0; i < a.size(); ++i) {
      a.pixels()[i] = static_cast<uint8_t>(i * 13);
      b.pixels()[i] = static_cast<uint16_t>(i * 1097);
    }
    int depth = 0;
    ASSERT_TRUE(WritePng8(file_, a).ok());
    auto read = ReadPng(file_, &depth);
    ASSERT_TRUE(read.ok()) << read.status().message();
    EXPECT_EQ(depth, 8);
    ASSERT_EQ(read->channels(), channels);
    for (size_t i = 0; i < a.size(); ++i) EXPECT_EQ(read->pixels()[i], a.pixels()[i]);
    ASSERT_TRUE(WritePng16(file_, b).ok());
    read = ReadPng(file_, &depth);
    ASSERT_TRUE(read.ok()) << read.status().message();
    EXPECT_EQ(depth, 16);
    for (size_t i = 0; i < b.size(); ++i) EXPECT_EQ(read->pixels()[i], b.pixels()[i]);
  }
}

TEST_F(PngFile, NamesMissingForeignAndTruncatedFiles) {
  EXPECT_EQ(ReadPng(file_, nullptr).status().code(), StatusCode::kNotFound);
  std::ofstream(file_) << "this is no picture";
  EXPECT_EQ(ReadPng(file_, nullptr).status().code(), StatusCode::kUsage);
  ASSERT_TRUE(WritePng8(file_, Image<uint8_t>(64, 64, 1, 7)).ok());
  const auto size = std::filesystem::file_size(file_);
  for (uintmax_t keep = 8; keep < size; keep += 11) {
    ASSERT_TRUE(WritePng8(file_, Image<uint8_t>(64, 64, 1, 7)).ok());
    std::filesystem::resize_file(file_, keep);
    const auto read = ReadPng(file_, nullptr);
    EXPECT_EQ(read.status().code(), StatusCode::kIntegrity) << keep;
    EXPECT_NE(read.status().message().find(file_.string()), std::string::npos);
  }
}

TEST_F(PngFile, ClaimsOfMorePixelsThanTheFileCanHoldGetNoMemory) {
  // Signature and header of 60000 x 60000 pixels of 16 bits, then nothing: 7 GB that deflate cannot make of 41 bytes.
  constexpr char kHeader[] =
      "\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\xea\x60\0\0\xea\x60\x10\0\0\0\0\xf5\x29\xf6\xdd\0\0\0\0IDAT";
  std::ofstream(file_, std::ios::binary).write(kHeader, sizeof kHeader - 1);
  const auto read = ReadPng(file_, nullptr);
  EXPECT_EQ(read.status().code(), StatusCode::kIntegrity);
  EXPECT_NE(read.status().message().find("truncated"), std::string::npos) << read.status().message();
}

TEST_F(PngFile, AFolderIsNoPicture) {
  const auto read = ReadPng(file_.parent_path(), nullptr);
  EXPECT_FALSE(read.ok());
}

}  // namespace
}  // namespace stratalux
