// SPDX-License-Identifier: Apache-2.0
// Light on a flat world whose answer is known: Lambert's and the distance law, the energy and the line spread of the
// skin table, oblique incidence reflectometry, Monte Carlo.
#include "firmware-host/simulated/light_transport.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <gtest/gtest.h>

#include "firmware-host/simulated/rig_description.h"
#include "firmware-host/simulated/table_tool/line_spread.h"
#include "shared/units/angle.h"
#include "tests/firmware-host/simulated/flat_world.h"
#include "tests/firmware-host/simulated/plain_patterns.h"

namespace stratalux::rig {
namespace {

Pattern Comb(int period, int width, int shift, PatternAxis axis = PatternAxis::kColumns) {
  return {.kind = PatternKind::kComb, .axis = axis, .period = period, .width = width, .shift = shift};
}

// Subsurface plus direct light of a pattern, DN per ms.
std::vector<float> Light(const LightTransport& transport, size_t pixels, const Pattern& pattern) {
  std::vector<float> light(pixels, 0.0F);
  transport.Render(pattern, light, light);
  return light;
}

std::vector<SubjectPixel> PixelBlock(const FlatWorld& world, int size, int step = 1) {
  std::vector<SubjectPixel> pixels;
  for (int k = 0; k < size * size; ++k)
    pixels.push_back(world.Pixel((k % size - size / 2) * step, (k / size - size / 2) * step));
  return pixels;
}

double Column(const LightTransport& transport, size_t i) { return transport.ColumnRow(i).x(); }

// Millimetres along the tangent from one column to the next.
double ColumnMm(const FlatWorld& world, const SubjectPixel& pixel) {
  const double c0 = world.projector().ProjectFromCamera(pixel.point - 0.05 * world.tangent())->x();
  const double c1 = world.projector().ProjectFromCamera(pixel.point + 0.05 * world.tangent())->x();
  return 0.1 / (c1 - c0);
}

// First moment of the response about the pixel's own column, mm along rising columns (docs/conventions.md, u).
double CentroidMm(const std::vector<double>& response, double column, double column_mm, double reach_mm = 20.0) {
  double sum = 0.0, moment = 0.0;
  for (size_t c = 0; c < response.size(); ++c) {
    const double u = (static_cast<double>(c) - column) * column_mm;
    if (std::abs(u) > reach_mm) continue;
    sum += response[c];
    moment += response[c] * u;
  }
  return moment / sum;
}

// Mean centroid of a few pixels: columns as wide as the kernel's spike make that of one pixel depend on its phase.
double MeanCentroidMm(const FlatWorldOptions& options) {
  const FlatWorld world(options);
  std::vector<SubjectPixel> pixels;
  for (int k = -4; k < 4; ++k) pixels.push_back(world.Pixel(k));
  const LightTransport transport = world.Transport(pixels);
  const auto responses = RenderedColumnResponses(transport, pixels.size(), options.projector_px);
  double mean = 0.0;
  for (size_t i = 0; i < pixels.size(); ++i)
    mean += CentroidMm(responses[i], Column(transport, i), ColumnMm(world, pixels[i])) / 8.0;
  return mean;
}

// 1 / mu_s', the transport mean free path (absorption of red light adds 2 % at most).
double TransportMm(const SkinParameters& skin) {
  const TissueLayer dermis = AbsorbingSkin(0, skin).layers[1];
  return 1.0 / (dermis.mu_s_per_mm * (1.0 - dermis.g) + 0.35 * dermis.mu_a_per_mm);
}

TEST(LightTransport, CombFramesOfOneCycleAddUpToTheWhiteFrame) {
  for (const int projector_px : {256, 42}) {  // 42: the outermost blocks of the pyramid are cut
    const FlatWorld world({.light_deg = 30.0, .projector_px = projector_px, .line_blur_px = 0.5});
    const std::vector<SubjectPixel> pixels = PixelBlock(world, 12, 3);
    const LightTransport transport = world.Transport(pixels);
    const std::vector<float> white = Light(transport, pixels.size(), kWhitePattern);
    for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
      std::vector<double> sum(pixels.size(), 0.0);
      for (int shift = 0; shift < 64; shift += 2) {
        const std::vector<float> frame = Light(transport, pixels.size(), Comb(64, 2, shift, axis));
        for (size_t i = 0; i < pixels.size(); ++i) sum[i] += frame[i];
      }
      for (size_t i = 0; i < pixels.size(); ++i) {
        EXPECT_NEAR(sum[i] / white[i], 1.0, 1e-4) << projector_px << " columns, pixel " << i;
      }
    }
  }
}

TEST(LightTransport, TwoDimensionalPatternsAddUpToTheWhiteFrame) {
  // 42 is no multiple of 4 or 16: the outermost blocks of the pyramid are cut.
  const FlatWorld world({.light_deg = 30.0, .projector_px = 42});
  const std::vector<SubjectPixel> pixels = PixelBlock(world, 6, 5);
  const LightTransport transport = world.Transport(pixels);
  const std::vector<float> white = Light(transport, pixels.size(), kWhitePattern);
  std::vector<double> sum(pixels.size(), 0.0);
  for (int shift = 0; shift < 4; ++shift) {  // each square is lit in two of the four
    const std::vector<float> frame =
        Light(transport, pixels.size(), {.kind = PatternKind::kCheckerboard, .period = 8, .shift = shift, .shifts = 2});
    for (size_t i = 0; i < pixels.size(); ++i) sum[i] += frame[i];
  }
  for (size_t i = 0; i < pixels.size(); ++i) EXPECT_NEAR(sum[i] / (2.0 * white[i]), 1.0, 1e-4) << "pixel " << i;
}

TEST(LightTransport, WithoutScatteringFollowsLambertAndTheDistanceLaw) {
  // The difference of two skins has no surface reflection in it: (albedo - albedo') E, E = intensity n.l / d^2.
  const SkinParameters light{0.01F, 0.002F}, dark{0.1F, 0.01F};
  for (const double distance : {500.0, 1000.0})
    for (const double angle : {-60.0, 0.0, 35.0}) {
      std::array<std::vector<float>, 2> white;
      std::vector<SubjectPixel> pixels;
      double albedo = 0.0;
      for (int k = 0; k < 2; ++k) {
        FlatWorld world({.skin = k == 0 ? light : dark, .light_deg = angle, .light_mm = distance});
        world.rig().projectors[0].falloff = {-0.12, 0.02};
        pixels = PixelBlock(world, 5, 20);
        white[k] = Light(world.Transport(pixels, {.scattering = false}), pixels.size(), kWhitePattern);
        albedo += (k == 0 ? 1.0 : -1.0) * world.albedo()(0, k == 0 ? light : dark);
        if (k == 0) continue;
        for (size_t i = 0; i < pixels.size(); ++i)
          EXPECT_NEAR((white[0][i] - white[1][i]) / (albedo * world.Irradiance(pixels[i].point, 0)), 1.0, 1e-4)
              << angle << " degrees, " << distance << " mm, pixel " << i;
      }
    }
}

TEST(LightTransport, WithoutScatteringALineIsOneLineWide) {
  // A pixel sees of a line what its own width and the line have in common.
  const FlatWorld world({.light_deg = 30.0});
  constexpr int kSide = 8;
  const std::vector<SubjectPixel> pixels = PixelBlock(world, kSide);
  const LightTransport transport = world.Transport(pixels, {.scattering = false});
  const int columns = world.projector().model.width;
  const std::vector<float> white = Light(transport, pixels.size(), kWhitePattern);
  std::vector<double> sum(pixels.size());
  for (int c = 0; c < columns; ++c) {
    const std::vector<float> line = Light(transport, pixels.size(), Comb(columns, 1, c));
    for (size_t i = 0; i < pixels.size(); ++i) {
      const double u = Column(transport, i) - c;
      const size_t beside = i % kSide == 0 ? i + 1 : i - 1;
      const double half = 0.5 * std::abs(Column(transport, i) - Column(transport, beside));
      ASSERT_GT(half, 0.25);
      const double common = std::max(0.0, std::min(u + half, 0.5) - std::max(u - half, -0.5));
      ASSERT_NEAR(line[i] / white[i], common / (2.0 * half), 0.01) << "column " << c << ", pixel " << i;
      sum[i] += line[i];
    }
  }
  for (size_t i = 0; i < pixels.size(); ++i) EXPECT_NEAR(sum[i] / white[i], 1.0, 1e-5);
}

TEST(LightTransport, WhiteFrameIsSmoothAndHasTheEnergyOfTheKernel) {
  // On homogeneous skin the white frame is E times pi times the kernel's integral, whatever the phase between camera
  // pixels and projector columns. Measured: mean within 0.3 %, ripple 0.07 - 0.25 % rms, 0.6 % at most.
  for (const int camera_width : {1392, 696, 232})
    for (const double angle : {-60.0, 0.0, 30.0, 45.0}) {
      const FlatWorld world({.light_deg = angle, .camera_width = camera_width});
      const std::vector<SubjectPixel> pixels = PixelBlock(world, camera_width > 500 ? 24 : 12);
      std::vector<float> subsurface(pixels.size(), 0.0F), direct(pixels.size(), 0.0F);
      world.Transport(pixels).Render(kWhitePattern, subsurface, direct);
      double mean = 0.0, squares = 0.0, worst = 0.0;
      for (size_t i = 0; i < pixels.size(); ++i) {
        const double analytic =
            world.Irradiance(pixels[i].point, 0) * M_PI * world.KernelAt(pixels[i]).kernel.Integral();
        const double error = subsurface[i] / analytic - 1.0;
        mean += error / static_cast<double>(pixels.size());
        squares += error * error / static_cast<double>(pixels.size());
        worst = std::max(worst, std::abs(error));
      }
      const double rms = std::sqrt(squares - mean * mean);
      RecordProperty("ripple_rms_" + std::to_string(camera_width), std::to_string(rms));
      EXPECT_LT(std::abs(mean), 0.004) << angle << " degrees, camera " << camera_width;
      EXPECT_LT(rms, 0.004) << angle << " degrees, camera " << camera_width;
      EXPECT_LT(worst, 0.012) << angle << " degrees, camera " << camera_width;
    }
}

TEST(LightTransport, DistortionOfTheProjectorChangesNoIrradiance) {
  // Barrel distortion packs columns; the light that falls on a patch stays what the calibration says.
  FlatWorld world({.light_deg = 20.0});
  world.rig().projectors[0].model.distortion = {-20.0, 0.0, 0.0, 0.0, 0.0};
  std::vector<SubjectPixel> pixels;
  for (int k = -72; k <= 72; k += 24) pixels.push_back(world.Pixel(k));
  const std::vector<float> white = Light(world.Transport(pixels), pixels.size(), kWhitePattern);
  FlatWorld straight({.light_deg = 20.0});
  const std::vector<float> expected = Light(straight.Transport(pixels), pixels.size(), kWhitePattern);
  for (size_t i = 0; i < pixels.size(); ++i) EXPECT_NEAR(white[i] / expected[i], 1.0, 0.006) << i;
}

TEST(LightTransport, ResponseIsTheLineSpreadOfTheTable) {
  // Against polar quadrature of the table's kernel over column and footprint. Beyond nine columns the renderer keeps
  // blocks of four columns: compare those.
  const std::vector<std::pair<double, double>> view_light = {{0, 45}, {0, -45}, {0, 0}, {-20, 20}, {-20, 60}};
  for (const auto& [view, light] : view_light) {
    const FlatWorld world({.view_deg = view, .light_deg = light});
    const std::vector<SubjectPixel> pixels = {world.Pixel(0), world.Pixel(3, 1)};
    const LightTransport transport = world.Transport(pixels);
    const auto rendered = RenderedColumnResponses(transport, pixels.size(), 256);
    for (size_t i = 0; i < pixels.size(); ++i) {
      const std::vector<double> expected = world.ColumnResponse(pixels[i]);
      const double peak = *std::max_element(expected.begin(), expected.end());
      double block = 0.0, expected_block = 0.0;
      for (int c = 0; c < 256; ++c) {
        if (std::abs(c - Column(transport, i)) < 8.0) {
          EXPECT_NEAR(rendered[i][c], expected[c], 0.035 * peak) << view << ' ' << light << " column " << c;
        }
        block += rendered[i][c];
        expected_block += expected[c];
        if (c % 4 != 3) continue;
        EXPECT_NEAR(block, expected_block, 0.03 * peak) << view << ' ' << light << " columns to " << c;
        block = expected_block = 0.0;
      }
      const double mm = ColumnMm(world, pixels[i]), column = Column(transport, i);
      EXPECT_NEAR(CentroidMm(rendered[i], column, mm), CentroidMm(expected, column, mm), 0.006) << view << ' ' << light;
    }
  }
}

TEST(LightTransport, ResponseIsTheLineSpreadOfMonteCarlo) {
  // The whole chain - table, angle interpolation, gather - against photons that never saw the table.
  const FlatWorldOptions options{.light_deg = 45.0};
  const FlatWorld world(options);
  std::vector<SubjectPixel> pixels;
  for (int k = -4; k < 4; ++k) pixels.push_back(world.Pixel(k));
  const LightTransport transport = world.Transport(pixels);
  const auto rendered = RenderedColumnResponses(transport, pixels.size(), options.projector_px);

  const double mm = ColumnMm(world, pixels[4]);
  LineSpreadOptions spread{.skin = options.skin, .incidence_deg = {45.0}, .slit_mm = {mm}};
  spread.step_mm = 0.1;
  spread.acceptance_deg = 25.0;
  spread.photons = 200000;
  std::istringstream csv(LineSpreadCsv(spread));
  std::string line;
  std::getline(csv, line);
  std::vector<double> profile;  // radiance in the reflectance unit at u = (k - 120) * 0.1 mm
  while (std::getline(csv, line)) profile.push_back(std::stod(line.substr(line.rfind(',') + 1)));
  ASSERT_EQ(profile.size(), 241U);

  // Cumulative profiles below u: of all pixels' columns, and of the photons. The light travels towards falling columns,
  // and u = observed less line position counts the same way: the two senses agree.
  double total = 0.0, centroid = 0.0, rendered_total = 0.0, rendered_centroid = 0.0;
  constexpr double kReach = 8.0;
  for (int k = 0; k < 241; ++k) {
    const double u = (k - 120) * 0.1;
    if (std::abs(u) > kReach) continue;
    total += profile[k] * 0.1 / mm;
    centroid += profile[k] * 0.1 / mm * u;
  }
  for (size_t i = 0; i < pixels.size(); ++i)
    for (int c = 0; c < 256; ++c) {
      const double u = (c - Column(transport, i)) * mm;
      if (std::abs(u) > kReach) continue;
      const double share = rendered[i][c] / world.Irradiance(pixels[i].point, 0) / 8.0;
      rendered_total += share;
      rendered_centroid += share * u;
    }
  centroid /= total;
  rendered_centroid /= rendered_total;
  RecordProperty("centroid_um", static_cast<int>(1000.0 * rendered_centroid));
  RecordProperty("centroid_monte_carlo_um", static_cast<int>(1000.0 * centroid));
  // 200,000 photons leave 0.009 mm a sigma on 0.15 mm; the table's angle bins are 15 to 20 degrees wide.
  EXPECT_NEAR(rendered_total / total, 1.0, 0.03);
  EXPECT_NEAR(rendered_centroid, centroid, 0.03);
  for (const double edge : {-4.0, -2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 4.0}) {
    double below = 0.0, rendered_below = 0.0;
    for (int k = 0; k < 241; ++k)
      below += profile[k] * 0.1 / mm * std::clamp((edge - (k - 120) * 0.1) / 0.1 + 0.5, 0.0, 1.0);
    for (size_t i = 0; i < pixels.size(); ++i)
      for (int c = 0; c < 256; ++c)
        rendered_below += rendered[i][c] / world.Irradiance(pixels[i].point, 0) / 8.0 *
                          std::clamp(edge / mm - (c - Column(transport, i)) + 0.5, 0.0, 1.0);
    EXPECT_NEAR(rendered_below / rendered_total, below / total, 0.02) << "cumulative at " << edge << " mm";
  }
}

TEST(LightTransport, LightTravelsOnAwayFromTheLamp) {
  // Oblique incidence reflectometry (Wang & Jacques 1995): seen along the normal, the light has moved by 3 D
  // sin(theta_t) in its own direction. So it entered that much nearer the lamp, which stands towards rising columns.
  const SkinParameters skin{0.01F, 0.002F};
  for (const double angle : {30.0, 45.0, 60.0}) {
    const double expected = TransportMm(skin) * std::sin(RadFromDeg(angle)) / kSkinIndex;
    EXPECT_NEAR(MeanCentroidMm({.skin = skin, .light_deg = angle}) / expected, 1.0, 0.15) << angle;
  }
}

TEST(LightTransport, MirroredLightsHaveMirroredResponses) {
  std::array<std::vector<double>, 2> responses;
  std::array<double, 2> centroids{};
  for (int k = 0; k < 2; ++k) {
    const FlatWorld world({.light_deg = k == 0 ? 45.0 : -45.0});
    const std::vector<SubjectPixel> pixels = {world.Pixel()};
    const LightTransport transport = world.Transport(pixels);
    responses[k] = RenderedColumnResponses(transport, 1, 256)[0];
    centroids[k] = CentroidMm(responses[k], Column(transport, 0), ColumnMm(world, pixels[0]));
  }
  EXPECT_GT(centroids[0], 0.1);
  EXPECT_NEAR(centroids[0], -centroids[1], 0.006);
  const double peak = *std::max_element(responses[0].begin(), responses[0].end());
  for (int c = 0; c < 256; ++c)
    EXPECT_NEAR(responses[0][c], responses[1][255 - c], 0.02 * peak) << "columns " << c << ", " << 255 - c;
}

TEST(LightTransport, ResponseIsCentredWhereLightAndViewCoincide) {
  // Reciprocity: exchanging entry and exit changes nothing when omega_i = omega_o, along the normal or not.
  EXPECT_NEAR(MeanCentroidMm({.view_deg = 0.0, .light_deg = 0.0}), 0.0, 0.006);
  EXPECT_NEAR(MeanCentroidMm({.view_deg = -20.0, .light_deg = -20.0}), 0.0, 0.01);
  // Mirrored about the normal, both the way in and the way out displace.
  const double one = TransportMm({}) * std::sin(RadFromDeg(20.0)) / kSkinIndex;
  EXPECT_NEAR(MeanCentroidMm({.view_deg = -20.0, .light_deg = 20.0}) / (2.0 * one), 1.0, 0.15);
}

TEST(LightTransport, CentroidHasNoJumpWhereTheViewPassesThroughTheNormal) {
  // The azimuth of omega_o turns by 180 degrees from one pixel to the next there; the light must not notice.
  const FlatWorld world({.light_deg = 45.0});
  std::vector<SubjectPixel> pixels;
  for (int k = -2; k <= 2; ++k) pixels.push_back(world.Pixel(k, 1));
  for (size_t k = 1; k < pixels.size(); ++k) {
    const auto centroid = [](const SkinKernel& kernel) {
      double sum = 0.0, moment = 0.0;
      for (double r = 0.01; r < 15.0; r *= 1.02)
        for (int a = 0; a < 64; ++a) {
          const double x = r * std::cos(2.0 * M_PI * (a + 0.5) / 64), y = r * std::sin(2.0 * M_PI * (a + 0.5) / 64);
          const double s = kernel(static_cast<float>(x), static_cast<float>(y)) * r * r;
          sum += s;
          moment += s * x;
        }
      return moment / sum;
    };
    EXPECT_NEAR(centroid(world.KernelAt(pixels[k]).kernel), centroid(world.KernelAt(pixels[k - 1]).kernel), 0.004) << k;
  }
}

// Whether the straight way from a surface point to the lamp is blocked by more than `margin_mm` (+1), free by more than
// that (-1), or too close to call (0): small steps along the ray, against the surface's own formula.
int Shadowed(const Scene& scene, const Eigen::Vector3d& point, const Eigen::Vector3d& lamp, double margin_mm) {
  const Eigen::Vector3d direction = (lamp - point).normalized();
  double deepest = -1e9;
  for (double s = 3.0; s < 150.0; s += 0.25) {
    const Eigen::Vector3d p = point + s * direction;
    const double depth = p.z() - scene.Height(p.x(), p.y());  // below the surface when positive
    if (!std::isnan(depth)) deepest = std::max(deepest, depth);
  }
  return deepest > margin_mm ? 1 : deepest < -margin_mm ? -1 : 0;
}

TEST(LightTransport, TheNoseCastsAShadow) {
  SimulatedRigOptions options;
  options.projector_width = 512;
  options.projector_height = 384;
  RigCalibration rig = DescribeSimulatedRig(options);
  const Scene head = *Scene::Create("head", 1);
  const SkinTable table = *SkinTable::Load(SkinTable::DefaultPath());
  const SkinAlbedo albedo(table);
  std::vector<SubjectPixel> pixels;  // nose and cheeks
  for (int y = 0; y < rig.camera.model.height; y += 4)
    for (int x = 0; x < rig.camera.model.width; x += 4) {
      const auto hit = head.Intersect({Eigen::Vector3d::Zero(), rig.camera.model.Unproject({double(x), double(y)})});
      if (!hit || std::abs(hit->x()) > 45.0 || std::abs(hit->y()) > 45.0) continue;
      pixels.push_back({x, y, *hit, head.Normal(*hit), head.MaterialAt(*hit)});
    }
  for (const int p : {0, 3}) {
    // 60 degrees to the left and to the right: from their own places (33 degrees) the nose is too blunt for a shadow.
    const double side = p == 0 ? -1.0 : 1.0;
    rig.projectors[p].camera_from_projector = LookAt(
        {side * 835.0 * std::sin(RadFromDeg(60.0)), 0.0, 700.0 - 835.0 * std::cos(RadFromDeg(60.0))}, {0, 4, 700});
    const LightTransport transport(head, table, albedo, rig, p, pixels, {});
    std::vector<float> subsurface(pixels.size(), 0.0F), direct(pixels.size(), 0.0F);
    transport.Render(kWhitePattern, subsurface, direct);
    const Eigen::Vector3d lamp = rig.projectors[p].CentreInCamera();
    int shadow = 0, lit = 0, near_side = 0;
    for (size_t i = 0; i < pixels.size(); ++i) {
      const double cosine = pixels[i].normal.dot((lamp - pixels[i].point).normalized());
      if (cosine < 0.1) continue;
      const int shadowed = Shadowed(head, pixels[i].point, lamp, 0.7);
      if (shadowed > 0) {
        ++shadow;
        near_side += pixels[i].point.x() * lamp.x() > 0.0 ? 1 : 0;
        EXPECT_EQ(direct[i], 0.0F) << pixels[i].point.transpose();
        EXPECT_TRUE(std::isnan(transport.ColumnRow(i).x())) << pixels[i].point.transpose();
      } else if (shadowed < 0) {
        ++lit;
        EXPECT_GT(direct[i], 0.0F) << pixels[i].point.transpose();
        EXPECT_FALSE(std::isnan(transport.ColumnRow(i).x())) << pixels[i].point.transpose();
      }
    }
    EXPECT_GT(shadow, 100) << "projector " << p;
    EXPECT_LT(near_side, shadow / 2) << "the shadow lies on the far side of the nose";
    EXPECT_GT(lit, 1000) << "projector " << p;
  }
}

}  // namespace
}  // namespace stratalux::rig
