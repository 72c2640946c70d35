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

struct BlockPlace {
  int x = 0, y = 0;
  [[nodiscard]] friend bool operator==(const BlockPlace&, const BlockPlace&) = default;
};

// Blocks of a window in a tangent plane, rows padded like those of LitPlanes. Blocks that face away, and those that
// spread too wide, have no flux.
struct SeenBlocks {
  BlockWindow window;
  int stride = 0;
  std::vector<float> p, q;  // mm from the plane's origin
  std::vector<float> off2;  // squared distance from the plane, mm^2
  std::vector<float> flux;
  bool dark = true;  // no light falls anywhere

  // Blocks with light that spread wider than was asked for, row by row, whether they face the plane or not: parts of
  // them may.
  std::vector<BlockPlace> wide;
  // What they were opened into (AddPart, EndParts), padded by parts without flux.
  std::vector<float> part_p, part_q, part_off2, part_flux;

  [[nodiscard]] std::size_t At(int x, int y) const {
    return static_cast<std::size_t>(y - window.y0) * stride + static_cast<std::size_t>(x - window.x0);
  }
  void AddPart(float p_mm, float q_mm, float off_mm, float part);
  void EndParts();
};

// Without parts, to begin with. `seen`'s memory is kept from call to call.
void SeeBlocks(const LitPlanes& planes, const BlockWindow& window, const TangentPlane& plane, float max_spread_mm2,
               SeenBlocks& seen);

struct GatherTarget {
  float p_mm = 0.0F, q_mm = 0.0F;
  float half_inverse2 = 0.0F;  // 1 / 2 sigma^2
};

// Sum over blocks of a window, which `seen` must hold, and over all of its parts, of flux exp(-|offset|^2 / 2 sigma^2),
// the offset in space from the target, which lies on the plane.
[[nodiscard]] float GatherBlocks(const SeenBlocks& seen, const BlockWindow& window, const GatherTarget& target);

}  // namespace stratalux::fit
