// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/relight.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "fitter/evaluation/prediction_error.h"
#include "fitter/export/exr_file.h"
#include "tests/fitter/render/lit_scene.h"
#include "tests/support/png_rgba.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class RelightTest : public ScratchFolderTest {
 protected:
  [[nodiscard]] Relit Under(const Eigen::Vector3d& towards) const {
    VirtualLight light;
    light.kind = VirtualLight::Kind::kDirectional;
    light.vector = towards;
    auto relit = Relight(fit_, light);
    EXPECT_TRUE(relit.ok()) << relit.status().message();
    return std::move(*relit);
  }
  static SavedFit FitOf(const LitScene& scene) {
    SavedFit fit{{}, UniformSkin(scene, SkinLayers()), 1};
    fit.shape.record = scene.rig;
    fit.shape.surface = scene.surface;
    fit.map.training_projectors = {0};
    fit.map.surface.assign(static_cast<size_t>(fit.map.profiles()), 0.04F);
    return fit;
  }

  LitScene scene_ = MakeScene(FrontalPlane(), Eigen::Vector3d::Zero(), Cfa::kRggb);
  SavedFit fit_ = FitOf(scene_);
};

TEST_F(RelightTest, ALightBehindTheFaceIsSaid) {
  EXPECT_THAT(Under({0.0, 0.0, -1.0}).Notes(), IsEmpty());
  EXPECT_THAT(Under({0.0, 0.0, 1.0}).Notes(), Contains(HasSubstr("no light reaches the face")));
}

TEST_F(RelightTest, AColourThatWasNotFittedIsUnknownNotDark) {
  const Relit whole = Under({0.0, 0.0, -1.0});
  EXPECT_EQ(whole.incomplete, 0);
  fit_.map.reason[fit_.map.ProfileIndex(20, 15, 2)] = static_cast<uint8_t>(FitReason::kTooDark);
  const Relit relit = Under({0.0, 0.0, -1.0});
  EXPECT_EQ(relit.face, whole.face);
  EXPECT_EQ(relit.incomplete, 1);
  EXPECT_THAT(relit.Notes(), Contains(HasSubstr("1 of " + std::to_string(whole.face))));
  for (const Image<float>* image : {&relit.subsurface, &relit.surface, &relit.total}) {
    EXPECT_TRUE(std::isnan((*image)(20, 15, 2)));
    EXPECT_TRUE(std::isfinite((*image)(20, 15, 1)));
    EXPECT_TRUE(std::isfinite((*image)(21, 15, 2)));
  }
  EXPECT_EQ(relit.total(20, 15, 0), whole.total(20, 15, 0)) << "the others stay";
}

TEST_F(RelightTest, PicturesHaveTheFaceAsTheirAlpha) {
  for (int i = 0; i < 10; ++i) fit_.shape.surface.mask(i, 12) = 0;
  fit_.map.reason[fit_.map.ProfileIndex(20, 15, 2)] = static_cast<uint8_t>(FitReason::kTooDark);
  const Relit relit = Under({0.0, 0.0, -1.0});
  ASSERT_TRUE(WriteRelit(folder_, relit, 0.0, "s000001", "0123456789abcdef").ok());
  for (const std::string name : {"subsurface", "surface", "total"}) {
    const auto exr = ReadExr(folder_ / (name + ".exr"), {"R", "G", "B", "A"});
    ASSERT_TRUE(exr.ok()) << exr.status().message();
    const Image<uint8_t> png = ReadPngRgba(folder_ / (name + ".png"));
    for (int j = 0; j < png.height(); ++j)
      for (int i = 0; i < png.width(); ++i) {
        const bool face = fit_.shape.surface.mask(i, j) != 0;
        EXPECT_EQ((*exr)(i, j, 3), face ? 1.0F : 0.0F) << name << " " << i << " " << j;
        EXPECT_EQ(png(i, j, 3), face ? 255 : 0) << name << " " << i << " " << j;
        for (int c = 0; c < 3 && !face; ++c) EXPECT_EQ((*exr)(i, j, c), 0.0F) << "premultiplied";
      }
    EXPECT_TRUE(std::isnan((*exr)(20, 15, 2))) << "a colour that is not known does not take the face away";
  }
}

