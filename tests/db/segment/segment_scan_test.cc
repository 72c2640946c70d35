// SPDX-License-Identifier: Apache-2.0
// What is whole in a damaged segment is found, and what is not is named, byte by byte.
#include "db/segment/segment_scan.h"

#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <functional>

#include <gmock/gmock.h>
#include <xxhash.h>

#include "db/segment/frame_codec.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::IsSupersetOf;

constexpr int64_t kFrameBytes = 320 + 36;

class SegmentScanTest : public StoreTest {
 protected:
  enum class End { kSealed, kOpen };
  // Frames 0 .. 5 of 36 bytes each.
  void Write(End end) {
    std::filesystem::remove(file_ = folder_ / "frames-0001.seg");
    auto writer = SegmentWriter::Create(file_, "s000001-0badcafe");
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    FrameEncoder encoder(StoreCodec::kRaw12);
    for (int i = 0; i < 6; ++i) {
      const FrameRecord record = RecordFor(i, PixelFormat::kMono12, 6, 4);
      const auto pixels = PixelsFor(record);
      const auto encoded = encoder.Encode({record.format, record.cfa, 6, 4, 1}, pixels.pixels());
      ASSERT_TRUE(writer->Append(MakeFrameHeader(record, i, "white"), encoded->codec, encoded->bytes).ok());
    }
    ASSERT_TRUE((end == End::kSealed ? writer->Seal() : writer->Sync()).ok());
  }
  [[nodiscard]] SegmentScan Scan(const std::vector<KnownPlace>& known = {}) const {
    Status header;
    const auto reader = SegmentReader::OpenDamaged(file_, &header);
    EXPECT_TRUE(reader.ok()) << reader.status().message();
    return ScanSegment(*reader, known);
  }
  [[nodiscard]] static std::vector<int64_t> Numbers(const SegmentScan& scan) {
    std::vector<int64_t> numbers;
    for (const SegmentFrame& f : scan.frames) numbers.push_back(f.header.frame);
    return numbers;
  }
  [[nodiscard]] static int64_t OffsetOf(int64_t frame) { return kSegmentStart + frame * kFrameBytes; }
  // Writes `header` in front of its frame with a hash that fits.
  void Forge(int64_t frame, const std::function<void(FrameHeader&)>& change) const {
    auto bytes = ReadBytes(file_);
    FrameHeader header{};
    std::memcpy(&header, bytes.data() + OffsetOf(frame), sizeof header);
    change(header);
    header.header_hash = XXH3_64bits(&header, offsetof(FrameHeader, header_hash));
    std::memcpy(bytes.data() + OffsetOf(frame), &header, sizeof header);
    WriteBytes(file_, bytes);
  }

  std::filesystem::path file_;
};

TEST_F(SegmentScanTest, AWholeSegmentIsAllFramesAndNothingElse) {
  for (const End end : {End::kSealed, End::kOpen}) {
    Write(end);
    const SegmentScan scan = Scan();
    EXPECT_THAT(Numbers(scan), ElementsAre(0, 1, 2, 3, 4, 5));
    EXPECT_THAT(scan.asides, IsEmpty());
    EXPECT_THAT(scan.lost, IsEmpty());
    EXPECT_THAT(scan.findings, IsEmpty());
    EXPECT_EQ(scan.sealed, end == End::kSealed);
  }
}

TEST_F(SegmentScanTest, ADamagedHeaderCostsItsOwnFrameAloneAndNothingWhereTheFooterHasACopy) {
  for (const End end : {End::kSealed, End::kOpen}) {
    Write(end);
    for (int64_t frame = 0; frame < 6; ++frame) {
      for (int64_t at = 0; at < 320; at += 11) {
        SCOPED_TRACE(std::to_string(frame) + ", byte " + std::to_string(at));
        FlipBits(file_, static_cast<size_t>(OffsetOf(frame) + at), 0x08);
        const SegmentScan scan = Scan();
        FlipBits(file_, static_cast<size_t>(OffsetOf(frame) + at), 0x08);
        std::vector<int64_t> left = {0, 1, 2, 3, 4, 5};
        if (end == End::kSealed) {
          ASSERT_EQ(Numbers(scan), left);
          EXPECT_THAT(scan.findings, Contains(HasSubstr("frame " + std::to_string(frame) + " is damaged")));
          continue;
        }
        left.erase(left.begin() + frame);
        ASSERT_EQ(Numbers(scan), left);
        ASSERT_EQ(scan.asides.size(), 1U);
        EXPECT_EQ(scan.asides[0].begin, OffsetOf(frame));
        EXPECT_EQ(scan.asides[0].end, OffsetOf(frame + 1));
      }
    }
  }
}

