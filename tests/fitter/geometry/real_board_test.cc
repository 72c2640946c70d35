// SPDX-License-Identifier: Apache-2.0
// The public captures of a real projector and camera (procam-calibration, MIT): skipped where they are not installed.
#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include <gtest/gtest.h>

#include "fitter/structured_light/gray_decoder.h"
#include "fitter/structured_light/local_homography.h"
#include "shared/image/png.h"
#include "shared/pattern/pattern.h"
#include "tests/support/test_data.h"

namespace stratalux::fit {
namespace {

struct Corner {
  int pose = 0;
  Eigen::Vector2d camera, projector;
};

std::vector<std::istringstream> Lines(const std::filesystem::path& file) {
  std::vector<std::istringstream> lines;
  std::ifstream in(file);
  for (std::string line; std::getline(in, line);)
    if (!line.empty() && line[0] != '#') lines.emplace_back(line);
  return lines;
}

DecodeInput BoardInput(const std::vector<Image<uint16_t>>& frames, const Image<float>& black) {
  DecodeInput input{.white = frames[40].view(), .black = black};
  input.columns.count = 1024;
  input.rows.count = 768;
  for (size_t bit = 0; bit < 10; ++bit) {
    input.columns.bits.push_back({frames[2 * bit].view(), frames[2 * bit + 1].view()});
    input.rows.bits.push_back({frames[20 + 2 * bit].view(), frames[21 + 2 * bit].view()});
  }
  return input;
}

constexpr SensorNoise kNoise{.saturation_dn = 255.0, .gain_e_per_dn = 40.0, .read_noise_dn = 1.0};
constexpr int kPoses = 5;

struct Capture {
  std::vector<Image<uint16_t>> frames;
  Image<float> black;
};

void ReadPose(const std::filesystem::path& folder, int pose, Capture& capture) {
  for (int k = 0; k < 42; ++k) {
    char name[32];
    std::snprintf(name, sizeof(name), "pose%d/g%02d.png", pose, k);
    auto frame = ReadPng(folder / name, nullptr);
    ASSERT_TRUE(frame.ok()) << frame.status().message();
    capture.frames.push_back(std::move(frame).value());
  }
  const Image<uint16_t>& dark = capture.frames[41];
  capture.black = Image<float>(dark.width(), dark.height());
  std::copy(dark.pixels().begin(), dark.pixels().end(), capture.black.pixels().begin());
}

TEST(RealBoard, DecodesTheReferenceCorners) {
  const std::filesystem::path folder = TestDataFolder() / "procam_gray_kamino";
  if (!std::filesystem::exists(folder / "reference_corners.txt"))
    GTEST_SKIP() << folder << " is absent; set STRATALUX_DATA to the folder of the test data";

  std::vector<Corner> corners;
  for (std::istringstream& line : Lines(folder / "reference_corners.txt")) {
    Corner c;
    double board_x = 0.0, board_y = 0.0;
    line >> c.pose >> board_x >> board_y >> c.camera.x() >> c.camera.y() >> c.projector.x() >> c.projector.y();
    corners.push_back(c);
  }
  for (std::istringstream& line : Lines(folder / "crops.txt")) {
    int pose = 0;
    Eigen::Vector2d crop;
    line >> pose >> crop.x() >> crop.y();
    Capture capture;
    ASSERT_NO_FATAL_FAILURE(ReadPose(folder, pose, capture));
    const auto report = DecodeGray(BoardInput(capture.frames, capture.black), kNoise, {.min_signal_fraction = 0.1});
    ASSERT_TRUE(report.ok()) << report.status().message();

    std::vector<double> errors;
    int wanted = 0;
    for (const Corner& c : corners) {
      if (c.pose != pose) continue;
      ++wanted;
      const auto at = LookUpProjectorPoint(report->map, c.camera - crop);
      if (at) errors.push_back((at->column_row - c.projector).norm());
    }
    ASSERT_GE(errors.size(), wanted * 0.9) << "pose " << pose;
    std::sort(errors.begin(), errors.end());
    std::cout << "pose " << pose << ": " << errors.size() << "/" << wanted << " corners, projector error median "
              << errors[errors.size() / 2] << " px, largest " << errors.back() << " px, decoded "
              << static_cast<double>(report->counts[0]) / static_cast<double>(report->map.reason.size()) << "\n";
    EXPECT_LE(errors[errors.size() / 2], 0.3) << "pose " << pose;
  }
}

// No dense truth exists. A board is plane, so that each projector coordinate is a smooth function of the camera's: a
// polynomial of degree 4, fitted robustly to what the bare comparison of each pair's frames says, is the referee. That
// comparison is whole columns; their rounding averages out over the board.
class Referee {
 public:
  Referee(const Image<float>& compared, const std::vector<size_t>& sites) : width_(compared.width()) {
    double scale_px = 50.0;
    for (int iteration = 0; iteration < 25; ++iteration) {
      Matrix normal = Matrix::Zero();
      Basis right = Basis::Zero();
      for (size_t i = 0; i < sites.size(); i += 7) {
        const Basis basis = At(sites[i]);
        const double value = compared.data()[sites[i]];
        const double off = iteration == 0 ? 0.0 : (value - basis.dot(coefficients_)) / scale_px;
        const double weight = 1.0 / std::pow(1.0 + off * off, 2);
        normal += weight * basis * basis.transpose();
        right += weight * value * basis;
      }
      coefficients_ = normal.ldlt().solve(right);
      scale_px = std::max(1.0, 0.7 * scale_px);
    }
  }
  [[nodiscard]] double operator()(size_t site) const { return At(site).dot(coefficients_); }