// What intervals of a pattern's light are measured by; a lamp without a pattern is its own white.
TEST_F(RelightTest, APatternHasTheWhiteOfItsLight) {
  EXPECT_TRUE(Under({0.0, 0.0, -1.0}).white.empty());
  VirtualLight light{.kind = VirtualLight::Kind::kProjector};
  const auto white = Relight(fit_, light);
  light.pattern = {.kind = PatternKind::kComb, .period = 64, .width = 8};
  const auto stripe = Relight(fit_, light);
  ASSERT_TRUE(white.ok() && stripe.ok());
  EXPECT_TRUE(white->white.empty());
  ASSERT_EQ(stripe->white.size(), white->total.size());
  double dimmer = 0.0;
  for (size_t i = 0; i < white->total.size(); ++i) {
    EXPECT_EQ(stripe->white.pixels()[i], white->total.pixels()[i]) << i;
    dimmer += stripe->total.pixels()[i] < 0.5F * white->total.pixels()[i] ? 1.0 : 0.0;
  }
  EXPECT_GT(dimmer, 0.2 * static_cast<double>(white->total.size()));
}

TEST_F(RelightTest, StatesIntervalsWhereTheyAreKnownAndKeepsNoneOfAnotherPicture) {
  Relit relit = Under({0.0, 0.0, -1.0});
  const std::vector<PredictionError> told(3, {0.03 / kInterval95, 0.0, 0.0, 0.0, 1000});
  relit.half_width = HalfWidths(fit_.shape.surface, relit.light_mm, relit.total, relit.total, told);
  ASSERT_TRUE(WriteRelit(folder_, relit, 0.0, "s000001", "0123456789abcdef").ok());
  const auto half = ReadExr(folder_ / "interval.exr", {"R", "G", "B", "A"});
  ASSERT_TRUE(half.ok()) << half.status().message();
  EXPECT_NEAR((*half)(20, 15, 1), 0.03F * relit.total(20, 15, 1), 1e-5F);
  const auto json = nlohmann::json::parse(ReadText(folder_ / "relit.json"));
  EXPECT_NEAR(json["interval"]["half_width"].get<double>(), 0.03, 1e-6);
  relit.half_width = {};
  ASSERT_TRUE(WriteRelit(folder_, relit, 0.0, "s000001", "0123456789abcdef").ok());
  EXPECT_FALSE(std::filesystem::exists(folder_ / "interval.exr"));
  EXPECT_THAT(ReadText(folder_ / "relit.json"), Not(HasSubstr("interval")));
}

TEST_F(RelightTest, PicturesThatAFailureHasMixedHaveNoRecord) {
  Relit relit = Under({0.0, 0.0, -1.0});
  relit.half_width = relit.total;
  // A picture in the midst of them, and the record itself, each with a folder in the way.
  for (const char* blocked : {"surface.exr.new", "relit.json.new"}) {
    ASSERT_TRUE(WriteRelit(folder_, relit, 0.0, "s000001", "0123456789abcdef").ok());
    std::filesystem::create_directories(folder_ / blocked / "kept");
    relit.half_width = {};
    const Status failed = WriteRelit(folder_, relit, 0.0, "s000001", "fedcba9876543210");
    EXPECT_EQ(failed.code(), StatusCode::kFailed) << blocked;
    EXPECT_THAT(failed.message(), HasSubstr(blocked));
    EXPECT_FALSE(std::filesystem::exists(folder_ / "relit.json")) << blocked;
    EXPECT_FALSE(std::filesystem::exists(folder_ / "interval.exr")) << blocked << ": of the earlier pictures";
    std::filesystem::remove_all(folder_ / blocked);
    ASSERT_TRUE(WriteRelit(folder_, relit, 0.0, "s000001", "fedcba9876543210").ok());
    EXPECT_THAT(ReadText(folder_ / "relit.json"), HasSubstr("fedcba9876543210"));
    relit.half_width = relit.total;
  }
}

// Its virtual projector looks along the axis that is "down" elsewhere.
TEST_F(RelightTest, StraightFromAboveOrBelowIsLikeAlmostSo) {
  scene_ = MakeScene(FaceLike(), Eigen::Vector3d::Zero(), Cfa::kRggb);
  fit_ = FitOf(scene_);
  for (const double y : {-1.0, 1.0}) {
    const Relit straight = Under({0.0, y, 0.0}), almost = Under({1e-3, y, 0.0});
    EXPECT_THAT(straight.Notes(), IsEmpty());
    double light = 0.0, change = 0.0;
    for (size_t k = 0; k < almost.total.size(); ++k) {
      light += almost.total.pixels()[k];
      change += std::abs(straight.total.pixels()[k] - almost.total.pixels()[k]);
    }
    EXPECT_GT(light, 0.0);
    EXPECT_LT(change, 0.01 * light);
  }
}

}  // namespace
}  // namespace stratalux::fit
