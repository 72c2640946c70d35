// SPDX-License-Identifier: Apache-2.0
// Wrong flags, configurations, plans and pictures: each is named with its place, its value and what would be right,
// before any work starts, and nothing on disk has changed.
#include <array>

#include <gmock/gmock.h>

#include "shared/image/png.h"
#include "tests/integration/tiny_session.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

using WrongFlags = TinyStore;
using WrongConfig = TinyStore;
using WrongPlan = TinyStore;
using WrongSession = TinyStore;
using WrongImport = TinyStore;
using NoRoom = TinyStore;

TEST_F(WrongFlags, AreUsageErrorsOfAllPrograms) {
  for (const char* verb : {"stratalux-db ls", "stratalux-rig plan show", "stratalux-rig capture --simulate",
                           "stratalux-fit run s000001", "stratalux-fit decode s000001"}) {
    ExpectRefused(std::string(verb) + " --frobnicate", 2, {"--frobnicate"});
    const std::string flag = std::string(verb).find("plan") == std::string::npos ? " --store" : " --config";
    ExpectRefused(verb + flag, 2, {flag.substr(1)});
  }
  for (const char* program : {"stratalux-db", "stratalux-rig", "stratalux-fit"}) {
    ExpectRefused(program, 2, {"subcommand"});
    ExpectRefused(std::string(program) + " frobnicate", 2, {"no command"});
  }
  ExpectUnharmed();
}

TEST_F(WrongFlags, NumbersThatAreNone) {
  const std::array<std::array<const char*, 3>, 26> cases = {{
      {"stratalux-db frames s000001 --projector one", "--projector", "one"},
      {"stratalux-db frames s000001 --phase party", "party", "preroll, reference"},
      {"stratalux-rig capture --simulate --seed one", "--seed", "one"},
      {"stratalux-rig capture --simulate --seed -1", "--seed", "-1"},
      {"stratalux-rig capture --simulate --seed 99999999999999999999", "--seed", "99999999999999999999"},
      {"stratalux-rig capture --simulate --size 96", "--size '96'", "WIDTHxHEIGHT"},
      {"stratalux-rig capture --simulate --size 4294967392x72", "--size '4294967392x72'", "WIDTHxHEIGHT"},
      {"stratalux-rig capture --simulate --size 195x146", "width = 195", "allowed: even, 64 .. 4096"},
      {"stratalux-rig capture --simulate --exposure nan", "exposure_ms = nan", "allowed: 0.01 .. 10000"},
      {"stratalux-rig capture --simulate --exposure soon", "--exposure", "soon"},
      {"stratalux-rig plan show --settle -5", "--settle -5", "allowed: 0 .. 10000 ms"},
      {"stratalux-rig plan show --settle nan", "--settle nan", "allowed: 0 .. 10000 ms"},
      {"stratalux-rig plan show --kind party", "party", "visitor, calibration"},
      {"stratalux-fit run s000001 --layers many", "--layers", "many"},
      {"stratalux-fit run s000001 --prior much", "--prior", "much"},
      {"stratalux-fit run s000001 --surface shiny", "--surface", "shiny"},
      {"stratalux-fit run s000001 --background maybe", "--background", "maybe"},
      {"stratalux-fit run s000001 --pool 0", "--pool", "0"},
      {"stratalux-fit run s000001 --shift odd", "'odd'", "paper, refracted"},
      {"stratalux-fit clean --keep-days nan", "--keep-days", "'nan' is not a finite number"},
      {"stratalux-fit clean --keep-days=-nan", "--keep-days", "'-nan' is not a finite number"},
      {"stratalux-fit clean --keep-days inf", "--keep-days", "inf"},
      {"stratalux-fit render s000001 --direction=0,0,-1 --out none --white nan", "--white",
       "'nan' is not a finite number"},
      {"stratalux-fit calibrate --valid-days nan", "--valid-days", "'nan' is not a finite number"},
      {"stratalux-fit calibrate --square-mm NaN", "--square-mm", "'NaN' is not a finite number"},
      {"stratalux-fit batch run --memory nan", "--memory", "'nan' is not a finite number"},
  }};
  for (const auto& [command, place, value] : cases) ExpectRefused(command, 2, {place, value});
  ExpectUnharmed();
}

TEST_F(WrongFlags, APseudonymIsTextThatAnyListCanShow) {
  const std::string capture = "stratalux-rig capture --simulate --config " + File("rig.toml", kTinyConfig);
  ExpectRefused(capture + " --visitor '\xff'", 2, {"--visitor", "UTF-8"});
  ExpectRefused(capture + " --visitor 'two\nlines'", 2, {"--visitor \"two\\nlines\"", "control"});
  ExpectUnharmed();
}

