// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/import.h"

#include <cstdio>

#include <gmock/gmock.h>

#include "db/apps/extract.h"
#include "db/care/verify.h"
#include "db/interchange/export.h"
#include "shared/image/png.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr const char* kHead = R"([import]
rig = "elsewhere"
camera_width = 40
camera_height = 30
bit_depth = 8
projector_width = 64
projector_height = 48
)";
constexpr const char* kPoses = R"([[pose]]
index = 4
folder = "a"
crop_x = 3
crop_y = 5
[[pose]]
index = 7
folder = "b"
)";
constexpr const char* kFiles = R"([[file]]
sequence = "g##.png"
first = 9
patterns = ["gray columns bit=0/6", "gray columns bit=0/6 inverse"]
[[file]]
file = "white.png"
pattern = "white"
exposure_ms = 2.5
)";

class ImportTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    int fill = 1;
    for (const char* folder : {"a", "b"}) {
      std::filesystem::create_directories(files_() / folder);
      for (const char* name : {"g09.png", "g10.png", "white.png"}) Write8(std::string(folder) + "/" + name, fill++);
    }
  }
  [[nodiscard]] std::filesystem::path files_() const { return folder_ / "files"; }
  void Write8(const std::string& name, int fill, int width = 20, int height = 10, int channels = 1) const {
    Image<uint8_t> image(width, height, channels, static_cast<uint8_t>(fill));
    image(1, 2) = 200;
    ASSERT_TRUE(WritePng8(files_() / name, ImageView<const uint8_t>(image.data(), width, height, channels)).ok());
  }
  void Write16(const std::string& name, uint16_t value) const {
    const Image<uint16_t> image(4, 4, 1, value);
    ASSERT_TRUE(WritePng16(files_() / name, image.view()).ok());
  }
  Result<ImportReport> Import(const std::string& manifest, std::optional<int> pose = {}) {
    WriteText(files_() / "m.toml", manifest);
    SessionStore store = OpenStore();
    return ImportSession(store, {files_() / "m.toml", {}, pose}, logger_);
  }
  void ExpectRefused(const std::string& manifest, const std::string& what) {
    const auto report = Import(manifest);
    EXPECT_EQ(report.status().code(), StatusCode::kUsage);
    EXPECT_THAT(report.status().message(), HasSubstr(what));
    EXPECT_THAT(*OpenStore(AccessMode::kReadOnly).ListSessions(), IsEmpty()) << "nothing may be written";
    EXPECT_TRUE(std::filesystem::is_empty(folder_ / "sessions"));
  }

  Logger logger_{LogLevel::kError};
};

TEST_F(ImportTest, StoresEachFileOfEachPoseWithWhatTheManifestSays) {
  const auto report = Import(std::string(kHead) + kPoses + kFiles);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ(report->frames, 6);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto row = store.FindSession(report->session);
  EXPECT_EQ(row->info.kind, SessionKind::kCalibration);
  EXPECT_EQ(row->info.status, SessionStatus::kComplete);
  EXPECT_EQ(row->info.rig, "elsewhere");
  EXPECT_EQ(row->info.plan_json, "");
  const auto frames = *store.ListFrames(report->session);
  ASSERT_EQ(frames.size(), 6U);
  const char* patterns[] = {"gray columns bit=0/6", "gray columns bit=0/6 inverse", "white"};
  for (size_t i = 0; i < 6; ++i) {
    const FrameRecord& r = frames[i].record;
    EXPECT_EQ(r.step, static_cast<int>(i));
    EXPECT_EQ(r.pose, i < 3 ? 4 : 7);
    EXPECT_EQ(r.crop_x, i < 3 ? 3 : 0);
    EXPECT_EQ(r.crop_y, i < 3 ? 5 : 0);
    EXPECT_EQ(r.projector, 0);
    EXPECT_EQ(r.pattern.ToString(), patterns[i % 3]);
    EXPECT_EQ(r.phase, i % 3 == 2 ? CapturePhase::kReference : CapturePhase::kCorrespondence);
    EXPECT_EQ(r.exposure_ms, i % 3 == 2 ? 2.5 : 0.0);
    EXPECT_EQ(r.format, PixelFormat::kMono8);
    EXPECT_EQ(r.cfa, Cfa::kMono);
    EXPECT_EQ(r.level_check, LevelCheck::kNotChecked);
    const auto image = *store.ReadFrame(report->session, frames[i]);
    EXPECT_EQ(image(0, 0), i + 1);
    EXPECT_EQ(image(1, 2), 200);
    EXPECT_NEAR(r.mean_dn, (199.0 * static_cast<double>(i + 1) + 200.0) / 200.0, 1e-9);
  }
  EXPECT_THAT(VerifySession(store, *row)->problems, IsEmpty());
}

