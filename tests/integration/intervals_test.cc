// SPDX-License-Identifier: Apache-2.0
// What 95 % intervals hold of the truth: people are captured twice, by the camera and by one of a hundred times the
// photons, and what the visit states is held to what that one shows (docs/math/evaluation.md, "Intervals"). A camera
// without any noise is no truth: nothing dithers its steps of 1 DN, and dim tails are rounded away.
//   STRATALUX_PEOPLE=1000,1003 STRATALUX_VISITOR_SIZE=696x520 intervals_test     prints the figures of those people;
//   with STRATALUX_WORK=FOLDER their stores stay there, and are not captured anew
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "db/catalogue/artifact_record.h"
#include "fitter/evaluation/compare.h"
#include "fitter/evaluation/heldout_takes.h"
#include "fitter/evaluation/predict.h"
#include "fitter/evaluation/truth.h"
#include "fitter/export/exr_file.h"
#include "fitter/mixture/standard_errors.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/layer_maps.h"
#include "fitter/stages/layers_file.h"
#include "shared/base/formatted.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

// The better camera: electrons a DN, and DN of read noise.
constexpr int kQuietGain = 400;
constexpr double kQuietRead = 0.5;

std::string Given(const char* variable, const char* otherwise) {
  const char* text = std::getenv(variable);
  return text != nullptr ? text : otherwise;
}

std::vector<std::string> People() {
  std::istringstream in(Given("STRATALUX_PEOPLE", "12"));
  std::vector<std::string> people;
  for (std::string person; std::getline(in, person, ',');) people.push_back(person);
  return people;
}

// One store's session, fitted.
struct Visit {
  std::string store;
  fs::path session;
  Json metrics;
  [[nodiscard]] fs::path Artifact(const std::string& folder) const { return session / "artifacts" / folder; }
  [[nodiscard]] fs::path Made(const std::string& stage) const {
    return Artifact(metrics.at("artifacts").at(stage).get<std::string>());
  }
};

// How many values lie within their interval.
struct Within {
  int64_t inside = 0, all = 0;
  void Add(bool is_inside) {
    inside += is_inside ? 1 : 0;
    ++all;
  }
  [[nodiscard]] double share() const { return static_cast<double>(inside) / static_cast<double>(all); }
};

class Intervals : public ScratchFolderTest {
 protected:
  Visit Make(const std::string& name, const std::string& scene, const std::string& capture, const std::string& run) {
    Visit visit;
    visit.store = (fs::path(Given("STRATALUX_WORK", folder_.c_str())) / name).string();
    const std::string at = " --store " + visit.store;
    if (!fs::exists(visit.store)) {
      const Outcome captured = Execute("stratalux-rig capture --simulate" + scene + " --size " +
                                       Given("STRATALUX_VISITOR_SIZE", "348x260") + capture + at);
      EXPECT_TRUE(captured.code == 0 || captured.code == 3) << captured.out;
    }
    const Outcome fitted = Execute("stratalux-fit run latest --json" + run + at, Show::kStdout);
    EXPECT_EQ(fitted.code, 0);
    for (const auto& entry : fs::directory_iterator(fs::path(visit.store) / "sessions")) visit.session = entry.path();
    visit.metrics =
        Json::parse(ReadText(fs::path(Json::parse(fitted.out)["folder"].get<std::string>()) / "metrics.json"));
    return visit;
  }

  // The visit of a person, and the same by the quiet camera at the same exposure.
  void MakeBoth(const std::string& person, const std::string& run) {
    noisy_ = Make("person-" + person + "-noisy", "", " --exposure auto --seed " + person, run);
    const auto frames = SessionFrames::Open(noisy_.store, "latest");
    ASSERT_TRUE(frames.ok()) << frames.status().message();
    const fs::path scene = folder_ / "quiet.toml";
    WriteText(scene, Formatted("[camera]\ngain_e_per_dn = %d\nread_noise_dn = %.1f\n", kQuietGain, kQuietRead));
    quiet_ = Make("person-" + person + "-quiet", "=" + scene.string(),
                  " --seed " + person + " --exposure " + std::to_string(frames->plan()->exposure_ms), "");
    auto truth = SceneTruth::Open(noisy_.session);
    ASSERT_TRUE(truth.ok() && *truth);
    truth_ = **std::move(truth);
    auto skin = truth_->Skin();
    ASSERT_TRUE(skin.ok());
    skin_ = *std::move(skin);
  }

