// SPDX-License-Identifier: Apache-2.0
// A real face under seven calibrated near lights (near_ps, GPL, no part of the sources): skipped where it is absent.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/photometric/photometric_stereo.h"
#include "shared/image/png.h"
#include "shared/units/angle.h"
#include "tests/support/test_data.h"

namespace stratalux::fit {
namespace {

struct Led {
  int index = 0;
  Eigen::Vector3d position_mm, axis;
  double exponent = 0.0;
  double strength = 0.0;  // mean of the channels
  Image<float> grey;      // mean of the channels, 8-bit levels, ambient removed
};

class RealFace : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = TestDataFolder() / "nearps_face";
    if (!std::filesystem::exists(folder_ / "calib.txt"))
      GTEST_SKIP() << folder_ << " is absent; set STRATALUX_DATA to the folder of the test data";
    ReadCalibration();
    mask_ = Png("human1_mask.png");
    const Image<uint16_t> ambient = Png("human1_ambient_q16.png");
    for (Led& led : leds_) {
      const Image<uint16_t> lit = Png("human1_led" + std::to_string(led.index) + "_q16.png");
      led.grey = Image<float>(lit.width(), lit.height());
      for (size_t i = 0; i < lit.size(); ++i)
        led.grey.data()[i / 3] += static_cast<float>(lit.data()[i] - ambient.data()[i]) / 256.0F / 3.0F;
    }
  }

  [[nodiscard]] Image<uint16_t> Png(const std::string& name) const {
    auto image = ReadPng(folder_ / name, nullptr);
    EXPECT_TRUE(image.ok()) << image.status().message();
    return image.ok() ? std::move(image).value() : Image<uint16_t>(1, 1);
  }

  // Three lines of the camera's matrix, then a line a light; the fifth has no image.
  void ReadCalibration() {
    std::ifstream in(folder_ / "calib.txt");
    int row = 0;
    for (std::string text; std::getline(in, text);) {
      if (text.empty() || text[0] == '#') continue;
      std::istringstream line(text);
      if (row < 3) {
        line >> camera_(row, 0) >> camera_(row, 1) >> camera_(row, 2);
        ++row;
        continue;
      }
      Led led;
      line >> led.index;
      for (int k = 0; k < 3; ++k) line >> led.position_mm[k];
      for (int k = 0; k < 3; ++k) line >> led.axis[k];
      line >> led.exponent;
      for (double channel; line >> channel;) led.strength += channel / 3.0;
      if (led.index != 5) leds_.push_back(std::move(led));
    }
    ASSERT_EQ(leds_.size(), 7U);
  }

  [[nodiscard]] Eigen::Vector3d PointAt(int i, int j, double z_mm) const {
    return z_mm * camera_.inverse() * Eigen::Vector3d(i, j, 1.0);
  }

  // A plane at a depth, facing the camera: points for the lights, and a poor prior.
  [[nodiscard]] SurfaceMap PlaneAt(double z_mm) const {
    const int width = mask_.width(), height = mask_.height();
    SurfaceMap surface{Image<float>(width, height, 3, std::nanf("")), Image<float>(width, height, 3, std::nanf("")),
                       Image<float>(width, height), Image<uint8_t>(width, height)};
    for (int j = 0; j < height; ++j)
      for (int i = 0; i < width; ++i) {
        if (mask_(i, j) == 0) continue;
        surface.mask(i, j) = 1;
        const Eigen::Vector3d x = PointAt(i, j, z_mm);
        for (int k = 0; k < 3; ++k) {
          surface.point_mm(i, j, k) = static_cast<float>(x[k]);
          surface.normal(i, j, k) = k == 2 ? -1.0F : 0.0F;
        }
      }
    return surface;
  }

  // The reference: grey = albedo white (n . l), by plain least squares over the lights that give more than kLeastLevel,
  // three at least, as near_ps has it.
  struct Reference {
    Image<float> normal;  // W x H x 3, NaN where lights are too few
    double relative_residual = 0.0;
  };
  [[nodiscard]] Reference PlainLeastSquares(double z_mm) const {
    Reference reference{Image<float>(mask_.width(), mask_.height(), 3, std::nanf("")), 0.0};
    double squares = 0.0, all = 0.0;
    for (int j = 0; j < mask_.height(); ++j)
      for (int i = 0; i < mask_.width(); ++i) {
        if (mask_(i, j) == 0) continue;
        const Eigen::Vector3d x = PointAt(i, j, z_mm);
        Eigen::Matrix<double, 7, 3> a = Eigen::Matrix<double, 7, 3>::Zero();
        Eigen::Matrix<double, 7, 1> y = Eigen::Matrix<double, 7, 1>::Zero();
        int lights = 0;
        for (const Led& led : leds_) {
          if (led.grey(i, j) < kLeastLevel) continue;
          const Eigen::Vector3d way = led.position_mm - x;
          const double lobe = std::pow(std::max(0.0, -way.normalized().dot(led.axis)), led.exponent);
          a.row(lights) = led.strength * lobe / way.squaredNorm() * way.normalized().transpose();
          y[lights++] = led.grey(i, j);
        }
        if (lights < 3) continue;
        const Eigen::Vector3d g = a.colPivHouseholderQr().solve(y);
        squares += (a * g - y).squaredNorm();
        all += y.squaredNorm();
        const Eigen::Vector3d n = g.normalized();
        for (int k = 0; k < 3; ++k) reference.normal(i, j, k) = static_cast<float>(n[k]);
      }
    reference.relative_residual = std::sqrt(squares / all);
    return reference;
  }

