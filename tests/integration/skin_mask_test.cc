// SPDX-License-Identifier: Apache-2.0
// A person with eyes, brows, hair and nostrils, from the frames to the skin mask: by the light alone, and held to what
// the simulation knows.
//   STRATALUX_SEED=12 skin_mask_test     prints the figures of another person
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <numeric>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/segment/truth_segment.h"
#include "fitter/evaluation/image_error.h"
#include "fitter/sensor/linear_frame.h"
#include "fitter/stages/separate.h"
#include "fitter/stages/skin.h"
#include "shared/capture/surface_class.h"
#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using ::testing::HasSubstr;

constexpr double kExposureMs = 16.0;  // of a capture that asks for none

std::string Seed() {
  const char* seed = std::getenv("STRATALUX_SEED");
  return seed != nullptr ? seed : "106";  // no constant was chosen on this one
}

// One session for all cases of this program.
class SkinOfAPerson : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = fs::temp_directory_path() / ("stratalux_skin_mask_" + std::to_string(getpid()));
    store_ = (folder_ / "store").string();
    ASSERT_EQ(Execute("stratalux-rig capture --simulate --size 464x348 --store " + store_ + " --seed " + Seed()).code,
              0);
    const Outcome made = Execute("stratalux-fit skin latest --store " + store_, Show::kStdout);
    ASSERT_EQ(made.code, 0);
    for (const auto& entry : fs::directory_iterator(fs::path(store_) / "sessions")) session_ = entry.path();
    const auto mask = LoadSkin(Artifact("skin"));
    ASSERT_TRUE(mask.ok()) << mask.status().message();
    mask_ = *mask;
    const auto truth = db::TruthSegment::Open(session_ / "truth.seg");
    ASSERT_TRUE(truth.ok()) << truth.status().message();
    const auto part = truth->Read("class");
    ASSERT_TRUE(part.ok());
    part_ = *part;
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static fs::path Artifact(const std::string& stage) {
    for (const auto& entry : fs::directory_iterator(session_ / "artifacts"))
      if (entry.path().filename().string().starts_with(stage + "-")) return entry.path();
    ADD_FAILURE() << "no artifact of " << stage;
    return {};
  }

  static SurfaceClass PartAt(int i, int j) { return static_cast<SurfaceClass>(part_(i, j)); }
  static bool IsTrueSkin(int i, int j) { return IsSkin(PartAt(i, j)) || PartAt(i, j) == SurfaceClass::kStubble; }

  static double IouOf(const SkinMask& mask) {
    Image<uint8_t> truth(mask.skin.width(), mask.skin.height()), surface = truth;
    for (int j = 0; j < truth.height(); ++j)
      for (int i = 0; i < truth.width(); ++i) {
        truth(i, j) = IsTrueSkin(i, j) ? 1 : 0;
        surface(i, j) = mask.reason(i, j) != static_cast<uint8_t>(SkinReason::kNoSurface) ? 1 : 0;
      }
    return CompareMasks(truth, mask.skin, surface).IntersectionOverUnion();
  }

  // As the stage judges, but for the options and the projectors.
  static SkinMask Judged(const SkinOptions& options, int only_projector = -1) {
    auto shape = LoadShape(Artifact("shape"));
    const auto separation = LoadSeparation(Artifact("separate"));
    EXPECT_TRUE(shape.ok() && separation.ok());
    for (int p = 0; p < static_cast<int>(shape->lit.size()); ++p)
      if (only_projector >= 0 && p != only_projector)
        shape->lit[p] = Image<uint8_t>(shape->surface.width(), shape->surface.height());
    const auto light = MeasureSkinLight(*separation, shape->lit, shape->surface, LinearRig(shape->record), kExposureMs);
    EXPECT_TRUE(light.ok());
    auto mask = JudgeSkin(*light, options);
    EXPECT_TRUE(mask.ok());
    return std::move(mask).value();
  }

  static inline fs::path folder_, session_;
  static inline std::string store_;
  static inline SkinMask mask_;
  static inline Image<float> part_;
};

