// SPDX-License-Identifier: Apache-2.0
// What the self-checks on the white card measured, one after the other, over restarts of the program. Figures of a
// rig, of nobody. No file, no clock of its own.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "shared/units/time.h"

namespace stratalux::rig {

// Of each projector (CardFigures, RigCheckReport), but for the last.
enum class CheckFigure : uint8_t {
  kLevel,     // DN, white less black
  kDark,      // DN
  kRedGreen,  // colours of the light, as ratios; of a colour camera alone
  kBlueGreen,
  kEven,      // share
  kLit,       // share
  kSync,      // ms, TRIGGER to SYNC
  kFrameRate  // frames a second, of the camera
};
inline constexpr int kCheckFigures = 8;
[[nodiscard]] const char* ToString(CheckFigure figure);  // "level", "red_green"

struct Selfcheck {
  WallNs at;  // whole seconds
  bool passed = false;
  // Two checks can be compared where these are the same.
  double exposure_ms = 0.0;
  int width = 0, height = 0;
  // By projector; kFrameRate: one. Five significant digits are kept.
  std::array<std::vector<std::optional<double>>, kCheckFigures> figures;

  [[nodiscard]] std::vector<std::optional<double>>& Of(CheckFigure figure) {
    return figures[static_cast<size_t>(figure)];
  }
  [[nodiscard]] const std::vector<std::optional<double>>& Of(CheckFigure figure) const {
    return figures[static_cast<size_t>(figure)];
  }
  friend bool operator==(const Selfcheck&, const Selfcheck&) = default;
};

class SelfcheckBook {
 public:
  static constexpr int kSchema = 1;
  static constexpr size_t kMostChecks = 100;  // three months of mornings

  SelfcheckBook() = default;
  // Of what ToJson() gave. Throws what the JSON library throws where that is not what it gives.
  [[nodiscard]] static SelfcheckBook From(const std::string& json);
  // With a number `schema`; at most 60 kB: what a rig of many projectors has more of, its oldest checks, are left out.
  [[nodiscard]] std::string ToJson() const;

  // Figures that are no finite numbers are left out.
  void Add(Selfcheck check);
  // In the order in which they were made, whatever the clock said.
  [[nodiscard]] const std::deque<Selfcheck>& checks() const { return checks_; }

 private:
  std::deque<Selfcheck> checks_;
};

}  // namespace stratalux::rig
