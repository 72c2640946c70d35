// SPDX-License-Identifier: Apache-2.0
// What goes wrong when a rig is calibrated and used, from the command line: each fault is named with its remedy, and
// none ends in a silently bad result.
#include <chrono>
#include <filesystem>
#include <future>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class CalibrationFaults : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = fs::temp_directory_path() / ("stratalux_calibration_faults_" + std::to_string(getpid()));
    fs::create_directories(folder_);
    // Five poses of the shipped scene; and the same board held frontally.
    WriteText(folder_ / "tilted.toml", Board() + Pose("0, 0, 0", "12, -6, 3") + Pose("5, -8, 20", "22, 0, 4") +
                                           Pose("-8, 6, 10", "-22, 5, -3") + Pose("6, 4, -15", "3, 24, 2") +
                                           Pose("-5, -6, 25", "-4, -24, 8"));
    WriteText(folder_ / "frontal.toml", Board() + Pose("0, 0, 0", "0, 0, 2") + Pose("8, 4, 20", "0, 0, 10") +
                                            Pose("-8, 6, -15", "0, 0, -5") + Pose("3, -6, 30", "0, 0, 20"));
    const Outcome series = Execute(Capture("tilted.toml") + " --store " + Store("tilted") + " --json", Show::kStdout);
    ASSERT_EQ(series.code, 0) << series.out;
    series_ = Json::parse(series.out, nullptr, false);
    exact_ =
        Json::parse(ReadText(fs::path(Store("tilted")) / "sessions" / Session(0) / "manifest.json"))["calibration"];
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static std::string Board() {
    return "[subject]\nshape = \"charuco\"\n[plate]\ncolumns = 10\nrows = 7\nsquare_mm = 20\nmarker_mm = 15\n";
  }
  static std::string Pose(const std::string& position, const std::string& rotation) {
    return "[[pose]]\nposition_mm = [" + position + "]\nrotation_deg = [" + rotation + "]\n";
  }
  static std::string Capture(const std::string& scene) {
    return "stratalux-rig capture --kind calibration --size 348x260 --simulate=" + (folder_ / scene).string();
  }
  static std::string Store(const std::string& name) { return (folder_ / name).string(); }
  static std::string Session(size_t pose) { return series_["poses"][pose]["session"]; }
  static Outcome Calibrate(const std::string& arguments) {
    return Execute("stratalux-fit calibrate --distortion k1 " + arguments);
  }

  static inline fs::path folder_;
  static inline Json series_, exact_;
};

// The store's index goes between two poses, as with a disk that is pulled: those before are told, and where to go on.
TEST_F(CalibrationFaults, ASeriesThatAnErrorEndsTellsThePosesBefore) {
  const fs::path store = Store("gone");
  auto running = std::async(std::launch::async, [&] {
    return Execute(Capture("tilted.toml") + " --store " + store.string() + " --json", Show::kStdout);
  });
  const auto first_is_whole = [&] {
    std::error_code error;
    for (const auto& session : fs::directory_iterator(store / "sessions", error))
      if (ReadText(session.path() / "manifest.json").find("\"complete\"") != std::string::npos) return true;
    return false;
  };
  while (!first_is_whole() && running.wait_for(std::chrono::milliseconds(20)) != std::future_status::ready) continue;
  for (const char* name : {"index.sqlite", "index.sqlite-wal", "index.sqlite-shm"}) {
    std::error_code error;
    fs::rename(store / name, store / (std::string(name) + ".away"), error);
  }
  const Outcome series = running.get();
  EXPECT_EQ(series.code, 1) << series.out;
  const Json json = Json::parse(series.out, nullptr, false);
  ASSERT_TRUE(json.is_object()) << series.out;
  EXPECT_FALSE(json["finished"]);
  EXPECT_THAT(json.value("error", ""), HasSubstr("index.sqlite"));
  EXPECT_GE(json["sessions"].size(), 1U);
  EXPECT_LT(json["sessions"].size(), 5U);
  for (const Json& pose : json["poses"]) EXPECT_NE(pose["session"], "") << pose;
}

TEST_F(CalibrationFaults, ASeriesTellsItsSessionsAndWhatTheBoardCovered) {
  ASSERT_EQ(series_["poses"].size(), 5U);
  for (const Json& pose : series_["poses"]) EXPECT_TRUE(pose["usable"]) << pose;
  EXPECT_EQ(series_["sessions"].size(), 5U);
  EXPECT_TRUE(series_["finished"]);
  EXPECT_GT(series_["coverage"]["camera"]["share"].get<double>(), 0.3);
  ASSERT_EQ(series_["coverage"]["projectors"].size(), 4U);
  for (const Json& p : series_["coverage"]["projectors"]) EXPECT_GT(p["share"].get<double>(), 0.3);
}

