// SPDX-License-Identifier: Apache-2.0
// Sweeps of translucent skin: brackets, both readings, rows, distances along the surface, visitors that move.
#include <cmath>
#include <cstdlib>

#include <gtest/gtest.h>

#include "fitter/srd/srd_extractor.h"
#include "shared/base/random.h"
#include "shared/geometry/quad.h"
#include "tests/fitter/srd/plane_scene.h"

namespace stratalux::fit {
namespace {

constexpr double kBlackLevel = 64.0;

// Skin that spreads each line by a Gaussian and moves it towards larger columns.
struct Skin {
  double albedo = 0.5;
  double sigma_mm = 1.2;
  double moved_mm = 0.3;
};

// What the comb of frame k gives at `column` where a column is `m` mm long: over the all-white irradiance.
double Response(const Skin& skin, const CombCycle& cycle, int k, double column, double m) {
  const double line = k * cycle.step + (cycle.width - 1) * 0.5, half = 0.5 * cycle.width * m;
  double sum = 0.0;
  for (int copy = -1; copy <= 1; ++copy) {
    const double u = (std::remainder(line - column, cycle.period) + copy * cycle.period) * m - skin.moved_mm;
    const double scale = 1.0 / (std::sqrt(2.0) * skin.sigma_mm);
    sum += 0.5 * (std::erf((u + half) * scale) - std::erf((u - half) * scale));
  }
  return skin.albedo * sum;
}

struct Scene {
  RigCalibration rig = SmallRig();
  SurfaceMap surface = Plane(rig, 0.2);
  CombCycle cycle{.period = 128, .width = 2, .step = 2, .exposure_ms = 16.0};

