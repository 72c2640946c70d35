// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "fitter/evaluation/image_error.h"
#include "fitter/evaluation/metrics.h"
#include "fitter/evaluation/metrics_json.h"
#include "fitter/evaluation/normal_error.h"
#include "fitter/evaluation/predict.h"
#include "fitter/evaluation/surface_error.h"
#include "fitter/scattering/baselines.h"
#include "shared/base/random.h"
#include "shared/units/angle.h"
#include "tests/fitter/render/lit_scene.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

const Image<uint8_t> kEverywhere(64, 48, 1, 1);

// A smooth picture with three different channels, values 100 .. 900.
Image<float> Picture() {
  Image<float> image(64, 48, 3);
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x)
      for (int c = 0; c < 3; ++c)
        image(x, y, c) = static_cast<float>(500.0 + 400.0 * std::sin(0.2 * x + c) * std::cos(0.15 * y));
  return image;
}

TEST(CompareImages, FindsNoErrorInEqualPictures) {
  const ImageError e = CompareImages(Picture(), Picture(), kEverywhere);
  EXPECT_EQ(e.nrmse, 0.0);
  EXPECT_NEAR(e.ssim, 1.0, 1e-9);
  EXPECT_EQ(e.pixels, 64 * 48);
}

TEST(CompareImages, CallsATenPercentGainTenPercent) {
  Image<float> brighter = Picture();
  for (float& v : brighter.pixels()) v *= 1.1F;
  const ImageError e = CompareImages(Picture(), brighter, kEverywhere);
  EXPECT_NEAR(e.nrmse, 0.1, 1e-5);
  for (double channel : e.nrmse_channel) EXPECT_NEAR(channel, 0.1, 1e-5);
  EXPECT_NEAR(e.bias, 0.1, 1e-5);
}

TEST(CompareImages, TellsTheChannelsApart) {
  const Image<float> reference(64, 48, 3, 200.0F);
  Image<float> estimate = reference;
  for (size_t i = 1; i < estimate.size(); i += 3) estimate.pixels()[i] = 260.0F;
  const ImageError e = CompareImages(reference, estimate, kEverywhere);
  EXPECT_EQ(e.nrmse_channel[0], 0.0);
  EXPECT_NEAR(e.nrmse_channel[1], 0.3, 1e-6);
  EXPECT_EQ(e.nrmse_channel[2], 0.0);
  EXPECT_NEAR(e.nrmse, 0.3 / std::sqrt(3.0), 1e-6);
}

TEST(CompareImages, MeasuresTheDecibelsOfKnownNoise) {
  const Image<float> reference(64, 48, 3, 1000.0F);
  Image<float> noisy = reference;
  Random random(11);
  for (float& v : noisy.pixels()) v += static_cast<float>(10.0 * random.Normal());
  // Peak 1000 over noise 10: 40 dB; 9216 samples know the variance to 1.5 %.
  EXPECT_NEAR(CompareImages(reference, noisy, kEverywhere).psnr_db, 40.0, 0.25);
}

TEST(CompareImages, NothingInCommonIsNoErrorOfZero) {
  const Image<uint8_t> nowhere(64, 48, 1, 0);
  const ImageError e = CompareImages(Picture(), Picture(), nowhere);
  EXPECT_EQ(e.pixels, 0);
  EXPECT_TRUE(std::isnan(e.nrmse));
  EXPECT_TRUE(std::isnan(NoiseFloor(Picture(), Picture(), nowhere)));
  HeldOutFigure figure;
  figure.error = e;
  const nlohmann::ordered_json json = figure;
  const auto text = nlohmann::json::parse(json.dump());
  EXPECT_TRUE(text["nrmse"].is_null());
  EXPECT_TRUE(text["nrmse_without_noise"].is_null());
  const auto back = text.get<HeldOutFigure>();
  EXPECT_TRUE(std::isnan(back.error.nrmse));
  EXPECT_TRUE(std::isnan(back.error.nrmse_channel[2]));
}