TEST_F(SkinOfAPerson, IsFoundByTheLightAlone) {
  ASSERT_TRUE(mask_.told);
  const double iou = IouOf(mask_);
  std::printf("seed %s: %lld quads of the surface, %lld of them skin, intersection over union %.4f\n", Seed().c_str(),
              static_cast<long long>(mask_.surface_quads()), static_cast<long long>(mask_.skin_quads), iou);
  EXPECT_GE(iou, 0.95);
  // Regions of skin that are unlike the rest are skin; what is none is none, but for quads at its edge.
  int64_t lips = 0, lips_found = 0, hair = 0, hair_missed = 0, eyes = 0, eyes_missed = 0;
  for (int j = 0; j < mask_.skin.height(); ++j)
    for (int i = 0; i < mask_.skin.width(); ++i) {
      if (mask_.reason(i, j) == static_cast<uint8_t>(SkinReason::kNoSurface)) continue;
      const bool skin = mask_.skin(i, j) != 0;
      const SurfaceClass part = PartAt(i, j);
      lips += part == SurfaceClass::kLips || part == SurfaceClass::kEyelids ? 1 : 0;
      lips_found += (part == SurfaceClass::kLips || part == SurfaceClass::kEyelids) && skin ? 1 : 0;
      hair += part == SurfaceClass::kHair ? 1 : 0;
      hair_missed += part == SurfaceClass::kHair && skin ? 1 : 0;
      eyes += part == SurfaceClass::kEye ? 1 : 0;
      eyes_missed += part == SurfaceClass::kEye && skin ? 1 : 0;
    }
  EXPECT_GT(lips, 500);
  EXPECT_GT(lips_found, 95 * lips / 100);
  EXPECT_GT(hair + eyes, 200);
  EXPECT_LT(hair_missed, hair / 10);
  EXPECT_LT(eyes_missed, eyes / 5);
}

TEST_F(SkinOfAPerson, IsFoundWorseWithoutShareReflectanceOrNeighbours) {
  const double whole = IouOf(Judged({}));
  EXPECT_EQ(whole, IouOf(mask_));
  std::vector<double> lost;
  for (const SkinOptions& options :
       {SkinOptions{.by_share = false}, {.by_reflectance = false}, {.coupling = 0.0}, {.least_log_scale = 0.02}})
    lost.push_back(whole - IouOf(Judged(options)));
  for (const double each : lost) EXPECT_GT(each, 0.0);
  EXPECT_GT(std::accumulate(lost.begin(), lost.end(), 0.0) / static_cast<double>(lost.size()), 0.002);
}

TEST_F(SkinOfAPerson, IsFoundInTheLightOfOneProjector) {
  for (int p = 0; p < 4; ++p) EXPECT_GT(IouOf(Judged({}, p)), 0.8) << p;
}

TEST_F(SkinOfAPerson, TakesTheMasksWordWhereThereIsNoTruth) {
  const std::string options =
      " latest --pool 2 --prior none --offset off --maps off --iterations 1 --layers 1 --json --store ";
  const auto metrics = [&](const std::string& store) {
    const Outcome run = Execute("stratalux-fit run" + options + store, Show::kStdout);
    EXPECT_EQ(run.code, 0);
    const fs::path fit = Json::parse(run.out)["folder"].get<std::string>();
    EXPECT_TRUE(fs::exists(fit / "skin.exr"));
    EXPECT_THAT(ReadText(fit / "report" / "index.html"),
                HasSubstr(std::to_string(mask_.left_out()) + " of " + std::to_string(mask_.surface_quads()) +
                          " quads of the surface, which are left out"));
    return Json::parse(ReadText(fit / "metrics.json"));
  };
  const fs::path blind = folder_ / "blind";
  fs::create_directories(blind);
  fs::copy(store_, blind / "store", fs::copy_options::recursive);
  const Outcome plan =
      Execute("stratalux-fit run latest --dry-run --store " + (blind / "store").string(), Show::kStdout);
  EXPECT_THAT(plan.out, HasSubstr("skin: is there"));
  const fs::path copy = blind / "store" / "sessions" / session_.filename();
  fs::remove(copy / "truth.seg");
  fs::remove_all(copy / "artifacts");
  const Json with = metrics(store_), without = metrics((blind / "store").string());
  // Nothing of the truth entered the mask.
  EXPECT_EQ(with["artifacts"]["skin"], without["artifacts"]["skin"]);
  const std::string made = with["artifacts"]["skin"];
  for (const char* file : {"skin.exr", "skin.json"})
    EXPECT_EQ(ReadText(copy / "artifacts" / made / file), ReadText(session_ / "artifacts" / made / file)) << file;

  EXPECT_EQ(with["skin"]["truth"]["iou"].get<double>(), IouOf(mask_));
  EXPECT_FALSE(without["skin"].contains("truth"));
  EXPECT_EQ(without["skin"]["skin"], mask_.skin_quads);
  const Json judged = with["coverage"][0], blindly = without["coverage"][0];
  EXPECT_EQ(judged["skin_by"], "truth");
  EXPECT_EQ(blindly["skin_by"], "mask");
  EXPECT_EQ(blindly["lit_skin"], 0) << "what is truly lit is not known";
  for (const Json& coverage : {judged, blindly}) EXPECT_GT(coverage["not_skin"], 50) << coverage;
  EXPECT_NEAR(blindly["judged"].get<double>() / judged["judged"].get<double>(), 1.0, 0.02);
}

}  // namespace
}  // namespace stratalux::fit
