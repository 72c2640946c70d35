// SPDX-License-Identifier: Apache-2.0
#include "fitter/motion/carried.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "fitter/reconstruction/one_surface.h"
#include "shared/base/median.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

struct Corner {
  int x = 0, y = 0;
  float weight = 0.0F;
};

// Around a place in a map of that size.
struct Neighbours {
  int nearest_x = 0, nearest_y = 0;
  std::array<Corner, 4> corners;
  bool all = false;  // the four lie within the map
};

std::optional<Neighbours> Around(float x, float y, int width, int height) {
  if (!std::isfinite(x) || !std::isfinite(y)) return std::nullopt;
  Neighbours n;
  n.nearest_x = static_cast<int>(std::lround(x));
  n.nearest_y = static_cast<int>(std::lround(y));
  if (n.nearest_x < 0 || n.nearest_y < 0 || n.nearest_x >= width || n.nearest_y >= height) return std::nullopt;
  const int left = static_cast<int>(std::floor(x)), top = static_cast<int>(std::floor(y));
  const float a = x - static_cast<float>(left), b = y - static_cast<float>(top);
  for (int k = 0; k < 4; ++k)
    n.corners[static_cast<size_t>(k)] = {left + k % 2, top + k / 2,
                                         (k % 2 == 0 ? 1.0F - a : a) * (k / 2 == 0 ? 1.0F - b : b)};
  n.all = left >= 0 && top >= 0 && left + 1 < width && top + 1 < height;
  return n;
}

template <typename Work>
void ForRows(int height, const Work& work) {
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) work(y);
  });
}

float Between(const Image<float>& map, const Neighbours& n, int c = 0) {
  float sum = 0.0F;
  for (const Corner& corner : n.corners) sum += corner.weight * map(corner.x, corner.y, c);
  return sum;
}

// How much codes of one surface may differ from site to site: as much as those of most of it do, times what the
// steepest surface makes of that (one_surface.h).
float MostStep(const Image<float>& codes) {
  std::vector<double> steps;
  constexpr int kStride = 7;
  for (int y = 0; y + 1 < codes.height(); y += kStride)
    for (int x = 0; x + 1 < codes.width(); x += kStride)
      if (const float across = codes(x + 1, y) - codes(x, y), down = codes(x, y + 1) - codes(x, y);
          std::isfinite(across) && std::isfinite(down))
        steps.push_back(std::max(std::abs(across), std::abs(down)));
  return static_cast<float>((1.0 + kMaxSlope) * Median(std::move(steps)));
}

bool Alike(const Image<float>& codes, const Neighbours& n, float most) {
  const float here = codes(n.nearest_x, n.nearest_y);
  for (const Corner& corner : n.corners)
    if (std::abs(codes(corner.x, corner.y) - here) > most) return false;
  return true;
}

Image<float> CarriedQuads(const Image<float>& map, const Image<float>& places) {
  Image<float> carried(map.width(), map.height(), map.channels(), std::nanf(""));
  ForRows(map.height(), [&](int y) {
    for (int x = 0; x < map.width(); ++x) {
      const auto n = Around(places(x, y, 0), places(x, y, 1), map.width(), map.height());
      if (!n) continue;
      for (int c = 0; c < map.channels(); ++c) {
        const float between = n->all ? Between(map, *n, c) : std::nanf("");
        carried(x, y, c) = std::isfinite(between) ? between : map(n->nearest_x, n->nearest_y, c);
      }
    }
  });
  return carried;
}

template <typename Value>
Image<Value> Nearest(const Image<Value>& map, const Image<float>& places, Value none) {
  Image<Value> carried(map.width(), map.height(), 1, none);
  ForRows(map.height(), [&](int y) {
    for (int x = 0; x < map.width(); ++x)
      if (const auto n = Around(places(x, y, 0), places(x, y, 1), map.width(), map.height()))
        carried(x, y) = map(n->nearest_x, n->nearest_y);
  });
  return carried;
}

}  // namespace

DecodedMap Carried(const DecodedMap& map, const Image<float>& places, Cfa cfa) {
  const int width = map.reason.width(), height = map.reason.height(), step = QuadStep(cfa);
  const Image<float> nothing(width, height, 1, std::nanf(""));
  DecodedMap carried{nothing, nothing, nothing, nothing,
                     Image<uint8_t>(width, height, 1, static_cast<uint8_t>(DecodeReason::kOutside))};
  const auto valid = [&](int x, int y) { return map.reason(x, y) == static_cast<uint8_t>(DecodeReason::kValid); };
  const std::array fields = {&DecodedMap::column, &DecodedMap::row, &DecodedMap::column_sigma, &DecodedMap::row_sigma};
  const std::array codes = {std::pair(&map.column, MostStep(map.column)), std::pair(&map.row, MostStep(map.row))};
  ForRows(step * places.height(), [&](int y) {
    for (int x = 0; x < step * places.width(); ++x) {
      const int i = x / step, j = y / step;
      const float across = places(i, j, 0) - static_cast<float>(i), down = places(i, j, 1) - static_cast<float>(j);
      const auto n = Around(static_cast<float>(x) + static_cast<float>(step) * across,
                            static_cast<float>(y) + static_cast<float>(step) * down, width, height);
      if (!n) continue;
      bool between = n->all;
      for (const Corner& corner : n->corners) between = between && valid(corner.x, corner.y);
      for (const auto& [of, most] : codes)
        between = between && (!std::isfinite((*of)(n->nearest_x, n->nearest_y)) || Alike(*of, *n, most));
      for (const auto field : fields)
        (carried.*field)(x, y) = between ? Between(map.*field, *n) : (map.*field)(n->nearest_x, n->nearest_y);
      carried.reason(x, y) = map.reason(n->nearest_x, n->nearest_y);
    }
  });
  return carried;
}

SeparationMap Carried(const SeparationMap& map, const Image<float>& places) {
  return {CarriedQuads(map.direct, places), CarriedQuads(map.global, places), CarriedQuads(map.direct_variance, places),
          CarriedQuads(map.white, places), Nearest(map.reason, places, static_cast<uint8_t>(SeparationReason::kUnlit))};
}

Image<uint8_t> Carried(const Image<uint8_t>& mask, const Image<float>& places) {
  return Nearest(mask, places, uint8_t{0});
}

std::vector<int64_t> CarriedProfiles(const Image<float>& places, int pool, int channels) {
  const int width = places.width() / pool, height = places.height() / pool;
  std::vector<int64_t> which(static_cast<size_t>(width) * static_cast<size_t>(height) * static_cast<size_t>(channels),
                             -1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      double across = 0.0, down = 0.0;
      int known = 0;
      for (int b = 0; b < pool; ++b)
        for (int a = 0; a < pool; ++a) {
          const int i = pool * x + a, j = pool * y + b;
          if (!std::isfinite(places(i, j, 0)) || !std::isfinite(places(i, j, 1))) continue;
          across += double{places(i, j, 0)} - i;
          down += double{places(i, j, 1)} - j;
          ++known;
        }
      if (known == 0) continue;
      const auto from_x = std::lround(x + across / known / pool), from_y = std::lround(y + down / known / pool);
      if (from_x < 0 || from_y < 0 || from_x >= width || from_y >= height) continue;
      for (int c = 0; c < channels; ++c)
        which[static_cast<size_t>((int64_t{y} * width + x) * channels + c)] =
            (int64_t{from_y} * width + from_x) * channels + c;
    }
  return which;
}

}  // namespace stratalux::fit