TEST(NoiseFloor, IsTheErrorOfThePerfectEstimate) {
  const Image<float> truth = Picture();
  Image<float> measured = truth, variance = truth;
  Random random(12);
  for (size_t i = 0; i < truth.size(); ++i) {
    variance.pixels()[i] = 9.0F + truth.pixels()[i] / 4.0F;  // read noise and shot noise
    measured.pixels()[i] += static_cast<float>(std::sqrt(variance.pixels()[i]) * random.Normal());
  }
  const double floor = NoiseFloor(measured, variance, kEverywhere);
  EXPECT_NEAR(CompareImages(measured, truth, kEverywhere).nrmse, floor, 0.03 * floor);
  EXPECT_GT(floor, 0.015);

  HeldOutFigure figure;
  figure.noise_nrmse = floor;
  Image<float> tenth_off = truth;
  for (float& v : tenth_off.pixels()) v *= 1.1F;
  figure.error = CompareImages(measured, tenth_off, kEverywhere);
  EXPECT_NEAR(figure.WithoutNoise(), 0.1, 0.002);
}

TEST(CompareImages, TakesThePeakAtTheUpperMilleOfTheReference) {
  Image<float> reference(64, 48, 1, 100.0F);
  reference(3, 3) = 4000.0F;  // one hot pixel of 3072 lies above the 99.9th percentile
  Image<float> estimate = reference;
  for (float& v : estimate.pixels()) v += 1.0F;
  EXPECT_NEAR(CompareImages(reference, estimate, kEverywhere).psnr_db, 40.0, 1e-6);
}

TEST(CompareImages, FollowsTheFormulaOfStructuralSimilarityOnConstants) {
  // Constant pictures have no structure: SSIM is the luminance term alone.
  const Image<float> a(64, 48, 1, 100.0F), b(64, 48, 1, 60.0F);
  const double c1 = 1.0;  // (0.01 peak)^2
  EXPECT_NEAR(CompareImages(a, b, kEverywhere).ssim, (2 * 100.0 * 60.0 + c1) / (100.0 * 100.0 + 60.0 * 60.0 + c1),
              1e-6);
}

TEST(CompareImages, FollowsTheFormulaOfStructuralSimilarityOnContrast) {
  // A one-pixel checkerboard of half the contrast: same mean, covariance k v against (1 + k^2) v.
  Image<float> a(64, 48), b(64, 48);
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x) {
      const float sign = (x + y) % 2 == 0 ? 1.0F : -1.0F;
      a(x, y) = 500.0F + 100.0F * sign;
      b(x, y) = 500.0F + 50.0F * sign;
    }
  const double c2 = std::pow(0.03 * 600.0, 2), v = 1e4;
  EXPECT_NEAR(CompareImages(a, b, kEverywhere).ssim, (2 * 0.5 * v + c2) / (1.25 * v + c2), 1e-3);
}

TEST(CompareMasks, CountsWhatBothSayAndWhatOneSaysAlone) {
  Image<uint8_t> truth(10, 4), mask(10, 4), where(10, 4, 1, 1);
  for (int j = 0; j < 4; ++j)
    for (int i = 0; i < 10; ++i) {
      truth(i, j) = i < 6 ? 1 : 0;
      mask(i, j) = i >= 2 && i < 7 ? 1 : 0;
      where(i, j) = j > 0 ? 1 : 0;
    }
  const MaskOverlap overlap = CompareMasks(truth, mask, where);
  EXPECT_EQ(overlap.both, 3 * 4);
  EXPECT_EQ(overlap.only_estimate, 3 * 1);
  EXPECT_EQ(overlap.only_reference, 3 * 2);
  EXPECT_DOUBLE_EQ(overlap.IntersectionOverUnion(), 12.0 / 21.0);
  EXPECT_TRUE(std::isnan(CompareMasks(truth, mask, Image<uint8_t>(10, 4)).IntersectionOverUnion()));
}

TEST(CompareImages, SeesNothingOutsideTheMask) {
  const Image<float> reference = Picture();
  Image<float> estimate = reference;
  Image<uint8_t> mask(64, 48, 1, 1);
  for (int y = 0; y < 48; ++y)
    for (int x = 40; x < 64; ++x) {
      mask(x, y) = 0;
      for (int c = 0; c < 3; ++c) estimate(x, y, c) = -5000.0F;
    }
  const ImageError e = CompareImages(reference, estimate, mask);
  EXPECT_EQ(e.nrmse, 0.0);
  EXPECT_NEAR(e.ssim, 1.0, 1e-9);
  EXPECT_EQ(e.pixels, 40 * 48);
}