  Visit noisy_, quiet_;
  std::optional<SceneTruth> truth_;
  Image<uint8_t> skin_;
};

// Of skin that both have fitted: is what the quiet fit finds within the noisy one's interval?
// The fourth: is the simulated skin's own width?
std::array<Within, 4> LayersWithin(const Visit& noisy, const Visit& quiet, const Image<uint8_t>& skin,
                                   const Image<float>& spread) {
  std::array<Within, 4> within;
  const auto layers = LoadLayers(noisy.Made("fit")), without = LoadLayers(quiet.Made("fit"));
  const std::vector<std::string> names = {"total_weight.R",       "total_weight.G",       "total_weight.B",
                                          "mean_depth_mm.R",      "mean_depth_mm.G",      "mean_depth_mm.B",
                                          "effective_width_mm.R", "effective_width_mm.G", "effective_width_mm.B"};
  const auto errors = ReadExr(noisy.Made("standard_errors") / "standard_errors.exr", names);
  EXPECT_TRUE(layers.ok() && without.ok() && errors.ok());
  const LayerMaps found = SummariseLayers(layers->map), truth = SummariseLayers(without->map);
  const std::array<std::pair<const Image<float>*, const Image<float>*>, 3> maps = {
      {{&found.total_weight, &truth.total_weight},
       {&found.mean_depth_mm, &truth.mean_depth_mm},
       {&found.effective_width_mm, &truth.effective_width_mm}}};
  for (int y = 0; y < skin.height(); ++y)
    for (int x = 0; x < skin.width(); ++x)
      for (int c = 0; c < 3 && skin(x, y) != 0; ++c)
        for (int m = 0; m < 3; ++m) {
          const double half = kInterval95 * (*errors)(x, y, 3 * m + c),
                       off = (*maps[m].first)(x, y, c) - (*maps[m].second)(x, y, c);
          if (std::isfinite(half) && std::isfinite(off)) within[m].Add(std::abs(off) <= half);
          if (m == 2 && std::isfinite(half) && std::isfinite(spread(x, y, c)))
            within[3].Add(std::abs(found.effective_width_mm(x, y, c) - spread(x, y, c)) <= half);
        }
  return within;
}

// The fit's own comparison of a hold-out, not that of the ablations.
struct HoldOut {
  fs::path compare, predict;
  Comparison comparison;
};

std::map<int, HoldOut> HoldOutsOf(const Visit& visit) {
  std::map<int, HoldOut> found;
  for (const auto& entry : fs::directory_iterator(visit.session / "artifacts")) {
    if (!entry.path().filename().string().starts_with("compare-")) continue;
    const auto record = db::ReadArtifactRecord(entry.path());
    EXPECT_TRUE(record.ok());
    const Json options = Json::parse(record->identity.options_json);
    if (options.at("geometry") != "reconstructed" || !record->identity.inputs.contains("predict:dipole")) continue;
    HoldOut holdout{entry.path(), visit.Artifact("predict-" + record->identity.inputs.at("predict:tied")), {}};
    auto comparison = LoadComparison(holdout.compare);
    EXPECT_TRUE(comparison.ok());
    holdout.comparison = *std::move(comparison);
    found[options.at("projector")] = std::move(holdout);
  }
  return found;
}

// Of narrower intervals the quiet camera's own noise would be most of what is judged.
constexpr double kLeastHalfDn = 2.0;

// Variance of the quiet camera's light, DN^2: of photons, of what it reads by, and of its steps of 1 DN; by how many
// sites it is the mean of.
double QuietVariance(double light_dn, int sites) {
  return (std::max(light_dn, 0.0) / kQuietGain + kQuietRead * kQuietRead + 1.0 / 12.0) / sites;
}

