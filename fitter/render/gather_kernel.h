// SPDX-License-Identifier: Apache-2.0
// The inner loops of the renderer: lit blocks as one place of the skin sees them, and their Gaussian-weighted flux.
// Internal to fitter/render.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace stratalux::fit {

inline constexpr int kGatherLanes = 16;

// Columns x0 .. x1, rows y0 .. y1 of a level's blocks, or of pixels; x1 < x0 or y1 < y0: none.
struct BlockWindow {
  int x0 = 0, x1 = -1, y0 = 0, y1 = -1;

  [[nodiscard]] bool Empty() const { return x1 < x0 || y1 < y0; }
  // The least window that holds both.
  [[nodiscard]] BlockWindow With(const BlockWindow& other) const;
  // What lies in both.
  [[nodiscard]] BlockWindow Within(const BlockWindow& other) const;
};

// One pyramid level as planes, rows padded by kGatherLanes blocks without flux. All colours of a light fall alike, but
// for their strength: `flux` is that of the brightest.
struct LitPlanes {
  int width = 0, height = 0, stride = 0;
  std::vector<float> x, y, z;     // position, mm
  std::vector<float> nx, ny, nz;  // normal
  std::vector<float> spread_mm2;
  std::vector<float> flux;
  BlockWindow lit;  // the least that holds every block with flux
};

// A tangent plane: axes p and q at right angles, lengths in mm.
struct TangentPlane {
  std::array<float, 3> origin_mm{}, normal{}, p{}, q{};
};

// Blocks of a window in a tangent plane, rows padded like those of LitPlanes. Blocks that face away have no flux, but
// their spread: parts of them may face the plane.
struct SeenBlocks {
  BlockWindow window;
  int stride = 0;
  std::vector<float> p, q;  // mm from the plane's origin
  std::vector<float> flux;
  std::vector<float> spread_mm2;  // 0 where no light falls
  float widest_mm2 = 0.0F;        // the largest of these
  bool dark = true;               // no light falls anywhere

  [[nodiscard]] std::size_t At(int x, int y) const {
    return static_cast<std::size_t>(y - window.y0) * stride + static_cast<std::size_t>(x - window.x0);
  }
};

// `seen`'s memory is kept from call to call.
void SeeBlocks(const LitPlanes& planes, const BlockWindow& window, const TangentPlane& plane, SeenBlocks& seen);

struct GatherTarget {
  float p_mm = 0.0F, q_mm = 0.0F;
  float half_inverse2 = 0.0F;   // 1 / 2 sigma^2
  float max_spread_mm2 = 0.0F;  // blocks that spread wider are left out
};

// Sum over blocks of a window, which `seen` must hold, of flux exp(-|offset|^2 / 2 sigma^2).
[[nodiscard]] float GatherBlocks(const SeenBlocks& seen, const BlockWindow& window, const GatherTarget& target);

}  // namespace stratalux::fit
