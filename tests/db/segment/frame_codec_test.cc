// SPDX-License-Identifier: Apache-2.0
// Every frame comes back sample by sample; whatever else the decoder is given, it says so.
#include "db/segment/frame_codec.h"

#include <functional>
#include <random>
#include <string>

#include <gtest/gtest.h>

namespace stratalux::db {
namespace {

using Fill = std::function<unsigned(unsigned top, int x, int y, std::mt19937& random)>;

const std::vector<std::pair<std::string, Fill>> kContents = {
    {"noise over all bits", [](unsigned top, int, int, std::mt19937& r) { return r() & top; }},
    {"noise of a few digital numbers", [](unsigned top, int, int, std::mt19937& r) { return top / 3 + r() % 13; }},
    {"black", [](unsigned, int, int, std::mt19937&) { return 0U; }},
    {"saturated", [](unsigned top, int, int, std::mt19937&) { return top; }},
    {"black and saturated", [](unsigned top, int x, int y, std::mt19937&) { return (x / 3 + y) % 2 ? top : 0U; }},
    {"ramp along rows", [](unsigned top, int x, int, std::mt19937&) { return static_cast<unsigned>(x * 7) & top; }},
    {"ramp along columns", [](unsigned top, int, int y, std::mt19937&) { return static_cast<unsigned>(y * 9) & top; }}};

struct Side {
  int width, height;
};
constexpr Side kSides[] = {{1, 1}, {1, 37}, {37, 1}, {2, 2}, {3, 5}, {64, 48}, {65, 47}, {131, 3}};

std::vector<uint16_t> Make(const FrameShape& shape, const Fill& fill) {
  const unsigned top = (1U << BitDepth(shape.format)) - 1U;
  std::mt19937 random(7);
  std::vector<uint16_t> samples;
  for (int y = 0; y < shape.height; ++y)
    for (int x = 0; x < shape.width * shape.channels; ++x)
      samples.push_back(static_cast<uint16_t>(std::min(top, fill(top, x, y, random))));
  return samples;
}

// Of `shape`, or the reason why not.
std::string RoundTrip(FrameEncoder& encoder, FrameDecoder& decoder, const FrameShape& shape,
                      const std::vector<uint16_t>& samples) {
  const auto encoded = encoder.Encode(shape, std::span<const uint16_t>(samples));
  if (!encoded.ok()) return encoded.status().message();
  if (encoded->codec == Codec::kDelta && encoded->bytes.size() >= RawBytes(shape, RawCodec(shape)))
    return "delta that is not smaller than raw";
  const auto image = decoder.Decode(shape, encoded->codec, encoded->bytes);
  if (!image.ok()) return image.status().message();
  const bool same = image->width() == shape.width && image->height() == shape.height &&
                    image->channels() == shape.channels &&
                    std::equal(samples.begin(), samples.end(), image->pixels().begin(), image->pixels().end());
  return same ? "" : "other samples";
}

TEST(FrameCodec, GivesBackEveryFrameOfEveryFormatFilterArrayAndSize) {
  FrameDecoder decoder;
  int frames = 0;
  for (const StoreCodec codec : {StoreCodec::kRaw12, StoreCodec::kDelta}) {
    FrameEncoder encoder(codec);  // one for all: what an earlier frame leaves in its buffers must not matter
    for (const PixelFormat format : {PixelFormat::kMono8, PixelFormat::kMono12, PixelFormat::kMono16})
      for (int cfa = 0; cfa <= 4; ++cfa)
        for (const Side side : kSides)
          for (const int channels : {1, 3})
            for (const auto& [name, fill] : kContents) {
              const FrameShape shape{format, static_cast<Cfa>(cfa), side.width, side.height, channels};
              ASSERT_EQ(RoundTrip(encoder, decoder, shape, Make(shape, fill)), "")
                  << name << ", " << BitDepth(format) << " bits, cfa " << cfa << ", " << side.width << " x "
                  << side.height << " x " << channels;
              ++frames;
            }
  }
  EXPECT_EQ(frames, 2 * 3 * 5 * 8 * 2 * 7);
}

TEST(FrameCodec, EightBitSamplesComeBackWidened) {
  const FrameShape shape{PixelFormat::kMono8, Cfa::kRggb, 61, 40, 1};
  std::vector<uint8_t> samples(shape.samples());
  for (size_t i = 0; i < samples.size(); ++i) samples[i] = static_cast<uint8_t>(i / 50);
  for (const StoreCodec codec : {StoreCodec::kRaw12, StoreCodec::kDelta}) {
    FrameEncoder encoder(codec);
    const auto encoded = encoder.Encode(shape, std::span<const uint8_t>(samples));
    ASSERT_TRUE(encoded.ok()) << encoded.status().message();
    EXPECT_EQ(encoded->codec, codec == StoreCodec::kDelta ? Codec::kDelta : Codec::kRaw8);
    const auto image = FrameDecoder().Decode(shape, encoded->codec, encoded->bytes);
    ASSERT_TRUE(image.ok()) << image.status().message();
    EXPECT_TRUE(std::equal(samples.begin(), samples.end(), image->pixels().begin(), image->pixels().end()));
  }
}

TEST(FrameCodec, StoresRawWhatDeltaDoesNotShrinkAndSaysSo) {
  FrameEncoder encoder(StoreCodec::kDelta);
  const struct {
    PixelFormat format;
    int channels;
    Codec raw;
  } cases[] = {{PixelFormat::kMono8, 1, Codec::kRaw8},
               {PixelFormat::kMono12, 1, Codec::kRaw12},
               {PixelFormat::kMono12, 3, Codec::kRaw16},
               {PixelFormat::kMono16, 1, Codec::kRaw16}};
  for (const auto& c : cases) {
    const FrameShape shape{c.format, Cfa::kMono, 64, 64, c.channels};
    const auto flat = Make(shape, kContents[3].second), noise = Make(shape, kContents[0].second);
    EXPECT_EQ(encoder.Encode(shape, std::span<const uint16_t>(flat))->codec, Codec::kDelta);
    const Codec stored = encoder.Encode(shape, std::span<const uint16_t>(noise))->codec;
    // 12 bits of noise in 16-bit samples shrink even so.
    EXPECT_EQ(stored, c.channels == 3 ? Codec::kDelta : c.raw) << BitDepth(c.format);
  }
}

TEST(FrameCodec, RefusesSamplesThatAreNotOfTheFormat) {
  FrameEncoder encoder(StoreCodec::kDelta);
  FrameShape shape{PixelFormat::kMono12, Cfa::kRggb, 4, 4, 1};
  std::vector<uint16_t> samples(16, 4095);
  EXPECT_TRUE(encoder.Encode(shape, std::span<const uint16_t>(samples)).ok());
  samples[11] = 4096;
  const Status over = encoder.Encode(shape, std::span<const uint16_t>(samples)).status();
  EXPECT_EQ(over.code(), StatusCode::kUsage);
  EXPECT_EQ(over.message(), "value 4096 exceeds 12 bits");
  samples.pop_back();
  samples[11] = 0;
  EXPECT_EQ(encoder.Encode(shape, std::span<const uint16_t>(samples)).status().code(), StatusCode::kUsage);
  const std::vector<uint8_t> narrow(16);
  EXPECT_EQ(encoder.Encode(shape, std::span<const uint8_t>(narrow)).status().code(), StatusCode::kUsage);
}

class Damage : public ::testing::Test {
 protected:
  void SetUp() override {
    std::mt19937 random(3);
    for (size_t i = 0; i < shape_.samples(); ++i)
      samples_.push_back(static_cast<uint16_t>(600 + 20 * (i % 2) + random() % 9 + (random() % 50 == 0 ? 3000 : 0)));
    FrameEncoder encoder(StoreCodec::kDelta);
    const auto encoded = encoder.Encode(shape_, std::span<const uint16_t>(samples_));
    ASSERT_TRUE(encoded.ok());
    ASSERT_EQ(encoded->codec, Codec::kDelta);
    payload_.assign(encoded->bytes.begin(), encoded->bytes.end());
  }
  // True where the decoder refuses the bytes; anything but the identical frame is a failure.
  bool Refused(std::span<const uint8_t> bytes) {
    const auto image = decoder_.Decode(shape_, Codec::kDelta, bytes);
    if (!image.ok()) {
      EXPECT_EQ(image.status().code(), StatusCode::kIntegrity) << image.status().message();
      return true;
    }
    EXPECT_TRUE(std::equal(samples_.begin(), samples_.end(), image->pixels().begin(), image->pixels().end()));
    return false;
  }

