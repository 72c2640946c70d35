// SPDX-License-Identifier: Apache-2.0
// A visitor captured with each code of columns: every frame is proven, the surface stands, and what each code makes of
// it against the truth (docs/math/geometry.md, "Which code").
//   STRATALUX_VISITOR_SIZE=696x520 STRATALUX_SEED=2001 STRATALUX_CODES_PLAN=default codes_test     prints the table
// STRATALUX_SCENE: a scene file in place of the person of that number.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include "fitter/evaluation/surface_error.h"
#include "fitter/evaluation/truth.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/decode.h"
#include "fitter/stages/shape.h"
#include "shared/base/log.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

std::string Given(const char* variable, const std::string& otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? text : otherwise;
}

// By day, a projector whose pixels the small camera tells apart, as a whole camera does a whole projector's.
constexpr const char* kSmallPlan =
    "projector_width = 256\nprojector_height = 192\npreroll_markers = 4\ncomb_period = 32\nspot_radius = 0\n"
    "motion_whites = 0\nguards = 1\n";
// Of the plan's frames, all but some of the sweep, of which geometry has no use.
constexpr const char* kDefaultPlan = "comb_period = 32\n";

struct Figures {
  double decoded = 0.0;  // of lit sites
  double skin = 0.0;     // of the skin's quads that have a surface
  SurfaceError error;    // on skin
  SurfaceError first;    // of the first code's surface, on those of its quads that this one has, too
};

SurfaceMap OnSkin(SurfaceMap truth, const Image<uint8_t>& skin) {
  for (size_t i = 0; i < skin.size() && !skin.empty(); ++i)
    if (skin.data()[i] == 0) truth.mask.data()[i] = 0;
  return truth;
}

class Codes : public ScratchFolderTest, public ::testing::WithParamInterface<const char*> {
 protected:
  void Capture(const std::string& code) {
    const std::string at = " --store " + store_, seed = Given("STRATALUX_SEED", "2001");
    const std::string rig = (folder_ / "rig.toml").string(), scene = (folder_ / "scene.toml").string();
    WriteText(rig, std::string("[plan]\nsecond_takes = false\n") +
                       (Given("STRATALUX_CODES_PLAN", "small") == "default" ? kDefaultPlan : kSmallPlan));
    WriteText(scene, "[subject]\nseed = " + seed + "\n[skin]\nperson = " + seed + "\n");
    ASSERT_EQ(Execute("stratalux-db init" + at).code, 0);
    capture_ = Execute("stratalux-rig capture --config " + rig + " --simulate=" + Given("STRATALUX_SCENE", scene) +
                       " --exposure auto --seed " + seed + " --size " + Given("STRATALUX_VISITOR_SIZE", "348x260") +
                       " --code " + code + at);
  }

  static Figures Judge(const SessionFrames& frames, CodeReading reading) {
    Logger logger(LogLevel::kError);
    Figures figures;
    const auto decoded = DecodeFace(frames, logger, reading);
    if (!decoded.ok()) return ADD_FAILURE() << decoded.status().message(), figures;
    int64_t lit = 0;
    for (int r = 0; r < kDecodeReasons; ++r)
      if (r != static_cast<int>(DecodeReason::kUnlit)) lit += decoded->counts[r];
    figures.decoded = static_cast<double>(decoded->counts[0]) / static_cast<double>(lit);
    const RigCalibration& rig = *frames.calibration();
    const auto shape = ReconstructShape(decoded->maps, {}, rig, rig);
    if (!shape.ok()) return figures;  // no surface is left
    const auto truth = SceneTruth::Open(frames.folder());
    const auto skin = (*truth)->Skin();
    const SurfaceMap on_skin = OnSkin((*truth)->SurfaceInItsRig(rig)->surface, *skin);
    figures.error = CompareSurface(shape->surface, on_skin);
    const auto first = first_.try_emplace(reading, shape->surface).first;
    figures.first = CompareSurface(first->second, OnSkin(on_skin, shape->surface.mask));
    int64_t all = 0;
    for (const uint8_t quad : on_skin.mask.pixels()) all += quad;
    figures.skin = static_cast<double>(figures.error.pixels) / static_cast<double>(all);
    return figures;
  }

  static inline std::map<CodeReading, SurfaceMap> first_;
  const std::string store_ = (folder_ / "store").string();
  Outcome capture_;
};

TEST_P(Codes, AreProvenAndGiveASurface) {
  Capture(GetParam());
  EXPECT_EQ(capture_.code, 0) << capture_.out;
  const auto frames = SessionFrames::Open(store_, "latest");
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  EXPECT_STREQ(ToString(frames->plan()->ShownCode()), GetParam());
  int64_t proven = 0, failed = 0;
  for (const db::FrameRow& row : frames->rows()) {
    proven += row.record.level_check == LevelCheck::kPassed ? 1 : 0;
    failed += row.record.level_check == LevelCheck::kFailed ? 1 : 0;
  }
  EXPECT_EQ(failed, 0);
  EXPECT_GT(proven, static_cast<int64_t>(frames->rows().size() * 9 / 10)) << "black frames are not asked";
  for (const auto& [name, reading] :
       {std::pair("with sinusoids", CodeReading::kWithSinusoids), {"bits alone", CodeReading::kBitsAlone}}) {
    const Figures f = Judge(*frames, reading);
    std::printf(
        "%-10s %-14s %zu frames, %lld checked; decoded %.1f %% of lit sites; surface on %.1f %% of skin, depth bias "
        "%+.3f mm, rms about it %.3f mm (the first code's there: %+.3f, %.3f)\n",
        GetParam(), name, frames->rows().size(), static_cast<long long>(proven), 100.0 * f.decoded, 100.0 * f.skin,
        f.error.depth_bias_mm, f.error.depth_rms_mm, f.first.depth_bias_mm, f.first.depth_rms_mm);
    if (std::getenv("STRATALUX_CODES_PLAN") != nullptr) continue;
    EXPECT_GT(f.decoded, 0.65) << name;
    EXPECT_GT(f.skin, 0.98) << name;
    EXPECT_LT(f.error.depth_rms_mm, reading == CodeReading::kBitsAlone ? 0.3 : 0.12) << name;
  }
  if (std::getenv("STRATALUX_CODES_PLAN") != nullptr) return;
  const Outcome made = Execute("stratalux-fit reconstruct latest --store " + store_);
  EXPECT_EQ(made.code, 0) << made.out;
  const std::string decode = "stratalux-fit decode latest --json --store " + store_;
  const Outcome with = Execute(decode, Show::kStdout), alone = Execute(decode + " --bits-alone", Show::kStdout);
  EXPECT_EQ(with.code, 0);
  EXPECT_EQ(alone.code, 0);
  EXPECT_NE(with.out, alone.out);
}

INSTANTIATE_TEST_SUITE_P(All, Codes, ::testing::Values("gray", "xor-4", "xor-2", "min-stripe", "micro-phase"),
                         [](const auto& code) {
                           std::string name = code.param;
                           std::erase(name, '-');
                           return name;
                         });

}  // namespace
}  // namespace stratalux::fit
