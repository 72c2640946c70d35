// SPDX-License-Identifier: Apache-2.0
// Where the regions of a face lie, what they do to its skin, and the classes that a truth names.
#include "firmware-host/simulated/scene/face_regions.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/face_skin.h"
#include "firmware-host/simulated/scene/scene.h"
#include "firmware-host/simulated/skin/skin_table.h"
#include "shared/capture/plan.h"
#include "tests/firmware-host/simulated/small_rig.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

SkinDescription EvenSkin(double regions) {
  SkinDescription skin;
  skin.melanin = 0.03;
  skin.blood = 0.004;
  skin.scattering = 0.8;
  skin.patches = skin.redness = 0.0;
  skin.freckles = skin.vessels = 0;
  skin.regions = regions;
  return skin;
}

FaceFeatures FeaturesOf(double variation, uint64_t seed) {
  HeadDescription head;
  head.variation = variation;
  return FaceFeatures::Of(head, seed);
}

TEST(FaceRegions, WeightsAddUpAndHaveNoStep) {
  constexpr double kStep = 0.05;
  for (uint64_t seed = 1; seed <= 6; ++seed) {
    const FaceRegions regions(FeaturesOf(0.2, seed));
    for (double y = -100; y < 100; y += 3.7) {
      RegionWeights before = regions.WeightsAt(-80, y);
      for (double x = -80 + kStep; x < 80; x += kStep) {
        const RegionWeights here = regions.WeightsAt(x, y);
        ASSERT_NEAR(std::accumulate(here.begin(), here.end(), 0.0), 1.0, 1e-12);
        for (size_t r = 0; r < here.size(); ++r) {
          ASSERT_GE(here[r], 0.0);
          // The steepest border, the vermilion's, rises by 1.5 over 1 mm in its middle.
          ASSERT_LT(std::abs(here[r] - before[r]), 2.5 * kStep) << r << " at " << x << ' ' << y << ", seed " << seed;
        }
        before = here;
      }
    }
  }
}

TEST(FaceRegions, FollowTheFeaturesOfTheHead) {
  std::set<double> chins;
  for (uint64_t seed = 1; seed <= 40; ++seed) {
    const FaceFeatures f = FeaturesOf(0.1, seed);
    const FaceRegions regions(f);
    EXPECT_EQ(regions.At(0, f.bridge.cy), FaceRegion::kNose) << seed;
    EXPECT_EQ(regions.At(0, f.tip.cy), FaceRegion::kNose) << seed;
    EXPECT_EQ(regions.At(0, 0.5 * (f.upper_lip.cy + f.lower_lip.cy)), FaceRegion::kLips) << seed;
    EXPECT_NE(regions.At(0, f.lower_lip.cy + f.lower_lip.sy), FaceRegion::kLips) << seed;
    EXPECT_EQ(regions.At(0, f.chin.cy), FaceRegion::kChin) << seed;
    EXPECT_EQ(regions.At(0, f.brow.cy - 20.0), FaceRegion::kForehead) << seed;
    for (const double side : {-1.0, 1.0}) {
      EXPECT_EQ(regions.At(side * f.wing.cx, f.wing.cy), FaceRegion::kNose) << seed;
      EXPECT_EQ(regions.At(side * f.lid.cx, f.lid.cy), FaceRegion::kEyelids) << seed;
      EXPECT_EQ(regions.At(side * (f.cheekbone.cx + 4.0), f.cheekbone.cy + 4.0), FaceRegion::kCheek) << seed;
      EXPECT_EQ(regions.At(side * (f.radius_x_mm - 4.0), f.lid.cy), FaceRegion::kOther) << "temple, " << seed;
    }
    chins.insert(f.chin.cy);
  }
  EXPECT_GT(*chins.rbegin() - *chins.begin(), 8.0) << "another seed, another chin";
}

