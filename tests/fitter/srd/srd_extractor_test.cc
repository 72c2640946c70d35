// SPDX-License-Identifier: Apache-2.0
#include "fitter/srd/srd_extractor.h"

#include <cmath>

#include <gtest/gtest.h>

#include "fitter/mixture/line_response.h"
#include "fitter/mixture/surface_offset.h"
#include "shared/base/random.h"
#include "shared/geometry/quad.h"
#include "tests/fitter/srd/plane_scene.h"

namespace stratalux::fit {
namespace {

// Frames of a Lambertian plane of reflectance `albedo` per channel whose response is a box `blur_columns` wide on top
// of the comb's own lines, at each mosaic site's own column. `sample` -> the light fraction that the site sees.
Image<uint16_t> OpaqueFrame(const RigCalibration& rig, const SurfaceMap& s, const CombCycle& cycle, int k,
                            double blur_columns, const std::array<double, 3>& albedo) {
  Image<uint16_t> frame(kWidth, kHeight, 1, 64);
  const Eigen::Vector3d n = s.Normal(0, 0);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d ray = rig.camera.model.Unproject({double(x), double(y)});
      const Eigen::Vector3d point = ray * (n.dot(s.Point(3, 3)) / n.dot(ray));
      const double c = rig.projectors[0].ProjectFromCamera(point)->x();
      // Overlap of the box [c - b/2, c + b/2] with the lines [k step - 1/2, k step + width - 1/2] + period Z.
      double lit = 0.0;
      for (int copy = -12; copy <= 12; ++copy) {
        const double low = k * cycle.step - 0.5 + copy * cycle.period, high = low + cycle.width;
        lit += std::max(0.0, std::min(high, c + blur_columns / 2) - std::max(low, c - blur_columns / 2));
      }
      const int colour = CfaColour(Cfa::kRggb, x, y);
      const double white = rig.projectors[0].WhiteTargetDn(point, n, colour, cycle.exposure_ms) *
                           (1.0 - rig.projectors[0].black_level);  // less the black frame
      frame(x, y) = static_cast<uint16_t>(std::lround(64 + albedo[colour] * white * lit / blur_columns));
    }
  return frame;
}

SrdBatch Extract(const RigCalibration& rig, const SurfaceMap& s, const CombCycle& cycle, const SrdOptions& options,
                 std::array<int64_t, kSrdReasons>* counts = nullptr, uint16_t flash = 0, double box_columns = 6.0) {
  const Image<uint8_t> lit(kWidth / 2, kHeight / 2, 1, 1);
  const Image<float> dark(kWidth, kHeight, 1, 64.0F);
  SrdExtractor extractor(s, lit, rig, 0, cycle, options);
  for (int k = 0; k < cycle.frames(); ++k) {
    Image<uint16_t> frame = OpaqueFrame(rig, s, cycle, k, box_columns, {0.6, 0.4, 0.3});
    if (flash != 0 && k == 5) frame(10, 10) = flash;
    extractor.AddFrames(std::vector<CombFrame>{{k, {{frame, dark, cycle.exposure_ms}}}});
  }
  SrdBatch batch = extractor.Take();
  if (counts != nullptr) *counts = extractor.counts();
  return batch;
}

CombCycle Cycle() { return {.period = 128, .width = 2, .step = 2, .exposure_ms = 16.0}; }

// Circular first moment of a profile, mm.
double Centroid(const SrdBatch& b, int64_t profile) {
  const double step = b.step_mm[profile];
  const double period = b.samples * step;
  double c = 0.0, s = 0.0;
  for (int k = 0; k < b.samples; ++k) {
    const double angle = 2.0 * M_PI * (b.first_u_mm[profile] + k * step) / period;
    c += b.Samples(profile)[k] * std::cos(angle);
    s += b.Samples(profile)[k] * std::sin(angle);
  }
  return std::atan2(s, c) * period / (2.0 * M_PI);
}

TEST(SrdExtractor, CycleAddsUpToTheWhiteReflectance) {
  for (const double black_level : {0.0, 0.2}) {  // of the projector: the black frame holds as much of the light
    RigCalibration rig = SmallRig();
    rig.projectors[0].black_level = black_level;
    const SurfaceMap plane = Plane(rig, 0.3);
    const SrdBatch batch = Extract(rig, plane, Cycle(), {});
    const double albedo[3] = {0.6, 0.4, 0.3};
    for (int64_t i = 0; i < batch.profiles(); ++i) {
      ASSERT_EQ(batch.valid[i], 1);
      double sum = 0.0;
      for (int k = 0; k < batch.samples; ++k) sum += batch.Samples(i)[k];
      EXPECT_NEAR(sum, albedo[i % 3], 2e-3) << "profile " << i << " " << black_level;  // rounding to digital numbers
    }
  }
}

TEST(SrdExtractor, OpaqueSurfaceRespondsAtItsOwnColumnInEveryColour) {
  // The sites of R and B lie half a mosaic pixel (0.2 mm) off the quad's centre: a centroid error of that size would
  // drown the direction effect of 0.1 mm.
  const RigCalibration rig = SmallRig();
  for (double slope : {-0.4, 0.0, 0.4}) {
    const SurfaceMap plane = Plane(rig, slope);
    const SrdBatch batch = Extract(rig, plane, Cycle(), {});
    for (int64_t i = 0; i < batch.profiles(); i += 7) EXPECT_NEAR(Centroid(batch, i), 0.0, 0.01) << "profile " << i;
  }
}

// Largest error of a sample of an OpaqueFrame cycle against the line response that `response_of` makes of the batch's,
// in reflectance.
template <typename ResponseOf>
double WorstPrediction(const SrdBatch& batch, double box_columns, const ResponseOf& response_of) {
  const double albedo[3] = {0.6, 0.4, 0.3};
  double worst = 0.0;
  for (int64_t i = 0; i < batch.profiles(); ++i) {
    const double step = batch.step_mm[i], period = batch.samples * step;
    LineResponse line = LineResponseOf(batch, i, box_columns * step / Cycle().step);
    line.blur_mm = line.sites.box_x_mm = line.sites.box_y_mm = 0.0;  // the frame is drawn at points
    line = response_of(line);
    for (int k = 0; k < batch.samples; ++k) {
      const double u = std::remainder(batch.first_u_mm[i] + k * step, period);
      worst = std::max(worst, std::abs(batch.Samples(i)[k] - albedo[i % 3] * line.At(u)));
    }
  }
  return worst;
}

TEST(SrdExtractor, PooledSamplesAreTheMeanOfTheirSites) {
  // A tilted plane under a projector turned about its axis: the columns cross both of the image's axes.
  RigCalibration rig = SmallRig();
  rig.projectors[0].camera_from_projector.rotation *=
      Eigen::Quaterniond(Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()));
  constexpr double kBoxColumns = 2.0;
  for (int pool : {2, 4}) {
    const SrdBatch batch = Extract(rig, Plane(rig, 0.3), Cycle(), {.pool = pool}, nullptr, 0, kBoxColumns);
    // Rounding to digital numbers, and the perspective within a pixel.
    const double exact = WorstPrediction(batch, kBoxColumns, [](const LineResponse& line) { return line; });
    const double gaussian = WorstPrediction(batch, kBoxColumns, [](LineResponse line) {
      line.blur_mm = std::sqrt(line.sites.VarianceMm2());
      line.sites = {};
      return line;
    });
    EXPECT_LT(exact, 0.001) << pool;
    EXPECT_GT(gaussian, 0.02) << pool;
  }
}

