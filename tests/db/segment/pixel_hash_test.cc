// SPDX-License-Identifier: Apache-2.0
// The pixel hash is of what a frame shows, whatever its codec; the page of formats says of which bytes.
#include "db/segment/pixel_hash.h"

#include <cstring>

#include <gtest/gtest.h>
#include <sodium.h>
#include <xxhash.h>

#include "db/segment/frame_codec.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

PixelHash Xxh3Of(const std::vector<uint8_t>& bytes) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(bytes.data(), bytes.size()));
  PixelHash hash;
  std::memcpy(hash.data(), canonical.digest, hash.size());
  return hash;
}

TEST(PixelHash, IsOfTheSamplesAtTheFormatsOwnWidth) {
  const std::vector<uint16_t> samples = {0x12, 0x34, 0xfe};
  EXPECT_EQ(HashPixels(PixelFormat::kMono8, samples, nullptr), Xxh3Of({0x12, 0x34, 0xfe}));
  EXPECT_EQ(HashPixels(PixelFormat::kMono12, samples, nullptr), Xxh3Of({0x12, 0, 0x34, 0, 0xfe, 0}));
  EXPECT_EQ(HashPixels(PixelFormat::kMono16, samples, nullptr), Xxh3Of({0x12, 0, 0x34, 0, 0xfe, 0}));
  const std::vector<uint8_t> bytes = {0x12, 0x34, 0xfe};
  EXPECT_EQ(HashPixels(bytes, nullptr), Xxh3Of(bytes)) << "8-bit samples that were never widened";
}

TEST(PixelHash, IsTheSameForEveryCodec) {
  FrameDecoder decoder;
  for (const PixelFormat format : {PixelFormat::kMono8, PixelFormat::kMono12, PixelFormat::kMono16}) {
    const FrameShape shape{format, Cfa::kRggb, 40, 30, 1};
    Image<uint16_t> image(40, 30);
    for (size_t i = 0; i < image.size(); ++i) image.data()[i] = static_cast<uint16_t>(60 + i % 7 + i / 90);
    const PixelHash hash = HashPixels(format, std::as_const(image).pixels(), nullptr);
    FrameHeader header{};
    header.format = static_cast<uint16_t>(format);
    SetPixelHash(header, hash);
    for (const StoreCodec codec : {StoreCodec::kRaw12, StoreCodec::kDelta}) {
      FrameEncoder encoder(codec);
      const auto encoded = encoder.Encode(shape, std::as_const(image).pixels());
      ASSERT_TRUE(encoded.ok()) << encoded.status().message();
      EXPECT_EQ(encoded->codec == Codec::kDelta, codec == StoreCodec::kDelta);
      const auto decoded = decoder.Decode(shape, encoded->codec, encoded->bytes);
      ASSERT_TRUE(decoded.ok()) << decoded.status().message();
      EXPECT_TRUE(CheckPixels(header, *decoded, nullptr).ok());
    }
  }
}

TEST(PixelHash, OfAnEncryptedSessionNeedsItsKey) {
  SecretKey key, other;
  for (size_t i = 0; i < key.bytes.size(); ++i) key.bytes[i] = static_cast<uint8_t>(i);
  const std::vector<uint16_t> samples = {1, 2, 3};
  const PixelHash hash = HashPixels(PixelFormat::kMono12, samples, &key);
  const std::vector<uint8_t> bytes = {1, 0, 2, 0, 3, 0};
  PixelHash blake{};
  ASSERT_EQ(crypto_generichash(blake.data(), 16, bytes.data(), bytes.size(), key.bytes.data(), 32), 0);
  EXPECT_EQ(hash, blake) << "keyed BLAKE2b with 16 bytes of output";
  EXPECT_NE(hash, HashPixels(PixelFormat::kMono12, samples, &other));
  EXPECT_NE(hash, HashPixels(PixelFormat::kMono12, samples, nullptr));
}

TEST(PixelHash, OneChangedSampleIsRefusedAndAMissingHashIsNot) {
  const FrameRecord record = RecordFor(0, PixelFormat::kMono12, 6, 4);
  Image<uint16_t> image = PixelsFor(record);
  FrameHeader header = MakeFrameHeader(record, 7, "white");
  EXPECT_FALSE(HasPixelHash(header));
  EXPECT_TRUE(CheckPixels(header, image, nullptr).ok()) << "not recorded: nothing to compare";
  SetPixelHash(header, HashPixels(record.format, std::as_const(image).pixels(), nullptr));
  EXPECT_TRUE(HasPixelHash(header));
  for (uint16_t& v : image.pixels()) {
    v ^= 1U;
    EXPECT_EQ(CheckPixels(header, image, nullptr).code(), StatusCode::kIntegrity);
    v ^= 1U;
  }
  EXPECT_TRUE(CheckPixels(header, image, nullptr).ok());
}

}  // namespace
}  // namespace stratalux::db