TEST(FaceRegions, SkinAroundTheOpeningOfAnEyeIsTheLids) {
  for (uint64_t seed = 1; seed <= 40; ++seed) {
    const FaceFeatures f = FeaturesOf(0.2, seed);
    const FaceRegions regions(f);
    for (double u = -1.0; u <= 1.0; u += 0.1)
      for (const double side : {-1.0, 1.0}) {
        const double v = kEyeHalfHeight * (1.0 - u * u) + 1.0;
        for (const double y : {f.lid.cy - v, f.lid.cy + v})
          EXPECT_EQ(regions.At(side * (kEyeX + u * (kEyeHalfWidth + 1.0)), y), FaceRegion::kEyelids)
              << seed << ' ' << u;
      }
  }
}

TEST(FaceRegions, TheVermilionEndsWithinAMillimetre) {
  const FaceFeatures f = FeaturesOf(0.0, 1);
  const FaceSkin skin(EvenSkin(1.0), FaceRegions(f), 1);
  constexpr double kX = 8.0;  // beside the philtrum
  const double around = skin.At(kX, f.upper_lip.cy - 8).blood, inside = skin.At(kX, f.upper_lip.cy + 3).blood;
  ASSERT_NEAR(inside / around, 6.0, 0.01);
  double nine_tenths = 0.0, one_tenth = 0.0;
  for (double y = f.upper_lip.cy + 3; y > f.upper_lip.cy - 8; y -= 0.01) {
    const double share = std::log(skin.At(kX, y).blood / around) / std::log(inside / around);
    if (share > 0.9) nine_tenths = y;
    if (share > 0.1) one_tenth = y;
  }
  EXPECT_GT(nine_tenths - one_tenth, 0.3);
  EXPECT_LT(nine_tenths - one_tenth, 1.0);
}

TEST(FaceSkin, RegionsMultiplyTheCheeksSkinByTheirFactors) {
  const FaceFeatures f = FeaturesOf(0.0, 1);
  for (const double strength : {0.5, 1.0}) {
    const FaceSkin skin(EvenSkin(strength), FaceRegions(f), 1);
    const SkinParameters cheek = skin.At(46, 18);
    EXPECT_FLOAT_EQ(cheek.scattering, 0.8F);
    for (const auto& [region, x, y] : {std::tuple{FaceRegion::kForehead, 0.0, -65.0},
                                       {FaceRegion::kNose, 0.0, 17.0},
                                       {FaceRegion::kLips, 0.0, 52.0},
                                       {FaceRegion::kEyelids, 31.0, -19.0},
                                       {FaceRegion::kChin, 0.0, 79.0}}) {
      const SkinFactors& factors = kRegionFactors[static_cast<size_t>(region)];
      const SkinParameters here = skin.At(x, y);
      EXPECT_NEAR(here.epidermis_mm / cheek.epidermis_mm, std::pow(factors.epidermis, strength), 0.01) << int(region);
      EXPECT_NEAR(here.blood / cheek.blood, std::pow(factors.blood, strength), 0.03) << int(region);
      EXPECT_NEAR(here.melanin / cheek.melanin, std::pow(factors.melanin, strength), 0.01) << int(region);
      EXPECT_NEAR(here.scattering / cheek.scattering, std::pow(factors.scattering, strength), 0.01) << int(region);
    }
  }
}

TEST(FaceSkin, AScarScattersLessThanTheSkinAroundIt) {
  SkinDescription description = EvenSkin(1.0);
  description.scar = true;
  const FaceSkin skin(description, FaceRegions(FeaturesOf(0.0, 1)), 1);
  EXPECT_NEAR(skin.At(31, 19).scattering, 0.8 * 4.2 / 6.3, 0.01);
  EXPECT_EQ(skin.ClassAt(31, 19), SurfaceClass::kScar);
  EXPECT_FLOAT_EQ(skin.At(40, 10).scattering, 0.8F);
  EXPECT_EQ(skin.ClassAt(40, 10), SurfaceClass::kCheek);
}