// Header and payload: the footer's copy vouches for a payload that fits it alone.
TEST_F(SegmentScanTest, ADamagedHeaderBeforeADamagedPayloadCostsItsFrame) {
  Write(End::kSealed);
  FlipBits(file_, static_cast<size_t>(OffsetOf(2) + 40), 0x08);
  FlipBits(file_, static_cast<size_t>(OffsetOf(2) + 330), 0x08);
  EXPECT_THAT(Numbers(Scan()), ElementsAre(0, 1, 3, 4, 5));
}

TEST_F(SegmentScanTest, BytesPutInOrTakenOutCostTheirOwnFrameAlone) {
  for (const End end : {End::kSealed, End::kOpen}) {
    for (const int64_t at : {OffsetOf(2), OffsetOf(2) + 5, OffsetOf(2) + 330, OffsetOf(3) - 1}) {
      SCOPED_TRACE(at);
      Write(end);
      const auto whole = ReadBytes(file_);
      auto bytes = whole;
      bytes.insert(bytes.begin() + at, {7, 7, 7});
      WriteBytes(file_, bytes);
      EXPECT_THAT(Numbers(Scan()), IsSupersetOf({0, 1, 3, 4, 5}));
      bytes = whole;
      bytes.erase(bytes.begin() + at, bytes.begin() + at + 1);
      WriteBytes(file_, bytes);
      EXPECT_THAT(Numbers(Scan()), IsSupersetOf({0, 1, 3, 4, 5}));
    }
  }
}

TEST_F(SegmentScanTest, CopiesOfHeadersInADamagedFooterAreNoFrames) {
  Write(End::kSealed);
  const auto size = std::filesystem::file_size(file_);
  for (auto at = static_cast<size_t>(OffsetOf(6)); at < size; at += 5) {
    FlipBits(file_, at, 0x40);
    const SegmentScan scan = Scan();
    ASSERT_THAT(Numbers(scan), ElementsAre(0, 1, 2, 3, 4, 5)) << "byte " << at;
    ASSERT_FALSE(scan.sealed);
    // Of the trailer's pointer alone the footer stays whole.
    ASSERT_NE(scan.asides.empty(), scan.findings.empty());
    if (!scan.asides.empty()) {
      EXPECT_EQ(scan.asides[0].end, static_cast<int64_t>(size));
    }
    FlipBits(file_, at, 0x40);
  }
}

TEST_F(SegmentScanTest, APictureOfAHeaderIsNoFrame) {
  // A header within the payload of a frame whose own header is gone.
  Write(End::kOpen);
  auto bytes = ReadBytes(file_);
  const std::vector<uint8_t> copy(bytes.begin() + OffsetOf(1), bytes.begin() + OffsetOf(1) + 320);
  bytes.insert(bytes.begin() + OffsetOf(3) + 330, copy.begin(), copy.end());
  bytes[static_cast<size_t>(OffsetOf(3)) + 2] ^= 1U;
  WriteBytes(file_, bytes);
  EXPECT_THAT(Numbers(Scan()), ElementsAre(0, 1, 2, 4, 5));
}

TEST_F(SegmentScanTest, AFooterThatDisagreesIsSaidAndTheHeadersCount) {
  Write(End::kSealed);
  Forge(4, [](FrameHeader& h) { h.step = 77; });
  const SegmentScan scan = Scan();
  EXPECT_THAT(scan.findings, Contains(HasSubstr("footer disagrees with the header of frame 4")));
  EXPECT_FALSE(scan.sealed);
  ASSERT_EQ(scan.frames.size(), 6U);
  EXPECT_EQ(scan.frames[4].header.step, 77);
}

