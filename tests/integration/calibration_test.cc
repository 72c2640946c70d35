// SPDX-License-Identifier: Apache-2.0
// A rig is calibrated as its operator does it: twelve poses of a board are captured, one session each, and calibrated
// together. The simulated rig knows what must come out.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

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
using ::testing::AnyOf;
using ::testing::HasSubstr;

Json ReadJson(const fs::path& file) { return Json::parse(ReadText(file), nullptr, false); }

// fx fy cx cy k1 k2 p1 p2 k3, then of projectors the angle-axis vector and the translation.
std::vector<double> Parameters(const Json& device) {
  const Json& m = device["model"];
  std::vector<double> v = {m["fx"], m["fy"], m["cx"], m["cy"]};
  for (double k : m["distortion_k1_k2_p1_p2_k3"]) v.push_back(k);
  if (!device.contains("camera_from_projector")) return v;
  const auto q = device["camera_from_projector"]["quaternion_wxyz"].get<std::array<double, 4>>();
  const double n = std::hypot(q[1], q[2], q[3]), angle = 2.0 * std::atan2(n, q[0]);
  for (size_t i = 1; i < 4; ++i) v.push_back(n > 0.0 ? angle * q[i] / n : 0.0);
  for (double t : device["camera_from_projector"]["translation_mm"]) v.push_back(t);
  return v;
}

// Diagonal of the upper triangle, row by row.
std::vector<double> StandardDeviations(const Json& device, size_t parameters) {
  std::vector<double> sd;
  size_t at = 0;
  for (size_t i = 0; i < parameters; at += parameters - i, ++i)
    sd.push_back(std::sqrt(device["geometry_covariance"][at].get<double>()));
  return sd;
}

// Of the camera, in pixels; at night that of the figures in docs/math/calibration.md.
std::string Size() {
  const char* size = std::getenv("STRATALUX_CALIBRATION_SIZE");
  return size != nullptr ? size : "522x390";
}

class Calibration : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = fs::temp_directory_path() / ("stratalux_calibration_" + std::to_string(getpid()));
    store_ = (folder_ / "store").string();
    for (int pose = 0; pose < 12; ++pose)
      ASSERT_EQ(Execute(CaptureOf(pose) + " --store " + store_ + " --seed " + std::to_string(40 + pose)).code, 0)
          << "pose " << pose;
    const Outcome run =
        Execute("stratalux-fit calibrate --last 12 --store " + store_ + " --json --out " + Record(), Show::kStdout);
    code_ = run.code;
    result_ = Json::parse(run.out, nullptr, false);
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static std::string CaptureOf(int pose) {
    return "stratalux-rig capture --kind calibration --size " + Size() +
           " --simulate=" STRATALUX_SOURCE_DIR "/docs/examples/scenes/charuco_poses.toml --pose " +
           std::to_string(pose);
  }
  static std::string Record() { return (folder_ / "calibration.json").string(); }
  // What the simulation used: the record its sessions carry.
  static Json Truth() {
    for (const auto& session : fs::directory_iterator(fs::path(store_) / "sessions"))
      return ReadJson(session.path() / "manifest.json")["calibration"];
    return {};
  }

  static inline fs::path folder_;
  static inline std::string store_;
  static inline int code_ = -1;
  static inline Json result_;
};

TEST_F(Calibration, OfASimulatedRigIsAccepted) {
  ASSERT_EQ(code_, 0) << result_.dump(1);
  EXPECT_EQ(result_["verdict"], "accepted");
  EXPECT_EQ(result_["poses"].size(), 12U);
  EXPECT_TRUE(result_["left_out"].empty());
  for (const Json& pose : result_["poses"]) EXPECT_THAT(pose["name"].get<std::string>(), HasSubstr("pose "));
}

TEST_F(Calibration, FindsAllDevicesWithinThreeOfItsOwnStandardDeviations) {
  ASSERT_EQ(code_, 0);
  const Json record = ReadJson(Record()), truth = Truth();
  double squares = 0.0, largest = 0.0;
  int count = 0;
  auto compare = [&](const Json& found, const Json& wanted, const std::string& name) {
    const auto f = Parameters(found), w = Parameters(wanted);
    const auto sd = StandardDeviations(found, f.size());
    for (size_t i = 0; i < f.size(); ++i) {
      if (!(sd[i] > 0.0)) continue;  // a term that the chosen model does not have
      const double sigmas = (f[i] - w[i]) / sd[i];
      EXPECT_LE(std::abs(sigmas), 3.0) << name << ", parameter " << i << ": " << f[i] << ", true " << w[i];
      squares += sigmas * sigmas;
      largest = std::max(largest, std::abs(sigmas));
      ++count;
    }
  };
  compare(record["camera"], truth["camera"], "camera");
  ASSERT_EQ(record["projectors"].size(), 4U);
  for (size_t p = 0; p < 4; ++p)
    compare(record["projectors"][p], truth["projectors"][p], "projector " + std::to_string(p));
  std::cout << count << " parameters, largest error " << largest << " sd, root mean square "
            << std::sqrt(squares / count) << " sd; distortion " << result_["distortion"] << "\n";
  EXPECT_GE(count, 49);
}