TEST(SrdExtractor, PoolingKeepsCentroidAndBlurOfASite) {
  const RigCalibration rig = SmallRig();
  const SurfaceMap plane = Plane(rig, 0.2);
  const SrdBatch fine = Extract(rig, plane, Cycle(), {});
  const SrdBatch pooled = Extract(rig, plane, Cycle(), {.pool = 2});
  ASSERT_EQ(pooled.profiles() * 4, fine.profiles());
  const int width = kWidth / 4;
  for (int64_t i = 0; i < pooled.profiles(); i += 5) {
    const int64_t x = i / 3 % width, y = i / 3 / width, c = i % 3;
    const int64_t twin = (2 * y * 2 * width + 2 * x) * 3 + c;
    EXPECT_NEAR(Centroid(pooled, i), 0.0, 0.015);
    EXPECT_NEAR(pooled.blur_mm[i] / fine.blur_mm[twin], 1.0, 0.01);
    EXPECT_NEAR(pooled.VarianceOfSum(i) / fine.VarianceOfSum(twin), 0.25, 0.02);
  }
}

TEST(SrdExtractor, SlopesFollowTheTiltOfTheSurface) {
  // Light from -x, columns rising with +x: on a frontal plane t(omega_in) . e is negative, t(omega_out) . e about zero.
  const RigCalibration rig = SmallRig();
  const SurfaceMap plane = Plane(rig, 0.0);
  const SrdGeometry g = ComputeSrdGeometry(rig, 0, {0, 0, 700}, {0, 0, -1}, {47.5, 31.5}, 1, 16.0);
  EXPECT_NEAR(g.slope_in, -350.0 / 700.0, 0.01);
  EXPECT_NEAR(g.slope_out, 0.0, 1e-3);
  EXPECT_NEAR(g.cos_in, 700.0 / std::hypot(350.0, 40.0, 700.0), 1e-6);
  EXPECT_NEAR(g.mm_per_column, 0.29 / g.cos_in, 0.03);
}

