// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/em_kernel.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "fitter/mixture/em_kernel.cc"
#include "fitter/mixture/highway_targets.h"
// After the targets:
#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace stratalux::fit {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<float, kEmLanes>;
using V = hn::Vec<D>;

// A Gaussian runs through a tile of cells by recurrence from exact values at its first cell. The first value must not
// underflow where the peak lies further on: the narrower the layer, the smaller the tile.
struct TileSize {
  int cells;                      // a power of two
  float least_sigma, most_sigma;  // cells
};
constexpr float kUnbounded = std::numeric_limits<float>::max();
constexpr TileSize kTileSizes[] = {{4, 0.0F, 1.3F}, {8, 1.3F, 5.2F}, {32, 5.2F, kUnbounded}};
constexpr float kReach = 5.2F;  // standard deviations; beyond lie 2e-7 of a layer

enum Value { kHeight, kMean, kCurvature, kRatioM1, kReachCells, kSum0, kSum1, kSum2, kValues };

int TilesOf(const EmGrid& grid, int tile) { return (grid.cells + tile - 1) / tile; }

// Index of the tile of coordinate z; wrapped grids repeat theirs on either side. Outside: held to the nearest.
int TileAt(const EmGrid& grid, int tile, float z) {
  const int tiles = TilesOf(grid, tile);
  const float cells = static_cast<float>(grid.cells);
  const int cell = static_cast<int>(std::clamp(z, -cells, 2.0F * cells) + cells) - grid.cells;  // rounded down
  int image = 0;
  if (cell < 0) image = -1;
  if (cell >= grid.cells) image = cell >= 2 * grid.cells ? 2 : 1;
  const int at = image * tiles + ((cell - image * grid.cells) >> std::countr_zero(static_cast<unsigned>(tile)));
  return grid.wrapped ? std::clamp(at, -tiles, 2 * tiles - 1) : std::clamp(at, 0, tiles - 1);
}

// Layers that some lane of this part holds at this tile size.
void FindItems(const EmGrid& grid, const LayersOnGrid& layers, int lane, const TileSize& size, LayerTiles::Part& part) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  const V far = hn::Set(d, 1e9F);
  for (int l = 0; l < layers.layers; ++l) {
    const int at = l * kEmLanes + lane;
    const V weight = hn::Load(d, layers.weight + at), sigma = hn::Load(d, layers.sigma + at);
    const auto in = hn::And(hn::Gt(weight, hn::Zero(d)), hn::And(hn::Ge(sigma, hn::Set(d, size.least_sigma)),
                                                                 hn::Lt(sigma, hn::Set(d, size.most_sigma))));
    if (hn::AllFalse(d, in)) continue;
    const V mean = hn::Load(d, layers.mean + at), reach = hn::Mul(sigma, hn::Set(d, kReach));
    const float low = hn::GetLane(hn::MinOfLanes(d, hn::IfThenElse(in, hn::Sub(mean, reach), far)));
    const float high = hn::GetLane(hn::MaxOfLanes(d, hn::IfThenElse(in, hn::Add(mean, reach), hn::Neg(far))));
    const V inverse = hn::Div(hn::Set(d, 1.0F), sigma);
    const V curvature = hn::Mul(inverse, inverse);
    const size_t item = part.items.size();
    part.items.push_back({l, TileAt(grid, size.cells, low), TileAt(grid, size.cells, high)});
    if (part.values.size() < (item + 1) * kValues * n) part.values.resize((item + 1) * kValues * n);
    float* values = part.values.data() + item * kValues * n;
    hn::Store(hn::IfThenElseZero(in, hn::Mul(hn::Mul(weight, inverse), hn::Set(d, 0.398942280F))), d,
              values + kHeight * n);
    hn::Store(mean, d, values + kMean * n);
    hn::Store(curvature, d, values + kCurvature * n);
    // Held as ratio - 1: near 1 the ratio itself would round to a visibly different width.
    hn::Store(hn::Expm1(d, hn::Neg(curvature)), d, values + kRatioM1 * n);
    hn::Store(hn::IfThenElse(in, reach, hn::Neg(far)), d, values + kReachCells * n);  // the others meet no tile
    for (int sum = kSum0; sum <= kSum2; ++sum) hn::Store(hn::Zero(d), d, values + sum * n);
  }
}

