// SPDX-License-Identifier: Apache-2.0
// The EM inner loops: layers on the fine grid of model section 7, for sixteen profiles at once. All arrays are
// [index][lane]; positions and widths are in cells of the lane's own grid. A lane's results never depend on what the
// other lanes hold. Compiled for each instruction set of the machine family and chosen at run time (Highway).
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "fitter/mixture/em_lanes.h"

namespace stratalux::fit {

struct EmGrid {
  int cells = 0;
  bool wrapped = true;
};

// Layers of a block on one light's grid; weight 0: the lane lacks the layer.
struct LayersOnGrid {
  int layers = 0;
  const float* weight = nullptr;  // [layer][lane]
  const float* mean = nullptr;    // cells
  const float* sigma = nullptr;   // cells, at least kLeastSigmaCells
};
inline constexpr float kLeastSigmaCells = 0.65F;

// What AddLayers works out for LayerMoments of the same layers: which layer meets which tile of the grid, and each
// Gaussian's value and growth at the tile's first cell. Memory is kept from sweep to sweep.
class LayerTiles {
 public:
  // Cells x layers x lanes that were evaluated, not skipped as negligible, by AddLayers so far.
  [[nodiscard]] int64_t evaluated() const { return evaluated_; }

  // The rest is the kernel's.
  struct Item {  // one layer in the lanes whose width suits one tile size
    int layer, first, last;
  };
  struct Entry {
    int item;
    float z;  // of the tile's first cell
  };
  struct Tile {
    int cell, cells;  // in memory
    int first_entry, entries;
  };
  struct Part {  // of a row: one vector
    std::vector<Item> items;
    std::vector<Entry> entries;
    std::vector<Tile> tiles;
    std::vector<uint32_t> met;  // [image][tile]: a bit an item
    LaneRows values;            // [item][height, mean, curvature, ratio - 1, reach, sums of c, c z, c z^2]
    LaneRows starts;            // [entry][value, growth]
  };
  std::array<Part, kEmLanes> parts;
  int64_t evaluated_ = 0;
};

// mass[cell][lane] = sum over layers of weight_l N(cell; mean_l, sigma_l).
void AddLayers(const EmGrid& grid, const LayersOnGrid& layers, LayerTiles& tiles, float* mass);

// moments[layer][3][lane] = sum over cells of q m_l {1, z - mean_l, (z - mean_l)^2}, for the layers that AddLayers has
// just seen.
void LayerMoments(const LayersOnGrid& layers, LayerTiles& tiles, const float* q, float* moments);

// Which instruction set these kernels use on this machine, such as AVX2: between sets results differ in the last bits.
[[nodiscard]] std::string KernelIsa();

}  // namespace stratalux::fit
