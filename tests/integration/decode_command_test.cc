// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit decode` of imported images: a camera that looks through the projector, pixel for pixel.
#include <filesystem>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "shared/image/png.h"
#include "shared/pattern/pattern.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

constexpr int kWidth = 64, kHeight = 48, kBits = 6;

std::vector<Pattern> Codes() {
  std::vector<Pattern> codes;
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows})
    for (int bit = 0; bit < kBits; ++bit)
      codes.push_back({.kind = PatternKind::kGray, .axis = axis, .bit = bit, .bits = kBits});
  return codes;
}

class DecodeCommand : public ScratchFolderTest {
 protected:
  DecodeCommand() {
    fs::create_directories(folder_ / "files");
    manifest_ =
        "[import]\nrig = \"elsewhere\"\ncamera_width = 64\ncamera_height = 48\nbit_depth = 8\nprojectors = 2\n"
        "projector_width = 64\nprojector_height = 48\n";
  }
  void Pose(int index) { manifest_ += "[[pose]]\nindex = " + std::to_string(index) + "\n"; }
  // `more`: further keys of the entry.
  void Capture(const Pattern& pattern, const std::string& more) { CaptureAs(pattern, pattern, more); }
  // What is said to show `pattern` shows `really`.
  void CaptureAs(const Pattern& pattern, const Pattern& really, const std::string& more) {
    const Image<float> shown = really.Render(kWidth, kHeight);
    Image<uint8_t> seen(kWidth, kHeight);
    for (size_t i = 0; i < seen.size(); ++i) seen.data()[i] = static_cast<uint8_t>(10.0F + 200.0F * shown.data()[i]);
    const std::string name = "f" + std::to_string(files_++) + ".png";
    EXPECT_TRUE(WritePng8(folder_ / "files" / name, seen.view()).ok());
    entries_ += "[[file]]\nfile = \"" + name + "\"\npattern = \"" + pattern.ToString() + "\"\n" + more;
  }
  void Import() {
    WriteText(folder_ / "files" / "m.toml", manifest_ + entries_);
    ASSERT_EQ(Execute("stratalux-db init" + Store()).code, 0);
    const Outcome imported =
        Execute("stratalux-db import --manifest " + (folder_ / "files" / "m.toml").string() + Store());
    ASSERT_EQ(imported.code, 0) << imported.out;
  }
  [[nodiscard]] std::string Store() const { return " --store " + (folder_ / "store").string(); }
  [[nodiscard]] Outcome Decode(const std::string& options, Show show = Show::kAll) const {
    return Execute("stratalux-fit decode latest " + options + Store(), show);
  }
  [[nodiscard]] std::string Reference(const std::string& text) const {
    WriteText(folder_ / "reference.txt", text);
    return "--reference " + (folder_ / "reference.txt").string();
  }

 private:
  std::string manifest_, entries_;
  int files_ = 0;
};

// Three poses: of two of them codes by projector 0, of one by projector 1; one shows white alone.
class DecodeOfPoses : public DecodeCommand {
 protected:
  void SetUp() override {
    for (const int pose : {1, 4, 6}) Pose(pose);
    Capture({.kind = PatternKind::kWhite}, "");
    Capture({.kind = PatternKind::kBlack}, "");
    for (const Pattern& code : Codes())
      for (const int pose : {1, 6}) Capture(code, "pose = " + std::to_string(pose) + "\n");
    for (const PatternKind kind : {PatternKind::kWhite, PatternKind::kBlack})
      Capture({.kind = kind}, "projector = 1\n");
    for (const Pattern& code : Codes()) Capture(code, "projector = 1\npose = 4\n");
    Import();
  }
};

TEST_F(DecodeOfPoses, ThoseWithCodesOfTheProjectorAreDecodedAndTheOthersNamed) {
  const fs::path out = folder_ / "maps";
  const Outcome first = Decode("--json --out " + out.string(), Show::kStdout);
  ASSERT_EQ(first.code, 0);
  const Json said = Json::parse(first.out);
  ASSERT_EQ(said.size(), 2U);
  EXPECT_EQ(said[0]["pose"], 1);
  EXPECT_EQ(said[1]["pose"], 6);
  EXPECT_EQ(said[1]["pixels"]["valid"], kWidth * kHeight);
  for (const char* map : {"projector0_pose1_column.exr", "projector0_pose6_row.exr"})
    EXPECT_TRUE(fs::exists(out / map)) << map;
  EXPECT_THAT(Decode("").out, HasSubstr("pose 4 has no codes of projector 0 and is left out"));
  const Outcome second = Decode("--projector 1");
  EXPECT_EQ(second.code, 0) << second.out;
  EXPECT_THAT(second.out, HasSubstr("projector 1 pose 4: "));
}

// What nobody can read is a map without values: an earlier run's must not stand for it.
TEST_F(DecodeCommand, MapsOfAPoseInTheDarkTakeThePlaceOfEarlierOnes) {
  constexpr Pattern kDark{.kind = PatternKind::kBlack};
  Pose(1);
  CaptureAs({.kind = PatternKind::kWhite}, kDark, "");
  Capture(kDark, "");
  for (const Pattern& code : Codes()) CaptureAs(code, kDark, "pose = 1\n");
  Import();
  const fs::path out = folder_ / "maps";
  fs::create_directories(out);
  for (const char* map : {"projector0_pose1_column.exr", "projector0_pose1_row.png"})
    WriteText(out / map, "an earlier one");
  const Outcome dark = Decode("--out " + out.string());
  EXPECT_EQ(dark.code, 0) << dark.out;
  for (const char* map : {"projector0_pose1_column.exr", "projector0_pose1_row.png"})
    EXPECT_NE(ReadText(out / map), "an earlier one") << map;
}

