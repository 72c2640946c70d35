// SPDX-License-Identifier: Apache-2.0
// A visitor who sways during the capture, and one who jumps: each frame is still proven, the fitter finds how the head
// moved, and the surface is as good as of one who held still (docs/math/motion.md).
//   STRATALUX_VISITOR_SIZE=696x520 STRATALUX_SEED=2001 moving_head_test     prints the figures of another visitor
#include <Eigen/Geometry>
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "fitter/evaluation/surface_error.h"
#include "fitter/evaluation/truth.h"
#include "fitter/stages/shape.h"
#include "shared/units/angle.h"
#include "tests/fitter/export/read_export.h"
#include "tests/support/drawn.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

std::string Given(const char* variable, const char* otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? text : otherwise;
}

// From about the first white frame on; a millimetre and half a degree in ten seconds, by day four tenths of that. Each
// step costs a light transport, and is a jump: of more than these, edges in the picture give other patterns away.
struct Sway {
  double mm_per_s = 0.0, deg_per_s = 0.0, step_mm = 0.0;
};
const bool kNight = std::getenv("STRATALUX_VISITOR_SIZE") != nullptr;
const Sway kSway = kNight ? Sway{0.06, 0.05, 0.02} : Sway{0.025, 0.02, 0.02};

class MovingHead : public ScratchFolderTest {
 protected:
  // Each of the two captures takes as long as ten others.
  static bool IsLeftToTheNight(int which) { return !kNight && !IsDrawn(which, 2); }
  // A capture of the scene in a store of its own.
  void Capture(const std::string& scene, const std::string& options) {
    const std::string at = " --store " + store_;
    WriteText(folder_ / "scene.toml", scene);
    ASSERT_EQ(Execute("stratalux-db init" + at).code, 0);
    capture_ = Execute("stratalux-rig capture --simulate=" + (folder_ / "scene.toml").string() +
                       " --exposure auto --size " + Given("STRATALUX_VISITOR_SIZE", "348x260") + options + at);
    EXPECT_EQ(capture_.code, 3) << "degraded: the visitor moved";
    EXPECT_THAT(capture_.out, HasSubstr("the visitor moved"));
    EXPECT_THAT(capture_.out, Not(HasSubstr("no proven frame")));
    for (const auto& entry : fs::directory_iterator(store_ + "/sessions")) session_ = entry.path();
  }

  void CaptureASway() {
    constexpr uint64_t kPeople = 1'000'000;  // of the population; a night's seed is its date
    const std::string number = std::to_string(std::stoull(Given("STRATALUX_SEED", "2001")) % kPeople);
    Capture("[subject]\nseed = " + number + "\n[skin]\nperson = " + number +
                "\n[motion]\ndrift_start_s = 1.0\nstep_mm = " + std::to_string(kSway.step_mm) + "\ndrift_mm_per_s = [" +
                std::to_string(kSway.mm_per_s) + ", " + std::to_string(kSway.mm_per_s) + ", " +
                std::to_string(kSway.mm_per_s) + "]\nturn_deg_per_s = [" + std::to_string(kSway.deg_per_s) + ", " +
                std::to_string(kSway.deg_per_s) +
                ", 0]\n[timing]\nreadout_ms = 8.0\noverlapped_readout = true\nmin_frame_period_ms = 16.667\n",
            " --seed " + number);
  }

  FaceShape Reconstruct(const std::string& options) {
    const Outcome made = Execute("stratalux-fit reconstruct latest " + options + " --store " + store_);
    EXPECT_EQ(made.code, 0) << made.out;
    said_ = made.out;
    // The newest of the two.
    fs::path folder;
    for (const auto& entry : fs::directory_iterator(session_ / "artifacts"))
      if (entry.path().filename().string().starts_with("shape-") &&
          (folder.empty() || fs::last_write_time(entry.path()) > fs::last_write_time(folder)))
        folder = entry.path();
    auto shape = LoadShape(folder);
    EXPECT_TRUE(shape.ok()) << shape.status().message();
    return shape.ok() ? *std::move(shape) : FaceShape();
  }

