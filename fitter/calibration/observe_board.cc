// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/observe_board.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "fitter/structured_light/local_homography.h"
#include "shared/base/formatted.h"
#include "shared/base/median.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {
namespace {

constexpr int kSaturationReach = 10;  // sites about a corner that are looked at

double SaturatedShare(const Image<uint8_t>& saturated, const std::vector<BoardCorner>& corners) {
  int64_t all = 0, bad = 0;
  for (const BoardCorner& corner : corners) {
    const int cx = static_cast<int>(std::lround(corner.pixel_px.x()));
    const int cy = static_cast<int>(std::lround(corner.pixel_px.y()));
    for (int y = cy - kSaturationReach; y <= cy + kSaturationReach; ++y)
      for (int x = cx - kSaturationReach; x <= cx + kSaturationReach; ++x) {
        if (!saturated.contains(x, y)) continue;
        ++all;
        bad += saturated(x, y) != 0;
      }
  }
  return all > 0 ? static_cast<double>(bad) / static_cast<double>(all) : 0.0;
}

double SaturatedShare(const Image<uint8_t>& saturated) {
  int64_t bad = 0;
  for (uint8_t v : saturated.pixels()) bad += v != 0;
  return static_cast<double>(bad) / static_cast<double>(std::max<size_t>(saturated.size(), 1));
}

// Median distance between the same corners in two pictures. A chessboard's corners may come in the opposite order.
double Motion(const std::vector<BoardCorner>& before, const std::vector<BoardCorner>& after) {
  std::map<int, Eigen::Vector2d> at;
  for (const BoardCorner& corner : after) at[corner.corner] = corner.pixel_px;
  std::vector<double> same, turned;
  const int last = static_cast<int>(after.size()) - 1;
  for (const BoardCorner& corner : before) {
    if (const auto found = at.find(corner.corner); found != at.end())
      same.push_back((found->second - corner.pixel_px).norm());
    if (const auto found = at.find(last - corner.corner); found != at.end())
      turned.push_back((found->second - corner.pixel_px).norm());
  }
  if (same.empty()) return std::numeric_limits<double>::infinity();
  const double moved = Median(same);
  return turned.size() < same.size() ? moved : std::min(moved, Median(turned));
}

Status CheckStill(const std::string& what, const Image<float>& picture, const std::vector<BoardCorner>& corners,
                  const BoardDescription& board, const ObserveOptions& options) {
  const auto there = FindBoard(picture, board);
  // Alone, a picture may be too dark for the search; the lookup of its projector's corners will tell.
  if (!there.ok()) return Status::Ok();
  const double moved = Motion(*there, corners);
  if (moved <= options.max_motion_px) return Status::Ok();
  return Status::Failed("the board moved by " + Formatted("%.2f", moved) + " px (" + what +
                        " against all pictures of the pose); fix it and capture this pose again");
}

DecodedMap WithInverted(const DecodedMap& map, PatternAxis axis, const DeviceSize& size) {
  DecodedMap other = map;
  const int count = axis == PatternAxis::kColumns ? size.width : size.height;
  const unsigned mask = (1U << GrayBits(count)) - 1U;
  Image<float>& values = axis == PatternAxis::kColumns ? other.column : other.row;
  for (float& v : values.pixels())
    if (std::isfinite(v)) {
      const auto cell = static_cast<unsigned>(std::lround(std::max(v, 0.0F)));
      v = static_cast<float>(BinaryFromGray(~GrayFromBinary(cell) & mask));
    }
  return other;
}

ProjectorCorners LookUp(const DecodedMap& map, const std::vector<BoardCorner>& corners, const ObserveOptions& options) {
  ProjectorCorners result;
  int found = 0;
  for (const BoardCorner& corner : corners) {
    const auto at = LookUpProjectorPoint(map, corner.pixel_px);
    result.column_row.push_back(at ? std::optional(at->column_row) : std::nullopt);
    found += at.has_value();
  }
  result.seen = found >= options.min_projector_corners * static_cast<double>(corners.size());
  return result;
}

}  // namespace

