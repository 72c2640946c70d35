// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/light_field.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "fitter/calibration/line_profile.h"
#include "fitter/calibration/projector_ramp.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

RigCalibration VignettedRig() {
  RigCalibration rig;
  rig.camera.model = {348, 260, 812.0, 812.0, 175.0, 129.0, {}};
  rig.camera.vignetting = {-0.14, 0.015};
  for (const double x : {-450.0, -180.0, 200.0, 430.0}) {
    ProjectorCalibration p;
    p.model = {1024, 768, 2690.0, 2690.0, 517.0, 374.0, {}};
    p.camera_from_projector = LookAt({x, 100.0 - 0.3 * x, 0.0}, {0.0, 4.0, 700.0});
    p.falloff = {-0.2 + 1e-4 * x, 0.04};
    p.white_dn_mm2_per_ms = {1.0e8, 1.05e8 + 1e4 * x, 0.95e8};
    rig.projectors.push_back(p);
  }
  return rig;
}

// A Lambertian plane seen by the rig, 0.5 % of noise a sample.
std::vector<FlatSample> Target(const RigCalibration& rig, const Eigen::Vector3d& centre, const Eigen::Vector3d& tilt,
                               int pose, double albedo) {
  Random random(7, static_cast<uint64_t>(pose));
  const Eigen::Vector3d normal = Eigen::Vector3d(tilt.x(), tilt.y(), -1.0).normalized();
  std::vector<FlatSample> samples;
  for (int y = 4; y < 260; y += 8)
    for (int x = 4; x < 348; x += 8) {
      const Eigen::Vector3d ray = rig.camera.model.Unproject({double(x), double(y)});
      const Eigen::Vector3d point = ray * (normal.dot(centre) / normal.dot(ray));
      for (int p = 0; p < 4; ++p) {
        const ProjectorCalibration& projector = rig.projectors[p];
        const auto at = projector.ProjectFromCamera(point);
        if (!at || !projector.model.Contains(*at)) continue;
        const Eigen::Vector3d to_light = projector.CentreInCamera() - point;
        for (int c = 0; c < 3; ++c) {
          const double dn = albedo * projector.WhiteTargetDn(point, normal, c, 16.0) * rig.camera.Vignetting(x, y);
          samples.push_back({p,
                             c,
                             pose,
                             {double(x), double(y)},
                             *at,
                             16.0 * normal.dot(to_light) / std::pow(to_light.norm(), 3),
                             dn * (1.0 + 0.005 * random.Normal()),
                             0.005 * dn});
        }
      }
    }
  return samples;
}

std::vector<FlatSample> ThreePoses(const RigCalibration& rig, double albedo) {
  std::vector<FlatSample> all = Target(rig, {0, 0, 700}, {0.05, -0.05, 0}, 0, albedo);
  for (const auto& more :
       {Target(rig, {0, 0, 610}, {-0.25, 0.3, 0}, 1, albedo), Target(rig, {0, 0, 790}, {0.25, -0.3, 0}, 2, albedo)})
    all.insert(all.end(), more.begin(), more.end());
  return all;
}

TEST(LightField, ThreePosesTellFalloffVignettingAndWhite) {
  const RigCalibration truth = VignettedRig();
  const auto field = FitLightField(ThreePoses(truth, 0.9), truth, 0.9, VignettingFit::kFree);
  ASSERT_TRUE(field.ok()) << field.status().message();
  RigCalibration found = truth;
  found.camera.vignetting = field->vignetting;
  for (size_t p = 0; p < 4; ++p) {
    found.projectors[p].falloff = field->projectors[p].falloff;
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(field->projectors[p].white_dn_mm2_per_ms[c] / truth.projectors[p].white_dn_mm2_per_ms[c], 1.0, 0.01);
    for (double column = 150; column < 900; column += 50)
      for (double row = 100; row < 700; row += 50)
        EXPECT_NEAR(found.projectors[p].Falloff({column, row}), truth.projectors[p].Falloff({column, row}), 0.01)
            << p << " at " << column << ", " << row;
  }
  for (double x = 0; x < 348; x += 20)
    EXPECT_NEAR(found.camera.Vignetting(x, 30), truth.camera.Vignetting(x, 30), 0.01);
}

