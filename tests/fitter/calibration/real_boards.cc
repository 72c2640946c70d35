// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/calibration/real_boards.h"

#include <cstdio>
#include <fstream>
#include <sstream>

#include "fitter/calibration/observe_board.h"
#include "fitter/structured_light/gray_decoder.h"
#include "shared/image/png.h"
#include "tests/support/test_data.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

Result<std::vector<Image<uint16_t>>> ReadPose(int pose) {
  std::vector<Image<uint16_t>> frames;
  for (int k = 0; k < 42; ++k) {
    char name[32];
    std::snprintf(name, sizeof name, "pose%d/g%02d.png", pose, k);
    SLX_ASSIGN_OR_RETURN(auto frame, ReadPng(RealBoardsFolder() / name, nullptr));
    frames.push_back(std::move(frame));
  }
  return frames;
}

// From the frames themselves: search, motion, decoding, look-up.
Result<PoseObservation> ObservePose(int pose, const Eigen::Vector2d& crop, const BoardDescription& board) {
  SLX_ASSIGN_OR_RETURN(const auto frames, ReadPose(pose));
  Image<float> black(frames[41].width(), frames[41].height()), twice = black;
  Image<uint16_t> codes(black.width(), black.height());
  for (size_t i = 0; i < black.size(); ++i) {
    black.pixels()[i] = frames[41].pixels()[i];
    twice.pixels()[i] = 2.0F * black.pixels()[i];
    codes.pixels()[i] = static_cast<uint16_t>(frames[38].pixels()[i] + frames[39].pixels()[i]);
  }
  std::vector<ProjectorPictures> pictures(1);
  pictures[0].white_light = BoardLight(frames[40], black, Cfa::kMono);
  pictures[0].codes_light = BoardLight(codes, twice, Cfa::kMono);
  pictures[0].saturated = Image<uint8_t>(black.width(), black.height());
  PoseObservation observation{pose, "pose " + std::to_string(pose), {}};
  SLX_ASSIGN_OR_RETURN(const auto corners, FindStillBoard(pictures, board));

  DecodeInput input{.white = frames[40].view(), .black = black};
  input.columns.count = 1024;
  input.rows.count = 1024;
  for (size_t bit = 0; bit < 10; ++bit) {
    input.columns.bits.push_back({frames[2 * bit].view(), frames[2 * bit + 1].view()});
    input.rows.bits.push_back({frames[20 + 2 * bit].view(), frames[21 + 2 * bit].view()});
  }
  SLX_ASSIGN_OR_RETURN(const auto decoded,
                       DecodeGray(input, {.saturation_dn = 255.0, .gain_e_per_dn = 20.0, .read_noise_dn = 1.0}));
  SLX_ASSIGN_OR_RETURN(const auto seen, LookUpCorners(decoded.map, corners, {1024, 1024}));
  if (!seen.seen) return Status::Failed(observation.name + ": too few corners in the projector's light");
  for (size_t i = 0; i < corners.size(); ++i)
    observation.corners.push_back({corners[i].corner, corners[i].pixel_px + crop, {seen.column_row[i]}});
  return observation;
}

}  // namespace

fs::path RealBoardsFolder() { return TestDataFolder() / "procam_gray_kamino"; }

Result<CalibrationObservations> ObserveRealBoards() {
  CalibrationObservations observations{{BoardKind::kChess, 10, 8, 75.0, 0.0}, {1280, 1024}, {{1024, 768}}, {}};
  std::ifstream in(RealBoardsFolder() / "crops.txt");
  for (std::string line; std::getline(in, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream text(line);
    int pose = 0;
    Eigen::Vector2d crop;
    text >> pose >> crop.x() >> crop.y();
    SLX_ASSIGN_OR_RETURN(auto observed, ObservePose(pose, crop, observations.board));
    observations.poses.push_back(std::move(observed));
  }
  return observations;
}

}  // namespace stratalux::fit