TEST(FaceSkin, RegionsStayWithinTheTableAndWithinWhatIsAsked) {
  for (const double scattering : {0.5, 0.75, 1.0, 1.1})
    for (const bool scar : {false, true}) {
      SkinDescription description;
      description.scattering = scattering;
      description.epidermis_mm = 0.055;
      description.scar = scar;
      description.regions = 2.0;
      const FaceSkin skin(description, FaceRegions(FeaturesOf(0.1, 3)), 3);
      const ScatteringRange range = ScatteringOf(description, 3);
      double least = 9.0, most = 0.0;
      for (double x = -70; x <= 70; x += 0.7)
        for (double y = -95; y <= 95; y += 0.7) {
          const SkinParameters here = skin.At(x, y);
          ASSERT_GE(here.melanin, static_cast<float>(SkinGrid::kMelanin.front()));  // less is lit as this much
          ASSERT_LE(here.melanin, 0.3F);
          ASSERT_GE(here.blood, 0.0005F);
          ASSERT_LE(here.blood, 0.06F);
          ASSERT_GE(here.epidermis_mm, 0.05F);
          ASSERT_LE(here.epidermis_mm, 0.15F);
          least = std::min<double>(least, here.scattering);
          most = std::max<double>(most, here.scattering);
        }
      EXPECT_GE(least, 0.5 - 1e-6);
      EXPECT_GE(least, range.least - 1e-6);
      EXPECT_NEAR(least, range.least, 0.02) << "nothing is asked of the table that is not there";
      EXPECT_NEAR(most, range.most, 1e-6);
    }
}

TEST(HeadClasses, AHeadWithAllOfThemNamesEachClass) {
  SceneDescription scene;
  scene.head.stubble_per_cm2 = 60;
  scene.skin.scar = true;
  std::map<SurfaceClass, int> seen;
  auto look = [&](const Scene& face) {
    for (double x = -70; x <= 70; x += 0.5)
      for (double y = -98; y <= 98; y += 0.5) {
        if (std::isnan(face.Height(x, y))) continue;
        const Material here = face.MaterialAt({x, y, 700});
        ++seen[here.part];
        ASSERT_EQ(IsSkin(here.part), here.kind == MaterialKind::kSkin) << ToString(here.part);
        ASSERT_EQ(here.part == SurfaceClass::kEye, here.kind == MaterialKind::kEye);
        ASSERT_EQ(here.part == SurfaceClass::kNostril, here.kind == MaterialKind::kMatt);
      }
  };
  look(*Scene::Create(scene, 1));
  scene.head.eyes = Eyes::kClosed;
  look(*Scene::Create(scene, 1));
  EXPECT_EQ(seen.count(SurfaceClass::kNone), 0U);
  EXPECT_EQ(seen.size(), kSurfaceClassNames.size() - 1);
  for (const auto& [surface, count] : seen) EXPECT_GT(count, 20) << ToString(surface);
}

TEST(HeadClasses, EachIsWhereItBelongs) {
  SceneDescription scene;
  scene.head.variation = 0.0;
  scene.head.stubble_per_cm2 = 60;
  const Scene face = *Scene::Create(scene, 2);
  EXPECT_EQ(face.MaterialAt({31, -20, 700}).part, SurfaceClass::kEye);
  EXPECT_EQ(face.MaterialAt({6.5, 27.8, 700}).part, SurfaceClass::kNostril);
  auto within = [&](SurfaceClass surface, double left, double right, double top, double bottom) {
    int inside = 0, outside = 0;
    for (double x = -70; x <= 70; x += 0.25)
      for (double y = -95; y <= 95; y += 0.25) {
        if (face.MaterialAt({x, y, 700}).part != surface) continue;
        ++(std::abs(x) > left && std::abs(x) < right && y > top && y < bottom ? inside : outside);
      }
    EXPECT_GT(inside, 100) << ToString(surface);
    EXPECT_EQ(outside, 0) << ToString(surface);
  };
  within(SurfaceClass::kBrow, 8, 62, -48, -28);
  within(SurfaceClass::kHair, -1, 71, -96, -30);
  within(SurfaceClass::kStubble, -1, 71, 22, 96);
}