TEST(CompareImages, CountsOnlyPixelsThatAreFiniteInBoth) {
  const Image<float> reference = Picture();
  Image<float> estimate = reference;
  estimate(10, 10, 2) = std::numeric_limits<float>::quiet_NaN();
  estimate(30, 20, 0) = std::numeric_limits<float>::infinity();
  const ImageError e = CompareImages(reference, estimate, kEverywhere);
  EXPECT_EQ(e.pixels, 64 * 48 - 2);
  EXPECT_EQ(e.nrmse, 0.0);
  EXPECT_NEAR(e.ssim, 1.0, 1e-9);
}

// A frontal plane at 600 mm.
SurfaceMap Plane() {
  SurfaceMap s{Image<float>(20, 10, 3), Image<float>(20, 10, 3), Image<float>(20, 10), Image<uint8_t>(20, 10, 1, 1)};
  for (int j = 0; j < 10; ++j)
    for (int i = 0; i < 20; ++i) {
      s.point_mm(i, j, 2) = 600.0F;
      s.normal(i, j, 2) = -1.0F;
    }
  return s;
}

TEST(CompareSurface, SeparatesBiasFromScatterAndMeasuresTilt) {
  SurfaceMap surface = Plane(), truth = Plane();
  const double tilt = RadFromDeg(3.0);
  for (int j = 0; j < 10; ++j)
    for (int i = 0; i < 20; ++i) {
      truth.point_mm(i, j, 2) = 599.5F;
      surface.point_mm(i, j, 2) += i % 2 == 0 ? 0.2F : -0.2F;
      truth.normal(i, j, 0) = static_cast<float>(std::sin(tilt));
      truth.normal(i, j, 2) = static_cast<float>(-std::cos(tilt));
    }
  surface.mask(0, 0) = 0;
  truth.mask(1, 0) = 0;
  const SurfaceError e = CompareSurface(surface, truth);
  EXPECT_NEAR(e.depth_bias_mm, 0.5, 1e-3);
  EXPECT_NEAR(e.depth_rms_mm, 0.2, 1e-3);
  EXPECT_NEAR(e.normal_median_deg, 3.0, 1e-3);
  EXPECT_EQ(e.pixels, 198);
}

TEST(CompareNormals, TellsSmallAnglesOfWhatIsAskedFor) {
  Image<float> found(20, 10, 3), truth(20, 10, 3);
  Image<uint8_t> quads(20, 10, 1, 1);
  const double small = RadFromDeg(0.01), large = RadFromDeg(4.0);
  for (int j = 0; j < 10; ++j)
    for (int i = 0; i < 20; ++i) {
      truth(i, j, 2) = -1.0F;
      const double tilt = j < 7 ? small : large;
      found(i, j, 1) = static_cast<float>(std::sin(tilt));
      found(i, j, 2) = static_cast<float>(-std::cos(tilt));
    }
  found(3, 3, 1) = std::nanf("");
  truth(4, 3, 0) = std::nanf("");
  const AngleError all = CompareNormals(found, truth, quads);
  EXPECT_NEAR(all.median_deg, 0.01, 1e-4);
  EXPECT_NEAR(all.rms_deg, 4.0 * std::sqrt(60.0 / 198.0), 1e-3);
  EXPECT_EQ(all.quads, 198);
  for (int i = 0; i < 20; ++i)
    for (int j = 0; j < 7; ++j) quads(i, j) = 0;
  EXPECT_NEAR(CompareNormals(found, truth, quads).median_deg, 4.0, 1e-3);
  EXPECT_EQ(CompareNormals(found, truth, Image<uint8_t>(20, 10)).quads, 0);
}

