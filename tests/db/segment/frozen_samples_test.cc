// SPDX-License-Identifier: Apache-2.0
// Segments that a released program wrote are read for ever. tests/db/samples/ is never regenerated: a new version adds
// a file of its own (--gtest_also_run_disabled_tests --gtest_filter='*Write*' makes one, and prints its table).
#include <cstdio>

#include <gtest/gtest.h>
#include <xxhash.h>

#include "db/segment/frame_codec.h"
#include "db/segment/segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

struct Expected {
  Codec codec;
  PixelFormat format;
  Cfa cfa;
  int width, height, channels;
  const char* pixels;  // XXH3-128 of the decoded samples: 16 bits, little-endian, rows top to bottom
};
constexpr Expected kSegmentV1[] = {
    {Codec::kRaw8, PixelFormat::kMono8, Cfa::kMono, 9, 4, 1, "f82b0ddae2847a4432e8f711197b966b"},
    {Codec::kRaw12, PixelFormat::kMono12, Cfa::kRggb, 7, 5, 1, "601cae17b03e3257823de5986c1f390a"},
    {Codec::kRaw16, PixelFormat::kMono16, Cfa::kMono, 5, 3, 3, "4fdd4d302a2ac61347523fedb916368b"},
    {Codec::kDelta, PixelFormat::kMono8, Cfa::kGrbg, 31, 20, 1, "a5900f4dc302d25a95eae149f50956b9"},
    {Codec::kDelta, PixelFormat::kMono12, Cfa::kRggb, 31, 20, 1, "3ad3dd001aaa211d9ce05116fa7b2f83"},
    {Codec::kDelta, PixelFormat::kMono12, Cfa::kGbrg, 32, 21, 1, "5a42da90134348a7be97da9f8694ec41"},
    {Codec::kDelta, PixelFormat::kMono16, Cfa::kMono, 20, 17, 3, "5f3dc58f6ac30602976937e3384ceea8"}};

std::string HashOf(const Image<uint16_t>& image) {
  uint8_t digest[16];
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(image.data(), image.size() * 2));
  std::copy(std::begin(canonical.digest), std::end(canonical.digest), digest);
  return HashText(digest);
}

TEST(FrozenSamples, SegmentVersion1IsReadForEver) {
  const auto reader = SegmentReader::Open(STRATALUX_SOURCE_DIR "/tests/db/samples/segment-v1.seg");
  ASSERT_TRUE(reader.ok()) << reader.status().message();
  EXPECT_EQ(reader->session_id(), "s000017-0badcafe");
  bool sealed = false;
  const auto frames = reader->Walk(true, &sealed);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  EXPECT_TRUE(sealed);
  ASSERT_EQ(frames->size(), std::size(kSegmentV1));
  FrameDecoder decoder;
  for (size_t i = 0; i < frames->size(); ++i) {
    SCOPED_TRACE(i);
    const Expected& e = kSegmentV1[i];
    FrameHeader header{};
    const auto payload = reader->Read((*frames)[i].offset, &header);
    ASSERT_TRUE(payload.ok()) << payload.status().message();
    const auto record = RecordOf(header);
    ASSERT_TRUE(record.ok()) << record.status().message();
    EXPECT_EQ(record->trigger_number, 1000 + static_cast<int64_t>(i));
    EXPECT_EQ(record->pattern.ToString(), "gray rows bit=3/10 inverse");
    EXPECT_EQ(static_cast<Codec>(header.codec), e.codec);
    EXPECT_EQ(record->format, e.format);
    EXPECT_EQ(record->cfa, e.cfa);
    const auto image = decoder.Decode(ShapeOf(header), e.codec, *payload);
    ASSERT_TRUE(image.ok()) << image.status().message();
    EXPECT_EQ(image->width(), e.width);
    EXPECT_EQ(image->height(), e.height);
    EXPECT_EQ(image->channels(), e.channels);
    EXPECT_EQ(HashOf(*image), e.pixels);
  }
}

TEST(FrozenSamples, DISABLED_Write) {
  std::string folder = (std::filesystem::temp_directory_path() / "segment-new-XXXXXX").string();
  ASSERT_NE(mkdtemp(folder.data()), nullptr);
  const auto file = std::filesystem::path(folder) / "segment-new.seg";
  auto writer = SegmentWriter::Create(file, "s000017-0badcafe");
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  int step = 0;
  for (const Expected& e : kSegmentV1) {
    FrameRecord record = RecordFor(step, e.format, e.width, e.height, e.channels);
    record.cfa = e.cfa;
    Image<uint16_t> image = PixelsFor(record);
    if (e.codec == Codec::kDelta)  // what delta shrinks
      for (size_t i = 0; i < image.size(); ++i)
        image.data()[i] = static_cast<uint16_t>(90 + image.data()[i] % 13 + i / 40);
    FrameEncoder encoder(e.codec == Codec::kDelta ? StoreCodec::kDelta : StoreCodec::kRaw12);
    const auto header = MakeFrameHeader(record, step++, record.pattern.ToString());
    const auto encoded = encoder.Encode(ShapeOf(header), std::as_const(image).pixels());
    ASSERT_TRUE(encoded.ok());
    ASSERT_EQ(encoded->codec, e.codec);
    ASSERT_TRUE(writer->Append(header, encoded->codec, encoded->bytes).ok());
    std::printf("%s %s\n", ToString(encoded->codec), HashOf(image).c_str());
  }
  ASSERT_TRUE(writer->Seal().ok());
}

}  // namespace
}  // namespace stratalux::db
