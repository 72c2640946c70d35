// SPDX-License-Identifier: Apache-2.0
// Scene files, materials and motion.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/plate.h"
#include "firmware-host/simulated/scene/scene.h"
#include "firmware-host/simulated/simulation_file.h"
#include "firmware-host/simulated/skin/population.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

class SceneFile : public ScratchFolderTest {
 protected:
  Result<SceneDescription> Load(const std::string& text) {
    std::ofstream(file_) << text;
    SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(file_.string()));
    return simulation.scene;
  }
  Scene Make(const std::string& text) { return *Scene::Create(*Load(text), 1); }
  std::filesystem::path file_ = folder_ / "scene.toml";
};

TEST_F(SceneFile, AnEmptyFileIsTheDefaultVisitor) {
  const Scene described = Make(""), head = *Scene::Create("head", 1);
  for (double x = -60; x <= 60; x += 7.3)
    for (double y = -80; y <= 80; y += 9.1) {
      if (std::isnan(head.Height(x, y))) continue;
      ASSERT_EQ(described.Height(x, y), head.Height(x, y));
      ASSERT_EQ(described.Skin({x, y, 0}).melanin, head.Skin({x, y, 0}).melanin);
    }
}

TEST_F(SceneFile, EveryPlainSceneThatIsNamedIsOne) {
  std::istringstream names(PlainSceneNames());
  int count = 0;
  for (std::string name; std::getline(names >> std::ws, name, ',');) {
    const auto scene = LoadSimulation(name);
    ASSERT_TRUE(scene.ok()) << scene.status().message();
    EXPECT_TRUE(scene->scene.Validate().ok()) << name;
    ++count;
  }
  EXPECT_GE(count, 11);
  EXPECT_NE(LoadSimulation("cube").status().message().find("'cube' is unknown; allowed: " + PlainSceneNames()),
            std::string::npos);
}

TEST_F(SceneFile, EveryComplaintNamesFileLineAndRemedy) {
  const struct {
    const char *text, *complaint;
  } cases[] = {
      {"[subject]\nshape = \"cube\"\n", ":2: shape 'cube' is unknown; allowed: head, plane"},
      {"[subject]\nsahpe = \"head\"\n", ":2"},
      {"[skin]\nmelanin = 0.9\n", ":2"},
      {"[skin]\nperson = -1\n", ":2: skin.person: value -1 is out of range, allowed: 0 .. 999999"},
      {"[skin]\nperson = 1000000\n", "value 1000000 is out of range, allowed: 0 .. 999999"},
      {"[skin]\nperson = 1.5\n", "value 1.5 is not an integer"},
      {"[skin]\nsubcutis_absorption = 0.5\n",
       ":2: skin.subcutis_absorption: value 0.5 is out of range, allowed: 1 .. 4"},
      {"[skin]\nskin_mm = 0.5\n", ":2: skin.skin_mm: value 0.5 is out of range, allowed: 0.98 .. 1.98"},
      {"[head]\n\neyes = \"wide\"\n", ":3: eyes 'wide' is unknown; allowed: none, closed, open"},
      {"[subject]\nposition_mm = [1, 2]\n", ":2: position_mm takes three numbers"},
      {"[subject]\nshape = \"charuco\"\n[plate]\nmarker_mm = 30\n", "must be smaller than square_mm"},
      {"[subject]\nshape = \"charuco\"\n[plate]\ncolumns = 20\nrows = 20\n", "50 markers"},
      {"[surface]\nform = \"velvet\"\n", ":2: form 'velvet' is unknown; allowed: ggx, beckmann, two_lobes"},
      {"[surface]\noiliness = 1.2\n", ":2"},
      {"[subject\n", ":1"},
  };
  for (const auto& c : cases) {
    const auto scene = Load(c.text);
    ASSERT_FALSE(scene.ok()) << c.text;
    EXPECT_EQ(scene.status().code(), StatusCode::kUsage) << c.text;
    EXPECT_THAT(scene.status().message(), HasSubstr(file_.filename().string())) << c.text;
    EXPECT_THAT(scene.status().message(), HasSubstr(c.complaint)) << c.text;
  }
  EXPECT_EQ(LoadSimulation("/nowhere/scene.toml").status().code(), StatusCode::kUsage);
}