// The tiles of one size and, of the items from `first` on, those that meet each. The order (tile in memory, image,
// item) is the same whatever else the block holds: sums must not depend on that.
void FindEntries(const EmGrid& grid, int tile, int first, LayerTiles::Part& part) {
  const int tiles = TilesOf(grid, tile), images = grid.wrapped ? 1 : 0;
  part.met.assign(size_t(3) * tiles, 0);
  int low = part.items[first].first, high = part.items[first].last;
  for (size_t i = first; i < part.items.size(); ++i) {
    low = std::min(low, part.items[i].first);
    high = std::max(high, part.items[i].last);
    for (int at = part.items[i].first; at <= part.items[i].last; ++at) part.met[at + tiles] |= 1U << (i - first);
  }
  // In memory the tiles from low to high are one run, or two.
  const bool all = high - low + 1 >= tiles;
  const int begin = all ? 0 : (low + tiles) % tiles, end = all ? tiles - 1 : (high + tiles) % tiles;
  for (int t = begin <= end ? begin : 0; t < tiles; ++t) {
    if (t == end + 1) {
      if (begin <= end) break;
      t = std::max(t, begin);
    }
    const int cell = t * tile, before = static_cast<int>(part.entries.size());
    for (int image = -images; image <= images; ++image)
      for (uint32_t met = part.met[(image + 1) * tiles + t]; met != 0; met &= met - 1)
        part.entries.push_back({first + std::countr_zero(met), static_cast<float>(image * grid.cells + cell)});
    const int found = static_cast<int>(part.entries.size()) - before;
    if (found > 0) part.tiles.push_back({cell, std::min(tile, grid.cells - cell), before, found});
  }
}

// e^x for |x| <= 87, relative error 2e-7 (1 + |x| / 4): 2^n times a polynomial of the remainder. Enough here, at half
// the cost of the library's.
HWY_INLINE V ShortExp(V x) {
  const D d;
  const hn::RebindToSigned<D> di;
  const V t = hn::Mul(x, hn::Set(d, 1.442695041F));
  const V n = hn::Round(t), f = hn::Sub(t, n);
  V p = hn::MulAdd(hn::Set(d, 1.54653e-4F), f, hn::Set(d, 1.339887e-3F));
  p = hn::MulAdd(p, f, hn::Set(d, 9.618130e-3F));
  p = hn::MulAdd(p, f, hn::Set(d, 5.5503324e-2F));
  p = hn::MulAdd(p, f, hn::Set(d, 2.40226507e-1F));
  p = hn::MulAdd(p, f, hn::Set(d, 6.93147181e-1F));
  p = hn::MulAdd(p, f, hn::Set(d, 1.0F));
  const auto power = hn::ShiftLeft<23>(hn::ConvertTo(di, n));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), power));
}

// N(z + 1) / N(z) = exp(-((z - mu) + 1/2) / sigma^2), itself falling by exp(-1 / sigma^2) a cell. Lanes that the tile
// lies beyond the reach of start, and stay, at 0.
void FindStarts(LayerTiles::Part& part) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  if (part.starts.size() < part.entries.size() * 2 * n) part.starts.resize(part.entries.size() * 2 * n);
  for (const LayerTiles::Tile& tile : part.tiles) {
    const V half = hn::Set(d, 0.5F * static_cast<float>(tile.cells - 1));
    for (int e = tile.first_entry; e < tile.first_entry + tile.entries; ++e) {
      const float* values = part.values.data() + size_t(part.entries[e].item) * kValues * n;
      const V z = hn::Sub(hn::Set(d, part.entries[e].z), hn::Load(d, values + kMean * n));
      const auto near = hn::Le(hn::Abs(hn::Add(z, half)), hn::Add(hn::Load(d, values + kReachCells * n), half));
      const V slope = hn::IfThenElseZero(near, hn::Mul(z, hn::Load(d, values + kCurvature * n)));
      const V g = ShortExp(hn::Mul(hn::Mul(slope, z), hn::Set(d, -0.5F)));
      const V r = ShortExp(hn::Neg(hn::MulAdd(hn::Load(d, values + kCurvature * n), hn::Set(d, 0.5F), slope)));
      float* start = part.starts.data() + size_t(e) * 2 * n;
      hn::Store(hn::IfThenElseZero(near, hn::Mul(hn::Load(d, values + kHeight * n), g)), d, start);
      hn::Store(hn::IfThenElseZero(near, r), d, start + n);
    }
  }
}