TEST_F(Calibration, PredictsHeldOutPosesToASixthOfAPixel) {
  ASSERT_EQ(code_, 0);
  std::cout << "RMS " << result_["joint_rms_px"] << ", held out " << result_["held_out_joint_px"] << " px\n";
  EXPECT_LE(result_["held_out_joint_px"].get<double>(), 0.15);
  for (const Json& device : result_["devices"]) EXPECT_LE(device["held_out_px"].get<double>(), 0.15) << device["name"];
}

TEST_F(Calibration, StaysInTheStore) {
  ASSERT_EQ(code_, 0);
  const Json shown =
      Json::parse(Execute("stratalux-db show latest --json --store " + store_, Show::kStdout).out, nullptr, false);
  ASSERT_EQ(shown["fits"].size(), 1U);
  const std::string page = ReadText(fs::path(Record()).replace_extension(".html"));
  EXPECT_THAT(page, HasSubstr("Accepted"));
  EXPECT_THAT(page, HasSubstr("Before and after"));
  EXPECT_EQ(Execute("stratalux-db verify --store " + store_).code, 0);
}

TEST_F(Calibration, WithAWrongSquareSizeIsRefusedAndNamesTheRightOne) {
  const Outcome run =
      Execute("stratalux-fit calibrate --last 6 --store " + store_ +
              " --square-mm 25 --marker-mm 18.75 --distortion k1k2 --out " + (folder_ / "refused.json").string());
  EXPECT_EQ(run.code, 1) << run.out;
  EXPECT_THAT(run.out, HasSubstr("times as large as before"));
  EXPECT_THAT(run.out, HasSubstr("measure the board's squares: 20.0"));
  EXPECT_FALSE(fs::exists(folder_ / "refused.json"));
  // The page says so, too: it is there that the operator sees why.
  const std::string page = ReadText(folder_ / "refused.html");
  EXPECT_THAT(page, HasSubstr("Refused: do not use this calibration"));
  EXPECT_THAT(page, HasSubstr("times as large as before"));
}

TEST_F(Calibration, NamesThePoseInWhichTheBoardMovedAndGoesOnWithoutIt) {
  const std::string store = (folder_ / "moved").string();
  // In the midst of a projector's codes the sequencer would capture that projector anew. Before the reference of
  // projector 2 nothing contradicts the move but the calibration (FindStillBoard).
  ASSERT_THAT(Execute(CaptureOf(1) + " --store " + store + " --fault subject_moved@96=0.3").code, AnyOf(0, 3));
  for (int pose : {2, 3, 4, 5}) ASSERT_EQ(Execute(CaptureOf(pose) + " --store " + store).code, 0);
  const Outcome run = Execute("stratalux-fit calibrate --last 5 --distortion k1 --store " + store);
  EXPECT_EQ(run.code, 3) << run.out;
  EXPECT_THAT(run.out, HasSubstr("pose 1 (session s000001"));
  EXPECT_THAT(run.out, AnyOf(HasSubstr("the board moved by"), HasSubstr("capture it again with nothing moving")));
  // Captured again it is missing no longer, and of its two attempts the younger counts, in whatever order they are
  // named; both are one of the five.
  ASSERT_EQ(Execute(CaptureOf(1) + " --store " + store).code, 0);
  std::string newest_first;
  for (int number = 6; number >= 1; --number) newest_first += " s00000" + std::to_string(number);
  for (const std::string& sessions : {std::string(" --last 5"), newest_first}) {
    const Outcome again =
        Execute("stratalux-fit calibrate" + sessions + " --distortion k1 --json --store " + store, Show::kStdout);
    EXPECT_EQ(again.code, 0) << sessions;
    const Json result = Json::parse(again.out, nullptr, false);
    EXPECT_TRUE(result["left_out"].empty()) << sessions;
    ASSERT_EQ(result["poses"].size(), 5U) << sessions;
    std::string names;
    for (const Json& pose : result["poses"]) names += pose["name"].get<std::string>() + "; ";
    EXPECT_THAT(names, HasSubstr("pose 1 (session s000006")) << sessions;
  }
}

TEST_F(Calibration, SaysThatThereIsNoBoard) {
  const std::string store = (folder_ / "plain").string();
  ASSERT_EQ(Execute("stratalux-rig capture --kind calibration --size 348x260 --simulate=white --store " + store).code,
            0);
  const Outcome run = Execute("stratalux-fit calibrate latest --store " + store);
  EXPECT_EQ(run.code, 1) << run.out;
  EXPECT_THAT(run.out, HasSubstr("no charuco board of 10x7 squares"));
  const Outcome usage = Execute("stratalux-fit calibrate latest --squares 10by7 --store " + store);
  EXPECT_EQ(usage.code, 2);
  EXPECT_THAT(usage.out, HasSubstr("--squares '10by7'"));
}

}  // namespace
}  // namespace stratalux