TEST_F(SceneFile, ShippedScenesLoad) {
  int scenes = 0;
  for (const auto& entry : std::filesystem::directory_iterator(STRATALUX_SOURCE_DIR "/docs/examples/scenes")) {
    const auto simulation = LoadSimulation(entry.path().string());
    ASSERT_TRUE(simulation.ok()) << simulation.status().message();
    EXPECT_TRUE(Scene::Create(simulation->scene, 1).ok()) << entry.path();
    ++scenes;
  }
  EXPECT_GE(scenes, 7);
}

TEST_F(SceneFile, SeedOfTheFileWinsOverTheSessions) {
  const SceneDescription fixed = *Load("[subject]\nseed = 9\n");
  EXPECT_EQ(Scene::Create(fixed, 1)->Height(10, 10), Scene::Create(fixed, 2)->Height(10, 10));
  EXPECT_EQ(Scene::Create(fixed, 1)->Height(10, 10), Scene::Create("head", 9)->Height(10, 10));
}

TEST_F(SceneFile, ABoardTakesThePoseThatIsAskedFor) {
  SceneDescription scene = *Load(
      "[subject]\nshape = \"charuco\"\nposition_mm = [9, 9, 9]\n[[pose]]\nposition_mm = [1, 2, 3]\n[[pose]]\n"
      "rotation_deg = [10, -20, 5]\n");
  ASSERT_EQ(scene.poses.size(), 2U);
  ASSERT_TRUE(scene.TakePose(-1).ok());
  EXPECT_EQ(scene.pose.position_mm[0], 9.0);
  ASSERT_TRUE(scene.TakePose(0).ok());
  EXPECT_EQ(scene.pose.position_mm[2], 3.0);
  ASSERT_TRUE(scene.TakePose(1).ok());
  EXPECT_EQ(scene.pose.rotation_deg[1], -20.0);
  EXPECT_EQ(scene.pose.position_mm[0], 0.0);  // the subject's own place does not count
  const Status beyond = scene.TakePose(2);
  EXPECT_EQ(beyond.code(), StatusCode::kUsage);
  EXPECT_THAT(beyond.message(), HasSubstr("poses 0 .. 1"));
  EXPECT_THAT(Load("[[pose]]\nposition = [1, 2, 3]\n").status().message(), HasSubstr(":2"));
}

TEST_F(SceneFile, APoseMovesSurfaceNormalAndMaterialTogether) {
  const std::string board = "[subject]\nshape = \"checkerboard\"\n[plate]\ncolumns = 9\nrows = 6\nsquare_mm = 25\n";
  const Scene resting = Make(board);
  const SceneDescription description = *Load(
      "[subject]\nshape = \"checkerboard\"\nposition_mm = [12, -7, 30]\nrotation_deg = [20, -15, 8]\n"
      "[plate]\ncolumns = 9\nrows = 6\nsquare_mm = 25\n");
  const Scene turned = *Scene::Create(description, 1);
  // Independently: R = Rz Ry Rx about (0, 0, 700), then the shift.
  auto rotate = [](Eigen::Vector3d p) {
    const double rx = 20 * M_PI / 180, ry = -15 * M_PI / 180, rz = 8 * M_PI / 180;
    p = {p.x(), p.y() * std::cos(rx) - p.z() * std::sin(rx), p.y() * std::sin(rx) + p.z() * std::cos(rx)};
    p = {p.x() * std::cos(ry) + p.z() * std::sin(ry), p.y(), -p.x() * std::sin(ry) + p.z() * std::cos(ry)};
    return Eigen::Vector3d(p.x() * std::cos(rz) - p.y() * std::sin(rz), p.x() * std::sin(rz) + p.y() * std::cos(rz),
                           p.z());
  };
  for (double x = -90.3; x <= 90; x += 13)
    for (double y = -60.2; y <= 60; y += 11) {
      const Eigen::Vector3d on_board(x, y, 0.0);
      const Eigen::Vector3d point = rotate(on_board) + Eigen::Vector3d(12, -7, 730);
      const auto hit = turned.Intersect({Eigen::Vector3d::Zero(), point.normalized()});
      ASSERT_TRUE(hit.has_value());
      EXPECT_LT((*hit - point).norm(), 1e-9);
      EXPECT_LT((turned.Normal(*hit) - rotate({0, 0, -1})).norm(), 1e-12);
      EXPECT_EQ(turned.MaterialAt(*hit).albedo, resting.MaterialAt({x, y, 700}).albedo);
    }
}