TEST_F(CalibrationFaults, ASaturatedBoardIsNamedByTheRigAndByTheFitter) {
  const std::string store = Store("bright");
  const Outcome rig = Execute(Capture("tilted.toml") + " --pose 0 --exposure 64 --store " + store);
  EXPECT_EQ(rig.code, 3) << rig.out;
  EXPECT_THAT(rig.out, AllOf(HasSubstr("saturated"), HasSubstr("--exposure 32")));
  const Outcome fit = Calibrate("latest --store " + store);
  EXPECT_NE(fit.code, 0);
  EXPECT_THAT(fit.out, AllOf(HasSubstr("saturated"), HasSubstr("pose 0")));
}

TEST_F(CalibrationFaults, FrontalPosesAreRefused) {
  const std::string store = Store("frontal");
  ASSERT_EQ(Execute(Capture("frontal.toml") + " --store " + store).code, 0);
  const Outcome fit = Calibrate("--last 4 --store " + store);
  EXPECT_EQ(fit.code, 1) << fit.out;
  EXPECT_THAT(fit.out, HasSubstr("tilt"));
}

// Projectors 1 and 2 were exchanged since the calibration that the sessions name.
TEST_F(CalibrationFaults, SwappedCablesAreNamedAgainstTheEarlierCalibration) {
  Json earlier = exact_;
  std::swap(earlier["projectors"][1], earlier["projectors"][2]);
  WriteText(folder_ / "earlier.json", earlier.dump());
  std::string sessions;
  for (size_t pose = 0; pose < 5; ++pose) sessions += Session(pose) + " ";
  const Outcome fit =
      Calibrate(sessions + "--known-rig " + (folder_ / "earlier.json").string() + " --store " + Store("tilted"));
  EXPECT_EQ(fit.code, 1) << fit.out;
  EXPECT_THAT(fit.out, AllOf(HasSubstr("projector 1 stands where projector 2 stood"), HasSubstr("cable")));
}

// As a projector whose inverse pictures lie in the memory where the others belong.
TEST_F(CalibrationFaults, InvertedCodesAreNamedWithTheProjector) {
  const std::string out = (folder_ / "exported").string();
  ASSERT_EQ(
      Execute("stratalux-db export " + Session(0) + " --format tiff --out " + out + " --store " + Store("tilted")).code,
      0);
  std::string manifest = ReadText(fs::path(out) / "import.toml"), swapped;
  std::string pattern;
  for (size_t at = 0; at < manifest.size();) {
    const size_t end = manifest.find('\n', at);
    std::string line = manifest.substr(at, end - at);
    at = end + 1;
    // The projector stands behind the pattern.
    if (line.starts_with("pattern = \"gray columns")) {
      pattern = line;
      continue;
    }
    if (!pattern.empty() && line == "projector = 1") {
      const size_t inverse = pattern.find(" inverse");
      if (inverse == std::string::npos) {
        pattern.insert(pattern.size() - 1, " inverse");
      } else {
        pattern.erase(inverse, 8);
      }
    }
    if (!pattern.empty() && line.starts_with("projector = ")) {
      swapped += pattern + "\n";
      pattern.clear();
    }
    swapped += line + "\n";
  }
  WriteText(fs::path(out) / "inverted.toml", swapped);
  const std::string store = Store("inverted");
  ASSERT_EQ(Execute("stratalux-db init --store " + store).code, 0);
  const Outcome import = Execute("stratalux-db import --manifest " + out + "/inverted.toml --store " + store);
  ASSERT_EQ(import.code, 0) << import.out;
  const Outcome fit = Calibrate("latest --store " + store);
  EXPECT_NE(fit.code, 0);
  EXPECT_THAT(fit.out, AllOf(HasSubstr("projector 1"), HasSubstr("inverted")));
}

TEST_F(CalibrationFaults, ASessionThatNamesNoCalibrationThatIsThereIsNotCaptured) {
  const std::string store = Store("empty");
  const std::string visit = "stratalux-rig capture --simulate=plane --size 160x120 --store " + store;
  const Outcome none = Execute(visit + " --calibration latest");
  EXPECT_EQ(none.code, 4) << none.out;
  EXPECT_THAT(none.out, HasSubstr("--calibration latest"));
  EXPECT_FALSE(fs::exists(store));
  WriteText(folder_ / "exact.json", exact_.dump());
  const Outcome other = Execute(visit + " --calibration " + (folder_ / "exact.json").string());
  EXPECT_EQ(other.code, 2) << other.out;
  EXPECT_THAT(other.out, AllOf(HasSubstr("348x260"), HasSubstr("160x120")));
}