TEST(HeadClasses, BaldIsTheHeadWithoutThem) {
  const Scene bald = *Scene::Create("bald", 5), head = *Scene::Create("head", 5);
  int other = 0;
  for (double x = -60; x <= 60; x += 0.7)
    for (double y = -90; y <= 90; y += 0.7) {
      if (std::isnan(bald.Height(x, y))) continue;
      ASSERT_TRUE(IsSkin(bald.MaterialAt({x, y, 700}).part));
      const SurfaceClass part = head.MaterialAt({x, y, 700}).part;
      other += IsSkin(part) ? 0 : 1;
      // The nostrils' pits reach into the nose and a little around it.
      const bool near_nostrils = std::abs(x) < 20.0 && y > 10.0 && y < 46.0;
      if (!IsSkin(part) || near_nostrils) continue;
      ASSERT_NEAR(bald.Height(x, y), head.Height(x, y), 1e-3);
      ASSERT_EQ(bald.Skin({x, y, 700}).melanin, head.Skin({x, y, 700}).melanin);
    }
  EXPECT_GT(other, 500);
}

TEST(HeadClasses, NostrilsAreShallowPits) {
  SceneDescription scene;
  scene.head = HeadDescription::Bald();
  scene.head.variation = 0.0;
  const Scene smooth = *Scene::Create(scene, 1);
  scene.head.nostrils = true;
  const Scene pitted = *Scene::Create(scene, 1);
  EXPECT_NEAR(pitted.Height(6.5, 27.8) - smooth.Height(6.5, 27.8), 1.5, 0.05);
  EXPECT_EQ(pitted.Height(0, 10), smooth.Height(0, 10));
}

class RegionRig : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    scratch_.emplace();
    Logger quiet(LogLevel::kError);
    for (const auto& [name, axis] : {std::pair{"one", std::vector{1.0}}, {"two", std::vector{0.5, 1.0}}})
      ASSERT_TRUE(GenerateSkinTable({1000, 1, 0}, axis, {}, quiet)->Save(File(name), 1).ok());
    std::ofstream(File("scene.toml")) << "[skin]\nscattering = 0.8\nscar = true\n";
    std::ofstream(File("samples.toml")) << "[skin]\nscattering = 1\n";
    std::ofstream(File("thin.toml"))
        << "[subject]\nshape = \"plane\"\n[skin]\nscattering = 0.8\nsubcutis_absorption = 2.5\nskin_mm = 1.2\n";
    std::ofstream(File("low.toml")) << "[skin]\nscattering = 0.4\n";
  }
  static void TearDownTestSuite() { scratch_.reset(); }
  static std::string File(const std::string& name) { return (*scratch_ / name).string(); }
  static Result<std::unique_ptr<SimulatedRig>> Make(const std::string& scene, const std::string& table) {
    SimulatedRigOptions options = SmallRig(File(scene));
    options.skin_table = File(table);
    static Logger quiet(LogLevel::kError);
    return SimulatedRig::Create(options, quiet);
  }

  // Of a scene, by name.
  static std::map<std::string, Image<float>> Truth(const std::string& scene = "scene.toml") {
    const auto rig = Make(scene, "two");
    EXPECT_TRUE(rig.ok()) << rig.status().message();
    auto maps = (*rig)->Truth(*BuildPlan({.projectors = 1, .projector_width = 256, .projector_height = 192}));
    EXPECT_TRUE(maps.ok()) << maps.status().message();
    std::map<std::string, Image<float>> truth;
    for (TruthMap& map : *maps) truth[map.name] = std::move(map.map);
    return truth;
  }

 private:
  static inline std::optional<ScratchFolder> scratch_;
};

TEST_F(RegionRig, ATableThatDoesNotKnowTheirScatteringIsRefused) {
  const Status status = Make("samples.toml", "one").status();
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_NE(status.message().find("regions = 1 makes 0.75 .. 1 of scattering = 1"), std::string::npos)
      << status.message();
  EXPECT_NE(status.message().find("generate --scattering"), std::string::npos) << status.message();
  EXPECT_TRUE(Make("samples.toml", "two").ok());
  // Nor may a subject that comes later bring what the table does not know.
  const auto rig = Make("samples.toml", "two");
  EXPECT_TRUE((*rig)->SetSubject({.scene = File("scene.toml")}).ok());
  EXPECT_EQ((*rig)->SetSubject({.scene = File("low.toml")}).code(), StatusCode::kUsage);
}

