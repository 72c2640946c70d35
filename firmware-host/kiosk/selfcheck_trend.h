// SPDX-License-Identifier: Apache-2.0
// How the newest self-check stands among those of the days before: is a figure where it usually is?
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/kiosk/selfcheck_book.h"

namespace stratalux::rig {

// The newest figure x drifted where |x - m| > limit, of the same figures x_i of the n days before:
//
//   m     = median x_i,   s = 1.4826 median |x_i - m|        (the standard deviation of what is normal but for
//   outliers) limit = max(3.5 (1 + 13 / n) s, least)
//
// 3.5: of Iglewicz and Hoaglin, "How to Detect and Handle Outliers", 1993; of a normal figure whose m and s are known,
// one in 2,200 lies beyond. Of the 29 figures of four projectors and a colour camera one does so without a reason
// once in some 75 mornings. m and s of few days are not known well: 1 + 13 / n makes up for it, so that with 8 days one
// figure in 1,000 is told without a reason, with 12 in 1,500, with 30 in 3,000 (simulated, selfcheck_trend_test). Fewer
// than 8 days say nothing.
// least: what nobody need look at, however alike the days were: a hundredth of m, which comb_cycle.h takes for a lamp's
// own flicker; of kDark one DN, the camera's step; of kSync 1 ms, by which a thread may be late (deadlines.h).
//
// The n days are the last up to 30 days (of the local calendar) before that of the newest check on which one of the
// same setup passed; the last such check of each counts.
struct UsualFigure {
  double median = 0.0;
  double limit = 0.0;  // of the distance from it
  friend bool operator==(const UsualFigure&, const UsualFigure&) = default;
};
struct FigureDrift {
  CheckFigure figure = CheckFigure::kLevel;
  int projector = 0;  // 0 for kFrameRate, too
  double value = 0.0;
  UsualFigure usual;
  friend bool operator==(const FigureDrift&, const FigureDrift&) = default;
};

struct SelfcheckTrend {
  static constexpr size_t kMostShown = 30;
  static constexpr int kMostDays = 30, kFewestDays = 8;

  std::vector<Selfcheck> checks;  // the newest, oldest first
  int days = 0;                   // that the newest is compared with; fewer than kFewestDays: with none
  std::array<std::vector<std::optional<UsualFigure>>, kCheckFigures> usual;  // as Selfcheck::figures
  std::vector<FigureDrift> drifts;
  std::string note;  // what could not be read or kept; empty
};
[[nodiscard]] SelfcheckTrend TrendOf(const SelfcheckBook& book);

// m and limit of the formula; nullopt of fewer than kFewestDays.
[[nodiscard]] std::optional<UsualFigure> UsualOf(CheckFigure figure, const std::vector<double>& of_days);

// "level of projector 2: 1810, usually 2005 +- 41 (14 days)".
[[nodiscard]] std::string ToText(const FigureDrift& drift, int days);

// A table; one JSON object.
[[nodiscard]] std::string TrendAsText(const SelfcheckTrend& trend);
[[nodiscard]] std::string TrendAsJson(const SelfcheckTrend& trend);

}  // namespace stratalux::rig