  [[nodiscard]] PhotometricMap Estimate(const std::vector<int>& indices) const {
    const Image<float> variance(mask_.width(), mask_.height(), 1, static_cast<float>(kLevelVariance));
    std::vector<LitImage> images;
    for (const Led& led : leds_) {
      if (std::ranges::find(indices, led.index) == indices.end()) continue;
      images.push_back({{NearLight{led.position_mm, LambertianLobe(led.axis, led.exponent)}, {}}, led.grey, variance});
      images.back().light.strength.fill(led.strength);
    }
    auto map = EstimateNormals(images, PlaneAt(kDepthMm));
    EXPECT_TRUE(map.ok()) << map.status().message();
    return std::move(map).value();
  }

  // Median angle to the reference, degrees, where each of the seven lights gives `least` levels; NaN counts as 180.
  [[nodiscard]] double MedianAngle(const PhotometricMap& map, const Reference& reference, double least) const {
    std::vector<double> angles;
    for (int j = 0; j < mask_.height(); ++j)
      for (int i = 0; i < mask_.width(); ++i) {
        const bool sufficient = std::ranges::all_of(leds_, [&](const Led& led) { return led.grey(i, j) >= least; });
        if (mask_(i, j) == 0 || !sufficient) continue;
        double cosine = 0.0;
        for (int k = 0; k < 3; ++k) cosine += reference.normal(i, j, k) * map.normal(i, j, k);
        angles.push_back(std::isnan(cosine) ? 180.0 : DegFromRad(std::acos(std::clamp(cosine, -1.0, 1.0))));
      }
    if (angles.empty()) return 180.0;
    const auto middle = angles.begin() + static_cast<std::ptrdiff_t>(angles.size() / 2);
    std::ranges::nth_element(angles, middle);
    return *middle;
  }

  static constexpr double kDepthMm = 700.0;
  static constexpr double kLeastLevel = 0.004 * 255.0;  // an 8-bit level
  static constexpr double kSufficientLevel = 2.0;
  static constexpr double kLevelVariance = 1.0;  // of a JPEG's dark grey: about as much
  std::filesystem::path folder_;
  Eigen::Matrix3d camera_;
  std::vector<Led> leds_;
  Image<uint16_t> mask_;
};

TEST_F(RealFace, ResidualIsLeastAtItsDepth) {
  double best_mm = 0.0, best = INFINITY;
  for (double z_mm = 640.0; z_mm <= 760.0; z_mm += 10.0) {
    const double residual = PlainLeastSquares(z_mm).relative_residual;
    std::printf("plane at %.0f mm: relative residual %.4f\n", z_mm, residual);
    if (residual < best) best = residual, best_mm = z_mm;
  }
  EXPECT_NEAR(best_mm, kDepthMm, 20.0);
  EXPECT_LE(best, 0.069);
}

// Of the 35 choices of four two hold to seven within 2.5 degrees, by plain least squares as well: what the face is not
// of the plane, four lights cannot average away.
TEST_F(RealFace, SevenAndFourLightsAgreeWithPlainLeastSquares) {
  const std::map<std::vector<int>, double> most_deg = {{{1, 2, 3, 4, 6, 7, 8}, 1.0}, {{1, 2, 6, 7}, 2.5},
                                                       {{1, 4, 6, 7}, 2.5},          {{1, 3, 6, 7}, 4.0},
                                                       {{2, 3, 6, 7}, 4.0},          {{3, 4, 6, 7}, 4.0}};
  const Reference reference = PlainLeastSquares(kDepthMm);
  for (const auto& [lights, most] : most_deg) {
    const PhotometricMap map = Estimate(lights);
    std::string names;
    for (const int light : lights) names += " " + std::to_string(light);
    const double median = MedianAngle(map, reference, kSufficientLevel);
    std::printf("lights%s: median %.2f degrees; where each gives one level %.2f; %.1f %% from light alone\n",
                names.c_str(), median, MedianAngle(map, reference, kLeastLevel),
                100.0 * static_cast<double>(map.counts[0]) /
                    static_cast<double>(map.counts[0] + map.counts[2] + map.counts[3] + map.counts[4]));
    EXPECT_LE(median, most) << names;
  }
}

}  // namespace
}  // namespace stratalux::fit