Image<float> BoardLight(ImageView<const uint16_t> lit, ImageView<const float> dark, Cfa cfa) {
  Image<float> light(lit.width(), lit.height());
  std::array<double, 3> sum{};
  std::array<int64_t, 3> count{};
  for (int y = 0; y < lit.height(); ++y)
    for (int x = 0; x < lit.width(); ++x) {
      light(x, y) = static_cast<float>(lit(x, y)) - dark(x, y);
      const int colour = CfaColour(cfa, x, y);
      sum[colour] += light(x, y);
      ++count[colour];
    }
  if (cfa == Cfa::kMono) return light;
  std::array<float, 3> gain{1.0F, 1.0F, 1.0F};
  for (int c : {0, 2})
    if (sum[c] > 0.0 && sum[1] > 0.0)
      gain[c] = static_cast<float>(sum[1] / static_cast<double>(count[1]) / (sum[c] / static_cast<double>(count[c])));
  for (int y = 0; y < lit.height(); ++y)
    for (int x = 0; x < lit.width(); ++x) light(x, y) *= gain[CfaColour(cfa, x, y)];
  return light;
}

Result<std::vector<BoardCorner>> FindStillBoard(const std::vector<ProjectorPictures>& pictures,
                                                const BoardDescription& board, const ObserveOptions& options) {
  if (pictures.empty()) return Status::NotFound("no projector lit the board");
  Image<float> all = pictures[0].white_light;
  for (size_t i = 1; i < pictures.size(); ++i)
    for (size_t s = 0; s < all.size(); ++s) all.pixels()[s] += pictures[i].white_light.pixels()[s];
  auto corners = FindBoard(all, board);
  if (!corners.ok()) {
    for (const ProjectorPictures& p : pictures)
      if (const double share = SaturatedShare(p.saturated); share > options.max_saturated)
        return Status(corners.status().code(), corners.status().message() + "; " + Formatted("%.0f", 100.0 * share) +
                                                   " % of projector " + std::to_string(p.projector) +
                                                   "'s white frame is saturated: shorten the exposure");
    return corners.status();
  }
  const auto least = static_cast<size_t>(std::max<double>(options.min_corners * board.corners(), kLeastCorners));
  if (corners->size() < least)
    return Status::NotFound("only " + std::to_string(corners->size()) + " of the board's " +
                            std::to_string(board.corners()) + " corners were found; show more of it");
  for (const ProjectorPictures& p : pictures) {
    const std::string name = "projector " + std::to_string(p.projector);
    if (const double share = SaturatedShare(p.saturated, *corners); share > options.max_saturated)
      return Status::Failed(Formatted("%.0f", 100.0 * share) + " % of the board is saturated in the white of " + name +
                            "; shorten the exposure and capture this pose again");
    SLX_RETURN_IF_ERROR(CheckStill(name + ", white", p.white_light, *corners, board, options));
    if (!p.codes_light.empty())
      SLX_RETURN_IF_ERROR(CheckStill(name + ", after its codes", p.codes_light, *corners, board, options));
  }
  return corners;
}

Result<ProjectorCorners> LookUpCorners(const DecodedMap& map, const std::vector<BoardCorner>& corners,
                                       const DeviceSize& projector, const ObserveOptions& options) {
  ProjectorCorners result = LookUp(map, corners, options);
  if (result.seen) return result;
  // An inverted code scrambles the columns so that no homography fits; put right, it does.
  for (const auto& [axis, name] : {std::pair{PatternAxis::kColumns, "column"}, std::pair{PatternAxis::kRows, "row"}}) {
    const DecodedMap other = WithInverted(map, axis, projector);
    const DecodedMap both = WithInverted(other, PatternAxis::kRows, projector);
    const bool alone = LookUp(other, corners, options).seen;
    if (alone || (axis == PatternAxis::kColumns && LookUp(both, corners, options).seen))
      return Status::Failed("the " + std::string(alone ? name : "column and row") +
                            " codes come inverted (each frame shows its inverse); check the pattern memory and the "
                            "projector's polarity setting, then capture again");
  }
  return result;
}

}  // namespace stratalux::fit