TEST_F(SceneFile, TheSurfaceIsThatOfTheSkinAlone) {
  const std::string head = "[subject]\nseed = 4\n[head]\nvariation = 0\nhair = false\n[surface]\n";
  const Scene plain = Make(head + "form = \"ggx\"\noiliness = 0\nfuzz = 0\n"), oily = Make(head + "oiliness = 0.8\n");
  const Eigen::Vector3d pupil(31, -20.6, 700), forehead(0, -64, 650), cheek(45, 16, 680);
  EXPECT_EQ(oily.MaterialAt(pupil).surface.form, FacetForm::kGgx);
  EXPECT_EQ(oily.MaterialAt(pupil).surface.fuzz_depth, 0.0F);
  EXPECT_EQ(plain.MaterialAt(forehead).surface.form, FacetForm::kGgx);
  EXPECT_EQ(oily.MaterialAt(cheek).surface.form, FacetForm::kBeckmann);
  EXPECT_LT(oily.MaterialAt(forehead).surface.wide_share, oily.MaterialAt(cheek).surface.wide_share - 0.2F);
  EXPECT_GT(oily.MaterialAt(cheek).surface.fuzz_depth, 0.0F);
  // It says nothing of the light inside.
  EXPECT_EQ(oily.Skin(cheek).melanin, plain.Skin(cheek).melanin);
}

TEST_F(SceneFile, BoardSquaresAreWhereTheSquareSizeSays) {
  const Scene board = Make("[subject]\nshape = \"checkerboard\"\n[plate]\ncolumns = 4\nrows = 2\nsquare_mm = 10\n");
  const float dark = 0.04F, light = 0.9F;
  for (int c = 0; c < 4; ++c)
    for (int r = 0; r < 2; ++r)
      EXPECT_FLOAT_EQ(board.MaterialAt({-20 + 10 * c + 5.0, -10 + 10 * r + 5.0, 700}).albedo[1],
                      (c + r) % 2 == 0 ? dark : light);
  EXPECT_FLOAT_EQ(board.MaterialAt({25, 0, 700}).albedo[1], light) << "the margin";
  EXPECT_TRUE(std::isnan(board.Height(30.5, 0))) << "ends one square beyond the pattern";
}

// The first rows of the dictionary's markers 0 and 49, as OpenCV 4.6 draws them.
TEST_F(SceneFile, CharucoMarkersAreThoseOfTheDictionary) {
  const Scene board =
      Make("[subject]\nshape = \"charuco\"\n[plate]\ncolumns = 10\nrows = 7\nsquare_mm = 20\nmarker_mm = 12\n");
  auto row_of_marker = [&](double corner_x, double corner_y, int row) {
    std::string bits;
    for (int cell = 0; cell < 6; ++cell)
      bits += board.MaterialAt({corner_x + 4 + 2 * (cell + 0.5), corner_y + 4 + 2 * (row + 0.5), 700}).albedo[0] > 0.5F
                  ? '1'
                  : '0';
    return bits;
  };
  // Marker 0 lies in the second square of the first row.
  EXPECT_EQ(row_of_marker(-80, -70, 0), "000000");
  EXPECT_EQ(row_of_marker(-80, -70, 1), "010110");
  EXPECT_EQ(row_of_marker(-80, -70, 2), "001010");
  EXPECT_EQ(row_of_marker(-80, -70, 4), "000100");
  // The first white square of the second row is its first: marker 5.
  EXPECT_EQ(row_of_marker(-100, -50, 1), "001110");
}