  const FrameShape shape_{PixelFormat::kMono12, Cfa::kRggb, 48, 30, 1};
  std::vector<uint16_t> samples_;
  std::vector<uint8_t> payload_;
  FrameDecoder decoder_;
};

TEST_F(Damage, EveryTruncationIsRefused) {
  for (size_t length = 0; length < payload_.size(); ++length)
    ASSERT_TRUE(Refused(std::span<const uint8_t>(payload_).first(length))) << length;
  EXPECT_FALSE(Refused(payload_));
}

TEST_F(Damage, BytesBehindTheEndAreRefused) {
  payload_.push_back(0);
  EXPECT_TRUE(Refused(payload_));
}

TEST_F(Damage, EveryFlippedByteIsRefusedOrChangesNothing) {
  size_t refused = 0, tried = 0;
  for (size_t at = 0; at < payload_.size(); ++at)
    for (const unsigned mask : {0x01U, 0x02U, 0x04U, 0x08U, 0x10U, 0x20U, 0x40U, 0x80U, 0xffU}) {
      payload_[at] = static_cast<uint8_t>(payload_[at] ^ mask);
      refused += Refused(payload_) ? 1 : 0;
      ++tried;
      payload_[at] = static_cast<uint8_t>(payload_[at] ^ mask);
    }
  // zstd leaves some bits of its headers and tables unused; nearly all others count.
  EXPECT_GT(refused, tried / 100 * 99);
}

TEST_F(Damage, ForeignBytesAreRefused) {
  std::mt19937 random(11);
  for (int i = 0; i < 2000; ++i) {
    std::vector<uint8_t> bytes(random() % 400);
    for (uint8_t& b : bytes) b = static_cast<uint8_t>(random());
    if (i % 2 == 0 && bytes.size() > 12) std::copy_n(payload_.begin(), 10, bytes.begin());  // a header of ours
    ASSERT_TRUE(Refused(bytes)) << i;
  }
}

TEST_F(Damage, AShapeThatIsNotThePayloadsIsRefused) {
  const auto code = [&](FrameShape shape, Codec codec) {
    return decoder_.Decode(shape, codec, payload_).status().code();
  };
  for (const int width : {-1, 0, 1, 47, 49, 65536, 1 << 30}) {
    FrameShape other = shape_;
    other.width = width;
    EXPECT_EQ(code(other, Codec::kDelta), StatusCode::kIntegrity) << width;
    EXPECT_EQ(code(other, Codec::kRaw12), StatusCode::kIntegrity) << width;
  }
  FrameShape vast = shape_;
  vast.width = vast.height = 65536;
  vast.channels = 64;
  EXPECT_EQ(code(vast, Codec::kDelta), StatusCode::kIntegrity);
  FrameShape narrow = shape_;
  narrow.format = PixelFormat::kMono8;
  EXPECT_EQ(code(narrow, Codec::kDelta), StatusCode::kIntegrity) << "values above 8 bits";
  EXPECT_EQ(code(shape_, Codec::kF32), StatusCode::kIntegrity);
  EXPECT_EQ(code(shape_, static_cast<Codec>(0)), StatusCode::kIntegrity);
  EXPECT_EQ(code(shape_, static_cast<Codec>(6)), StatusCode::kNewerSchema);
}

}  // namespace
}  // namespace stratalux::db