TEST(CompareNormals, HoldsEachNormalAgainstItsOwnTruth) {
  TrueSurface truth;
  truth.surface = Plane();
  truth.skin = Image<uint8_t>(20, 10, 1, 1);
  truth.skin(0, 0) = 0;
  truth.spread_mm = Image<float>(20, 10, 3, 1.5F);
  truth.diffuse_normal = Image<float>(20, 10, 9);
  Image<float> specular(20, 10, 3), diffuse(20, 10, 9);
  const auto tilted = [](Image<float>& normals, int i, int j, int colour, double deg) {
    normals(i, j, 3 * colour) = static_cast<float>(std::sin(RadFromDeg(deg)));
    normals(i, j, 3 * colour + 2) = static_cast<float>(-std::cos(RadFromDeg(deg)));
  };
  for (int j = 0; j < 10; ++j)
    for (int i = 0; i < 20; ++i) {
      tilted(specular, i, j, 0, 5.0);
      for (int c = 0; c < 3; ++c) {
        tilted(truth.diffuse_normal, i, j, c, 2.0 + c);
        tilted(diffuse, i, j, c, 2.25 + c);
      }
    }
  const Image<float>& straight = truth.surface.normal;
  const Image<float> width_mm(20, 10, 3, 1.25F);
  const FoundNormals found{specular, straight, straight, diffuse, width_mm};
  const NormalFigures figures = CompareNormalsWithTruth(found, truth);
  EXPECT_NEAR(figures.specular.median_deg, 5.0, 1e-3);
  EXPECT_EQ(figures.specular.quads, 199) << "skin";
  EXPECT_EQ(figures.surface.median_deg, 0.0);
  ASSERT_EQ(figures.diffuse.size(), 3U);
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(figures.diffuse[c].colour, std::string(1, "RGB"[c]));
    EXPECT_NEAR(figures.diffuse[c].filtered.median_deg, 0.25, 1e-3);
    EXPECT_NEAR(figures.diffuse[c].unfiltered.median_deg, 3.0 - c, 1e-3);
    EXPECT_EQ(figures.diffuse[c].width_mm, 1.25);
    EXPECT_EQ(figures.diffuse[c].true_width_mm, 1.5);
  }
  truth.diffuse_normal = {};  // of an older simulation
  EXPECT_TRUE(CompareNormalsWithTruth(found, truth).diffuse.empty());
}

// Of a projector 100 mm to the left, 1,200 px of focal length: column = 1200 * 100 / z + 500.
TEST(CompareColumns, SaysHowFarFromTheTrueColumnASurfaceIsSeen) {
  RigCalibration rig;
  for (int p = 0; p < 2; ++p) {
    ProjectorCalibration projector;
    projector.model = {1024, 768, 1200, 1200, 500.0, 384.0, {}};
    projector.camera_from_projector.translation_mm.x() = p == 0 ? 0.0 : -100.0;
    rig.projectors.push_back(projector);
  }
  SurfaceMap surface = Plane();
  const Image<uint8_t> all(20, 10, 1, 1);
  TrueSurface truth{Plane(), rig, {all, all}};
  for (int j = 0; j < 10; ++j)
    for (int i = 0; i < 20; ++i) {
      truth.surface.point_mm(i, j, 2) = 598.0F;
      surface.point_mm(i, j, 2) += j % 2 == 0 ? 0.3F : -0.3F;
    }
  // Not known, not lit, not true: none of the three counts.
  surface.point_mm(3, 2, 2) = 700.0F;
  surface.mask(3, 2) = 0;
  surface.point_mm(4, 2, 2) = 700.0F;
  truth.lit_by[1](4, 2) = 0;
  surface.point_mm(5, 2, 2) = 700.0F;
  truth.surface.mask(5, 2) = 0;
  const ColumnError e = CompareColumns(surface, rig, truth, 1);
  EXPECT_EQ(e.projector, 1);
  EXPECT_EQ(e.quads, 197);
  EXPECT_NEAR(e.mean_px, 1200.0 * 100.0 * (1.0 / 600.0 - 1.0 / 598.0), 0.002);
  EXPECT_NEAR(e.rms_px, 1200.0 * 100.0 * 0.3 / (600.0 * 600.0), 0.001);
  EXPECT_EQ(CompareColumns(surface, rig, truth, 0).mean_px, 0.0);  // it looks along the camera's view
  // The true rig stands a tenth of a column elsewhere.
  truth.rig.projectors[1].model.cx -= 0.1;
  EXPECT_NEAR(CompareColumns(surface, rig, truth, 1).mean_px, e.mean_px + 0.1, 1e-4);
  // Of light that the truth does not tell there are no columns.
  truth.lit_by[0] = {};
  const SurfaceError both = CompareWithTruth(surface, rig, truth);
  ASSERT_EQ(both.columns.size(), 1U);
  EXPECT_EQ(both.columns[0].projector, 1);
  EXPECT_EQ(both.pixels, 198);
}