// By what the other hold-outs say, without the captured noise: is what the quiet camera saw within the interval,
// widened by that camera's noise?
Within LightWithin(const Visit& noisy, const Visit& quiet, const std::map<int, HoldOut>& holdouts, int projector,
                   const std::string& light, const SceneTruth& truth, const Image<uint8_t>& skin) {
  Within within;
  const auto record = db::ReadArtifactRecord(holdouts.at(projector).compare);
  const auto shape = LoadShape([&] {
    for (const char* stage : {"placed_shape-", "shape-"})
      if (fs::exists(noisy.Artifact(stage + record->identity.inputs.at("shape"))))
        return noisy.Artifact(stage + record->identity.inputs.at("shape"));
    return fs::path();
  }());
  const auto predicted = LoadPrediction(holdouts.at(projector).predict);
  const auto frames = SessionFrames::Open(quiet.store, "latest");
  const auto target = ReadHeldOutTarget(*frames, projector, light);
  const auto lit = truth.LitBy(projector);
  EXPECT_TRUE(shape.ok() && predicted.ok() && target.ok() && lit.ok());
  const HeldOutView view = ViewOf(*shape, *frames->plan(), projector, {light, "white"});
  const Image<float> prediction = predicted->AllLight(light, view.irradiance[0]),
                     white = predicted->AllLight("white", view.irradiance[1]);
  const ErrorCauseMaps causes(shape->surface, shape->record.projectors[projector].CentreInCamera(), prediction, white);
  for (int c = 0; c < prediction.channels(); ++c) {
    std::vector<ErrorSample> samples;
    for (const auto& [p, holdout] : holdouts)
      for (size_t of = 0; p != projector && of < holdout.comparison.errors.lights.size(); ++of) {
        const auto& own = holdout.comparison.errors.samples[of * prediction.channels() + c];
        samples.insert(samples.end(), own.begin(), own.end());
      }
    const auto error = LearnPredictionError(samples);
    EXPECT_TRUE(error.has_value());
    for (int j = 0; j < prediction.height(); ++j)
      for (int i = 0; i < prediction.width(); ++i) {
        if (skin(i, j) == 0 || (*lit)(i, j) == 0 || shape->lit[projector](i, j) == 0) continue;
        const double off = target->target(i, j, c) - prediction(i, j, c), half = error->HalfWidth(causes.At(i, j, c));
        if (!std::isfinite(off) || half < kLeastHalfDn) continue;
        const int sites = target->takes * (c == 1 ? 2 : 1);  // a quad has two greens
        const double of_noise = kInterval95 * std::sqrt(QuietVariance(target->target(i, j, c), sites));
        within.Add(std::abs(off) <= std::hypot(half, of_noise));
      }
  }
  return within;
}

TEST_F(Intervals, HoldTheTruthOfPeople) {
  for (const std::string& person : People()) {
    MakeBoth(person, " --full-evaluation --standard-errors");
    const auto spread = truth_->Spread();
    ASSERT_TRUE(spread.ok() && !spread->empty());
    const auto layers = LayersWithin(noisy_, quiet_, skin_, *spread);
    std::printf(
        "person %s: within 95 %% intervals: total weight %.3f, mean depth %.3f, effective width %.3f (true one %.3f) "
        "of %lld\n",
        person.c_str(), layers[0].share(), layers[1].share(), layers[2].share(), layers[3].share(),
        static_cast<long long>(layers[0].all));
    for (size_t m = 0; m < 3; ++m) EXPECT_GT(layers[m].share(), 0.8);
    const auto holdouts = HoldOutsOf(noisy_);
    ASSERT_EQ(holdouts.size(), 4U);
    for (const char* light : {"stripe", "white", "spot"}) {
      Within all;
      std::printf("  %s:", light);
      for (const auto& [projector, holdout] : holdouts) {
        const Within one = LightWithin(noisy_, quiet_, holdouts, projector, light, *truth_, skin_);
        std::printf(" %.3f", one.share());
        all.inside += one.inside;
        all.all += one.all;
      }
      std::printf(", all %.3f of %lld\n", all.share(), static_cast<long long>(all.all));
      EXPECT_GT(all.all, 500) << light;
      EXPECT_GT(all.share(), 0.91) << light;
      EXPECT_LT(all.share(), 0.985) << light;
    }
    for (const Json& c : noisy_.metrics["intervals"]["covered"])
      std::printf("  stated, projector %d, %s: %.3f, half-width %.3f\n", c["projector"].get<int>(),
                  c["light"].get<std::string>().c_str(), c["share"].get<double>(), c["half_width"].get<double>());
    std::printf("  parts: %s\n", noisy_.metrics["intervals"]["colours"].dump().c_str());
  }
}

}  // namespace
}  // namespace stratalux::fit
