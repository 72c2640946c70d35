// SPDX-License-Identifier: Apache-2.0
// A person with eyes, brows, hair and nostrils, from the frames to the skin mask: by the light alone, and held to what
// the simulation knows.
//   STRATALUX_SEED=12 skin_mask_test     prints the figures of another person, and of three more behind it
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <iterator>
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
#include "tests/support/drawn.h"
#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using ::testing::HasSubstr;

constexpr double kExposureMs = 16.0;  // of a capture that asks for none

uint64_t Seed() {
  const char* seed = std::getenv("STRATALUX_SEED");
  return seed != nullptr ? std::strtoull(seed, nullptr, 10) : 106;  // no constant was chosen on this one
}

// A session whose skin was looked for.
struct Person {
  uint64_t seed = 0;
  fs::path store, session;
  SkinMask mask;
  Image<float> part;

  static Person Capture(const fs::path& store, uint64_t seed) {
    Person person{seed, store, {}, {}, {}};
    const std::string at = " --store " + store.string();
    EXPECT_EQ(Execute("stratalux-rig capture --simulate --size 464x348" + at + " --seed " + std::to_string(seed)).code,
              0);
    EXPECT_EQ(Execute("stratalux-fit skin latest" + at, Show::kStdout).code, 0);
    for (const auto& entry : fs::directory_iterator(store / "sessions")) person.session = entry.path();
    const auto mask = LoadSkin(person.Artifact("skin"));
    EXPECT_TRUE(mask.ok()) << mask.status().message();
    if (mask.ok()) person.mask = *mask;
    const auto truth = db::TruthSegment::Open(person.session / "truth.seg");
    EXPECT_TRUE(truth.ok()) << truth.status().message();
    if (const auto part = truth.ok() ? truth->Read("class") : truth.status(); part.ok()) person.part = *part;
    return person;
  }

  [[nodiscard]] fs::path Artifact(const std::string& stage) const {
    for (const auto& entry : fs::directory_iterator(session / "artifacts"))
      if (entry.path().filename().string().starts_with(stage + "-")) return entry.path();
    ADD_FAILURE() << "no artifact of " << stage;
    return {};
  }

  [[nodiscard]] SurfaceClass PartAt(int i, int j) const { return static_cast<SurfaceClass>(part(i, j)); }
  [[nodiscard]] bool IsTrueSkin(int i, int j) const {
    return IsSkin(PartAt(i, j)) || PartAt(i, j) == SurfaceClass::kStubble;
  }
  // No quad around it is skin.
  [[nodiscard]] bool IsInside(int i, int j) const {
    for (int y = std::max(j - 1, 0); y <= std::min(j + 1, part.height() - 1); ++y)
      for (int x = std::max(i - 1, 0); x <= std::min(i + 1, part.width() - 1); ++x)
        if (IsTrueSkin(x, y)) return false;
    return true;
  }

  [[nodiscard]] double IouOf(const SkinMask& of) const {
    Image<uint8_t> truth(of.skin.width(), of.skin.height()), surface = truth;
    for (int j = 0; j < truth.height(); ++j)
      for (int i = 0; i < truth.width(); ++i) {
        truth(i, j) = IsTrueSkin(i, j) ? 1 : 0;
        surface(i, j) = of.reason(i, j) != static_cast<uint8_t>(SkinReason::kNoSurface) ? 1 : 0;
      }
    return CompareMasks(truth, of.skin, surface).IntersectionOverUnion();
  }

  // As the stage judges, but for the options and the projectors.
  [[nodiscard]] SkinMask Judged(const SkinOptions& options, int only_projector = -1) const {
    auto shape = LoadShape(Artifact("shape"));
    const auto separation = LoadSeparation(Artifact("separate"));
    EXPECT_TRUE(shape.ok() && separation.ok());
    for (int p = 0; p < static_cast<int>(shape->lit.size()); ++p)
      if (only_projector >= 0 && p != only_projector)
        shape->lit[p] = Image<uint8_t>(shape->surface.width(), shape->surface.height());
    const auto light = MeasureSkinLight(*separation, shape->lit, shape->surface, LinearRig(shape->record), kExposureMs);
    EXPECT_TRUE(light.ok());
    auto judged = JudgeSkin(*light, options);
    EXPECT_TRUE(judged.ok());
    return std::move(judged).value();
  }
};

// One session for most cases of this program.
class SkinOfAPerson : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = fs::temp_directory_path() / ("stratalux_skin_mask_" + std::to_string(getpid()));
    person_ = Person::Capture(folder_ / "store", Seed());
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static inline fs::path folder_;
  static inline Person person_;
};