TEST(Metrics, WritesSchemaTwo) {
  Metrics m;
  m.session = "s";
  m.fit = "f";
  m.heldout.push_back({3,
                       "stripe",
                       "tied",
                       "total",
                       "separated",
                       "reconstructed",
                       2,
                       2,
                       {0.05, {0.04, 0.05, 0.06}, -0.02, 33.0, 0.97, 1234},
                       0.03,
                       0.031});
  m.ablations.push_back(m.heldout[0]);
  m.ablations[0].model = "projectors_permuted";
  m.coverage.push_back({3, "reconstructed", 100, 77, 5, 10, 5, 2, 1, 3, {{"stripe", 0.2}}, "mask"});
  m.skin = {100, 90, true, {{"unlit", 4}}, {}};
  m.evaluation = "full";
  m.stages.push_back({"decode", 1.5, 2.5, 1 << 20});
  m.summary.masked_by_reason["too dark"] = 7;
  const auto without_truth = nlohmann::json::parse(m.ToJson());
  EXPECT_FALSE(without_truth.contains("truth"));
  EXPECT_FALSE(without_truth["skin"].contains("truth"));
  m.skin.truth = MaskOverlap{80, 10, 10};
  m.truth = SurfaceError{0.1, -0.2, 2.0, 99};
  const auto json = nlohmann::json::parse(m.ToJson());
  EXPECT_EQ(json["schema"], 2);
  EXPECT_EQ(json["evaluation"], "full");
  const auto& figure = json["prediction"][0];
  EXPECT_EQ(figure["projector"], 3);
  EXPECT_EQ(figure["light"], "stripe");
  EXPECT_EQ(figure["model"], "tied");
  EXPECT_EQ(figure["part"], "total");
  EXPECT_EQ(figure["direct"], "separated");
  EXPECT_EQ(figure["takes"], 2);
  EXPECT_EQ(figure["camera_noise_nrmse"], 0.031);
  EXPECT_EQ(figure["nrmse"], 0.05);
  EXPECT_EQ(figure["noise_nrmse"], 0.03);
  EXPECT_NEAR(figure["nrmse_without_noise"], 0.04, 1e-12);
  EXPECT_EQ(figure["nrmse_rgb"][2], 0.06);
  EXPECT_EQ(figure["bias"], -0.02);
  EXPECT_EQ(figure["psnr_db"], 33.0);
  EXPECT_EQ(figure["ssim"], 0.97);
  EXPECT_EQ(figure["pixels"], 1234);
  EXPECT_EQ(json["ablations"][0]["model"], "projectors_permuted");
  EXPECT_EQ(json["coverage"][0]["lit_skin"], 100);
  EXPECT_EQ(json["coverage"][0]["left_out_nrmse"]["stripe"], 0.2);
  EXPECT_EQ(json["coverage"][0]["skin_by"], "mask");
  EXPECT_EQ(json["coverage"][0].get<Coverage>().skin_by, "mask");
  EXPECT_EQ(json["coverage"][0].get<Coverage>().not_separated, 3);
  EXPECT_EQ(json["skin"]["surface_by_reason"]["unlit"], 4);
  EXPECT_EQ(json["skin"]["truth"]["iou"], 0.8);
  EXPECT_EQ(json["fit"]["masked_by_reason"]["too dark"], 7);
  EXPECT_EQ(json["stages"][0]["cpu_seconds"], 2.5);
  EXPECT_EQ(json["stages"][0]["peak_rss_bytes"], 1 << 20);
  EXPECT_EQ(json["truth"]["depth_bias_mm"], -0.2);
}