TEST_F(SceneFile, RampStepsAreEvenAndTheChartHasItsNeutrals) {
  const Scene ramp = Make(
      "[subject]\nshape = \"ramp\"\n[plate]\ncolumns = 5\ndark_albedo = 0.1\nlight_albedo = 0.9\nwidth_mm = 100\n");
  for (int step = 0; step < 5; ++step)
    EXPECT_FLOAT_EQ(ramp.MaterialAt({-40.0 + 20 * step, 0, 700}).albedo[2], 0.1F + 0.2F * static_cast<float>(step));
  const auto& chart = ColourChart();
  for (size_t i = 18; i < 24; ++i) {
    EXPECT_NEAR(chart[i][0], chart[i][1], 0.02);
    EXPECT_NEAR(chart[i][1], chart[i][2], 0.02);
    if (i > 18) {
      EXPECT_LT(chart[i][1], chart[i - 1][1]);
    }
  }
  EXPECT_NEAR(chart[22][1], 0.09, 0.01) << "neutral 3.5 of the chart reflects 9 %";
}

TEST_F(SceneFile, OpenEyesCloseWhileBlinking) {
  const Scene face = Make("[subject]\nseed = 4\n[head]\nvariation = 0\n[motion]\nblink_at_s = [1.0]\nblink_s = 0.2\n");
  const Eigen::Vector3d pupil(31, -20.6, 700);
  EXPECT_EQ(face.MaterialAt(pupil).kind, MaterialKind::kEye);
  EXPECT_EQ(face.In(face.StateAt(0.99)).MaterialAt(pupil).kind, MaterialKind::kEye);
  EXPECT_EQ(face.In(face.StateAt(1.1)).MaterialAt(pupil).kind, MaterialKind::kSkin);
  EXPECT_EQ(face.In(face.StateAt(1.2)).MaterialAt(pupil).kind, MaterialKind::kEye);
}

TEST_F(SceneFile, DriftGoesInStepsOfTheStatedLength) {
  const Scene face = Make("[motion]\ndrift_mm_per_s = [0.3, 0.4, 0.0]\ndrift_start_s = 1.0\nstep_mm = 0.1\n");
  EXPECT_EQ(face.StateAt(0.9), SubjectState{});
  EXPECT_EQ(face.StateAt(1.19), SubjectState{});
  EXPECT_NEAR(face.StateAt(1.21).offset_mm.norm(), 0.1, 1e-12);
  const SubjectState later = face.StateAt(3.001);  // 1 mm on
  EXPECT_LT((later.offset_mm - Eigen::Vector3d(0.6, 0.8, 0.0)).norm(), 1e-9);
  const Scene moved = face.In(later);
  EXPECT_NEAR(moved.Height(10.6, 20.8), face.Height(10.0, 20.0), 1e-6);
  EXPECT_EQ(moved.Skin({10.6, 20.8, 0}).blood, face.Skin({10.0, 20.0, 0}).blood);
}

