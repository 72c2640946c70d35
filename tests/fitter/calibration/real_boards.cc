// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/calibration/real_boards.h"

#include <algorithm>
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

struct PoseFrames {
  int pose = 0;
  Eigen::Vector2d crop_px;
  std::vector<Image<uint16_t>> frames;
  Image<float> black;
};

Result<PoseFrames> ReadFrames(int pose, const Eigen::Vector2d& crop_px) {
  PoseFrames read{pose, crop_px, {}, {}};
  SLX_ASSIGN_OR_RETURN(read.frames, ReadPose(pose));
  read.black = Image<float>(read.frames[41].width(), read.frames[41].height());
  std::ranges::copy(read.frames[41].pixels(), read.black.pixels().begin());
  return read;
}

Result<DecodedMap> Decode(const PoseFrames& pose) {
  const auto& frames = pose.frames;
  DecodeInput input{.white = frames[40].view(), .black = pose.black};
  input.columns.count = 1024;
  input.rows.count = 1024;
  for (size_t bit = 0; bit < 10; ++bit) {
    input.columns.bits.push_back({frames[2 * bit].view(), frames[2 * bit + 1].view()});
    input.rows.bits.push_back({frames[20 + 2 * bit].view(), frames[21 + 2 * bit].view()});
  }
  SLX_ASSIGN_OR_RETURN(auto decoded,
                       DecodeGray(input, {.saturation_dn = 255.0, .gain_e_per_dn = 20.0, .read_noise_dn = 1.0}));
  return std::move(decoded.map);
}

// From the frames themselves: search, motion, decoding, look-up.
Result<PoseObservation> ObservePose(const PoseFrames& pose, const BoardDescription& board) {
  const auto& frames = pose.frames;
  Image<float> twice = pose.black;
  Image<uint16_t> codes(twice.width(), twice.height());
  for (size_t i = 0; i < twice.size(); ++i) {
    twice.pixels()[i] *= 2.0F;
    codes.pixels()[i] = static_cast<uint16_t>(frames[38].pixels()[i] + frames[39].pixels()[i]);
  }
  std::vector<ProjectorPictures> pictures(1);
  pictures[0].white_light = BoardLight(frames[40], pose.black, Cfa::kMono);
  pictures[0].codes_light = BoardLight(codes, twice, Cfa::kMono);
  pictures[0].saturated = Image<uint8_t>(twice.width(), twice.height());
  PoseObservation observation{pose.pose, "pose " + std::to_string(pose.pose), {}};
  SLX_ASSIGN_OR_RETURN(const auto corners, FindStillBoard(pictures, board));
  SLX_ASSIGN_OR_RETURN(const auto decoded, Decode(pose));
  SLX_ASSIGN_OR_RETURN(const auto seen, LookUpCorners(decoded, corners, {1024, 1024}));
  if (!seen.seen) return Status::Failed(observation.name + ": too few corners in the projector's light");
  for (size_t i = 0; i < corners.size(); ++i)
    observation.corners.push_back({corners[i].corner, corners[i].pixel_px + pose.crop_px, {seen.column_row[i]}});
  return observation;
}

template <typename Each>
Status EachPose(const Each& each) {
  std::ifstream in(RealBoardsFolder() / "crops.txt");
  for (std::string line; std::getline(in, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream text(line);
    int pose = 0;
    Eigen::Vector2d crop;
    text >> pose >> crop.x() >> crop.y();
    SLX_ASSIGN_OR_RETURN(const auto frames, ReadFrames(pose, crop));
    SLX_RETURN_IF_ERROR(each(frames));
  }
  return Status::Ok();
}

}  // namespace

fs::path RealBoardsFolder() { return TestDataFolder() / "procam_gray_kamino"; }

Result<CalibrationObservations> ObserveRealBoards() {
  CalibrationObservations observations{{BoardKind::kChess, 10, 8, 75.0, 0.0}, {1280, 1024}, {{1024, 768}}, {}};
  SLX_RETURN_IF_ERROR(EachPose([&](const PoseFrames& pose) -> Status {
    SLX_ASSIGN_OR_RETURN(auto observed, ObservePose(pose, observations.board));
    observations.poses.push_back(std::move(observed));
    return Status::Ok();
  }));
  return observations;
}

Result<std::vector<DecodedBoard>> DecodeRealBoards() {
  std::vector<DecodedBoard> boards;
  SLX_RETURN_IF_ERROR(EachPose([&](const PoseFrames& pose) -> Status {
    DecodedBoard board{pose.crop_px, {}, Image<uint8_t>(pose.black.width(), pose.black.height())};
    SLX_ASSIGN_OR_RETURN(board.map, Decode(pose));
    for (size_t i = 0; i < board.lit.size(); ++i)
      board.lit.pixels()[i] = static_cast<float>(pose.frames[40].pixels()[i]) - pose.black.pixels()[i] > 40.0F ? 1 : 0;
    boards.push_back(std::move(board));
    return Status::Ok();
  }));
  return boards;
}

}  // namespace stratalux::fit
