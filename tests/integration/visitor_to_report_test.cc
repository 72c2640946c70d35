// SPDX-License-Identifier: Apache-2.0
// The main job, end to end, as a user runs it: a simulated visitor is captured, fitted, compared and reported.
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

// Of the camera, in pixels; at night the size of the figures in README.
std::string Size() {
  const char* size = std::getenv("STRATALUX_VISITOR_SIZE");
  return size != nullptr ? size : "348x260";
}

// Of a skin that does not scatter: layers tell it at any size.
std::string OpaqueSize() { return std::getenv("STRATALUX_VISITOR_SIZE") != nullptr ? Size() : "232x174"; }

// By day a pixel is twice as wide as that of the figures: two bounds are wider, by what was measured there (0.050 mm;
// 0.054 and 0.053).
double Bound(double of_figures, double by_day) {
  return std::getenv("STRATALUX_VISITOR_SIZE") != nullptr ? of_figures : by_day;
}

// One store for all cases of this program.
class Visitor : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = fs::temp_directory_path() / ("stratalux_integration_" + std::to_string(getpid()));
    store_ = (folder_ / "store").string();
    ASSERT_EQ(Execute("stratalux-db init --store " + store_).code, 0);
    // What is found of the surface can be held to what is there where it is of the fit's form.
    const std::string scene = STRATALUX_SOURCE_DIR "/docs/examples/scenes/plain_head.toml";
    ASSERT_EQ(
        Execute("stratalux-rig capture --simulate=" + scene + " --store " + store_ + " --seed 5 --size " + Size()).code,
        0);
    const Outcome run =
        Execute("stratalux-fit run latest --store " + store_ + " --full-evaluation --json", Show::kStdout);
    ASSERT_EQ(run.code, 0);
    fit_ = Json::parse(run.out)["folder"].get<std::string>();
    metrics_ = Json::parse(ReadText(fit_ / "metrics.json"));
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static Json Figure(const std::string& light, const std::string& model, const std::string& part,
                     const std::string& direct, int projector, const std::string& geometry) {
    for (const Json& f : metrics_["prediction"])
      if (f["light"] == light && f["model"] == model && f["part"] == part && f["direct"] == direct &&
          f["projector"] == projector && f["geometry"] == geometry)
        return f;
    ADD_FAILURE() << light << model << part << direct << projector << geometry;
    return {{"nrmse", std::nan("")}, {"nrmse_without_noise", std::nan("")}, {"bias", std::nan("")}};
  }
  static double Nrmse(const std::string& light, const std::string& model, const std::string& part,
                      const std::string& direct, int projector, const std::string& geometry) {
    return Figure(light, model, part, direct, projector, geometry)["nrmse"];
  }

  static inline fs::path folder_, fit_;
  static inline std::string store_;
  static inline Json metrics_;
};

TEST_F(Visitor, IsStoredWithAGaplessProof) {
  EXPECT_EQ(Execute("stratalux-db verify latest --store " + store_).code, 0);
}

TEST_F(Visitor, ShapeAgreesWithTheSimulatedTruth) {
  EXPECT_LT(metrics_["truth"]["depth_rms_mm"].get<double>(), 0.3);
  EXPECT_LT(std::abs(metrics_["truth"]["depth_bias_mm"].get<double>()), Bound(0.04, 0.06));
  EXPECT_LT(metrics_["truth"]["normal_median_deg"].get<double>(), 1.0);
  int width = 0, height = 0;
  ASSERT_EQ(std::sscanf(Size().c_str(), "%dx%d", &width, &height), 2);
  EXPECT_GT(metrics_["truth"]["pixels"].get<double>(), 0.062 * width * height);
  // What that is in columns: at most 2.1 a millimetre, for a projector that looks across the view at 32 degrees.
  const Json& columns = metrics_["truth"]["columns"];
  ASSERT_EQ(columns.size(), 4U);
  for (const Json& column : columns) {
    EXPECT_LT(std::abs(column["mean_px"].get<double>()), 2.1 * Bound(0.04, 0.06)) << column;
    EXPECT_LT(column["rms_px"].get<double>(), 2.1 * metrics_["truth"]["depth_rms_mm"].get<double>()) << column;
    EXPECT_GT(column["quads"], 0.5 * metrics_["truth"]["pixels"].get<double>()) << column;
  }
}

