// SPDX-License-Identifier: Apache-2.0
// What maps from all projectors are worth on a simulated visitor, whose truth is known: against the fit that leaves one
// out (docs/math/em.md, "Maps from all projectors").
//   STRATALUX_VISITOR_SIZE=696x520 STRATALUX_SEED=12 maps_worth_test     prints the figures of another visitor
//   STRATALUX_VISITOR_STORE=store maps_worth_test                        of the one of that store
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/evaluation/image_error.h"
#include "fitter/evaluation/predict.h"
#include "fitter/evaluation/truth.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/maps.h"
#include "fitter/stages/skin.h"
#include "fitter/stages/srd_file.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

std::string Given(const char* variable, const char* otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? text : otherwise;
}

constexpr int kHeldOut = 3, kProjectors = 4;

class MapsWorth : public ScratchFolderTest {
 protected:
  void SetUp() override {
    ScratchFolderTest::SetUp();
    const std::string store = Given("STRATALUX_VISITOR_STORE", (folder_ / "store").c_str()), at = " --store " + store;
    if (!fs::exists(store)) {
      const std::string visitor =
          " --seed " + Given("STRATALUX_SEED", "8") + " --size " + Given("STRATALUX_VISITOR_SIZE", "348x260");
      ASSERT_EQ(Execute("stratalux-db init" + at).code, 0);
      ASSERT_EQ(Execute("stratalux-rig capture --simulate" + at + visitor).code, 0);
    }
    // All layers that are compared here, those fitted below too, stand on the surface as the codes have it.
    const Outcome made = Execute("stratalux-fit fit latest --offset off" + at, Show::kStdout);
    ASSERT_EQ(made.code, 0) << made.out;
    for (const auto& entry : fs::directory_iterator(fs::path(store) / "sessions")) session_ = entry.path();
    auto srds = LoadSrds(Artifact("srd"));
    ASSERT_TRUE(srds.ok()) << srds.status().message();
    srds_ = std::move(srds->set);
    const auto skin = LoadSkin(Artifact("skin"));
    ASSERT_TRUE(skin.ok()) << skin.status().message();
    ASSERT_TRUE(SetApart(srds_, *skin).ok());
    auto shape = LoadShape(Artifact("shape"));
    ASSERT_TRUE(shape.ok()) << shape.status().message();
    shape_ = *std::move(shape);
    auto truth = SceneTruth::Open(session_);
    ASSERT_TRUE(truth.ok() && *truth);
    truth_ = **std::move(truth);
    const auto frames = SessionFrames::Open(store, "latest");
    ASSERT_TRUE(frames.ok()) << frames.status().message();
    plan_ = *frames->plan();
  }

  [[nodiscard]] fs::path Artifact(const std::string& stage) const {
    for (const auto& entry : fs::directory_iterator(session_ / "artifacts"))
      if (entry.path().filename().string().starts_with(stage + "-")) return entry.path();
    ADD_FAILURE() << "no artifact of " << stage;
    return {};
  }

  fs::path session_;
  SrdSet srds_;
  FaceShape shape_;
  PlanOptions plan_;
  std::optional<SceneTruth> truth_;
  Logger logger_;
};

SharedLight SharedOf(const SrdSet& srds) {
  return FindSharedLight({}, TrainingLightsOf(srds, kNoneHeldOut)->batches, srds.Grid());
}

// Of all maps, on one mask: skin that the light truly reaches and that each of them has fitted.
std::vector<double> ErrorsOf(const std::vector<const MixtureMap*>& maps, const FaceShape& shape,
                             const SceneTruth& truth, const PlanOptions& plan, int pool) {
  std::vector<double> errors(maps.size(), 0.0);
  const auto skin = truth.Skin();
  EXPECT_TRUE(skin.ok());
  const std::vector<std::string> lights = {"stripe", "white"};
  for (int p = 0; p < kProjectors; ++p) {
    const HeldOutView view = ViewOf(shape, plan, p, lights);
    const auto lit = truth.LitBy(p);
    EXPECT_TRUE(lit.ok());
    std::vector<Prediction> predicted;
    for (const MixtureMap* map : maps) predicted.push_back(Predict(*map, pool, view));
    for (const std::string& light : lights) {
      const auto real = truth.Subsurface(light, p);
      EXPECT_TRUE(real.ok());
      Image<uint8_t> mask = shape.surface.mask;
      for (int j = 0; j < mask.height(); ++j)
        for (int i = 0; i < mask.width(); ++i) {
          bool wanted = mask(i, j) != 0 && (*skin)(i, j) != 0 && (*lit)(i, j) != 0;
          for (const Prediction& of : predicted)
            for (int c = 0; c < real->channels(); ++c)
              wanted = wanted && std::isfinite(of.subsurface.at(light)(i, j, c));
          mask(i, j) = wanted ? 1 : 0;
        }
      for (size_t m = 0; m < maps.size(); ++m)
        errors[m] += CompareImages(real->view(), predicted[m].subsurface.at(light).view(), mask.view()).nrmse /
                     static_cast<double>(kProjectors * lights.size());
    }
  }
  return errors;
}

TEST_F(MapsWorth, AreNearerToTheTruthThanTheFitOfThree) {
  const auto fit = LoadLayers(Artifact("fit"));
  ASSERT_TRUE(fit.ok()) << fit.status().message();
  const FitOptions options;
  const auto maps = FitMaps(srds_, kHeldOut, options, SharedOf(srds_), logger_, "maps");
  ASSERT_TRUE(maps.ok()) << maps.status().message();
  // Ablation: the fourth light's samples are those of a light from the other side.
  SrdSet wrong = srds_;
  for (float& slope : wrong.batches[kHeldOut].slope_in) slope = -slope;
  const auto spoilt = FitMaps(wrong, kHeldOut, options, SharedOf(wrong), logger_, "spoilt");
  ASSERT_TRUE(spoilt.ok());

  const std::vector<const MixtureMap*> all = {&fit->map, &maps->layers.map, &spoilt->layers.map};
  const auto error = ErrorsOf(all, shape_, *truth_, plan_, srds_.pool);
  const char* names[] = {"fit of three", "maps, all four", "maps, wrong side"};
  for (size_t m = 0; m < all.size(); ++m) std::printf("%-18s error %.3f %%\n", names[m], 100 * error[m]);
  EXPECT_LT(error[1], 0.98 * error[0]);
  EXPECT_GT(error[2], 1.05 * error[1]);
}

}  // namespace
}  // namespace stratalux::fit