TEST_F(ImportTest, KeepsTheSizesOfTheDevices) {
  const std::string head = std::string(kHead) + "saturation = 250\n";
  const auto report = Import(head + kPoses + kFiles);
  ASSERT_TRUE(report.ok()) << report.status().message();
  SessionStore store = OpenStore();
  EXPECT_EQ(store.DevicesOf(report->session), (SessionDevices{40, 30, 64, 48, 250.0}));
  // And so do its export and whatever is made of that.
  const auto row = store.FindSession(report->session);
  ASSERT_TRUE(ExportSession(store, *row, {folder_ / "out", ExportFormat::kPng, {}, {}}, logger_).ok());
  const auto again = ImportSession(store, {folder_ / "out" / "import.toml", {}, {}}, logger_);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(store.DevicesOf(again->session), (SessionDevices{40, 30, 64, 48, 250.0}));
}

TEST_F(ImportTest, RefusesASaturationBeyondTheBitDepth) {
  ExpectRefused(std::string(kHead) + "saturation = 256\n" + kFiles,
                "m.toml:8: saturation: 256 exceeds the levels of 8 bits");
}

// Read as if it numbered all columns it would send them to the first quarter, and nobody would be told.
TEST_F(ImportTest, RefusesACodeOfFewerBitsThanTheProjectorNeeds) {
  ExpectRefused(std::string(kHead) + "[[file]]\nfile = \"w\"\npattern = \"gray columns bit=0/4\"",
                "m.toml:10: pattern: pattern 'gray columns bit=0/4' is of a code of 4 bits, 64 columns need 6");
  ExpectRefused(std::string(kHead) + "[[file]]\nsequence = \"g#.png\"\npatterns = [\"gray rows bit=4/5\"]",
                "of a code of 5 bits, 48 rows need 6");
}

TEST_F(ImportTest, RefusesAPatternThatIsListedTwice) {
  const std::string twice = "[[file]]\nfile = \"g10.png\"\npattern = \"gray columns bit=0/6\"\n";
  ExpectRefused(std::string(kHead) + kPoses + kFiles + twice,
                "m.toml:24: 'gray columns bit=0/6' of projector 0, pose 4, phase correspondence is listed at");
  // Of another bracket, projector or phase it is another frame.
  for (const char* other : {"bracket = 1\n", "phase = \"repeat\"\n"})
    EXPECT_TRUE(Import(std::string(kHead) + kPoses + kFiles + twice + other).ok()) << other;
}

TEST_F(ImportTest, WarnsOfWhiteThatIsReadOnceAndListedTwice) {
  const std::string white = "[[file]]\nfile = \"white.png\"\npattern = \"white\"\n",
                    black = "[[file]]\nfile = \"white.png\"\npattern = \"black\"\n";
  const auto notes = [&](const std::string& text) {
    WriteText(files_() / "m.toml", text);
    const auto manifest = ReadImportManifest({files_() / "m.toml", {}, {}});
    EXPECT_TRUE(manifest.ok()) << manifest.status().message();
    return manifest.ok() ? manifest->notes : std::vector<std::string>();
  };
  EXPECT_THAT(notes(std::string(kHead) + kPoses + kFiles + black), IsEmpty());
  const auto whites = notes(std::string(kHead) + kPoses + kFiles + white + white);
  ASSERT_EQ(whites.size(), 2U) << "one a pose";
  EXPECT_THAT(whites[1], HasSubstr("'white' of projector 0, pose 7, phase reference is listed at"));
  EXPECT_THAT(whites[1], HasSubstr("use only the last one"));
  EXPECT_EQ(notes(std::string(kHead) + kPoses + kFiles + black + black).size(), 2U);
  // Where poses are not numbered, and in other phases, stages take the mean of all.
  EXPECT_THAT(notes(std::string(kHead) + black + black), IsEmpty());
  EXPECT_THAT(notes(std::string(kHead) + white + "phase = \"motion\"\n" + white + "phase = \"motion\"\n"), IsEmpty());
}