TEST_F(SceneFile, ATurnGoesInStepsMeasuredAtAHundredMillimetres) {
  const Scene face = Make("[motion]\nturn_deg_per_s = [0.0, 0.573, 0.0]\nstep_mm = 0.5\n");  // 1 mm/s at 100 mm
  EXPECT_EQ(face.StateAt(0.49), SubjectState{});
  EXPECT_NEAR(face.StateAt(1.2).turned_deg.y(), 0.573, 1e-3);
  EXPECT_TRUE(face.StateAt(1.2).offset_mm.isZero(0.0));
  const Scene turned = face.In(face.StateAt(10.01));  // 5.73 degrees about the middle
  const Eigen::Vector3d nose(0.0, 10.0, face.Height(0.0, 10.0)), pivot(0.0, 0.0, 700.0);
  const Eigen::Vector3d there = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()) * (nose - pivot) + pivot;
  EXPECT_NEAR(turned.Height(there.x(), there.y()), there.z(), 0.05);
}

TEST_F(SceneFile, WrinklesAreGroovesOfTheStatedDepth) {
  const Scene smooth = Make("[subject]\nseed = 6\n"), old = Make("[subject]\nseed = 6\n[head]\nwrinkles_mm = 0.8\n");
  double deepest = 0.0;
  for (double y = -80; y < -45; y += 0.1) deepest = std::max(deepest, old.Height(0.0, y) - smooth.Height(0.0, y));
  EXPECT_GT(deepest, 0.35);
  EXPECT_LT(deepest, 0.85);
  EXPECT_EQ(old.Height(30, 5), smooth.Height(30, 5)) << "cheeks are smooth";
}

TEST_F(SceneFile, StubbleCoversTheStatedShareOfTheBeard) {
  const Scene face = Make("[head]\nstubble_per_cm2 = 60\nstubble_mm = 0.8\n");
  int covered = 0, points = 0, above = 0;
  for (double x = -15; x < 15; x += 0.07)
    for (double y = 62; y < 72; y += 0.07) {
      covered += face.MaterialAt({x, y, 0}).kind == MaterialKind::kHair;
      above += face.MaterialAt({x, y - 120, 0}).kind == MaterialKind::kHair;
      ++points;
    }
  // 60 hairs of 0.64 x 0.11 mm on 100 mm^2, the raster's cells a little wider than the hair.
  EXPECT_NEAR(static_cast<double>(covered) / points, 0.042, 0.02);
  EXPECT_EQ(above, 0);
}

TEST_F(SceneFile, APersonsSkinIsDrawnAndKeysBesideItStand) {
  const std::string even = "patches = 0\nfreckles = 0\nvessels = 0\nredness = 0\nregions = 0\n";
  const auto at_cheek = [](const Scene& scene) { return scene.Skin({45, 10, 0}); };
  for (const int person : {0, 7, 999999}) {
    const std::string key = "[skin]\nperson = " + std::to_string(person) + "\n" + even;
    const SkinParameters drawn = Person(person), here = at_cheek(Make(key));
    EXPECT_FLOAT_EQ(here.melanin, drawn.melanin) << person;
    EXPECT_FLOAT_EQ(here.blood, drawn.blood) << person;
    EXPECT_FLOAT_EQ(here.epidermis_mm, drawn.epidermis_mm) << person;
    EXPECT_FLOAT_EQ(here.scattering, drawn.scattering) << person;
    // Each key alone, wherever it stands.
    const SkinParameters melanin = at_cheek(Make(key + "melanin = 0.07\n")),
                         blood =
                             at_cheek(Make("[skin]\nblood = 0.02\nperson = " + std::to_string(person) + "\n" + even)),
                         thick = at_cheek(Make(key + "epidermis_mm = 0.12\n")),
                         clear = at_cheek(Make(key + "scattering = 0.93\n"));
    EXPECT_FLOAT_EQ(melanin.melanin, 0.07F);
    EXPECT_FLOAT_EQ(melanin.blood, drawn.blood);
    EXPECT_FLOAT_EQ(blood.blood, 0.02F);
    EXPECT_FLOAT_EQ(blood.scattering, drawn.scattering);
    EXPECT_FLOAT_EQ(thick.epidermis_mm, 0.12F);
    EXPECT_FLOAT_EQ(thick.melanin, drawn.melanin);
    EXPECT_FLOAT_EQ(clear.scattering, 0.93F);
    EXPECT_FLOAT_EQ(clear.epidermis_mm, drawn.epidermis_mm);
  }
  // Whose skin it is where nobody is named, the seed says.
  const SkinParameters unnamed = at_cheek(Make("[subject]\nseed = 7\n[skin]\n" + even)), seventh = Person(7);
  EXPECT_EQ(unnamed.melanin, seventh.melanin);
  EXPECT_EQ(unnamed.scattering, seventh.scattering);
  // Freckles and patches are the seed's, not the person's.
  const Scene one = Make("[subject]\nseed = 3\n[skin]\nperson = 7\n"),
              other = Make("[subject]\nseed = 4\n[skin]\nperson = 7\n");
  EXPECT_NE(at_cheek(one).melanin, at_cheek(other).melanin);
  EXPECT_EQ(at_cheek(one).scattering, at_cheek(other).scattering);
  const auto picture =
      Load("[subject]\nshape = \"mesh\"\n[mesh]\nfile = \"a.obj\"\nalbedo = \"a.png\"\n[skin]\nperson = 7\n");
  const Status refused = picture.ok() ? picture->Validate() : picture.status();
  EXPECT_EQ(refused.code(), StatusCode::kUsage);
  EXPECT_THAT(refused.message(), HasSubstr("[skin] person sets melanin and blood"));
}