  [[nodiscard]] SurfaceError Error(const FaceShape& shape) const {
    const auto truth = SceneTruth::Open(session_);
    const auto surface = (*truth)->SurfaceInItsRig(shape.record);
    EXPECT_TRUE(surface.ok());
    return CompareWithTruth(shape.surface, shape.record, *surface);
  }

  const std::string store_ = (folder_ / "store").string();
  fs::path session_;
  Outcome capture_;
  std::string said_;
};

// What the scene moves the point by between the reference time and `seconds` after it.
Eigen::Vector3d TrueMotion(const Eigen::Vector3d& point, double seconds) {
  const Eigen::Vector3d pivot(0.0, 0.0, 700.0), turn = RadFromDeg(kSway.deg_per_s) * seconds * Eigen::Vector3d(1, 1, 0);
  const Eigen::Vector3d arm = point - pivot;
  return Eigen::AngleAxisd(turn.norm(), turn.normalized()) * arm - arm +
         kSway.mm_per_s * seconds * Eigen::Vector3d::Ones();
}

// `stratalux-fit cloud` knows of the motion too: its points are those of the reference time.
void ExpectCloudOf(const FaceShape& carried, const std::string& store, const fs::path& folder) {
  const Outcome made = Execute(
      "stratalux-fit cloud latest --json --out " + (folder / "points").string() + " --store " + store, Show::kStdout);
  ASSERT_EQ(made.code, 0);
  const auto cloud = nlohmann::json::parse(made.out).at("clouds").at(0);
  EXPECT_TRUE(cloud.at("motion").at("moved"));
  EXPECT_NEAR(cloud.at("motion").at("largest_mm").get<double>(), carried.motion.head.largest_mm, 0.05);
  EXPECT_EQ(cloud.at("drift").at("warning"), "");
  const auto columns = ReadPly(folder / "points" / "cloud.ply").columns;
  std::vector<double> off_mm;
  const CameraCalibration& camera = carried.record.camera;
  for (size_t v = 0; v < columns.at("x").size(); ++v) {
    const Eigen::Vector3d point(columns.at("x")[v], columns.at("y")[v], columns.at("z")[v]);
    const Eigen::Vector2d pixel = *camera.model.Project(point);
    const int i = static_cast<int>(std::lround((pixel.x() - 0.5) / 2)),
              j = static_cast<int>(std::lround((pixel.y() - 0.5) / 2));
    if (carried.surface.mask.view().contains(i, j) && carried.surface.mask(i, j) != 0)
      off_mm.push_back((carried.surface.Point(i, j) - point).norm());
  }
  ASSERT_GT(off_mm.size(), columns.at("x").size() * 95 / 100);
  std::ranges::sort(off_mm);
  std::printf("cloud: %zu points, %.4f mm from the shape stage's (median), %.4f (95 %%)\n", off_mm.size(),
              off_mm[off_mm.size() / 2], off_mm[off_mm.size() * 95 / 100]);
  EXPECT_LT(off_mm[off_mm.size() / 2], 0.02) << "as if still: 0.12";
  EXPECT_LT(off_mm[off_mm.size() * 95 / 100], 0.08);
}