TEST_F(SkinOfAPerson, IsFoundByTheLightAlone) {
  const SkinMask& mask = person_.mask;
  ASSERT_TRUE(mask.told);
  const double iou = person_.IouOf(mask);
  std::printf("seed %llu: %lld quads of the surface, %lld of them skin, intersection over union %.4f\n",
              static_cast<unsigned long long>(person_.seed), static_cast<long long>(mask.surface_quads()),
              static_cast<long long>(mask.skin_quads), iou);
  EXPECT_GE(iou, 0.95);
  // Regions of skin that are unlike the rest are skin; what is none is none, but for quads at its edge: of who has
  // little hair in the picture they are a good part of it.
  int64_t lips = 0, lips_found = 0, hair = 0, hair_missed = 0, eyes = 0, eyes_missed = 0;
  for (int j = 0; j < mask.skin.height(); ++j)
    for (int i = 0; i < mask.skin.width(); ++i) {
      if (mask.reason(i, j) == static_cast<uint8_t>(SkinReason::kNoSurface)) continue;
      const bool skin = mask.skin(i, j) != 0, inside = person_.IsInside(i, j);
      const SurfaceClass part = person_.PartAt(i, j);
      lips += part == SurfaceClass::kLips || part == SurfaceClass::kEyelids ? 1 : 0;
      lips_found += (part == SurfaceClass::kLips || part == SurfaceClass::kEyelids) && skin ? 1 : 0;
      hair += inside && part == SurfaceClass::kHair ? 1 : 0;
      hair_missed += inside && part == SurfaceClass::kHair && skin ? 1 : 0;
      eyes += inside && part == SurfaceClass::kEye ? 1 : 0;
      eyes_missed += inside && part == SurfaceClass::kEye && skin ? 1 : 0;
    }
  std::printf("of %lld quads of hair away from skin %lld are missed, of %lld of eyes %lld\n",
              static_cast<long long>(hair), static_cast<long long>(hair_missed), static_cast<long long>(eyes),
              static_cast<long long>(eyes_missed));
  EXPECT_GT(lips, 500);
  EXPECT_GT(lips_found, 95 * lips / 100);
  EXPECT_GT(hair + eyes, 200);
  EXPECT_LT(hair_missed, hair / 10);
  EXPECT_LE(eyes_missed, eyes / 10);
}

// Each of the four things that tell skin, left out: worse for whoever it is (by day for two), and clearly so over
// several people, of whom each has another one that tells little.
TEST_F(SkinOfAPerson, IsFoundWorseWithoutShareReflectanceOrNeighbours) {
  const bool night = std::getenv("STRATALUX_SKIN_PEOPLE") != nullptr;
  const int people = night ? std::atoi(std::getenv("STRATALUX_SKIN_PEOPLE")) : 2;
  const SkinOptions without[] = {
      {.by_share = false}, {.by_reflectance = false}, {.coupling = 0.0}, {.least_log_scale = 0.02}};
  const char* names[] = {"share", "reflectance", "neighbours", "scales"};
  double lost[std::size(without)] = {};
  for (int k = 0; k < people; ++k) {
    const uint64_t further = night ? static_cast<uint64_t>(k) : 1 + SeedOfTheDay() % 3;
    const Person person = k == 0 ? person_ : Person::Capture(folder_ / std::to_string(k), person_.seed + 94 + further);
    const double whole = person.IouOf(person.Judged({}));
    EXPECT_EQ(whole, person.IouOf(person.mask));
    for (size_t o = 0; o < std::size(without); ++o) {
      const double each = whole - person.IouOf(person.Judged(without[o]));
      EXPECT_GT(each, 0.0) << names[o] << ", seed " << person.seed;
      lost[o] += each / people;
    }
  }
  for (size_t o = 0; o < std::size(without); ++o) {
    std::printf("without %-12s %.4f of the intersection over union is lost\n", names[o], lost[o]);
    if (night) {
      EXPECT_GT(lost[o], 0.001) << names[o];
    }
  }
}

TEST_F(SkinOfAPerson, IsFoundInTheLightOfOneProjector) {
  for (int p = 0; p < 4; ++p) EXPECT_GT(person_.IouOf(person_.Judged({}, p)), 0.8) << p;
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
                HasSubstr(std::to_string(person_.mask.left_out()) + " of " +
                          std::to_string(person_.mask.surface_quads()) + " quads of the surface, which are left out"));
    return Json::parse(ReadText(fit / "metrics.json"));
  };
  const fs::path blind = folder_ / "blind";
  fs::create_directories(blind);
  fs::copy(person_.store, blind / "store", fs::copy_options::recursive);
  const Outcome plan =
      Execute("stratalux-fit run latest --dry-run --store " + (blind / "store").string(), Show::kStdout);
  EXPECT_THAT(plan.out, HasSubstr("skin: is there"));
  const fs::path copy = blind / "store" / "sessions" / person_.session.filename();
  fs::remove(copy / "truth.seg");
  fs::remove_all(copy / "artifacts");
  const Json with = metrics(person_.store.string()), without = metrics((blind / "store").string());
  // Nothing of the truth entered the mask.
  EXPECT_EQ(with["artifacts"]["skin"], without["artifacts"]["skin"]);
  const std::string made = with["artifacts"]["skin"];
  for (const char* file : {"skin.exr", "skin.json"})
    EXPECT_EQ(ReadText(copy / "artifacts" / made / file), ReadText(person_.session / "artifacts" / made / file))
        << file;

  EXPECT_EQ(with["skin"]["truth"]["iou"].get<double>(), person_.IouOf(person_.mask));
  EXPECT_FALSE(without["skin"].contains("truth"));
  EXPECT_EQ(without["skin"]["skin"], person_.mask.skin_quads);
  const Json judged = with["coverage"][0], blindly = without["coverage"][0];
  EXPECT_EQ(judged["skin_by"], "truth");
  EXPECT_EQ(blindly["skin_by"], "mask");
  EXPECT_EQ(blindly["lit_skin"], 0) << "what is truly lit is not known";
  for (const Json& coverage : {judged, blindly}) EXPECT_GT(coverage["not_skin"], 50) << coverage;
  EXPECT_NEAR(blindly["judged"].get<double>() / judged["judged"].get<double>(), 1.0, 0.02);
}

}  // namespace
}  // namespace stratalux::fit
