// SPDX-License-Identifier: Apache-2.0
// Image files of others: read as they were meant, and never a crash.
#include <fstream>

#include <gmock/gmock.h>

#include "db/interchange/export.h"
#include "db/interchange/image_file.h"
#include "db/interchange/import.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

using Bytes = std::vector<uint8_t>;

Bytes Tga(uint8_t type, uint8_t depth, uint8_t descriptor, const Bytes& data) {
  Bytes file = {0, 0, type, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 2, 0, depth, descriptor};
  for (uint8_t byte : data) file.push_back(byte);
  return file;
}

class InterchangeTest : public StoreTest {
 protected:
  Result<ImageFile> Read(const std::string& name, const Bytes& bytes) {
    WriteBytes(folder_ / name, bytes);
    return ReadImageFile(folder_ / name);
  }
  // Cut anywhere or with any byte changed: an error that names the file, or a picture; never a crash.
  void Torture(const std::string& name, const Bytes& bytes) {
    for (size_t length = 0; length < bytes.size(); ++length) {
      const auto cut = Read(name, Bytes(bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(length)));
      if (!cut.ok()) {
        EXPECT_THAT(cut.status().message(), HasSubstr(name)) << length;
      }
    }
    for (size_t at = 0; at < bytes.size(); ++at)
      for (int mask : {0x01, 0x80, 0xff}) {
        Bytes flipped = bytes;
        flipped[at] = static_cast<uint8_t>(flipped[at] ^ mask);
        const auto read = Read(name, flipped);
        if (!read.ok()) {
          EXPECT_THAT(read.status().message(), HasSubstr(name)) << at;
        }
      }
  }
  Logger logger_{LogLevel::kError};
};

TEST_F(InterchangeTest, TgaOfBothOriginsPlainAndRunLength) {
  const auto bottom = Read("a.tga", Tga(3, 8, 0, {1, 2, 3, 4}));
  ASSERT_TRUE(bottom.ok()) << bottom.status().message();
  EXPECT_THAT(bottom->image.pixels(), ElementsAre(3, 4, 1, 2));
  EXPECT_THAT(Read("a.tga", Tga(3, 8, 0x20, {1, 2, 3, 4}))->image.pixels(), ElementsAre(1, 2, 3, 4));
  EXPECT_THAT(Read("a.tga", Tga(11, 8, 0x20, {0x81, 7, 0x01, 8, 9}))->image.pixels(), ElementsAre(7, 7, 8, 9));
  // B, G, R (, A) in the file.
  EXPECT_THAT(Read("a.tga", Tga(10, 32, 0x20, {0x83, 1, 2, 3, 99}))->image.pixels(),
              ElementsAre(3, 2, 1, 3, 2, 1, 3, 2, 1, 3, 2, 1));
  EXPECT_THAT(Read("a.tga", Tga(11, 8, 0x20, {0x84, 7})).status().message(), HasSubstr("offset 18"));
  EXPECT_EQ(Read("a.tga", Tga(1, 8, 0, {1, 2, 3, 4})).status().code(), StatusCode::kUsage) << "palette";
}

TEST_F(InterchangeTest, NetpbmOfAllFourKinds) {
  auto bytes = [](const std::string& text) { return Bytes(text.begin(), text.end()); };
  EXPECT_THAT(Read("a.pgm", bytes("P2 # grey\n2 1 255\n7 255"))->image.pixels(), ElementsAre(7, 255));
  EXPECT_THAT(Read("a.ppm", bytes("P3\n1 1\n4095 1 2 4095\n"))->image.pixels(), ElementsAre(1, 2, 4095));
  const auto high = Read("a.pgm", bytes("P5 2 1 65535\n\x12\x34\xab\xcd"));
  EXPECT_EQ(high->bits, 16);
  EXPECT_THAT(high->image.pixels(), ElementsAre(0x1234, 0xabcd)) << "high byte first";
  EXPECT_THAT(Read("a.ppm", bytes("P6 1 1 255\nabc"))->image.pixels(), ElementsAre('a', 'b', 'c'));
  EXPECT_THAT(Read("a.pgm", bytes("P5 2 1 100\nae")).status().message(), HasSubstr("offset 12"));
  EXPECT_EQ(Read("a.pgm", bytes("P5 60000 60000 255\nab")).status().code(), StatusCode::kUsage);
}

TEST_F(InterchangeTest, TiffReturnsWhatWasWritten) {
  for (int channels : {1, 3}) {
    Image<uint16_t> image(7, 5, channels);
    for (size_t i = 0; i < image.size(); ++i) image.data()[i] = static_cast<uint16_t>(i * 7919U);
    ASSERT_TRUE(WriteTiff16(folder_ / "a.tif", std::as_const(image).view()).ok());
    const auto read = ReadImageFile(folder_ / "a.tif");
    ASSERT_TRUE(read.ok()) << read.status().message();
    EXPECT_EQ(read->bits, 16);
    EXPECT_TRUE(std::equal(image.pixels().begin(), image.pixels().end(), read->image.pixels().begin()));
  }
}