// Up to four entries of a tile at once: independent recurrences hide each other's latency.
template <int kEntries>
HWY_INLINE void AddEntries(const LayerTiles::Part& part, int entry, int cells, float* HWY_RESTRICT mass) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  V g[kEntries], r[kEntries], ratio_m1[kEntries];
  for (int k = 0; k < kEntries; ++k) {
    const float* start = part.starts.data() + size_t(entry + k) * 2 * n;
    g[k] = hn::Load(d, start);
    r[k] = hn::Load(d, start + n);
    ratio_m1[k] = hn::Load(d, part.values.data() + (size_t(part.entries[entry + k].item) * kValues + kRatioM1) * n);
  }
  for (int j = 0; j < cells; ++j, mass += kEmLanes) {
    V sum = hn::Load(d, mass);
    for (int k = 0; k < kEntries; ++k) {
      sum = hn::Add(sum, g[k]);
      g[k] = hn::Mul(g[k], r[k]);
      r[k] = hn::MulAdd(r[k], ratio_m1[k], r[k]);
    }
    hn::Store(sum, d, mass);
  }
}

// Sums of c, of the running sum, and of that one's: at the tile's end they hold the moments about the cell behind it,
// in three operations a cell.
template <int kEntries>
HWY_INLINE void EntryMoments(LayerTiles::Part& part, int entry, int cells, const float* HWY_RESTRICT q) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  V g[kEntries], r[kEntries], ratio_m1[kEntries], s0[kEntries], s1[kEntries], s2[kEntries];
  for (int k = 0; k < kEntries; ++k) {
    const float* start = part.starts.data() + size_t(entry + k) * 2 * n;
    g[k] = hn::Load(d, start);
    r[k] = hn::Load(d, start + n);
    ratio_m1[k] = hn::Load(d, part.values.data() + (size_t(part.entries[entry + k].item) * kValues + kRatioM1) * n);
    s0[k] = s1[k] = s2[k] = hn::Zero(d);
  }
  for (int j = 0; j < cells; ++j, q += kEmLanes) {
    const V ratio = hn::Load(d, q);
    for (int k = 0; k < kEntries; ++k) {
      s0[k] = hn::MulAdd(g[k], ratio, s0[k]);
      g[k] = hn::Mul(g[k], r[k]);
      r[k] = hn::MulAdd(r[k], ratio_m1[k], r[k]);
      s1[k] = hn::Add(s1[k], s0[k]);
      s2[k] = hn::Add(s2[k], s1[k]);
    }
  }
  for (int k = 0; k < kEntries; ++k) {
    // With j cells from the end: s1 = sum c j, s2 = sum c j (j + 1) / 2.
    float* values = part.values.data() + size_t(part.entries[entry + k].item) * kValues * n;
    const V end =
        hn::Sub(hn::Set(d, part.entries[entry + k].z + static_cast<float>(cells)), hn::Load(d, values + kMean * n));
    const V squares = hn::Sub(hn::Add(s2[k], s2[k]), s1[k]);
    const V first = hn::MulSub(end, s0[k], s1[k]);
    const V second = hn::MulAdd(end, hn::Sub(first, s1[k]), squares);
    hn::Store(hn::Add(hn::Load(d, values + kSum0 * n), s0[k]), d, values + kSum0 * n);
    hn::Store(hn::Add(hn::Load(d, values + kSum1 * n), first), d, values + kSum1 * n);
    hn::Store(hn::Add(hn::Load(d, values + kSum2 * n), second), d, values + kSum2 * n);
  }
}