TEST_F(RegionRig, TheTruthNamesClassThicknessAndScattering) {
  const std::map<std::string, Image<float>> truth = Truth();
  const Image<float>&surface = truth.at("class"), &layers = truth.at("layers"), &material = truth.at("material");
  ASSERT_EQ(surface.width(), material.width());
  ASSERT_EQ(layers.channels(), 2);
  EXPECT_FALSE(truth.contains("subcutis")) << "the usual one";
  std::map<SurfaceClass, double> scattering;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) {
      const auto here = static_cast<SurfaceClass>(surface(i, j));
      ASSERT_EQ(IsSkin(here), material(i, j) == static_cast<float>(MaterialKind::kSkin));
      ASSERT_EQ(IsSkin(here), std::isfinite(layers(i, j, 0)));
      if (!IsSkin(here)) continue;
      ASSERT_GE(layers(i, j, 0), 0.05F);
      if (!scattering.contains(here) || scattering[here] > layers(i, j, 1)) scattering[here] = layers(i, j, 1);
    }
  EXPECT_NEAR(scattering.at(SurfaceClass::kNose), 0.8 * 0.85, 0.01);
  EXPECT_NEAR(scattering.at(SurfaceClass::kEyelids), 0.8 * 0.8, 0.01);
  EXPECT_NEAR(scattering.at(SurfaceClass::kLips), 0.8 * 0.75, 0.01);
  EXPECT_NEAR(scattering.at(SurfaceClass::kForehead), 0.8, 0.01);
}

TEST_F(RegionRig, TheTruthTellsAnotherSubcutis) {
  const std::map<std::string, Image<float>> truth = Truth("thin.toml");
  const Image<float>&subcutis = truth.at("subcutis"), &material = truth.at("material");
  ASSERT_EQ(subcutis.channels(), 2);
  int skin = 0;
  for (int j = 0; j < material.height(); ++j)
    for (int i = 0; i < material.width(); ++i) {
      if (material(i, j) != static_cast<float>(MaterialKind::kSkin)) continue;
      ++skin;
      ASSERT_EQ(subcutis(i, j, 0), 2.5F);
      ASSERT_EQ(subcutis(i, j, 1), 1.2F);
    }
  EXPECT_GT(skin, 1000);
}

// What the light says: no eye, brow or hair scatters, skin does in every colour.
TEST_F(RegionRig, TheTruthNamesQuadsWhoseSitesSeeTwoThings) {
  const std::map<std::string, Image<float>> truth = Truth();
  const Image<float>&material = truth.at("material"), &mixed = truth.at("mixed"),
        &light = truth.at("subsurface white 0"), &direct = truth.at("direct white 0");
  ASSERT_EQ(mixed.width(), material.width());
  int mixed_skin = 0, pure_skin = 0, scattering_in_part = 0;
  for (int j = 0; j < material.height(); ++j)
    for (int i = 0; i < material.width(); ++i) {
      int scatter = 0, lit = 0;
      for (int c = 0; c < 3; ++c) {
        scatter += light(i, j, c) > 0.0F ? 1 : 0;
        lit += direct(i, j, c) > 0.0F ? 1 : 0;
      }
      const bool skin = material(i, j) == static_cast<float>(MaterialKind::kSkin);
      if (mixed(i, j) != 0.0F) {
        mixed_skin += skin ? 1 : 0;
        scattering_in_part += scatter > 0 && scatter < 3 ? 1 : 0;
      } else if (skin) {
        ++pure_skin;
        if (lit == 3) {
          EXPECT_EQ(scatter, 3) << i << ", " << j;
        }
      } else {
        EXPECT_EQ(scatter, 0) << i << ", " << j;
      }
    }
  EXPECT_GT(pure_skin, 1000);
  EXPECT_GT(mixed_skin, 0);
  EXPECT_LT(mixed_skin, pure_skin / 5);
  EXPECT_GT(scattering_in_part, 0);
}

}  // namespace
}  // namespace stratalux::rig