TEST_F(InterchangeTest, NoCutAndNoFlippedByteCrashesAReader) {
  Torture("t.tga", Tga(10, 24, 0x20, {0x81, 1, 2, 3, 0x01, 4, 5, 6, 7, 8, 9}));
  Torture("t.tga", Tga(2, 24, 0, Bytes(12, 5)));
  const std::string p5 = "P5\n3 2\n65535\nabcdefghijkl", p3 = "P3 1 2 255 1 2 3 4 5 6";
  Torture("t.pgm", Bytes(p5.begin(), p5.end()));
  Torture("t.ppm", Bytes(p3.begin(), p3.end()));
  const Image<uint8_t> image(6, 4, 3, 77);
  ASSERT_TRUE(WriteTiff8(folder_ / "t.tif", image.view()).ok());
  Torture("t.tif", ReadBytes(folder_ / "t.tif"));
  EXPECT_THAT(Read("empty.tif", {}).status().message(), HasSubstr("0 bytes"));
}

TEST_F(InterchangeTest, AnExportReadBackHoldsTheSameFrames) {
  const std::string id = StoreSession(4);  // one a projector
  for (const ExportFormat format : {ExportFormat::kPng, ExportFormat::kTiff}) {
    SessionStore store = OpenStore();
    const auto out = folder_ / (format == ExportFormat::kPng ? "png" : "tiff");
    const auto report = ExportSession(store, *store.FindSession(id), {out, format, {}, {}}, logger_);
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_EQ(report->written, 4);
    const auto imported = ImportSession(store, {out / "import.toml", {}, {}}, logger_);
    ASSERT_TRUE(imported.ok()) << imported.status().message();
    const auto before = *store.ListFrames(id), after = *store.ListFrames(imported->session);
    ASSERT_EQ(after.size(), before.size());
    for (size_t i = 0; i < before.size(); ++i) {
      EXPECT_EQ(after[i].hash, before[i].hash) << "the stored bytes themselves";
      EXPECT_EQ(after[i].record.pattern, before[i].record.pattern);
      EXPECT_EQ(after[i].record.projector, before[i].record.projector);
      EXPECT_EQ(after[i].record.exposure_ms, before[i].record.exposure_ms);
      EXPECT_EQ(after[i].record.pose, before[i].record.pose);
    }
  }
}

// Whose manifest would otherwise be refused, or count what the capture did not.
TEST_F(InterchangeTest, OfStepsThatWereShotAgainAnExportNamesTheLastGoodShot) {
  std::string id;
  {
    SessionStore store = OpenStore();
    SessionInfo info;
    info.kind = SessionKind::kCalibration;
    auto writer = store.BeginSession(info);
    ASSERT_TRUE(writer.ok());
    int shots = 0;
    for (const auto& [step, level_check] : {std::pair{0, LevelCheck::kPassed},
                                            {0, LevelCheck::kPassed},
                                            {0, LevelCheck::kFailed},
                                            {1, LevelCheck::kPassed}}) {
      FrameRecord record = RecordFor(step, PixelFormat::kMono12, 6, 4);
      record.pattern = {.kind = PatternKind::kGray, .bit = step, .bits = 6};
      record.phase = CapturePhase::kCorrespondence;
      record.projector = 0;
      record.level_check = level_check;
      ++shots;
      const Image<uint16_t> pixels = PixelsFor(RecordFor(shots, record.format, 6, 4));
      ASSERT_TRUE(writer->Append(record, pixels.view()).ok());
    }
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    id = writer->info().id;
  }
  SessionStore store = OpenStore();
  const auto out = folder_ / "again";
  ASSERT_TRUE(ExportSession(store, *store.FindSession(id), {out, ExportFormat::kPng, {}, {}}, logger_).ok());
  const auto imported = ImportSession(store, {out / "import.toml", {}, {}}, logger_);
  ASSERT_TRUE(imported.ok()) << imported.status().message();
  const auto before = *store.ListFrames(id), after = *store.ListFrames(imported->session);
  ASSERT_EQ(after.size(), 2U);
  EXPECT_EQ(after[0].hash, before[1].hash);
  EXPECT_EQ(after[1].hash, before[3].hash);
  EXPECT_EQ(store.DevicesOf(imported->session).projector_width, 64) << "all that a code of 6 bits can number";
}

TEST_F(InterchangeTest, AnExportGoesOnWhereItWasCutAndReplacesNothing) {
  const std::string id = StoreSession(4);
  const SessionStore store = OpenStore();
  const auto row = *store.FindSession(id);
  const ExportOptions options{folder_ / "out", ExportFormat::kPng, {}, {}};
  ASSERT_TRUE(ExportSession(store, row, options, logger_).ok());
  const auto first = folder_ / "out" / "frames" / "000000-gray-rows-bit-3-10-inverse.png";
  ASSERT_TRUE(std::filesystem::remove(first));
  const auto again = ExportSession(store, row, options, logger_);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->written, 1);
  EXPECT_EQ(again->kept, 3);
  WriteText(first, "mine");
  EXPECT_EQ(ExportSession(store, row, options, logger_).status().code(), StatusCode::kIntegrity);
  EXPECT_EQ(ReadBytes(first).size(), 4U);
  std::filesystem::create_directories(folder_ / "full");
  WriteText(folder_ / "full" / "letter.txt", "dear");
  EXPECT_EQ(ExportSession(store, row, {folder_ / "full", ExportFormat::kPng, {}, {}}, logger_).status().code(),
            StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::db