 private:
  static constexpr int kDegree = 4;
  static constexpr int kTerms = (kDegree + 1) * (kDegree + 2) / 2;
  using Basis = Eigen::Matrix<double, kTerms, 1>;
  using Matrix = Eigen::Matrix<double, kTerms, kTerms>;

  [[nodiscard]] Basis At(size_t site) const {
    constexpr double kHalf_px = 300.0;  // of a crop, about
    const double x = static_cast<double>(site % static_cast<size_t>(width_)) / kHalf_px - 1.0;
    const double y = static_cast<double>(site / static_cast<size_t>(width_)) / kHalf_px - 1.0;
    Basis basis;
    int term = 0;
    for (int i = 0; i <= kDegree; ++i)
      for (int j = 0; i + j <= kDegree; ++j) basis[term++] = std::pow(x, i) * std::pow(y, j);
    return basis;
  }
  int width_ = 0;
  Basis coefficients_ = Basis::Zero();
};

Image<float> Compared(const std::vector<CodedBit>& bits) {
  Image<float> values(bits[0].positive.width(), bits[0].positive.height());
  for (size_t site = 0; site < values.size(); ++site) {
    unsigned gray = 0;
    for (const CodedBit& bit : bits)
      gray = gray << 1 | (bit.positive.data()[site] > bit.inverse.data()[site] ? 1U : 0U);
    values.data()[site] = static_cast<float>(BinaryFromGray(gray));
  }
  return values;
}

// The rule that wants every bit beyond four standard deviations and 6 % of the contrast.
bool EveryBitIsCertain(const DecodeInput& input, size_t site) {
  const double signal = input.white.data()[site] - input.black.data()[site];
  for (const AxisCode* axis : {&input.columns, &input.rows})
    for (const CodedBit& bit : axis->bits) {
      const double positive = bit.positive.data()[site], inverse = bit.inverse.data()[site];
      const double sigma = std::sqrt(kNoise.VarianceDn2(positive) + kNoise.VarianceDn2(inverse));
      if (std::abs(positive - inverse) < std::max(4.0 * sigma, 0.06 * signal)) return false;
    }
  return true;
}

double Percentile(std::vector<double>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

enum class Inverses { kCaptured, kMissing };

class RealBoardSites : public testing::TestWithParam<Inverses> {};

TEST_P(RealBoardSites, AreKeptAndLieWhereTheBoardIs) {
  const std::filesystem::path folder = TestDataFolder() / "procam_gray_kamino";
  if (!std::filesystem::exists(folder / "crops.txt"))
    GTEST_SKIP() << folder << " is absent; set STRATALUX_DATA to the folder of the test data";
  for (int pose = 0; pose < kPoses; ++pose) {
    Capture capture;
    ASSERT_NO_FATAL_FAILURE(ReadPose(folder, pose, capture));
    DecodeInput input = BoardInput(capture.frames, capture.black);
    constexpr int kLit_dn = 40;  // white less black, as the data's own page has it
    std::vector<size_t> lit;
    for (size_t site = 0; site < capture.black.size(); ++site)
      if (static_cast<float>(input.white.data()[site]) - capture.black.data()[site] > kLit_dn) lit.push_back(site);
    const std::array<Referee, 2> referees = {Referee(Compared(input.columns.bits), lit),
                                             Referee(Compared(input.rows.bits), lit)};
    const auto certain = std::ranges::count_if(lit, [&](size_t site) { return EveryBitIsCertain(input, site); });
    if (GetParam() == Inverses::kMissing)
      for (AxisCode* axis : {&input.columns, &input.rows})
        for (CodedBit& bit : axis->bits) bit.inverse = {};
    const auto report = DecodeGray(input, kNoise, {.min_signal_fraction = 0.1});
    ASSERT_TRUE(report.ok()) << report.status().message();
    std::vector<double> errors;
    for (const size_t site : lit) {
      if (report->map.reason.data()[site] != 0) continue;
      errors.push_back(std::max(std::abs(report->map.column.data()[site] - referees[0](site)),
                                std::abs(report->map.row.data()[site] - referees[1](site))));
    }
    const double all = static_cast<double>(lit.size()), kept = static_cast<double>(errors.size()) / all;
    const double half = Percentile(errors, 0.5), most = Percentile(errors, 0.95);
    std::printf(
        "pose %d: %.4f of %.0f lit sites kept (%.3f by all bits certain); of both axes' errors the larger one: "
        "median %.3f px, 95 %% %.3f px, 99 %% %.3f px\n",
        pose, kept, all, static_cast<double>(certain) / all, half, most, Percentile(errors, 0.99));
    EXPECT_GE(kept, 0.95) << "pose " << pose;
    EXPECT_LE(half, 0.15) << "pose " << pose;
    EXPECT_LE(most, 0.5) << "pose " << pose;
    EXPECT_LT(static_cast<double>(certain), 0.8 * all) << "pose " << pose;  // else these boards prove nothing
  }
}

INSTANTIATE_TEST_SUITE_P(, RealBoardSites, testing::Values(Inverses::kCaptured, Inverses::kMissing),
                         [](const auto& with) {
                           return with.param == Inverses::kCaptured ? "AgainstInverses" : "AgainstWhiteAndBlack";
                         });

}  // namespace
}  // namespace stratalux::fit