TEST_F(SegmentScanTest, APayloadBeyondTheFileEndsNothing) {
  for (const uint64_t bytes : {~uint64_t{0} - 319, ~uint64_t{0}, uint64_t{1} << 63, uint64_t{1} << 32}) {
    for (const End end : {End::kSealed, End::kOpen}) {
      Write(end);
      Forge(2, [bytes](FrameHeader& h) { h.payload_bytes = bytes; });
      if (end == End::kOpen) {
        EXPECT_THAT(Numbers(Scan()), ElementsAre(0, 1, 3, 4, 5));
      } else {
        EXPECT_THAT(Scan().findings, Contains(HasSubstr("frame 2")));
      }
      const auto reader = SegmentReader::Open(file_);
      EXPECT_EQ(reader->ReadHeader(OffsetOf(2)).status().code(), StatusCode::kIntegrity);
      bool sealed = false;
      EXPECT_EQ(reader->Walk(false, &sealed).status().code(), StatusCode::kIntegrity);
      EXPECT_EQ(reader->IntactEnd(), OffsetOf(2));
    }
  }
}

TEST_F(SegmentScanTest, WhatTheIndexKnowsIsFoundBehindAHeaderThatClaimsItsBytes) {
  Write(End::kOpen);
  const SegmentScan whole = Scan();
  std::vector<KnownPlace> known;
  for (const SegmentFrame& f : whole.frames)
    known.push_back(
        {f.header.frame, f.offset, 36, {std::begin(f.header.payload_hash), std::end(f.header.payload_hash)}});
  Forge(1, [](FrameHeader& h) { h.payload_bytes = 36 + kFrameBytes; });
  EXPECT_THAT(Numbers(Scan()), ElementsAre(0, 1, 3, 4, 5)) << "nothing else tells of frame 2";
  const SegmentScan scan = Scan(known);
  EXPECT_THAT(Numbers(scan), ElementsAre(0, 1, 2, 3, 4, 5));
  EXPECT_THAT(scan.findings, Contains(HasSubstr("frame 2")));
}

TEST_F(SegmentScanTest, ARecordThatWasNeverFinishedIsSetAsideUnlessTheIndexAcknowledgedIt) {
  Write(End::kOpen);
  const FrameHeader header = Scan().frames[5].header;
  const KnownPlace last{5, OffsetOf(5), 36, {std::begin(header.payload_hash), std::end(header.payload_hash)}};
  FlipBits(file_, static_cast<size_t>(OffsetOf(5)) + 330, 1);
  SegmentScan scan = Scan();
  EXPECT_THAT(Numbers(scan), ElementsAre(0, 1, 2, 3, 4));
  ASSERT_EQ(scan.asides.size(), 1U);
  EXPECT_EQ(scan.asides[0].begin, OffsetOf(5));
  scan = Scan({last});
  EXPECT_THAT(Numbers(scan), ElementsAre(0, 1, 2, 3, 4, 5));
  EXPECT_THAT(scan.findings, Contains(HasSubstr("payload of frame 5")));
}

TEST_F(SegmentScanTest, RandomBytesAreNoFramesAndNoTrouble) {
  file_ = folder_ / "frames-0001.seg";
  uint32_t state = 5;
  for (const size_t size : {size_t{0}, size_t{1}, size_t{63}, size_t{64}, size_t{65}, size_t{400}, size_t{100'000}}) {
    std::vector<uint8_t> bytes(size);
    for (uint8_t& b : bytes) b = static_cast<uint8_t>((state = state * 1664525U + 1013904223U) >> 24);
    WriteBytes(file_, bytes);
    EXPECT_THAT(Scan().frames, IsEmpty());
    EXPECT_FALSE(SegmentReader::Open(file_).ok());
  }
}

TEST_F(SegmentScanTest, APipeOrAFolderInASegmentsPlaceIsRefusedAtOnce) {
  ASSERT_EQ(std::system(("mkfifo " + (folder_ / "frames-0001.seg").string()).c_str()), 0);
  EXPECT_EQ(SegmentReader::Open(folder_ / "frames-0001.seg").status().code(), StatusCode::kIntegrity);
  std::filesystem::create_directory(folder_ / "frames-0002.seg");
  EXPECT_EQ(SegmentReader::Open(folder_ / "frames-0002.seg").status().code(), StatusCode::kIntegrity);
}

}  // namespace
}  // namespace stratalux::db