TEST_F(WrongFlags, AFullPipeIsNoSuccess) {
  for (const char* command : {"stratalux-db ls", "stratalux-rig plan show", "stratalux-fit decode s000001",
                              "stratalux-fit decode s000001 --json"}) {
    const Outcome outcome = Run(std::string(command) + " >/dev/full");
    EXPECT_EQ(outcome.code, 1) << command;
    EXPECT_THAT(outcome.err, HasSubstr("cannot write")) << command;
  }
}

TEST_F(WrongConfig, IsNamedWithFileLineKeyValueAndRemedy) {
  const std::array<std::array<const char*, 3>, 12> cases = {{
      {"[camera]\nwidth = 5\n", ":2: camera.width: value 5", "allowed: 16 .. 16384"},
      {"[plan]\n\nexposure_ms = -1.5\n", ":3: plan.exposure_ms: value -1.5", "allowed: 0.01 .. 10000"},
      {"[plan]\nexposure_ms = nan\n", ":2: plan.exposure_ms: value nan", "allowed: 0.01 .. 10000"},
      {"[plan]\nprojectors = 2.5\n", ":2: plan.projectors: value 2.5 is not an integer", "allowed: 1 .. 16"},
      {"[plan]\nbrackets = [1.0, -3]\n", ":2: plan.brackets: element 1, -3", "allowed: 0.001 .. 1000"},
      {"[plan]\nkind = \"party\"\n", ":2: kind 'party'", "allowed: visitor, calibration"},
      {"[plan]\nmotion_whites = 2\nmotion_blacks = 2\n", ":3: unknown key 'plan.motion_blacks'", "motion_whites"},
      {"[rig]\n[camara]\nwidth = 96\n", ":2: unknown key 'camara'",
       "known: camera, capture, gpio, kiosk, memory, plan, projector, retention, rig, store"},
      {"plan = 3\n", ":1: plan: must be a table", ""},
      {"[plan\nkind = 1\n", ":1: ", ""},
      {"this is no configuration\n", ":1: ", ""},
      {"\x89PNG\r\n\x1a\n\xff\xfe\xfd", ":1: ", ""},
  }};
  for (const auto& [text, place, remedy] : cases) {
    const std::string file = File("rig.toml", text);
    ExpectRefused("stratalux-rig capture --simulate --config " + file, 2, {file + place, remedy});
    ExpectRefused("stratalux-rig plan show --config " + file, 2, {file + place, remedy});
  }
  ExpectUnharmed();
}

TEST_F(WrongConfig, MustBeAFile) {
  ExpectRefused("stratalux-rig plan show --config " + (folder_ / "none.toml").string(), 2,
                {"none.toml", "No such file"});
  ExpectRefused("stratalux-rig plan show --config " + folder_.string(), 2, {folder_.string(), "folder, not a file"});
}

TEST_F(WrongPlan, IsRefusedBeforeTheFirstFrame) {
  const std::array<std::array<const char*, 3>, 10> cases = {{
      {"projector_width = 24", "spots period=160 radius=4", "pitch exceeds the projector"},
      {"comb_period = 2000", "comb columns period=2000", "exceeds the projector's 1024 px"},
      {"separation_period = 2", "separation_period: value 2", "allowed: 3 .. "},
      {"separation_period = 1025", "sinusoid columns period=1025", "must lie in 3 .. 1024 px"},
      {"comb_width = 0", "comb_width: value 0", "allowed: 1 .. "},
      {"comb_step = 4", "comb_step (at most comb_width) = 4", "allowed: 1 .. 2"},
      {"comb_width = 128", "comb columns period=128 width=128", "less than the period"},
      {"spot_pitch = 6", "spots period=6", "pitch more than its double"},
      {"projectors = 17", "projectors: value 17", "allowed: 1 .. 16"},
      {"projectors = 5", "5 projectors", "the rig has 4"},
  }};
  for (const auto& [line, place, remedy] : cases) {
    const std::string file =
        File("rig.toml", std::string("[camera]\nwidth = 160\nheight = 120\n[plan]\n") + line + "\n");
    ExpectRefused("stratalux-rig capture --simulate --config " + file, 2, {place, remedy});
  }
  ExpectUnharmed();
}

TEST_F(WrongSession, UnknownAndAmbiguousOnesAreNamed) {
  for (const char* verb : {"stratalux-db show", "stratalux-db frames", "stratalux-db verify", "stratalux-fit run",
                           "stratalux-fit decode", "stratalux-fit report"}) {
    ExpectRefused(std::string(verb) + " s9", 4, {"'s9'", store_.string(), "stratalux-db ls"});
    ExpectRefused(std::string(verb) + " s0000", 2, {"'s0000' is ambiguous", "s000001-", "s000002-", "more of the id"});
  }
  ExpectUnharmed();
}