// Beside each diffuse normal the specular one in its place. By day a quad is wider than light spreads: there is nothing
// to filter; of the figures' size red light spreads further.
TEST_F(Visitor, TwoNormalsAgreeWithTheSimulatedTruth) {
  const Json& normals = metrics_["normals"];
  EXPECT_LT(normals["specular"]["median_deg"].get<double>(), 1.5);
  EXPECT_GT(normals["photometric"]["median_deg"].get<double>(), normals["specular"]["median_deg"].get<double>());
  // Light adds detail that the surface lacks, and no error of its own (8 quads for L: a tenth and more).
  EXPECT_LT(normals["specular"]["rms_deg"].get<double>(), 1.05 * normals["surface"]["rms_deg"].get<double>());
  ASSERT_EQ(normals["diffuse"].size(), 3U);
  for (const Json& colour : normals["diffuse"]) {
    const double median = colour["filtered"]["median_deg"], unfiltered = colour["unfiltered"]["median_deg"];
    EXPECT_LT(median, 0.5) << colour;
    EXPECT_LT(median, (colour["colour"] == "R" ? Bound(0.95, 1.05) : 1.05) * unfiltered) << colour;
    EXPECT_GT(colour["filtered"]["quads"], 0.5 * metrics_["truth"]["pixels"].get<double>()) << colour;
  }
  EXPECT_TRUE(fs::exists(fit_ / "normal_diffuse.exr"));
}

// Scattering displaces the codes; the sweeps of the training lights tell by how much, and what light from other
// directions does is seen again.
TEST_F(Visitor, SurfaceLiesWhereTheSweepsSay) {
  const double by_codes = metrics_["unplaced"]["depth_bias_mm"];
  EXPECT_GT(by_codes, 0.06);
  ASSERT_EQ(metrics_["offsets"].size(), 9U);  // by all projectors; without each, and of the blind fit there
  for (const Json& offset : metrics_["offsets"]) {
    const double bias = offset["truth"]["depth_bias_mm"];
    if (offset["model"] == "tied")
      EXPECT_LT(std::abs(bias), 0.45 * by_codes) << offset;
    else
      EXPECT_GT(bias, 0.9 * by_codes) << offset;  // a wrong depth makes up for a wrong model
    EXPECT_LT(offset["sigma_mm"].get<double>(), 0.03) << offset;
  }
  for (const Json& centroid : metrics_["srd_centroid"]) {
    const double measured = centroid["measured_mm_per_shift"], predicted = centroid["predicted_mm_per_shift"];
    EXPECT_GT(measured, 0.1) << centroid;
    EXPECT_NEAR(predicted / measured, 1.0, 0.25) << centroid;
  }
}

// Skin displaces the codes by a fraction of a column: that is no drift.
TEST_F(Visitor, SaysThatTheRigStandsAsItWasCalibrated) {
  EXPECT_EQ(metrics_["drift"]["warning"], "");
  ASSERT_EQ(metrics_["drift"]["projectors"].size(), 4U);
  for (const Json& p : metrics_["drift"]["projectors"]) EXPECT_LT(p["shift_px"].get<double>(), 0.35) << p;
}

TEST_F(Visitor, LayersPredictTheHeldOutLightBetterThanTheBaselines) {
  for (const char* geometry : {"reconstructed", "truth"}) {
    const double tied = Nrmse("stripe", "tied", "subsurface", "truth", 3, geometry);
    EXPECT_LT(tied, 0.95 * Nrmse("stripe", "homogeneous", "subsurface", "truth", 3, geometry)) << geometry;
    EXPECT_LT(tied, 0.1) << geometry;
  }
  EXPECT_LT(Nrmse("white", "tied", "subsurface", "truth", 3, "reconstructed"),
            0.8 * Nrmse("white", "homogeneous", "subsurface", "truth", 3, "reconstructed"));
  // The whole direction effect is a centroid of 0.15 mm.
  for (const char* geometry : {"reconstructed", "truth"})
    EXPECT_LT(Nrmse("stripe", "tied", "subsurface", "truth", 3, geometry),
              0.7 * Nrmse("stripe", "direction_blind", "subsurface", "truth", 3, geometry))
        << geometry;
  EXPECT_LT(Nrmse("stripe", "tied", "subsurface", "truth", 3, "reconstructed"),
            Nrmse("stripe", "direction_blind_placed", "subsurface", "truth", 3, "reconstructed"));
}

