// SPDX-License-Identifier: Apache-2.0
// Where a face is, by light alone: the foreground that the projectors light, and how far away it is. No recognition.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "firmware-host/kiosk/visit_events.h"
#include "firmware-host/session/lit_blocks.h"
#include "shared/capture/plan.h"
#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"

namespace stratalux::rig {

// Blocks of kLitBlock pixels of the mosaic, row by row: 1 lit, 0 not.
struct Foreground {
  int columns = 0, rows = 0;
  std::vector<uint8_t> lit;

  [[nodiscard]] int64_t Count() const;
  [[nodiscard]] bool At(int column, int row) const { return lit[static_cast<size_t>(row * columns + column)] != 0; }
};

// The largest connected part of what any projector lights (LitBlocks); nullopt: nothing is lit. `scans`: of one size.
[[nodiscard]] std::optional<Foreground> ForegroundOf(std::span<const PreScan> scans, double read_noise_dn);

// Its box, but for the outermost 1 % of the blocks on each side, which may be stray light. Precondition: not empty.
[[nodiscard]] FaceBox BoxOf(const Foreground& foreground);

// Share of `before` that `now` has, in thousandths; 0 for grids of different sizes.
[[nodiscard]] int CoveragePermille(const Foreground& before, const Foreground& now);

// One bit of a Gray code and its inverse, as the camera saw them.
struct CodeBit {
  const Image<uint16_t>& bit;
  const Image<uint16_t>& inverse;
};

// The coarse bits of `projector`'s columns in reflected Gray code, where a plan shows columns at all, with their
// inverses, coarsest first; `bits` at most.
[[nodiscard]] std::vector<std::pair<Pattern, Pattern>> CoarseCode(const CapturePlan& plan, int projector, int bits);

// Median distance of the foreground from the camera's centre, along its axis, mm: each block's column is the middle of
// its coarse stripe, its depth that where the camera's ray meets the column. nullopt: too few blocks tell. `code`: as
// CoarseCode has it, of `code_bits` in all.
[[nodiscard]] std::optional<double> MedianDistanceMm(const Foreground& foreground, std::span<const CodeBit> code,
                                                     int code_bits, const RigCalibration& calibration, int projector);

}  // namespace stratalux::rig