TEST_F(DecodeCommand, APoseThatCannotBeDecodedLeavesNoMapsOfOthers) {
  Pose(1);
  Pose(6);
  for (const PatternKind kind : {PatternKind::kWhite, PatternKind::kBlack}) Capture({.kind = kind}, "pose = 1\n");
  for (const Pattern& code : Codes())
    for (const int pose : {1, 6}) Capture(code, "pose = " + std::to_string(pose) + "\n");
  Import();
  const fs::path out = folder_ / "maps";
  EXPECT_NE(Decode("--out " + out.string()).code, 0);
  EXPECT_FALSE(fs::exists(out));
  EXPECT_EQ(Decode("--pose 1 --out " + out.string()).code, 0);
  EXPECT_TRUE(fs::exists(out / "projector0_pose1_row.exr"));
}

TEST_F(DecodeOfPoses, AReferenceOfAnotherFormIsRefusedByItsLine) {
  for (const char* line : {"2.7 0 0 10 10 10 10", "1e300 0 0 10 10 10 10", "x 0 0 10 10 10 10", "1 0 0 10 10 10",
                           "1 0 0 10 10 10 10 10"}) {
    const Outcome outcome = Decode("--pose 1 " + Reference("1 0 0 10 10 10 10\n" + std::string(line) + "\n"));
    EXPECT_EQ(outcome.code, 2) << line;
    EXPECT_THAT(outcome.out, HasSubstr("reference.txt:2: ")) << line;
  }
}

TEST_F(DecodeOfPoses, WhatHasNoCodesIsNotFound) {
  const Outcome pose = Decode("--pose 4"), projector = Decode("--projector 2");
  EXPECT_EQ(pose.code, 4) << pose.out;
  EXPECT_THAT(pose.out, HasSubstr("has no codes of projector 0 in pose 4"));
  EXPECT_EQ(projector.code, 4) << projector.out;
  EXPECT_THAT(projector.out, HasSubstr("has no codes of projector 2"));
}

TEST_F(DecodeOfPoses, AReferenceOfOtherPosesIsAWrongInput) {
  const fs::path out = folder_ / "maps";
  const Outcome other = Decode(Reference("1 0 0 10 10 10 10\n") + " --out " + out.string());
  EXPECT_EQ(other.code, 2) << other.out;
  EXPECT_THAT(other.out, HasSubstr("reference.txt: has no line of pose 6"));
  EXPECT_FALSE(fs::exists(out)) << "found before anything is written";
  EXPECT_EQ(Decode("--pose 1 " + Reference("1 0 0 10 10 10 10\n")).code, 0);
}

TEST_F(DecodeOfPoses, AReferenceIsReadWithTheLineEndsOfAnySystem) {
  const Outcome compared = Decode(
      "--pose 1 --json " + Reference("# corners\r\n\r\n1 0 0 10 10 10 10\r\n1 1 0 30 20 30.5 20\r\n"), Show::kStdout);
  ASSERT_EQ(compared.code, 0);
  const Json reference = Json::parse(compared.out)[0]["reference"];
  EXPECT_EQ(reference["corners"], 2);
  EXPECT_EQ(reference["found"], 2);
  EXPECT_NEAR(reference["median_px"].get<double>(), 0.5, 0.02);
}

TEST_F(DecodeOfPoses, OfCornersThatNobodySeesThereIsNoMedian) {
  const std::string reference = "--pose 1 " + Reference("1 0 0 500 500 10 10\n");
  const Outcome json = Decode(reference + " --json", Show::kStdout), text = Decode(reference);
  ASSERT_EQ(json.code, 0);
  EXPECT_EQ(Json::parse(json.out)[0]["reference"], Json({{"corners", 1}, {"found", 0}, {"median_px", nullptr}}));
  EXPECT_THAT(text.out, HasSubstr("0 of 1 corners"));
  EXPECT_THAT(text.out, Not(HasSubstr("median")));
}

TEST_F(DecodeCommand, SinusoidsThatWereImportedAreRead) {
  for (const PatternKind kind : {PatternKind::kWhite, PatternKind::kBlack}) Capture({.kind = kind}, "");
  for (const Pattern& code : Codes()) Capture(code, "");
  for (int shift = 0; shift < 4; ++shift)
    Capture({.kind = PatternKind::kSinusoid, .period = 8, .shift = shift, .shifts = 4}, "");
  Import();
  const fs::path phases = folder_ / "phases", bits = folder_ / "bits";
  ASSERT_EQ(Decode("--out " + phases.string()).code, 0);
  ASSERT_EQ(Decode("--bits-alone --out " + bits.string()).code, 0);
  EXPECT_NE(ReadText(phases / "projector0_column.exr"), ReadText(bits / "projector0_column.exr"));
  EXPECT_EQ(ReadText(phases / "projector0_row.exr"), ReadText(bits / "projector0_row.exr")) << "has no sinusoids";
}

TEST_F(DecodeCommand, SinusoidsThatLackAShiftAreNamed) {
  for (const PatternKind kind : {PatternKind::kWhite, PatternKind::kBlack}) Capture({.kind = kind}, "");
  for (const Pattern& code : Codes()) Capture(code, "");
  for (const int shift : {0, 1, 3})
    Capture({.kind = PatternKind::kSinusoid, .period = 8, .shift = shift, .shifts = 4}, "");
  Import();
  const Outcome decoded = Decode("");
  EXPECT_EQ(decoded.code, 0);
  EXPECT_THAT(decoded.out, HasSubstr("columns, sinusoids of period 8 px: 3 of 4 shifts, all are needed"));
  EXPECT_THAT(Decode("--bits-alone").out, Not(HasSubstr("sinusoids")));
}

}  // namespace
}  // namespace stratalux