  // Column (or row) and its length of every mosaic site, and the white target there.
  struct Site {
    double column = 0.0, m = 0.0, white_dn = 0.0;
  };
  [[nodiscard]] std::vector<Site> Sites() const {
    const int axis = cycle.axis == PatternAxis::kColumns ? 0 : 1;
    const ProjectorCalibration& light = rig.projectors[0];
    const Eigen::Vector3d n = surface.Normal(0, 0);
    std::vector<Site> sites;
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const Eigen::Vector3d ray = rig.camera.model.Unproject({double(x), double(y)});
        const Eigen::Vector3d point = ray * (n.dot(surface.Point(3, 3)) / n.dot(ray));
        Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
        for (const Eigen::Vector3d& t :
             {Eigen::Vector3d(n.unitOrthogonal()), Eigen::Vector3d(n.cross(n.unitOrthogonal()))})
          gradient +=
              ((*light.ProjectFromCamera(point + 0.1 * t))[axis] - (*light.ProjectFromCamera(point - 0.1 * t))[axis]) /
              0.2 * t;
        sites.push_back({(*light.ProjectFromCamera(point))[axis], 1.0 / gradient.norm(),
                         light.WhiteTargetDn(point, n, CfaColour(Cfa::kRggb, x, y), cycle.exposure_ms)});
      }
    return sites;
  }
};

// A frame of `factor` times the nominal exposure, with the camera's noise where `random` is given.
template <typename Light>
Image<uint16_t> Shoot(const Scene& scene, const std::vector<Scene::Site>& sites, double factor, Random* random,
                      const Light& light) {
  Image<uint16_t> frame(kWidth, kHeight);
  const CameraCalibration& camera = scene.rig.camera;
  for (size_t i = 0; i < sites.size(); ++i) {
    const double signal = sites[i].white_dn * factor * light(sites[i]);
    double dn = kBlackLevel + signal;
    if (random != nullptr)
      dn += random->Normal() * std::sqrt(signal / camera.gain_e_per_dn + camera.read_noise_dn * camera.read_noise_dn);
    frame.pixels()[i] = static_cast<uint16_t>(std::lround(std::clamp(dn, 0.0, 4095.0)));
  }
  return frame;
}

struct Extracted {
  SrdBatch batch;
  std::array<int64_t, kSrdReasons> counts{};
  EnergyCheck energy;
  [[nodiscard]] int64_t Count(SrdReason reason) const { return counts[static_cast<int>(reason)]; }
};

struct Capture {
  Skin skin;
  std::vector<double> brackets = {1.0};
  uint64_t seed = 0;       // 0: no noise
  int left_out = -1;       // cycle position
  int moves_at = 1 << 20;  // from this cycle position on, the right half of the picture is half as bright
};

Extracted ExtractFrom(const Scene& scene, const Capture& capture, const SrdOptions& options = {}) {
  const auto sites = scene.Sites();
  const Image<uint8_t> lit(scene.surface.width(), scene.surface.height(), 1, 1);
  const Image<float> dark(kWidth, kHeight, 1, static_cast<float>(kBlackLevel));
  SrdExtractor extractor(scene.surface, lit, scene.rig, 0, scene.cycle, options);
  Random random(capture.seed);
  Random* noise = capture.seed == 0 ? nullptr : &random;
  for (int k = 0; k < scene.cycle.frames(); ++k) {
    if (k == capture.left_out) continue;
    std::vector<Image<uint16_t>> images;
    CombFrame comb{k, {}};
    for (double factor : capture.brackets) {
      images.push_back(Shoot(scene, sites, factor, noise, [&](const Scene::Site& site) {
        const bool right = (&site - sites.data()) % kWidth >= kWidth / 2;
        return (right && k >= capture.moves_at ? 0.5 : 1.0) *
               Response(capture.skin, scene.cycle, k, site.column, site.m);
      }));
    }
    for (size_t b = 0; b < images.size(); ++b)
      comb.shots.push_back({images[b], dark, scene.cycle.exposure_ms * capture.brackets[b]});
    extractor.AddFrames({&comb, 1});
  }
  const auto white = Shoot(scene, sites, 1.0, noise, [&](const Scene::Site&) { return capture.skin.albedo; });
  Image<float> mean(kWidth, kHeight);
  std::copy(white.pixels().begin(), white.pixels().end(), mean.data());
  extractor.SetWhite(mean, 1, dark);
  Extracted out{extractor.Take(), extractor.counts(), extractor.energy()};
  return out;
}

double U(const SrdBatch& b, int64_t profile, int k) {
  const double u = b.first_u_mm[profile] + k * double(b.step_mm[profile]);
  return b.wrapped ? std::remainder(u, b.samples * double(b.step_mm[profile])) : u;
}

// What Response() should have been read as.
double Expected(const Skin& skin, const SrdBatch& b, int64_t profile, int k) {
  const double half = 0.5 * b.line_width_mm[profile], u = U(b, profile, k) - skin.moved_mm;
  const double scale = 1.0 / (std::sqrt(2.0) * skin.sigma_mm);
  return skin.albedo * 0.5 * (std::erf((u + half) * scale) - std::erf((u - half) * scale));
}

struct Errors {
  double bias = 0.0, scatter = 0.0, variance = 0.0, standard_error = 0.0;
};

// Of all samples of the valid profiles against `skin`.
Errors Compare(const Extracted& e, const Skin& skin) {
  double sum = 0.0, sum2 = 0.0, variance = 0.0, count = 0.0;
  for (int64_t i = 0; i < e.batch.profiles(); ++i) {
    if (e.batch.valid[i] == 0) continue;
    for (int k = 0; k < e.batch.samples; ++k) {
      const double error = e.batch.Samples(i)[k] - Expected(skin, e.batch, i, k);
      sum += error;
      sum2 += error * error;
      count += 1.0;
    }
    variance += e.batch.VarianceOfSum(i);
  }
  return {sum / count, std::sqrt(sum2 / count), variance / count, std::sqrt(sum2) / count};
}

TEST(SrdBrackets, DarkSkinIsReadWithLessNoiseAndNoBias) {
  const Skin dark{.albedo = 0.05};
  const Scene scene;
  const Extracted one = ExtractFrom(scene, {.skin = dark, .seed = 1});
  const Extracted two = ExtractFrom(scene, {.skin = dark, .brackets = {1.0, 4.0}, .seed = 1});
  const Errors of_one = Compare(one, dark), of_two = Compare(two, dark);
  // Read noise of 3 against a signal of some ten digital numbers: four times the light is worth up to 16 such frames.
  EXPECT_LT(of_two.variance, of_one.variance / 5.0);
  EXPECT_LT(of_two.scatter, of_one.scatter / 2.2);
  // What is promised is what is seen, the rounding to digital numbers (a twelfth) apart.
  EXPECT_NEAR(of_two.scatter / std::sqrt(of_two.variance), 1.0, 0.05);
  EXPECT_LT(std::abs(of_two.bias), 4.0 * of_two.standard_error);
  EXPECT_LT(std::abs(of_two.bias), 2e-3 * dark.albedo);
}

TEST(SrdBrackets, SaturatedShotsAreLeftOutSampleBySample) {
  const Skin light{.albedo = 0.8, .sigma_mm = 0.6};
  const Scene scene;
  const Extracted all = ExtractFrom(scene, {.skin = light, .brackets = {1.0, 16.0}, .seed = 2});
  EXPECT_EQ(all.Count(SrdReason::kSaturated), 0);
  const Errors errors = Compare(all, light);
  EXPECT_LT(std::abs(errors.bias), 1e-3 * light.albedo / 10.0);
  // Without the shorter exposure nothing is left of those pixels.
  const Extracted alone = ExtractFrom(scene, {.skin = light, .brackets = {16.0}, .seed = 2});
  EXPECT_GT(alone.Count(SrdReason::kSaturated), alone.batch.profiles() / 2);
}

TEST(SrdEnergy, CycleAddsUpToTheWhiteFramesUnlessTheVisitorMoves) {
  const Scene scene;
  const Extracted still = ExtractFrom(scene, {.skin = {}, .seed = 3});
  EXPECT_EQ(still.Count(SrdReason::kMoved), 0);
  EXPECT_EQ(still.energy.profiles, still.batch.profiles());
  EXPECT_NEAR(still.energy.median_ratio, 1.0, 0.002);
  EXPECT_LT(still.energy.p95_error, 0.08);
  const Extracted moved = ExtractFrom(scene, {.skin = {}, .seed = 3, .moves_at = 10});
  int64_t found = 0, false_alarms = 0, dark_half = 0;
  for (int64_t i = 0; i < moved.batch.profiles(); ++i) {
    const bool right = i / 3 % (kWidth / 2) >= kWidth / 4;
    dark_half += right ? 1 : 0;
    found += right && moved.batch.valid[i] == 0 ? 1 : 0;
    false_alarms += !right && moved.batch.valid[i] == 0 ? 1 : 0;
  }
  EXPECT_EQ(false_alarms, 0);
  // A profile whose own lines came before the move loses nothing by it.
  EXPECT_GT(found, dark_half / 3);
  EXPECT_EQ(found, moved.Count(SrdReason::kMoved));
}

TEST(SrdSweep, OneLostFrameIsMadeUpForByTheWhiteFrames) {
  const Scene scene;
  const Skin skin;
  const Extracted whole = ExtractFrom(scene, {.skin = skin});
  const Extracted lost = ExtractFrom(scene, {.skin = skin, .left_out = 9});
  EXPECT_EQ(lost.Count(SrdReason::kValid), whole.Count(SrdReason::kValid));
  for (int64_t i = 0; i < lost.batch.profiles(); i += 5) {
    if (whole.batch.valid[i] == 0) continue;
    EXPECT_NEAR(lost.batch.Samples(i)[9], whole.batch.Samples(i)[9], 6e-3) << "profile " << i;  // 64 roundings
    // Its noise is that of the others: the sample that was made up has no part in it.
    EXPECT_NEAR(lost.batch.VarianceOfSum(i) / whole.batch.VarianceOfSum(i), 1.0, 0.05);
    EXPECT_GT(whole.batch.white_variance[i], 0.0F);
    EXPECT_EQ(lost.batch.white_variance[i], 0.0F) << "the white is in the samples: no second witness of the total";
  }
}

TEST(SrdRows, AreReadAlongTheirOwnDirection) {
  Scene scene;
  scene.cycle.axis = PatternAxis::kRows;
  const Skin skin{.moved_mm = -0.4};
  const Extracted rows = ExtractFrom(scene, {.skin = skin});
  const Errors errors = Compare(rows, skin);
  EXPECT_LT(errors.scatter, 0.01 * skin.albedo * 0.2);
  // The projector stands 350 mm to the side and 40 mm above: across rows its light falls in almost straight.
  const int64_t middle = (int64_t{kHeight / 4} * (kWidth / 2) + kWidth / 4) * 3 + 1;
  EXPECT_LT(std::abs(rows.batch.slope_in[middle]), 0.15);
  EXPECT_GT(std::abs(rows.batch.slope_in_across[middle]), 0.3);
}

TEST(SrdScatter, AgreesWithTheGatherReadingOnHomogeneousSkin) {
  const Scene scene;
  const Skin skin;
  const Extracted scatter = ExtractFrom(scene, {.skin = skin}, {.reading = SrdReading::kScatter});
  // Profiles near the edge of what is seen lack samples; the others are there.
  EXPECT_GT(scatter.Count(SrdReason::kCutOff), 0);
  EXPECT_GT(scatter.Count(SrdReason::kValid), scatter.batch.profiles() / 4);
  EXPECT_FALSE(scatter.batch.wrapped);
  const double peak = Expected(skin, scatter.batch, 0, 0) + skin.albedo * 0.2;
  const Errors errors = Compare(scatter, skin);
  EXPECT_LT(errors.scatter, 0.01 * peak);
  // The sign of the direction: reading it the other way round would be far worse.
  EXPECT_GT(Compare(scatter, {.moved_mm = -skin.moved_mm}).scatter, 3.0 * errors.scatter);
}

// A cylinder of 25 mm radius about a vertical axis, lit and seen from the front; light spreads along its surface.
TEST(SrdDistance, FollowsTheSurfaceWhereTheTangentPlaneLeavesIt) {
  constexpr double kRadius = 25.0, kSigma = 3.0, kAlbedo = 0.5;
  Scene scene;
  scene.rig.projectors[0].camera_from_projector = LookAt({-20, 0, 0}, {0, 0, 700});
  const ProjectorCalibration& light = scene.rig.projectors[0];
  const Eigen::Vector3d axis(0, 0, 700 + kRadius);
  auto hit = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector3d {
    const Eigen::Vector3d ray = scene.rig.camera.model.Unproject(pixel);
    const double a = ray.x() * ray.x() + ray.z() * ray.z(), b = ray.z() * axis.z(),
                 c = axis.z() * axis.z() - kRadius * kRadius, root = b * b - a * c;
    return root < 0.0 ? Eigen::Vector3d(0, 0, 0) : Eigen::Vector3d(ray * ((b - std::sqrt(root)) / a));
  };
  auto angle = [&](const Eigen::Vector3d& x) { return std::atan2(x.x(), axis.z() - x.z()); };
  // Angle of the surface point that the projector lights at a column of the middle row, by bisection.
  auto angle_at = [&](double column) {
    double low = -1.2, high = 1.2;
    for (int i = 0; i < 40; ++i) {
      const double mid = 0.5 * (low + high);
      const Eigen::Vector3d x = axis + kRadius * Eigen::Vector3d(std::sin(mid), 0, -std::cos(mid));
      (light.ProjectFromCamera(x)->x() < column ? low : high) = mid;
    }
    return 0.5 * (low + high);
  };
  for (int j = 0; j < scene.surface.height(); ++j)
    for (int i = 0; i < scene.surface.width(); ++i) {
      const Eigen::Vector3d x = hit(QuadCentre(Cfa::kRggb, i, j));
      const Eigen::Vector3d n = Eigen::Vector3d(x.x(), 0, x.z() - axis.z()).normalized();
      const bool on = x.z() > 0.0 && -n.z() > 0.3;
      scene.surface.mask(i, j) = on ? 1 : 0;
      for (int k = 0; k < 3; ++k) {
        scene.surface.point_mm(i, j, k) = static_cast<float>(x[k]);
        scene.surface.normal(i, j, k) = static_cast<float>(n[k]);
      }
    }
  std::vector<double> line_angle;
  for (int column = 380; column < 660; ++column) line_angle.push_back(angle_at(column + 0.5));
  // Of every mosaic site: where it looks, and what a line's light amounts to there. Every line brings the same light,
  // however long its stretch of skin is.
  std::vector<double> site_angle, site_dn;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d point = hit({double(x), double(y)});
      const bool on = point.z() > 0.0;
      site_angle.push_back(on ? angle(point) : 0.0);
      site_dn.push_back(0.0);
      if (!on) continue;
      const Eigen::Vector3d n = Eigen::Vector3d(point.x(), 0, point.z() - axis.z()).normalized();
      const double column = light.ProjectFromCamera(point)->x();
      const double m = kRadius * (angle_at(column + 0.5) - angle_at(column - 0.5));
      site_dn.back() = kAlbedo * scene.cycle.width * m / (kSigma * std::sqrt(2 * M_PI)) *
                       light.WhiteTargetDn(point, n, CfaColour(Cfa::kRggb, x, y), scene.cycle.exposure_ms);
    }
  auto rms_width_error = [&](SrdDistance distance) {
    const Image<uint8_t> lit(scene.surface.width(), scene.surface.height(), 1, 1);
    const Image<float> dark(kWidth, kHeight, 1, static_cast<float>(kBlackLevel));
    SrdExtractor extractor(scene.surface, lit, scene.rig, 0, scene.cycle, {.distance = distance});
    for (int k = 0; k < scene.cycle.frames(); ++k) {
      Image<uint16_t> frame(kWidth, kHeight, 1, static_cast<uint16_t>(kBlackLevel));
      for (size_t site = 0; site < site_dn.size(); ++site) {
        double sum = 0.0;
        for (size_t c = 0; c + 1 < line_angle.size(); ++c) {
          if ((380 + static_cast<int>(c) - k * scene.cycle.step + 1280) % scene.cycle.period != 0) continue;
          const double arc = kRadius * (line_angle[c] - site_angle[site]);
          sum += std::exp(-0.5 * arc * arc / (kSigma * kSigma));
        }
        frame.pixels()[site] = static_cast<uint16_t>(std::lround(std::min(4000.0, kBlackLevel + site_dn[site] * sum)));
      }
      const CombFrame comb{k, {{frame, dark, scene.cycle.exposure_ms}}};
      extractor.AddFrames({&comb, 1});
    }
    const SrdBatch b = extractor.Take();
    // Root mean square width of the profiles on the flank, where the plane leaves the cylinder.
    double error = 0.0, count = 0.0;
    for (int64_t i = 1; i < b.profiles(); i += 3) {
      const int x = static_cast<int>(i / 3 % scene.surface.width());
      const double a = angle(scene.surface.Point(x, static_cast<int>(i / 3 / scene.surface.width())));
      if (b.valid[i] == 0 || !(std::abs(a) > 0.45 && std::abs(a) < 0.6)) continue;
      double sum = 0.0, first = 0.0, second = 0.0;
      for (int k = 0; k < b.samples; ++k) {
        const double u = U(b, i, k), y = b.Samples(i)[k];
        if (std::abs(u) > 3.0 * kSigma) continue;
        sum += y;
        first += y * u;
        second += y * u * u;
      }
      const double width = std::sqrt(second / sum - first * first / sum / sum);
      error += std::abs(width - 0.9865 * kSigma);  // of a Gaussian cut at three sigma
      count += 1.0;
    }
    EXPECT_GT(count, 20.0);
    return error / count / kSigma;
  };
  const double plane = rms_width_error(SrdDistance::kTangentPlane), surface = rms_width_error(SrdDistance::kSurface);
  EXPECT_LT(surface, 0.02);
  EXPECT_GT(plane, 2.0 * surface);
}

TEST(SrdExtractor, GivesTheSameBitsForAnyNumberOfThreads) {
  const Scene scene;
  for (SrdReading reading : {SrdReading::kGather, SrdReading::kScatter}) {
    SrdBatch first;
    for (const char* threads : {"1", "3"}) {
      setenv("STRATALUX_THREADS", threads, 1);
      const Extracted run = ExtractFrom(scene, {.skin = {}, .brackets = {1.0, 4.0}, .seed = 5}, {.reading = reading});
      if (first.y.empty()) {
        first = run.batch;
        continue;
      }
      EXPECT_EQ(first.y, run.batch.y);
      EXPECT_EQ(first.noise_floor, run.batch.noise_floor);
      EXPECT_EQ(first.noise_slope, run.batch.noise_slope);
      EXPECT_EQ(first.valid, run.batch.valid);
    }
    unsetenv("STRATALUX_THREADS");
  }
}

}  // namespace
}  // namespace stratalux::fit