TEST(ScaledPrediction, IsThatOfTheScaledLayers) {
  // Light is linear in the weights: mean layers with each pixel's own albedo need no rendering of their own.
  const LitScene scene = MakeScene(FaceLike(), {-350.0, 0.0, 150.0}, Cfa::kRggb);
  MixtureMap skin = VaryingSkin(scene, SkinLayers());
  skin.reason[skin.ProfileIndex(20, 18, 1)] = static_cast<uint8_t>(FitReason::kTooDark);
  const MixtureMap mean = Homogeneous(skin), own_albedo = HomogeneousLocalAlbedo(skin);
  FaceShape shape;
  shape.record = scene.rig;
  shape.surface = scene.surface;
  const PlanOptions plan;
  const std::vector<std::string> lights = {"stripe", "white"};
  const HeldOutView view = ViewOf(shape, plan, 0, lights);
  const Prediction expected = Predict(own_albedo, 1, view),
                   found =
                       ScaledPrediction(Predict(mean, 1, view), skin, TotalWeights(mean), TotalWeights(own_albedo), 1);
  const auto near = [](const Image<float>& a, const Image<float>& b) {
    float most = 0.0F;
    for (float v : b.pixels()) most = std::fmax(most, v);  // of those that are known
    for (size_t i = 0; i < a.size(); ++i) {
      ASSERT_EQ(std::isnan(a.pixels()[i]), std::isnan(b.pixels()[i]));
      if (std::isfinite(b.pixels()[i])) {
        ASSERT_NEAR(a.pixels()[i], b.pixels()[i], 1e-6F * most);
      }
    }
  };
  ASSERT_EQ(found.subsurface.size(), 2U);
  for (const std::string& light : lights) {
    EXPECT_TRUE(std::ranges::any_of(found.subsurface.at(light).pixels(), [](float v) { return v > 1.0F; }));
    near(found.subsurface.at(light), expected.subsurface.at(light));
  }
  EXPECT_TRUE(std::ranges::any_of(found.direct_share.pixels(), [](float v) { return v > 0.01F; }));
  near(found.direct_share, expected.direct_share);
  near(found.reflectance, expected.reflectance);
}

TEST(Prediction, OfAnotherSurfaceKeepsTheLightThatFallsOnThatOne) {
  const LitScene scene = MakeScene(FaceLike(), {-350.0, 0.0, 150.0}, Cfa::kRggb);
  FaceShape shape;
  shape.record = scene.rig;
  shape.surface = scene.surface;
  const HeldOutView judged = ViewOf(shape, PlanOptions(), 0, {"stripe"});
  for (int j = 0; j < shape.surface.height(); ++j)
    for (int i = 0; i < shape.surface.width(); ++i) shape.surface.point_mm(i, j, 2) += 0.3F;
  const HeldOutView placed = ViewOf(shape, PlanOptions(), 0, {"stripe"});
  Prediction p = Predict(VaryingSkin(scene, SkinLayers()), 1, placed);
  const Image<float> elsewhere = p.DirectLight("stripe", judged.irradiance[0]);
  p.own_irradiance["stripe"] = placed.irradiance[0];
  const ScratchFolder scratch;
  ASSERT_TRUE(SavePrediction(scratch.path(), p).ok());
  const auto read = LoadPrediction(scratch.path());
  ASSERT_TRUE(read.ok()) << read.status().message();
  const auto same = [](const Image<float>& a, const Image<float>& b) {
    return a.size() == b.size() && std::ranges::equal(a.pixels(), b.pixels(), [](float x, float y) {
             return x == y || (std::isnan(x) && std::isnan(y));
           });
  };
  EXPECT_TRUE(same(read->subsurface.at("stripe"), p.subsurface.at("stripe")));
  EXPECT_TRUE(same(read->reflectance, p.reflectance));
  EXPECT_TRUE(same(read->direct_share, p.direct_share));
  for (const Image<float>& light :
       {read->DirectLight("stripe", judged.irradiance[0]), p.DirectLight("stripe", judged.irradiance[0])}) {
    EXPECT_TRUE(same(light, p.DirectLight("stripe", placed.irradiance[0])));
    EXPECT_FALSE(same(light, elsewhere));
  }
}

TEST(Predict, WhatWasNotFittedIsUnknownInThatColourAlone) {
  const LitScene scene = MakeScene(FaceLike(), {-350.0, 0.0, 150.0}, Cfa::kRggb);
  MixtureMap skin = VaryingSkin(scene, SkinLayers());
  skin.reason[skin.ProfileIndex(20, 18, 1)] = static_cast<uint8_t>(FitReason::kTooDark);
  FaceShape shape;
  shape.record = scene.rig;
  shape.surface = scene.surface;
  ASSERT_NE(scene.surface.mask(20, 18), 0);
  const HeldOutView view = ViewOf(shape, PlanOptions(), 0, {"stripe", "white"});
  const Prediction p = Predict(skin, 1, view);
  for (size_t k = 0; k < view.lights.size(); ++k) {
    const std::string& light = view.lights[k];
    const Image<float>& irradiance = view.irradiance[k];
    for (const Image<float>& image :
         {p.subsurface.at(light), p.SurfaceLight(light, irradiance), p.DirectLight(light, irradiance)})
      for (int j = 0; j < image.height(); ++j)
        for (int i = 0; i < image.width(); ++i)
          for (int c = 0; c < image.channels(); ++c) {
            const int64_t profile = skin.ProfileOfQuad(i, j, c, 1);
            const bool fitted = profile >= 0 && skin.Fitted(profile);
            ASSERT_EQ(std::isfinite(image(i, j, c)), fitted || scene.surface.mask(i, j) == 0)
                << light << " " << i << " " << j << " " << c;
          }
  }
}