// Half a millimetre to the side, late in projector 2's sweep: all it showed until then is captured anew.
TEST_F(MovingHead, AJumpIsCapturedAnewFoundAndMadeUpFor) {
  if (IsLeftToTheNight(0)) GTEST_SKIP() << "by day with an even STRATALUX_SEED";
  constexpr double kJump_mm = 0.5;
  Capture(ReadText(fs::path(STRATALUX_SOURCE_DIR) / "docs/examples/scenes/bearded.toml") +
              "\n[[fault]]\nkind = \"subject_moved\"\nat = 350\nvalue = " + std::to_string(kJump_mm) + "\n",
          " --seed 3");
  EXPECT_THAT(capture_.out, HasSubstr("captured again"));

  const FaceShape carried = Reconstruct("");
  const HeadMotion& head = carried.motion.head;
  ASSERT_TRUE(head.moved);
  // Nothing before it, the whole of it behind it, at every moment that is carried.
  double worst = 0.0;
  for (size_t p = 0; p < carried.motion.projectors.size(); ++p) {
    const ProjectorMoments& at = carried.motion.projectors[p];
    for (const double seconds : {at.codes_s, at.separation_s, at.sweep_s}) {
      const Eigen::Vector3d place = head.At(seconds) * head.pivot - head.pivot;
      worst = std::max(worst, (place - (p < 2 ? 0.0 : kJump_mm) * Eigen::Vector3d::UnitX()).norm());
    }
  }
  // By the whites that were captured anew, which alone saw it happen.
  double jump_mm = 0.0, within_s = 0.0;
  for (size_t k = 1; k < head.poses.size(); ++k) {
    const Vector6 moved = head.poses[k].motion.Vector() - head.poses[k - 1].motion.Vector();
    if (std::abs(moved[3]) <= jump_mm) continue;
    jump_mm = std::abs(moved[3]);
    within_s = head.poses[k].seconds - head.poses[k - 1].seconds;
  }
  std::printf("jumped by %.3f mm within %.2f s, found to %.3f mm at the worst, said to %.3f\n", jump_mm, within_s,
              worst, head.sigma_mm);
  EXPECT_NEAR(jump_mm, kJump_mm, 0.05) << "about the middle of the face: a turn takes some of it";
  EXPECT_LT(within_s, 1.0);
  EXPECT_LT(worst, 0.15);

  ExpectCloudOf(carried, store_, folder_);
  const FaceShape as_captured = Reconstruct("--motion off");
  const SurfaceError with = Error(carried), without = Error(as_captured);
  std::printf("depth rms %.3f, bias %.3f; as if still %.3f, %.3f\n", with.depth_rms_mm, with.depth_bias_mm,
              without.depth_rms_mm, without.depth_bias_mm);
  EXPECT_LT(with.depth_rms_mm, without.depth_rms_mm - 0.02);
}

TEST_F(MovingHead, ASwayIsProvenFoundAndMadeUpFor) {
  if (IsLeftToTheNight(1)) GTEST_SKIP() << "by day with an odd STRATALUX_SEED";
  CaptureASway();
  EXPECT_THAT(capture_.out, Not(HasSubstr("the level check failed"))) << "a sway makes no frame another one";

  const FaceShape carried = Reconstruct("");
  EXPECT_THAT(said_, HasSubstr("the head moved by"));
  const HeadMotion& head = carried.motion.head;
  ASSERT_TRUE(head.moved);
  EXPECT_LT(head.detail_after, head.detail_before);
  double worst = 0.0;
  for (const HeadPose& pose : head.poses)
    for (const Eigen::Vector3d& arm :
         {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(40, 0, 10), Eigen::Vector3d(0, 60, 0)}) {
      const Eigen::Vector3d point = head.pivot + arm;
      const Eigen::Vector3d found = pose.motion.About(head.pivot) * point - point;
      worst = std::max(worst, (found - TrueMotion(point, pose.seconds)).norm());
    }
  const Eigen::Vector3d whole = TrueMotion(head.pivot, head.poses.back().seconds);
  std::printf("moved %.2f mm, found to %.3f mm at the worst of poses and three points\n", whole.norm(), worst);
  EXPECT_LT(worst, 0.15);
  EXPECT_GT(whole.norm(), 0.4);

  ExpectCloudOf(carried, store_, folder_);
  const FaceShape as_captured = Reconstruct("--motion off");
  EXPECT_FALSE(as_captured.motion.moved());
  const SurfaceError with = Error(carried), without = Error(as_captured);
  std::printf("depth rms %.3f, bias %.3f, projectors apart %.2f px; as if still %.3f, %.3f, %.2f\n", with.depth_rms_mm,
              with.depth_bias_mm, carried.drift.projectors[3].shift_px, without.depth_rms_mm, without.depth_bias_mm,
              as_captured.drift.projectors[3].shift_px);
  EXPECT_LT(with.depth_rms_mm, without.depth_rms_mm - 0.02);
  EXPECT_LT(with.depth_bias_mm, without.depth_bias_mm - 0.05) << "both hold by how much scattering displaces codes";
  for (const ProjectorDrift& drift : carried.drift.projectors) EXPECT_LT(drift.shift_px, 0.1) << drift.projector;
  EXPECT_GT(as_captured.drift.projectors[3].shift_px, 0.1) << "what is left where nothing is made up for";
}

}  // namespace
}  // namespace stratalux::fit