// Surface and layers together are what the camera saw, noise apart.
TEST_F(Visitor, SumOfSurfaceAndLayersIsTheHeldOutLight) {
  const auto above_noise = [](const char* light, const char* model, const char* direct, const char* geometry) {
    return Figure(light, model, "total", direct, 3, geometry)["nrmse_without_noise"].get<double>();
  };
  for (const char* geometry : {"reconstructed", "truth"}) {
    EXPECT_LT(above_noise("stripe", "tied", "separated", geometry), Bound(0.05, 0.06)) << geometry;
    // A spot falls on few quads, dim ones beside it; all that exceed their noise are judged (measured: 0.0500).
    EXPECT_LT(above_noise("spot", "tied", "separated", geometry), 0.055) << geometry;
    EXPECT_LT(above_noise("white", "tied", "separated", geometry), 0.03) << geometry;
    // With nothing of the held-out light but its directions.
    EXPECT_LT(above_noise("stripe", "tied", "predicted", geometry), 0.055) << geometry;
    EXPECT_LT(above_noise("white", "tied", "predicted", geometry), 0.03) << geometry;
  }
  for (const char* geometry : {"reconstructed", "truth"})
    EXPECT_LT(above_noise("stripe", "tied", "separated", geometry),
              0.6 * above_noise("stripe", "direction_blind", "separated", geometry))
        << geometry;
}

TEST_F(Visitor, TotalOfTheLayersIsUnbiased) {
  for (const char* geometry : {"reconstructed", "truth"})
    EXPECT_LT(std::abs(Figure("white", "tied", "subsurface", "truth", 3, geometry)["bias"].get<double>()), 0.015)
        << geometry;
  EXPECT_NEAR(metrics_["fit"]["surface"]["strength"].get<double>(), 1.0, 0.15);
  EXPECT_NEAR(metrics_["fit"]["surface"]["roughness"].get<double>(), 0.35, 0.03);
}

TEST_F(Visitor, EveryProjectorIsHeldOutOnceWithEveryModel) {
  for (int p = 0; p < 4; ++p)
    for (const char* model : {"tied", "homogeneous", "homogeneous_local_albedo", "direction_blind"})
      for (const char* light : {"stripe", "white"}) {
        const double total = Nrmse(light, model, "total", "separated", p, "reconstructed"),
                     part = Nrmse(light, model, "subsurface", "truth", p, "reconstructed");
        EXPECT_TRUE(total > 0.0 && total < 0.3) << p << model << light << total;
        EXPECT_TRUE(part > 0.0 && part < 0.2) << p << model << light << part;
      }
  EXPECT_FALSE(metrics_["stages"].empty());
  for (const Json& stage : metrics_["stages"]) EXPECT_GT(stage["peak_rss_bytes"].get<int64_t>(), 1 << 20);
  EXPECT_GT(metrics_["fit"]["divergence"].get<double>(), 0.0);
}

TEST_F(Visitor, SpoiltFitsPredictWorse) {
  const auto error_of = [](const std::string& model) {
    for (const Json& a : metrics_["ablations"])
      if (a["model"] == model && a["light"] == "stripe" && a["part"] == "subsurface") return a["nrmse"].get<double>();
    ADD_FAILURE() << model;
    return 0.0;
  };
  EXPECT_GT(error_of("comb_frames_shuffled"), 3.0 * error_of("tied"));
  EXPECT_GT(error_of("projectors_permuted"), 1.05 * error_of("tied"));
}

// What two takes say of the noise is what the camera's model says.
TEST_F(Visitor, NoiseOfTheTakesIsTheCameras) {
  for (const Json& f : metrics_["prediction"]) {
    if (f["part"] != "total") continue;
    EXPECT_GE(f["takes"], 2) << f["light"];
    EXPECT_NEAR(f["noise_nrmse"].get<double>() / f["camera_noise_nrmse"].get<double>(), 1.0, 0.1) << f["light"];
  }
}

// Every table says of which skin it speaks, the same for all of its models.
TEST_F(Visitor, CoverageIsStatedAndOneMaskJudgesAllModels) {
  ASSERT_EQ(metrics_["coverage"].size(), 5U);  // four projectors, and the true surface
  for (const Json& c : metrics_["coverage"]) {
    const auto of = [&](const char* what) { return c[what].get<int64_t>(); };
    EXPECT_EQ(of("lit_skin"), of("judged") + of("no_surface") + of("unlit") + of("not_fitted") + of("not_separated"))
        << c;
    EXPECT_GT(of("judged"), of("lit_skin") / 2) << c;
  }
  std::map<std::string, int64_t> pixels;
  for (const Json& f : metrics_["prediction"]) {
    const std::string view = std::to_string(f["projector"].get<int>()) + f["geometry"].get<std::string>() +
                             f["light"].get<std::string>() + f["part"].get<std::string>();
    EXPECT_EQ(pixels.try_emplace(view, f["pixels"]).first->second, f["pixels"]) << view << f["model"];
  }
}