TEST_F(WrongSession, WithoutSweepsCannotBeFitted) {
  ExpectRefused("stratalux-fit run s000002", 2, {Session("s000002").filename().string(), "only `decode`"});
  ExpectUnharmed();
}

class WrongPicture : public TinyStore {
 protected:
  // Two pictures of the visitor, 96 x 72 with 16 bits a sample.
  void SetUp() override {
    TinyStore::SetUp();
    ASSERT_EQ(Run("stratalux-db frames s000001 --phase reference --projector 0 --extract " + folder_.string()).code, 0);
    for (const auto& entry : fs::directory_iterator(folder_))
      if (entry.path().extension() == ".png")
        fs::rename(entry.path(),
                   folder_ / (entry.path().string().find("white") != std::string::npos ? "w.png" : "b.png"));
  }
  [[nodiscard]] std::string Manifest(const std::string& head, const std::string& white = "file = \"w.png\"\n") const {
    return File("m.toml",
                "[import]\nrig = \"bench\"\ncamera_width = 96\ncamera_height = 72\nprojector_width = 128\n"
                "projector_height = 96\n" +
                    head + "[[file]]\npattern = \"white\"\n" + white +
                    "[[file]]\nfile = \"b.png\"\npattern = \"black\"\n");
  }
  void ExpectImportRefused(const std::string& manifest, const std::vector<std::string>& parts) const {
    ExpectRefused("stratalux-db import --manifest " + manifest, 2, parts);
  }
};

TEST_F(WrongPicture, OfAnotherBitDepthOrFormatIsRefused) {
  const std::string line = "m.toml:8: ", picture = (folder_ / "w.png").string();
  ExpectImportRefused(Manifest("bit_depth = 8\n"), {line, picture, "has 16 bits", "bit_depth = 8 needs files of 8"});
  ExpectImportRefused(Manifest("bit_depth = 10\n"), {"m.toml:7: ", "bit_depth", "10 is not 8, 12 or 16"});
  ExpectImportRefused(Manifest("bit_depth = 12\nalignment = \"low\"\n"),
                      {"m.toml:9: ", picture, "exceeds 12 bits", "high"});
  const std::string twelve = Manifest("bit_depth = 12\n");
  ASSERT_TRUE(WritePng16(folder_ / "w.png", Image<uint16_t>(96, 72, 1, 0x1233).view()).ok());
  ExpectImportRefused(twelve, {line, picture, "sample 4659", "bit_depth = 16?"});
  ASSERT_TRUE(WritePng16(folder_ / "w.png", Image<uint16_t>(96, 72, 3, 0x1230).view()).ok());
  ExpectImportRefused(twelve, {line, picture, "colour image", "one channel"});
  ASSERT_TRUE(WritePng16(folder_ / "w.png", Image<uint16_t>(98, 72, 1, 0x1230).view()).ok());
  ExpectImportRefused(twelve, {line, picture, "98x72", "96x72"});
  ExpectUnharmed();
}

TEST_F(WrongPicture, ThatIsNoneIsRefused) {
  const std::string manifest = Manifest("bit_depth = 12\n"),
                    line = "m.toml:8: ", picture = (folder_ / "w.png").string();
  const std::string png = ReadText(picture);
  WriteText(picture, png.substr(0, png.size() / 2));
  ExpectImportRefused(manifest, {line, picture, "truncated"});
  WriteText(picture, "P5 96 72 255\n");
  ExpectImportRefused(manifest, {line, picture, "offset 13: truncated: 96x72 pixels need more"});
  WriteText(picture, "");
  ExpectImportRefused(manifest, {line, picture, "empty, 0 bytes"});
  fs::remove(picture);
  ExpectImportRefused(manifest, {line, picture, "No such file"});
  fs::create_directory(picture);
  ExpectImportRefused(manifest, {line, picture, "folder, not a file"});
  ExpectUnharmed();
}

TEST_F(WrongPicture, ManifestErrorsCarryTheirLine) {
  const std::string depth = "bit_depth = 12\n";
  ExpectImportRefused(Manifest(depth, "file = \"w.png\"\nprojector = 1\n"), {"m.toml", "projector", "allowed: 0 .. 0"});
  ExpectImportRefused(Manifest(depth, "fille = \"w.png\"\n"), {"m.toml:10: unknown key", "fille"});
  ExpectImportRefused(Manifest(""), {"m.toml:1: import.bit_depth: is missing"});
  ExpectImportRefused(File("m.toml", "[import\n"), {"m.toml:1: "});
  ExpectImportRefused(folder_.string(), {folder_.string(), "folder, not a file"});
  const std::string gray = Manifest(depth);
  WriteText(gray, ReadText(gray) + "[[file]]\nfile = \"w.png\"\npattern = \"gray columns bit=1/11\"\n");
  ExpectImportRefused(gray, {"m.toml:16: pattern", "at most 7 bits"});
  ExpectUnharmed();
}