// The store's own calibration becomes a version, and is what a visitor's session names; the simulation's knowledge is
// kept from the fit.
TEST_F(CalibrationFaults, AVisitorNamesTheNewestVersionAndTheExactRecordStaysTruth) {
  const fs::path store = Store("tilted");
  std::string sessions;
  for (size_t pose = 0; pose < 5; ++pose) sessions += Session(pose) + " ";
  const Outcome accepted = Calibrate(sessions + "--valid-days 0.01 --json --store " + store.string());
  ASSERT_EQ(accepted.code, 0) << accepted.out;
  const Outcome ages = Execute("stratalux-db query calibration-age --json --store " + store.string(), Show::kStdout);
  EXPECT_THAT(ages.out, AllOf(HasSubstr("\"version\""), HasSubstr("valid")));
  const Outcome visit =
      Execute("stratalux-rig capture --simulate=white --size 348x260 --kind flat --calibration latest --json --store " +
                  store.string(),
              Show::kStdout);
  ASSERT_EQ(visit.code, 0) << visit.out;
  const fs::path session = store / "sessions" / Json::parse(visit.out)["session"].get<std::string>();
  const Json named = Json::parse(ReadText(session / "manifest.json"))["calibration"];
  EXPECT_THAT(named["source"].get<std::string>(), HasSubstr("calibration session " + Session(4)));
  EXPECT_NE(named["camera"]["model"]["fx"], exact_["camera"]["model"]["fx"]);
  EXPECT_EQ(Json::parse(ReadText(session / "truth_calibration.json")), exact_);
}

// A projector is turned by 0.15 degrees after the calibration.
TEST_F(CalibrationFaults, AVisitorTellsThatAProjectorWasTurned) {
  WriteText(folder_ / "exact.json", exact_.dump());
  WriteText(folder_ / "turned.toml",
            "[subject]\nshape = \"sphere\"\n[[projector]]\n[[projector]]\n[[projector]]\n"
            "turned_deg = [0.1, -0.11, 0]\n[[projector]]\n");
  WriteText(folder_ / "straight.toml", "[subject]\nshape = \"sphere\"\n");
  // A short sweep: the codes tell it.
  WriteText(folder_ / "rig.toml", "[plan]\ncomb_period = 16\nmotion_whites = 0\nspot_radius = 0\n");
  for (const std::string scene : {"straight", "turned"}) {
    const std::string store = Store("visit_" + scene);
    ASSERT_EQ(Execute("stratalux-rig capture --no-scattering --size 348x260 --config " +
                      (folder_ / "rig.toml").string() + " --simulate=" + (folder_ / (scene + ".toml")).string() +
                      " --calibration " + (folder_ / "exact.json").string() + " --store " + store)
                  .code,
              0);
    const Outcome fit = Execute("stratalux-fit reconstruct latest --store " + store);
    EXPECT_EQ(fit.code, 0) << fit.out;
    if (scene == "turned") {
      EXPECT_THAT(fit.out, HasSubstr("recalibration is due: the light of projector 2"));
    } else {
      EXPECT_THAT(fit.out, Not(HasSubstr("recalibration")));
    }
  }
}

// Boards of another program carry no record: light is kept from --known-rig, or was never measured.
TEST_F(CalibrationFaults, LightThatNothingTellsIsKeptFromTheKnownRigOrSaidToBeMissing) {
  const std::string store = Store("bare");
  ASSERT_EQ(Execute("stratalux-db init --store " + store).code, 0);
  std::string boards;
  for (size_t pose = 0; pose < 5; ++pose) {
    const std::string out = (folder_ / ("bare_" + std::to_string(pose))).string();
    const Outcome exported =
        Execute("stratalux-db export " + Session(pose) + " --format tiff --out " + out + " --store " + Store("tilted"));
    ASSERT_EQ(exported.code, 0) << exported.out;
    const Outcome import = Execute("stratalux-db import --manifest " + out + "/import.toml --store " + store);
    ASSERT_EQ(import.code, 0) << import.out;
    boards += "s00000" + std::to_string(pose + 1) + " ";
  }
  Json known = exact_;
  known["camera"]["gain_e_per_dn"] = 3.25;
  known["projectors"][1]["response"] = {0.0, 0.2, 0.6, 1.0};
  const std::string known_file = (folder_ / "known.json").string(), out = (folder_ / "kept.json").string();
  WriteText(known_file, known.dump());
  const Outcome kept = Calibrate(boards + "--known-rig " + known_file + " --out " + out + " --store " + store);
  ASSERT_EQ(kept.code, 0) << kept.out;
  EXPECT_THAT(kept.out, AllOf(HasSubstr("kept from --known-rig " + known_file + ": all light"),
                              Not(HasSubstr("never measured"))));
  const Json record = Json::parse(ReadText(out), nullptr, false);
  EXPECT_EQ(record["camera"]["gain_e_per_dn"], 3.25);
  EXPECT_EQ(record["projectors"][1]["response"], known["projectors"][1]["response"]);
  EXPECT_NE(record["camera"]["model"]["fx"], exact_["camera"]["model"]["fx"]);
  ASSERT_EQ(Execute("stratalux-rig capture --kind dark --size 348x260 --simulate=white --store " + store).code, 0);
  const Outcome dark = Calibrate(boards + "s000006 --out " + out + " --store " + store);
  ASSERT_EQ(dark.code, 0) << dark.out;
  EXPECT_THAT(dark.out, AllOf(HasSubstr("warning: part of the light was never measured; camera gain"),
                              HasSubstr("never measured: projector response"), Not(HasSubstr("kept from"))));
}

}  // namespace
}  // namespace stratalux