TEST_F(Visitor, IsRelitByLightsThatNobodyCaptured) {
  const auto relit = [&](const std::string& light, const std::string& name) {
    const fs::path out = folder_ / name;
    EXPECT_EQ(Execute("stratalux-fit render latest --store " + store_ + " " + light + " --out " + out.string()).code,
              0);
    for (const char* file : {"subsurface.exr", "surface.exr", "total.exr", "total.png", "interval.exr"})
      EXPECT_GT(fs::file_size(out / file), 5000U) << file;
    const double half_width = Json::parse(ReadText(out / "relit.json"))["interval"]["half_width"];
    EXPECT_GT(half_width, 0.02) << light;
    EXPECT_LT(half_width, 0.25) << light;
  };
  relit("--point=-200,-100,200", "point");
  relit("--direction=1,0,-1 --colour 1,0.8,0.6", "direction");
  relit("--projector 3 --pattern 'comb columns period=128 width=2 shift=0'", "stripe");
  const std::string render = "stratalux-fit render latest --store " + store_ + " --out " + folder_.string() + "/no ";
  for (const char* wrong : {"", "--point=1,2", "--direction=0,0,0", "--projector 9", "--projector 1 --pattern nonsense",
                            "--point=0,0,200 --direction=0,0,-1"})
    EXPECT_EQ(Execute(render + wrong).code, 2) << wrong;
  EXPECT_EQ(Execute(render + "--projector 1 --fit 0123").code, 4);
}

// What three hold-outs say of a prediction's error holds for the fourth.
TEST_F(Visitor, IntervalsHoldForLightsThatTheyWereNotLearntFrom) {
  const Json intervals = metrics_["intervals"];
  EXPECT_EQ(intervals["learnt_from"].size(), 4U);
  EXPECT_EQ(intervals["colours"].size(), 3U);
  EXPECT_EQ(intervals["covered"].size(), 12U);
  for (const Json& light : intervals["covered"]) {
    EXPECT_GT(light["samples"], 1000) << light;
    EXPECT_GT(light["share"], 0.92) << light;
    EXPECT_LT(light["share"], 0.98) << light;
  }
}

TEST_F(Visitor, ALightBehindTheFaceIsSaid) {
  const Outcome outcome = Execute("stratalux-fit render latest --store " + store_ + " --direction=0,0,1 --out " +
                                  (folder_ / "behind").string());
  EXPECT_EQ(outcome.code, 0);
  EXPECT_NE(outcome.out.find("warning: no light reaches the face"), std::string::npos) << outcome.out;
}

TEST_F(Visitor, AFullPipeIsNoSuccess) {
  const std::string full = " --store " + store_ + " >/dev/full";
  for (const std::string& command :
       {std::string("run latest"), std::string("run latest --json"), std::string("report latest --path-only"),
        "render latest --direction=0,0,-1 --out " + (folder_ / "full").string()})
    EXPECT_EQ(Execute("stratalux-fit " + command + full).code, 1) << command;
}

TEST_F(Visitor, MapsAndReportAreAsPrivateAsTheFrames) {
  constexpr auto kOthers = fs::perms::others_all;
  for (const auto& entry : fs::recursive_directory_iterator(fit_))
    EXPECT_EQ(entry.status().permissions() & kOthers, fs::perms::none) << entry.path();
}

TEST_F(Visitor, ReportHoldsEveryPictureAndNothingFromOutside) {
  const std::string html = ReadText(fit_ / "report" / "index.html");
  for (const char* title : {"figure 4", "Shape", "Direct and global", "figure 5", "figure 7", "figure 8", "figure 9",
                            "Layer maps", "Figures"})
    EXPECT_NE(html.find(title), std::string::npos) << title;
  EXPECT_EQ(html.find("src='http"), std::string::npos);
  EXPECT_EQ(html.find(" href="), std::string::npos);
}

TEST_F(Visitor, WithoutScatteringHardlyAnyLightIsInWideLayers) {
  ASSERT_EQ(
      Execute("stratalux-rig capture --simulate --no-scattering --store " + store_ + " --seed 5 --size " + OpaqueSize())
          .code,
      0);
  const Outcome opaque = Execute("stratalux-fit run s000002 --maps off --store " + store_ + " --json", Show::kStdout);
  ASSERT_EQ(opaque.code, 0);
  const fs::path folder = Json::parse(opaque.out)["folder"].get<std::string>();
  EXPECT_LE(Json::parse(ReadText(folder / "metrics.json"))["fit"]["wide_weight_fraction"].get<double>(), 0.02);
  EXPECT_GT(metrics_["fit"]["wide_weight_fraction"].get<double>(), 0.15);
}

}  // namespace
}  // namespace stratalux