// Registers hold this many entries' recurrences and sums.
constexpr int kAtOnce = HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_NEON ? 4 : 2;

void AddLayers(const EmGrid& grid, const LayersOnGrid& layers, LayerTiles& tiles, float* HWY_RESTRICT mass) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  std::memset(mass, 0, sizeof(float) * kEmLanes * static_cast<size_t>(grid.cells));
  for (int lane = 0; lane < kEmLanes; lane += n) {
    LayerTiles::Part& part = tiles.parts[lane / n];
    part.items.clear();
    part.entries.clear();
    part.tiles.clear();
    for (const TileSize& size : kTileSizes) {
      const int first = static_cast<int>(part.items.size());
      FindItems(grid, layers, lane, size, part);
      if (static_cast<int>(part.items.size()) > first) FindEntries(grid, size.cells, first, part);
    }
    FindStarts(part);
    for (const LayerTiles::Tile& tile : part.tiles) {
      tiles.evaluated_ += int64_t{tile.cells} * tile.entries * n;
      float* at = mass + size_t(tile.cell) * kEmLanes + lane;
      int entry = tile.first_entry;
      const int last = entry + tile.entries;
      for (; entry + 4 <= last; entry += 4) AddEntries<4>(part, entry, tile.cells, at);
      if (entry + 2 <= last) {
        AddEntries<2>(part, entry, tile.cells, at);
        entry += 2;
      }
      if (entry < last) AddEntries<1>(part, entry, tile.cells, at);
    }
  }
}

void LayerMoments(const LayersOnGrid& layers, LayerTiles& tiles, const float* HWY_RESTRICT q,
                  float* HWY_RESTRICT moments) {
  const D d;
  const int n = static_cast<int>(hn::Lanes(d));
  std::memset(moments, 0, sizeof(float) * 3 * kEmLanes * static_cast<size_t>(layers.layers));
  for (int lane = 0; lane < kEmLanes; lane += n) {
    LayerTiles::Part& part = tiles.parts[lane / n];
    for (const LayerTiles::Tile& tile : part.tiles) {
      const float* at = q + size_t(tile.cell) * kEmLanes + lane;
      int entry = tile.first_entry;
      const int last = entry + tile.entries;
      for (; entry + kAtOnce <= last; entry += kAtOnce) EntryMoments<kAtOnce>(part, entry, tile.cells, at);
      if (kAtOnce > 2 && entry + 2 <= last) {
        EntryMoments<2>(part, entry, tile.cells, at);
        entry += 2;
      }
      if (entry < last) EntryMoments<1>(part, entry, tile.cells, at);
    }
    for (size_t i = 0; i < part.items.size(); ++i)
      for (int m = 0; m < 3; ++m) {
        float* sum = moments + (size_t(part.items[i].layer) * 3 + m) * kEmLanes + lane;
        hn::Store(hn::Add(hn::Load(d, sum), hn::Load(d, part.values.data() + (i * kValues + kSum0 + m) * n)), d, sum);
      }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace stratalux::fit
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stratalux::fit {

HWY_EXPORT(AddLayers);
HWY_EXPORT(LayerMoments);

void AddLayers(const EmGrid& grid, const LayersOnGrid& layers, LayerTiles& tiles, float* mass) {
  HWY_DYNAMIC_DISPATCH(AddLayers)(grid, layers, tiles, mass);
}

void LayerMoments(const LayersOnGrid& layers, LayerTiles& tiles, const float* q, float* moments) {
  HWY_DYNAMIC_DISPATCH(LayerMoments)(layers, tiles, q, moments);
}

std::string KernelIsa() {
  const int64_t targets = hwy::SupportedTargets() & HWY_TARGETS;
  return hwy::TargetName(targets & -targets);  // the lowest bit is the best
}

}  // namespace stratalux::fit
#endif
