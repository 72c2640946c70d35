// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/raw_unpack.h"

#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/camera/raw_format.h"

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;

std::vector<uint16_t> Unpack(const RawFormat& format, const std::vector<uint8_t>& bytes, int width, int height,
                             size_t stride) {
  const auto image = UnpackRaw(bytes, format, width, height, stride);
  EXPECT_TRUE(image.ok()) << image.status().message();
  if (!image.ok()) return {};
  return {image->pixels().begin(), image->pixels().end()};
}

TEST(UnpackRaw, BytesGoToTheUpperBitsOfTwelve) {
  EXPECT_THAT(Unpack({8, RawPacking::kBytes}, {0, 1, 255}, 3, 1, 3), ElementsAre(0, 16, 4080));
}

TEST(UnpackRaw, TenBitWordsGoToTheUpperBitsOfTwelve) {
  EXPECT_THAT(Unpack({10, RawPacking::kWords}, {0xff, 0x03, 0x01, 0x00}, 2, 1, 4), ElementsAre(4092, 4));
}

TEST(UnpackRaw, TwelveBitWordsStay) {
  EXPECT_THAT(Unpack({12, RawPacking::kWords}, {0xff, 0x0f, 0x34, 0x02}, 2, 1, 4), ElementsAre(4095, 0x234));
}

TEST(UnpackRaw, BitsAboveTheFormatsAreCutOff) {
  EXPECT_THAT(Unpack({12, RawPacking::kWords}, {0x34, 0xf2}, 1, 1, 2), ElementsAre(0x234));
  EXPECT_THAT(Unpack({10, RawPacking::kWords}, {0x01, 0xfc}, 1, 1, 2), ElementsAre(4));
}

TEST(UnpackRaw, SixteenBitWordsInEitherOrder) {
  EXPECT_THAT(Unpack({16, RawPacking::kWords}, {0x34, 0x12}, 1, 1, 2), ElementsAre(0x1234));
  EXPECT_THAT(Unpack({16, RawPacking::kWordsBig}, {0x12, 0x34}, 1, 1, 2), ElementsAre(0x1234));
}

// MIPI RAW10: byte 4 holds the low bits, the first sample's in bits 1..0.
TEST(UnpackRaw, PackedTens) {
  const std::vector<uint8_t> bytes = {0x00, 0x40, 0x80, 0xff, 0b11'10'01'00};
  EXPECT_THAT(Unpack({10, RawPacking::kMipi10}, bytes, 4, 1, 5),
              ElementsAre(0, (0x40 * 4 + 1) * 4, (0x80 * 4 + 2) * 4, 1023 * 4));
}

TEST(UnpackRaw, ARowOfPackedTensMayEndInsideAGroup) {
  EXPECT_EQ(RowBytes({10, RawPacking::kMipi10}, 5), 10U);
  const std::vector<uint8_t> bytes = {1, 2, 3, 4, 0, 0xff, 0, 0, 0, 3};
  EXPECT_THAT(Unpack({10, RawPacking::kMipi10}, bytes, 5, 1, 10), ElementsAre(16, 32, 48, 64, 4092));
}

// MIPI RAW12: byte 2 holds the low nibbles, the first sample's in bits 3..0.
TEST(UnpackRaw, PackedTwelves) {
  EXPECT_THAT(Unpack({12, RawPacking::kMipi12}, {0x12, 0xab, 0xc3}, 2, 1, 3), ElementsAre(0x123, 0xabc));
}

TEST(UnpackRaw, PaddingAtTheEndOfRowsIsSkipped) {
  EXPECT_THAT(Unpack({8, RawPacking::kBytes}, {1, 2, 99, 3, 4, 99}, 2, 2, 3), ElementsAre(16, 32, 48, 64));
  // The last row needs none.
  EXPECT_THAT(Unpack({8, RawPacking::kBytes}, {1, 2, 99, 3, 4}, 2, 2, 3), ElementsAre(16, 32, 48, 64));
}

TEST(UnpackRaw, AShortBufferIsRefused) {
  const std::vector<uint8_t> bytes(15);
  EXPECT_EQ(UnpackRaw(bytes, {12, RawPacking::kWords}, 4, 2, 8).status().code(), StatusCode::kIntegrity);
  EXPECT_EQ(UnpackRaw(bytes, {8, RawPacking::kBytes}, 4, 2, 3).status().code(), StatusCode::kIntegrity)
      << "rows closer than they are long";
}

TEST(RawFormat, FourccsAreReadAsV4l2WritesThem) {
  EXPECT_EQ(FourccText(0x20323159), "Y12");
  EXPECT_EQ(FourccText(0x32314742), "BG12");
  EXPECT_EQ(FourccText(0x80000000U | 0x20363159), "Y16-BE");
  EXPECT_FALSE(RawFormatOf("YUYV").has_value());
}

// Mosaics whose FourCC says the order in a way of its own.
TEST(RawFormat, MosaicsKnowTheirOrder) {
  EXPECT_EQ(RawFormatOf("BA10")->cfa, Cfa::kGrbg);
  EXPECT_EQ(RawFormatOf("BA81")->cfa, Cfa::kBggr);
  EXPECT_EQ(RawFormatOf("BYR2")->cfa, Cfa::kBggr);
  EXPECT_EQ(RawFormatOf("pgCC")->cfa, Cfa::kGrbg);
  EXPECT_EQ(RawFormatOf("pgCC")->packing, RawPacking::kMipi12);
  EXPECT_EQ(RawFormatOf("RG12")->pixel_format(), PixelFormat::kMono12);
  EXPECT_EQ(RawFormatOf("RG16")->pixel_format(), PixelFormat::kMono16);
}

// Sensors of few bits never reach the 4095 of the numbers that their samples are moved to.
TEST(UnpackRaw, TheHighestSampleIsTheFormatsFullScale) {
  const std::vector<uint8_t> ones(64, 0xff);
  for (const auto& [name, full_dn] : {std::pair{"GREY", 4080.0}, {"Y10", 4092.0}, {"Y12", 4095.0}, {"Y16", 65535.0}}) {
    const auto format = RawFormatOf(name);
    ASSERT_TRUE(format.has_value()) << name;
    EXPECT_EQ(format->FullScaleDn(), full_dn) << name;
    const auto image = UnpackRaw(ones, *format, 4, 1, RowBytes(*format, 4));
    ASSERT_TRUE(image.ok()) << image.status().message();
    EXPECT_EQ((*image)(1, 0), full_dn) << name;
  }
}

}  // namespace
}  // namespace stratalux::rig