TEST_F(SceneFile, AnotherSubcutisIsEverywhereAndLeavesTheRestOfTheSkin) {
  const Scene usual = Make(""), other = Make("[skin]\nsubcutis_absorption = 2.5\nskin_mm = 1.2\n"),
              said = Make("[skin]\nsubcutis_absorption = 1\nskin_mm = 1.98\n");
  for (double x = -50; x < 50; x += 7.3)
    for (double y = -60; y < 60; y += 9.1) {
      const SkinParameters was = usual.Skin({x, y, 0}), is = other.Skin({x, y, 0});
      if (usual.MaterialAt({x, y, 0}).kind != MaterialKind::kSkin) continue;
      EXPECT_TRUE(was.UsualSubcutis());
      EXPECT_TRUE(said.Skin({x, y, 0}).UsualSubcutis());
      EXPECT_EQ(is.subcutis_absorption, 2.5F);
      EXPECT_EQ(is.skin_mm, 1.2);
      EXPECT_EQ(is.melanin, was.melanin);
      EXPECT_EQ(is.blood, was.blood);
      EXPECT_EQ(is.epidermis_mm, was.epidermis_mm);
      EXPECT_EQ(is.scattering, was.scattering);
    }
}

TEST_F(SceneFile, SkinTakesItsStatedMelaninFrecklesAndScar) {
  const std::string skin = "[skin]\nmelanin = 0.05\nregions = 0\npatches = 0\nfreckles = 0\n";
  const Scene even = Make(skin + "vessels = 0\nredness = 0\nblood = 0.004\n");
  for (double x = -50; x < 50; x += 3.7) {
    EXPECT_FLOAT_EQ(even.Skin({x, 10, 0}).melanin, 0.05F);
    EXPECT_FLOAT_EQ(even.Skin({x, 10, 0}).blood, 0.004F);
  }
  const Scene scarred = Make(skin + "scar = true\n");
  EXPECT_LT(scarred.Skin({31, 19, 0}).melanin, 0.02F);
  auto speckled = [](const Scene& scene) {
    int strong = 0;
    for (double x = -60; x < 60; x += 0.8)
      for (double y = -60; y < 80; y += 0.8) strong += scene.Skin({x, y, 0}).melanin > 0.06F;
    return strong;
  };
  const Scene many = Make("[skin]\nmelanin = 0.05\nregions = 0\npatches = 0\nfreckles = 300\n");
  EXPECT_GT(speckled(many), 100);
  EXPECT_EQ(speckled(even), 0);
}

}  // namespace
}  // namespace stratalux::rig