TEST(SrdExtractor, OfAMovedSurfaceIsTheProfileMoved) {
  const RigCalibration rig = SmallRig();
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows})
    for (const double tilt : {-0.5, 0.0, 0.4}) {
      const Eigen::Vector3d point(20, -12, 700), normal = Eigen::Vector3d(tilt, 0.3 * tilt, -1).normalized();
      const auto pixel = rig.camera.model.Project(point);
      const auto at = [&](double depth_mm) {
        // Deeper along the normal: where the view meets that plane.
        const double along = depth_mm / -normal.dot(point.normalized());
        const Eigen::Vector3d moved = point * (1.0 + along / point.norm());
        return ComputeSrdGeometry(rig, 0, moved, normal, *pixel, 1, 16.0, axis);
      };
      const SrdGeometry g = at(0.0);
      for (const double depth_mm : {-0.2, 0.1}) {
        SrdBatch batch;
        batch.samples = 1;
        batch.first_u_mm = {0.0F};
        batch.slope_in = {static_cast<float>(g.slope_in)};
        batch.slope_out = {static_cast<float>(g.slope_out)};
        const float along_normal = 1.0F;
        MoveSurface(batch, 1, {&along_normal, 1}, depth_mm);
        const double moved = (g.column - at(depth_mm).column) * g.mm_per_column;
        EXPECT_GT(std::abs(moved), 0.004);
        EXPECT_NEAR(batch.first_u_mm[0], moved, 0.01 * std::abs(moved) + 2e-4) << tilt << " " << depth_mm;
      }
    }
}

TEST(SrdExtractor, SaturationIsCountedAndNeverUsed) {
  const RigCalibration rig = SmallRig();
  std::array<int64_t, kSrdReasons> counts{};
  const SrdBatch batch = Extract(rig, Plane(rig, 0.0), Cycle(), {}, &counts, 4095);
  EXPECT_EQ(counts[static_cast<int>(SrdReason::kSaturated)], 3);
  const int64_t profile = (5 * (kWidth / 2) + 5) * 3;
  for (int c = 0; c < 3; ++c) EXPECT_EQ(batch.valid[profile + c], 0);
}

// One comb in four: the samples that are left are those of the whole cycle, and lie where they lay.
TEST(SrdExtractor, AThinnedCycleHasEveryFourthSampleOfTheWholeOne) {
  const RigCalibration rig = SmallRig();
  const SurfaceMap plane = Plane(rig, 0.3);
  CombCycle thinned = Cycle();
  thinned.step = 8;
  EXPECT_TRUE(Cycle().LightsAllAlike());
  EXPECT_FALSE(thinned.LightsAllAlike());
  const SrdBatch whole = Extract(rig, plane, Cycle(), {}), quarter = Extract(rig, plane, thinned, {});
  ASSERT_EQ(quarter.samples, 16);
  int64_t compared = 0;
  for (int64_t i = 0; i < whole.profiles(); ++i) {
    if (quarter.valid[i] == 0) continue;  // dark between the lines, and no white frame tells that it is lit
    ++compared;
    EXPECT_EQ(quarter.first_u_mm[i], whole.first_u_mm[i]);
    EXPECT_EQ(quarter.line_width_mm[i], whole.line_width_mm[i]);
    EXPECT_FLOAT_EQ(quarter.step_mm[i], 4.0F * whole.step_mm[i]);
    for (int k = 0; k < quarter.samples; ++k) EXPECT_EQ(quarter.Samples(i)[k], whole.Samples(i)[4 * k]);
  }
  EXPECT_GT(compared, whole.profiles() / 2);
}

TEST(CombCycle, RefusesStepsThatDoNotDivideThePeriod) {
  EXPECT_TRUE(Cycle().Validate().ok());
  EXPECT_EQ((CombCycle{.period = 128, .width = 2, .step = 3, .exposure_ms = 1}.Validate().code()), StatusCode::kUsage);
  EXPECT_EQ((CombCycle{.period = 128, .width = 2, .step = 2, .exposure_ms = 0}.Validate().code()), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::fit
