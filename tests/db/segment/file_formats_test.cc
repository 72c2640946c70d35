// SPDX-License-Identifier: Apache-2.0
// The worked example of docs/file-formats.md is what the code writes.
#include <cstdio>
#include <sstream>

#include <gmock/gmock.h>

#include "db/segment/delta_planes.h"
#include "db/segment/frame_codec.h"
#include "db/segment/pixel_hash.h"
#include "db/segment/segment.h"
#include "shared/image/raw12.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

// "00000040  46 52 ..  |FR..|": 16 bytes a line; '*' for lines equal to the one above.
std::string HexDump(const std::vector<uint8_t>& bytes) {
  std::string text, previous;
  bool starred = false;
  for (size_t at = 0; at < bytes.size(); at += 16) {
    std::string hex, letters;
    for (size_t i = at; i < std::min(at + 16, bytes.size()); ++i) {
      char digits[8];
      std::snprintf(digits, sizeof digits, " %02x", bytes[i]);
      hex += digits;
      letters += bytes[i] >= 32 && bytes[i] < 127 ? static_cast<char>(bytes[i]) : '.';
    }
    const bool last = at + 16 >= bytes.size();
    if (hex == previous && !last) {
      text += starred ? "" : "*\n";
      starred = true;
      continue;
    }
    starred = false;
    previous = hex;
    char offset[24];
    std::snprintf(offset, sizeof offset, "%08zx ", at);
    hex.resize(48, ' ');
    text += offset + hex + "  |" + letters + "|\n";
  }
  return text;
}

// A sealed segment with one frame of 3 x 2 pixels.
std::vector<uint8_t> ExampleSegment(const std::filesystem::path& file) {
  FrameRecord record;
  record.step = 25;
  record.projector = 1;
  record.phase = CapturePhase::kCorrespondence;
  record.pattern = *Pattern::Parse("gray columns bit=3/10");
  record.trigger_number = 26;
  record.trigger_time = {1'000'000'000};
  record.sync_time = {1'002'000'000};
  record.driver_sequence = 25;
  record.frame_time = {1'018'000'000};
  record.frame_clock = ClockSource::kMonotonic;
  record.exposure_ms = 16.0;
  record.level_check = LevelCheck::kPassed;
  record.mean_dn = 2208.0;
  record.width = 3;
  record.height = 2;
  const uint16_t pixels[6] = {0x123, 0x456, 0x789, 0xabc, 0xdef, 0xfff};
  std::vector<uint8_t> payload(2 * Raw12RowBytes(3));
  PackRaw12Row(pixels, 3, payload.data());
  PackRaw12Row(pixels + 3, 3, payload.data() + Raw12RowBytes(3));
  auto writer = SegmentWriter::Create(file, "s000017-0badcafe");
  EXPECT_TRUE(writer.ok()) << writer.status().message();
  FrameHeader header = MakeFrameHeader(record, 0, record.pattern.ToString());
  SetPixelHash(header, HashPixels(record.format, pixels, nullptr));
  EXPECT_TRUE(writer->Append(header, Codec::kRaw12, payload).ok());
  EXPECT_TRUE(writer->Seal().ok());
  return ReadBytes(file);
}

using FileFormats = StoreTest;

TEST_F(FileFormats, TheWorkedExampleIsWhatTheCodeWrites) {
  const std::string dump = HexDump(ExampleSegment(folder_ / "frames-0001.seg"));
  const auto page = ReadBytes(std::string(STRATALUX_SOURCE_DIR) + "/docs/file-formats.md");
  EXPECT_NE(std::string(page.begin(), page.end()).find(dump), std::string::npos) << dump;
}

TEST_F(FileFormats, TheWorkedExampleReadsBack) {
  const auto bytes = ExampleSegment(folder_ / "frames-0001.seg");
  const auto reader = SegmentReader::Open(folder_ / "frames-0001.seg");
  ASSERT_TRUE(reader.ok()) << reader.status().message();
  EXPECT_EQ(reader->session_id(), "s000017-0badcafe");
  bool sealed = false;
  const auto frames = reader->Walk(true, &sealed);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  EXPECT_TRUE(sealed);
  ASSERT_EQ(frames->size(), 1U);
  EXPECT_EQ((*frames)[0].offset, 64);
  // MIPI RAW12, by hand: 123 456 -> 12 45 63; a last 789 -> 78 09.
  const std::vector<uint8_t> row = {0x12, 0x45, 0x63, 0x78, 0x09};
  EXPECT_TRUE(std::equal(row.begin(), row.end(), bytes.begin() + 64 + 320));
}

// The bytes of the page's ```hex block.
std::vector<uint8_t> BytesOnThePage() {
  const auto page = ReadBytes(std::string(STRATALUX_SOURCE_DIR) + "/docs/file-formats.md");
  const std::string text(page.begin(), page.end()), fence = "```hex\n";
  const size_t start = text.find(fence);
  if (start == std::string::npos) return {};
  std::istringstream block(text.substr(start + fence.size(), text.find("```", start + 3) - start - fence.size()));
  std::vector<uint8_t> bytes;
  for (unsigned byte = 0; block >> std::hex >> byte;) bytes.push_back(static_cast<uint8_t>(byte));
  return bytes;
}

TEST_F(FileFormats, TheWorkedExampleOfDeltaIsReadFromThePage) {
  const FrameShape shape{PixelFormat::kMono12, Cfa::kRggb, 16, 4, 1};
  Image<uint16_t> pixels(16, 4);
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 16; ++x) pixels(x, y) = static_cast<uint16_t>(0x100 * (1 + y % 2 + x % 2));
  pixels(5, 2) = 0x2ff;
  const auto payload = BytesOnThePage();
  ASSERT_EQ(payload.size(), 39U);
  const auto image = FrameDecoder().Decode(shape, Codec::kDelta, payload);
  ASSERT_TRUE(image.ok()) << image.status().message();
  EXPECT_TRUE(std::equal(pixels.pixels().begin(), pixels.pixels().end(), image->pixels().begin()));
  // The planes, by the page's words: all zero but these.
  std::vector<uint8_t> planes(128), expected(128);
  SplitPlanes(shape, std::as_const(pixels).pixels(), planes);
  expected[2 * 16 + 5] = 0xfe;
  expected[64 + 2 * 16 + 5] = 0x01;
  expected[2 * 16 + 7] = 0xff;
  expected[64] = 0x02;
  expected[64 + 1] = expected[64 + 16] = 0x04;
  expected[64 + 17] = 0x06;
  EXPECT_EQ(planes, expected);
}

}  // namespace
}  // namespace stratalux::db