TEST_F(ImportTest, TakesOnePoseAlone) {
  const auto report = Import(std::string(kHead) + kPoses + kFiles, 7);
  ASSERT_TRUE(report.ok()) << report.status().message();
  const auto frames = *OpenStore().ListFrames(report->session);
  ASSERT_EQ(frames.size(), 3U);
  for (const FrameRow& f : frames) EXPECT_EQ(f.record.pose, 7);
  EXPECT_EQ(Import(std::string(kHead) + kPoses + kFiles, 5).status().code(), StatusCode::kUsage);
}

TEST_F(ImportTest, ReadsTwelveBitsFromEitherEndOfTheSample) {
  std::string head = kHead;
  head.replace(head.find("bit_depth = 8"), 13, "bit_depth = 12");
  const std::string file = "[[file]]\nfile = \"w.png\"\npattern = \"white\"\n";
  Write16("w.png", 0x0abc);
  ExpectRefused(head + file, "w.png: sample 2748 has bits below");
  const auto low = Import(head + "alignment = \"low\"\n" + file);
  ASSERT_TRUE(low.ok()) << low.status().message();
  Write16("w.png", 0xabc0);
  const auto high = Import(head + file);
  ASSERT_TRUE(high.ok()) << high.status().message();
  SessionStore store = OpenStore();
  for (const auto& report : {low, high}) {
    const FrameRow frame = (*store.ListFrames(report->session))[0];
    EXPECT_EQ(frame.codec, "raw12");
    EXPECT_EQ((*store.ReadFrame(report->session, frame))(3, 3), 0xabc);
  }
  EXPECT_THAT(Import(head + "alignment = \"low\"\n" + file).status().message(), HasSubstr("exceeds 12 bits"));
}

TEST_F(ImportTest, GivesBackWhatWasExtracted) {
  const std::string id = StoreSession(1);
  SessionStore store = OpenStore();
  const auto frames = *store.ListFrames(id);
  ASSERT_TRUE(ExtractFrames(store, id, frames, files_(), logger_).ok());
  const auto report = Import(
      "[import]\nrig = \"r\"\ncamera_width = 6\ncamera_height = 4\nbit_depth = 12\n"
      "projector_width = 1024\nprojector_height = 1024\n[[file]]\nfile = \"" +
      ExtractedName(frames[0]) + "\"\npattern = \"gray rows bit=3/10 inverse\"\n");
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_EQ((*store.ListFrames(report->session))[0].hash, frames[0].hash);
}

TEST_F(ImportTest, NamesAMissingFileAndTheLineThatAsksForIt) {
  std::filesystem::remove(files_() / "b" / "g10.png");
  ExpectRefused(std::string(kHead) + kPoses + kFiles, "m.toml:16: ");
  ExpectRefused(std::string(kHead) + kPoses + kFiles, "b/g10.png");
}

TEST_F(ImportTest, RefusesFilesOfAnotherKindThanStated) {
  const std::string manifest = std::string(kHead) + kPoses + kFiles;
  Write16("a/white.png", 7);
  ExpectRefused(manifest, "a/white.png: has 16 bits");
  Write8("a/white.png", 1, 20, 11);
  ExpectRefused(manifest, "a/white.png: is 20x11, but the first file of its pose is 20x10");
  Write8("a/white.png", 1, 20, 10, 3);
  ExpectRefused(manifest, "colour");
  WriteText(files_() / "a/white.png", "GIF89a");
  ExpectRefused(manifest, "a/white.png");
  Write8("a/white.png", 1);
  auto bytes = ReadBytes(files_() / "a/white.png");
  bytes.resize(bytes.size() / 2);
  WriteBytes(files_() / "a/white.png", bytes);
  ExpectRefused(manifest, "a/white.png");
}