TEST(LightField, WithoutVignettingTheFalloffTakesItsPlace) {
  // What is left out goes somewhere: the model without a camera's vignetting blames the projectors.
  RigCalibration truth = VignettedRig(), blind = VignettedRig();
  blind.camera.vignetting = {};
  const auto field = FitLightField(ThreePoses(truth, 1.0), blind, 1.0, VignettingFit::kKnown);
  ASSERT_TRUE(field.ok());
  RigCalibration found = truth;
  found.projectors[0].falloff = field->projectors[0].falloff;
  EXPECT_GT(std::abs(found.projectors[0].Falloff({150, 100}) - truth.projectors[0].Falloff({150, 100})), 0.02);
}

TEST(LightField, RefusesATargetThatOneProjectorMisses) {
  const RigCalibration rig = VignettedRig();
  std::vector<FlatSample> samples = Target(rig, {0, 0, 700}, {0, 0, 0}, 0, 1.0);
  std::erase_if(samples, [](const FlatSample& s) { return s.projector == 2; });
  const auto field = FitLightField(samples, rig, 1.0, VignettingFit::kKnown);
  EXPECT_NE(field.status().message().find("projector 2"), std::string::npos);
}

TEST(BlackLevels, AmbientLightOfAnyShapeDoesNotMatter) {
  Random random(3);
  const Eigen::Vector4d truth(0.003, 0.001, 0.0, 0.01);
  std::vector<BlackSample> samples;
  for (int i = 0; i < 400; ++i) {
    const double ambient = random.Uniform(60.0, 300.0);
    BlackSample s{ambient, Eigen::VectorXd(4), Eigen::VectorXd(4)};
    for (int p = 0; p < 4; ++p) {
      const double white = random.Uniform(1000.0, 3500.0);
      s.contrast_dn[p] = white * (1.0 - truth[p]);
      s.black_dn[p] = ambient + truth[p] * white + 0.5 * random.Normal();
      s.all_black_dn += truth[p] * white;
    }
    s.all_black_dn += 0.5 * random.Normal();
    samples.push_back(s);
  }
  const auto levels = FitBlackLevels(samples);
  ASSERT_TRUE(levels.ok());
  for (int p = 0; p < 4; ++p) EXPECT_NEAR((*levels)[p], truth[p], 5e-5);
}

TEST(BlackLevels, OneProjectorCannotBeToldFromAmbient) {
  const BlackSample s{64.0, Eigen::VectorXd::Ones(1), Eigen::VectorXd::Ones(1)};
  EXPECT_FALSE(FitBlackLevels({s}).ok());
  EXPECT_FALSE(FitBlackLevels({}).ok());
}

double LineAt(double u, double width, double sigma) {
  const double scale = 1.0 / (std::sqrt(2.0) * sigma);
  return 0.5 * (std::erf((u + 0.5 * width) * scale) - std::erf((u - 0.5 * width) * scale));
}

LineSamples Lines(double width, double sigma, double columns_per_px2) {
  Random random(11);
  LineSamples samples(2, 16);
  for (int i = 0; i < 20000; ++i) {
    const double column = random.Uniform(100.0, 900.0);
    const int shift = 2 * (i % 8);
    double u = std::fmod(column - (shift + 0.5) + 8.0, 16.0) - 8.0;
    if (u < -8.0) u += 16.0;
    samples.Add(column, shift, LineAt(u, width, sigma) + 0.02 * random.Normal(), columns_per_px2);
  }
  return samples;
}

TEST(LineProfile, WidthAndBlurComeApart) {
  for (const double sigma : {0.4, 0.8, 1.5}) {
    const auto shape = FitLine(Lines(2.0, sigma, 1.0));
    ASSERT_TRUE(shape.ok());
    EXPECT_NEAR(shape->width_px, 2.0, 0.05 * 2.0);
    EXPECT_NEAR(shape->sigma_px, sigma, 0.05 * sigma);
    EXPECT_NEAR(shape->centre_px, 0.0, 0.03);
  }
  EXPECT_NEAR(FitLine(Lines(2.3, 0.6, 1.0))->width_px, 2.3, 0.05);  // lines wider than planned are seen to be
}

