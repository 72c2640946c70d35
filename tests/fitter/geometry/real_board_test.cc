// SPDX-License-Identifier: Apache-2.0
// The public captures of a real projector and camera (procam-calibration, MIT): skipped where they are not installed.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include <gtest/gtest.h>

#include "fitter/structured_light/gray_decoder.h"
#include "fitter/structured_light/local_homography.h"
#include "shared/image/png.h"
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
    std::vector<Image<uint16_t>> frames;
    for (int k = 0; k < 42; ++k) {
      char name[32];
      std::snprintf(name, sizeof(name), "pose%d/g%02d.png", pose, k);
      auto frame = ReadPng(folder / name, nullptr);
      ASSERT_TRUE(frame.ok()) << frame.status().message();
      frames.push_back(std::move(frame).value());
    }
    Image<float> black(frames[41].width(), frames[41].height());
    std::copy(frames[41].pixels().begin(), frames[41].pixels().end(), black.pixels().begin());
    const SensorNoise noise{.saturation_dn = 255.0, .gain_e_per_dn = 40.0, .read_noise_dn = 1.0};
    const auto report = DecodeGray(BoardInput(frames, black), noise, {.min_signal_fraction = 0.1});
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

}  // namespace
}  // namespace stratalux::fit