TEST_F(ImportTest, RefusesCropsThatLeaveTheCamera) {
  ExpectRefused(std::string(kHead) + "[[pose]]\nindex = 4\nfolder = \"a\"\ncrop_x = 21\n" + kFiles,
                "20x10 at (21, 0) leaves the camera's frame of 40x30");
  ExpectRefused(std::string(kHead) + "[[pose]]\nindex = 4\nfolder = \"a\"\nwidth = 19\n" + kFiles, "is 20 wide");
}

struct BadManifest {
  const char *name, *text, *complaint;
};
class BadManifests : public ImportTest, public ::testing::WithParamInterface<BadManifest> {};

TEST_P(BadManifests, AreRefusedWithTheirLine) {
  ExpectRefused(std::string(kHead) + GetParam().text, GetParam().complaint);
}

INSTANTIATE_TEST_SUITE_P(
    Import, BadManifests,
    ::testing::Values(
        BadManifest{"UnknownKey", "colour = 1\n[[file]]\nfile = \"w\"\npattern = \"white\"", "m.toml:8: unknown key"},
        BadManifest{"NoFiles", "", "names no file"}, BadManifest{"Cfa", "cfa = \"xtrans\"", "m.toml:8: cfa"},
        BadManifest{"Kind", "kind = \"party\"", "m.toml:8: kind"},
        BadManifest{"Alignment", "alignment = \"left\"", "m.toml:8: alignment"},
        BadManifest{"Pattern", "[[file]]\nfile = \"w\"\npattern = \"pink\"", "m.toml:10: pattern"},
        BadManifest{"TooManyBits", "[[file]]\nfile = \"w\"\npattern = \"gray rows bit=0/9\"", "m.toml:10: pattern"},
        BadManifest{"Projector", "[[file]]\nfile = \"w\"\npattern = \"white\"\nprojector = 1", "m.toml:11: projector"},
        BadManifest{"Phase", "[[file]]\nfile = \"w\"\npattern = \"white\"\nphase = \"x\"", "m.toml:11: phase"},
        BadManifest{"Sequence", "[[file]]\nsequence = \"g.png\"\npatterns = [\"white\"]", "m.toml:9: sequence"},
        BadManifest{"Neither", "[[file]]\nphase = \"sweep\"", "m.toml:8: an entry needs"},
        BadManifest{"PoseTwice", "[[pose]]\nindex = 1\n[[pose]]\nindex = 1", "m.toml:11: index: 1 is used twice"},
        BadManifest{"CropOutside", "[[pose]]\nindex = 1\ncrop_x = 40", "allowed: 0 .. 39"},
        BadManifest{"Syntax", "[[file", "m.toml:8"}),
    [](const auto& test) { return test.param.name; });

TEST_F(ImportTest, RefusesAMissingManifestAndAnOddBitDepth) {
  SessionStore store = OpenStore();
  const auto report = ImportSession(store, {files_() / "none.toml", {}, {}}, logger_);
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  EXPECT_THAT(report.status().message(), HasSubstr("none.toml"));
  std::string head = kHead;
  head.replace(head.find("bit_depth = 8"), 13, "bit_depth = 10");
  ExpectRefused(head + kFiles, "m.toml:5: bit_depth: 10 is not 8, 12 or 16");
}

TEST(ImportManifest, TheShippedExampleNamesFivePosesOfFortyTwoFrames) {
  const std::filesystem::path file = std::string(STRATALUX_SOURCE_DIR) + "/docs/examples/procam_gray_kamino.toml";
  const auto manifest = ReadImportManifest({file, "captures", {}});
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  ASSERT_EQ(manifest->frames.size(), 5U * 42U);
  const ImportFrame& frame = manifest->frames[3 * 42 + 25];
  EXPECT_EQ(frame.file, "captures/pose3/g25.png");
  EXPECT_EQ(frame.record.pattern.ToString(), "gray rows bit=2/10 inverse");
  EXPECT_EQ(frame.record.crop_x, 395);
  EXPECT_EQ(manifest->frames[41].record.pattern.ToString(), "black");
}

}  // namespace
}  // namespace stratalux::db