TEST_F(NoRoom, AStoreThatCannotBeMadeIsNamed) {
  const std::string in_a_file = File("plain", "text") + "/store", config = File("rig.toml", kTinyConfig);
  const std::string capture = "stratalux-rig capture --simulate --config " + config + " --store ";
  const std::string long_name = (folder_ / std::string(300, 'x')).string();
  for (const std::string& place : {in_a_file, std::string("/proc/stratalux"), long_name}) {
    ExpectRefused(capture + place, 1, {"cannot create store " + place});
    ExpectRefused("stratalux-db init --store " + place, 1, {"cannot create store " + place});
  }
  ExpectRefused("stratalux-db frames s000001 --extract " + in_a_file, 1, {in_a_file});
  ExpectRefused("stratalux-rig plan render --out " + in_a_file, 1, {in_a_file});
}

// A file-size limit is the full disk that every machine has.
TEST_F(NoRoom, AFullDiskFailsTheSessionAndNoOther) {
  const std::string capture = "stratalux-rig capture --simulate --config " + File("rig.toml", kTinyConfig);
  const auto before = Contents(store_ / "sessions");
  const Outcome outcome = Run(capture, "trap '' XFSZ; ulimit -f 1000;");  // blocks of 512 or 1024 bytes
  EXPECT_EQ(outcome.code, 1) << outcome.err;
  EXPECT_THAT(outcome.out, HasSubstr(": failed, "));
  EXPECT_THAT(outcome.out, HasSubstr("frames-0001.seg: File too large"));
  const Outcome list = Run("stratalux-db ls");
  EXPECT_THAT(list.out, HasSubstr("s000003-"));
  EXPECT_THAT(list.out, HasSubstr("failed"));
  for (const auto& [name, text] : before) EXPECT_TRUE(ReadText(store_ / "sessions" / name) == text) << name;
  ExpectUnharmed();
  EXPECT_EQ(Run(capture).code, 0) << "with room again, the next capture works";
}

TEST_F(NoRoom, ADiskFullFromTheStartLeavesNoSession) {
  const std::string capture = "stratalux-rig capture --simulate --config " + File("rig.toml", kTinyConfig);
  const Outcome outcome = Run(capture, "trap '' XFSZ; ulimit -f 4;");
  EXPECT_EQ(outcome.code, 1) << outcome.err;
  EXPECT_EQ(outcome.out, "");
  EXPECT_THAT(outcome.err, HasSubstr(store_.string()));
  EXPECT_THAT(outcome.err, HasSubstr("free space"));
  ExpectUnharmed();
}

TEST_F(NoRoom, AFileSystemThatFillsUpSaysSoBeforeOrMeanwhile) {
  const fs::path room = folder_ / "room";
  fs::create_directory(room);
  const std::string bin = std::string(STRATALUX_BIN_DIR) + "/", log = (folder_ / "log").string();
  const std::string capture = bin + "stratalux-rig capture --simulate --config " + File("rig.toml", kTinyConfig) +
                              " --store " + room.string() + "; echo code=$?; ";
  const auto in_room = [&](const std::string& size, const std::string& script) {
    const std::string enter = "unshare -rm sh -c 'mount -t tmpfs -o size=" + size + " none " + room.string();
    if (std::system((enter + "' 2>/dev/null").c_str()) != 0) return false;
    EXPECT_EQ(std::system((enter + " && { " + script + "}' >" + log + " 2>&1").c_str()), 0);
    return true;
  };
  if (!in_room("512k", capture)) GTEST_SKIP() << "no file system may be mounted here";
  EXPECT_THAT(ReadText(log), AllOf(HasSubstr("free, the session may take"), HasSubstr("code=1")));
  // Somebody else's file takes what was free, once there are frames.
  const std::string fill = "(until [ -e " + room.string() + "/sessions/*/frames-0001.seg ]; do sleep 0.01; done; " +
                           "head -c 200M /dev/zero >" + room.string() + "/ballast) 2>/dev/null & ";
  // The capture of so few pixels may be over before that.
  for (int attempt = 0; attempt < 10; ++attempt) {
    in_room("100m",
            fill + capture + "wait; " + bin + "stratalux-db verify --store " + room.string() + "; echo verify=$?; ");
    if (ReadText(log).find("code=0") == std::string::npos) break;
  }
  // Frames or index, whichever meets the end first.
  EXPECT_THAT(ReadText(log), ::testing::AnyOf(HasSubstr("No space left on device"), HasSubstr("disk is full")));
  EXPECT_THAT(ReadText(log), AllOf(HasSubstr("code=1"), HasSubstr("verify=0")));
}

}  // namespace
}  // namespace stratalux