TEST(LineProfile, FootprintsThatDifferTellCameraFromProjector) {
  std::vector<BlurSample> samples;
  for (const double moved : {0.8, 1.6, 2.4, 3.2})
    for (int p = 0; p < 2; ++p)
      samples.push_back({p, std::sqrt((p == 0 ? 0.25 : 0.49) + (1.0 / 12.0 + 0.36) * moved), moved});
  const LineBlur blur = SplitBlur(samples, 2, 0.0);
  ASSERT_TRUE(blur.camera_px);
  EXPECT_NEAR(*blur.camera_px, 0.6, 0.02);
  EXPECT_NEAR(blur.projector_px[0], 0.5, 0.02);
  EXPECT_NEAR(blur.projector_px[1], 0.7, 0.02);
  // All of one footprint: the camera's is taken from the record before.
  for (BlurSample& s : samples) s = {s.projector, std::sqrt(0.25 + (1.0 / 12.0 + 0.36) * 1.6), 1.6};
  const LineBlur alike = SplitBlur(samples, 2, 0.6);
  EXPECT_FALSE(alike.camera_px);
  EXPECT_NEAR(alike.projector_px[0], 0.5, 0.01);
}

TEST(LineProfile, FullWidthOfASharpLineIsItsWidth) {
  EXPECT_NEAR(FullWidthAtHalf(2.0, 0.05), 2.0, 1e-3);
  EXPECT_NEAR(FullWidthAtHalf(0.01, 1.0), 2.0 * std::sqrt(2.0 * std::numbers::ln2), 1e-3);
}

std::vector<RampFrame> Ramp(double gamma, double drift_per_step) {
  std::vector<RampFrame> frames;
  int step = 0;
  auto add = [&](double grey) {
    frames.push_back({grey, 1e6 * std::pow(grey, gamma) * (1.0 + drift_per_step * step), step});
    ++step;
  };
  add(1.0);
  for (int k = 1; k < 32; ++k) {
    add(k / 32.0);
    if (k % 8 == 0) add(1.0);
  }
  add(1.0);
  return frames;
}

TEST(ProjectorRamp, GivesTheGammaWhateverTheLampDoes) {
  for (const double gamma : {1.0, 1.8, 2.4}) {
    const auto ramp = FitProjectorRamp(Ramp(gamma, 3e-4));
    ASSERT_TRUE(ramp.ok());
    ASSERT_EQ(ramp->response.size(), 33U);
    ProjectorCalibration projector;
    projector.response = ramp->response;
    for (double grey = 0.0; grey <= 1.0; grey += 0.01)
      EXPECT_NEAR(projector.Response(grey), std::pow(grey, gamma), 0.005);
    EXPECT_GT(ramp->lamp_drift, 0.005);
    EXPECT_EQ(ramp->worst_fall, 0.0);
  }
}

TEST(ProjectorRamp, ARampThatFallsIsToldAndMadeToRise) {
  std::vector<RampFrame> frames = Ramp(2.2, 0.0);
  for (RampFrame& f : frames)
    if (f.grey == 20.0 / 32.0) f.light *= 0.8;
  const auto ramp = FitProjectorRamp(frames);
  ASSERT_TRUE(ramp.ok());
  EXPECT_GT(ramp->worst_fall, 0.02);
  for (size_t k = 1; k < ramp->response.size(); ++k) EXPECT_GE(ramp->response[k], ramp->response[k - 1]);
  std::erase_if(frames, [](const RampFrame& f) { return f.grey == 3.0 / 32.0; });
  EXPECT_FALSE(FitProjectorRamp(frames).ok());
  EXPECT_FALSE(FitProjectorRamp({}).ok());
}

TEST(ProjectorResponse, HarmonicOfALinearProjectorIsAHalf) {
  ProjectorCalibration projector;
  EXPECT_NEAR(projector.SinusoidAmplitude(), 0.5, 1e-9);
  // (1 + cos)^2 / 4 = 3/8 + cos / 2 + cos(2 x) / 8.
  for (int k = 0; k < 129; ++k) projector.response.push_back(std::pow(k / 128.0, 2.0));
  EXPECT_NEAR(projector.SinusoidAmplitude(), 0.5, 1e-4);
  // (1 + cos)^3 / 8: coefficient of cos = 15/32.
  for (int k = 0; k < 129; ++k) projector.response[k] = std::pow(k / 128.0, 3.0);
  EXPECT_NEAR(projector.SinusoidAmplitude(), 15.0 / 32.0, 1e-4);
}

}  // namespace
}  // namespace stratalux::fit