// A head that moves to the side: what its sinusoids saw lies elsewhere than what its sweep does.
TEST(HeldOutView, CarriesWhatWasSeparatedToTheSweepsMoment) {
  const LitScene scene = MakeScene(FaceLike(), {-350.0, 0.0, 150.0}, Cfa::kRggb);
  FaceShape shape;
  shape.record = scene.rig;
  shape.surface = scene.surface;
  shape.surface.depth_sigma_mm = Image<float>(scene.surface.width(), scene.surface.height(), 1, 0.05F);
  shape.lit = {scene.surface.mask};
  HeadMotion& head = shape.motion.head;
  head.moved = true;
  const Eigen::Vector3d shift_mm(6.0, -2.0, 0.0);
  head.poses = {{0.0, {}}, {10.0, {Eigen::Vector3d::Zero(), shift_mm}}};
  shape.motion.projectors = {{.codes_s = 0.0, .separation_s = 2.0, .sweep_s = 8.0}};
  // Of the point of the head, wherever it is.
  const auto direct_at = [](const Eigen::Vector3d& at_reference) {
    return 100.0 + 2.0 * at_reference.x() + at_reference.y();
  };
  const SurfaceMap& surface = shape.surface;
  SeparationMap seen{Image<float>(surface.width(), surface.height(), 3, std::nanf("")),
                     {},
                     {},
                     {},
                     Image<uint8_t>(surface.width(), surface.height())};
  seen.global = seen.direct_variance = seen.white = seen.direct;
  const auto then = MoveSurface(surface, scene.rig.camera, [&](const Eigen::Vector3d&) {
    return Rigid3{Eigen::Quaterniond::Identity(), 0.2 * shift_mm};
  });
  const auto fill = [&](const SurfaceMap& moved, const Eigen::Vector3d& by, const auto& visit) {
    for (int j = 0; j < surface.height(); ++j)
      for (int i = 0; i < surface.width(); ++i)
        if (moved.mask(i, j) != 0) visit(i, j, moved.Point(i, j) - by);
  };
  fill(then.surface, 0.2 * shift_mm, [&](int i, int j, const Eigen::Vector3d& at_reference) {
    for (int c = 0; c < 3; ++c) {
      seen.direct(i, j, c) = static_cast<float>(direct_at(at_reference));
      seen.direct_variance(i, j, c) = 1.0F;
    }
  });
  const HeldOutView view = ViewOf(shape, PlanOptions(), 0, {"stripe"});
  const SeparationMap carried = OnView(view, seen);
  int judged = 0;
  double off = 0.0, left = 0.0;
  fill(view.shape.surface, 0.8 * shift_mm, [&](int i, int j, const Eigen::Vector3d& at_reference) {
    if (!std::isfinite(carried.direct(i, j, 0)) || !std::isfinite(seen.direct(i, j, 0))) return;
    off += std::abs(carried.direct(i, j, 0) - direct_at(at_reference));
    left += std::abs(seen.direct(i, j, 0) - direct_at(at_reference));
    ++judged;
  });
  ASSERT_GT(judged, 500);
  EXPECT_LT(off / judged, 0.1);   // a twentieth of a millimetre
  EXPECT_GT(left / judged, 3.0);  // as it was captured: 0.6 of the way
  // The light stands to the view's head as it stood to the head then.
  const Eigen::Vector3d lamp = view.separation_rig.projectors[0].CentreInCamera();
  EXPECT_NEAR((lamp - scene.rig.projectors[0].CentreInCamera() - 0.6 * shift_mm).norm(), 0.0, 1e-9);
}

}  // namespace
}  // namespace stratalux::fit
