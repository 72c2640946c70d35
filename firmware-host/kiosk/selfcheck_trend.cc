// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/selfcheck_trend.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include <nlohmann/json.hpp>

#include "firmware-host/kiosk/day_book.h"
#include "shared/base/formatted.h"
#include "shared/base/median.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kFar = 3.5, kOfFewDays = 13.0;

double LeastDistance(CheckFigure figure, double median) {
  if (figure == CheckFigure::kDark || figure == CheckFigure::kSync) return 1.0;
  return 0.01 * std::abs(median);
}

bool Comparable(const Selfcheck& a, const Selfcheck& b) {
  return a.exposure_ms == b.exposure_ms && a.width == b.width && a.height == b.height;
}

// That `newest`, the book's last, is compared with.
std::vector<const Selfcheck*> DaysBefore(const std::deque<Selfcheck>& checks, const Selfcheck& newest) {
  std::vector<const Selfcheck*> before;
  std::set<std::string> days = {LocalDay(newest.at)};
  for (auto check = checks.rbegin(); check != checks.rend() && before.size() < SelfcheckTrend::kMostDays; ++check)
    if (check->passed && Comparable(*check, newest) && days.insert(LocalDay(check->at)).second)
      before.push_back(&*check);
  return before;
}

Json OrNull(const std::optional<double>& value) { return value ? Json(*value) : Json(nullptr); }

Json PointOf(const Selfcheck& check) {
  Json figures = Json::object();
  for (int f = 0; f < kCheckFigures; ++f) {
    Json& values = figures[ToString(static_cast<CheckFigure>(f))] = Json::array();
    for (const auto& value : check.figures[static_cast<size_t>(f)]) values.push_back(OrNull(value));
  }
  return {{"at", check.at.ns / kSecondNs}, {"passed", check.passed}, {"figures", std::move(figures)}};
}

Json JsonOf(const UsualFigure& usual) { return {{"median", usual.median}, {"limit", usual.limit}}; }

Json JsonOf(const FigureDrift& drift) {
  return {{"figure", ToString(drift.figure)},
          {"projector", drift.projector},
          {"value", drift.value},
          {"median", drift.usual.median},
          {"limit", drift.usual.limit}};
}

}  // namespace

std::optional<UsualFigure> UsualOf(CheckFigure figure, const std::vector<double>& of_days) {
  const auto days = static_cast<double>(of_days.size());
  if (of_days.size() < SelfcheckTrend::kFewestDays) return std::nullopt;
  UsualFigure usual;
  usual.median = Median(of_days);
  std::vector<double> distances;
  for (const double one : of_days) distances.push_back(std::abs(one - usual.median));
  const double spread = kMadToDeviation * Median(distances);
  usual.limit = std::max(kFar * (1.0 + kOfFewDays / days) * spread, LeastDistance(figure, usual.median));
  return usual;
}

SelfcheckTrend TrendOf(const SelfcheckBook& book) {
  SelfcheckTrend trend;
  const auto& checks = book.checks();
  if (checks.empty()) return trend;
  const Selfcheck& newest = checks.back();
  const size_t shown = std::min(checks.size(), SelfcheckTrend::kMostShown);
  trend.checks.assign(checks.end() - static_cast<std::ptrdiff_t>(shown), checks.end());
  const auto before = DaysBefore(checks, newest);
  trend.days = static_cast<int>(before.size());
  for (size_t f = 0; f < newest.figures.size(); ++f) {
    const auto figure = static_cast<CheckFigure>(f);
    for (size_t p = 0; p < newest.figures[f].size(); ++p) {
      std::vector<double> of_days;
      for (const Selfcheck* check : before)
        if (p < check->figures[f].size() && check->figures[f][p]) of_days.push_back(*check->figures[f][p]);
      const auto usual = trend.usual[f].emplace_back(UsualOf(figure, of_days));
      const auto value = newest.figures[f][p];
      if (value && usual && std::abs(*value - usual->median) > usual->limit)
        trend.drifts.push_back({figure, static_cast<int>(p), *value, *usual});
    }
  }
  return trend;
}

std::string ToText(const FigureDrift& drift, int days) {
  const std::string of =
      drift.figure == CheckFigure::kFrameRate ? "" : " of projector " + std::to_string(drift.projector);
  return ToString(drift.figure) + of +
         Formatted(": %.5g, usually %.5g +- %.2g (%d days)", drift.value, drift.usual.median, drift.usual.limit, days);
}

std::string TrendAsText(const SelfcheckTrend& trend) {
  if (trend.checks.empty()) return "no self-check is kept\n";
  std::string text;
  for (const Selfcheck& check : trend.checks) {
    text += ToIso8601(check.at) + (check.passed ? "  passed" : "  FAILED");
    for (size_t f = 0; f < check.figures.size(); ++f) {
      if (check.figures[f].empty()) continue;
      text += std::string("  ") + ToString(static_cast<CheckFigure>(f));
      for (const auto& value : check.figures[f]) text += value ? Formatted(" %.5g", *value) : " -";
    }
    text += "\n";
  }
  for (const FigureDrift& drift : trend.drifts) text += "drift: " + ToText(drift, trend.days) + "\n";
  if (trend.days < SelfcheckTrend::kFewestDays)
    return text + Formatted("%d earlier days with a check that passed; drifts are reported from %d days on\n",
                            trend.days, SelfcheckTrend::kFewestDays);
  return trend.drifts.empty() ? text + Formatted("as on the %d days before\n", trend.days) : text;
}

std::string TrendAsJson(const SelfcheckTrend& trend) {
  Json checks = Json::array(), drifts = Json::array(), usual = Json::object();
  for (const Selfcheck& check : trend.checks) checks.push_back(PointOf(check));
  for (const FigureDrift& drift : trend.drifts) drifts.push_back(JsonOf(drift));
  for (int f = 0; f < kCheckFigures; ++f) {
    Json& values = usual[ToString(static_cast<CheckFigure>(f))] = Json::array();
    for (const auto& one : trend.usual[static_cast<size_t>(f)]) values.push_back(one ? JsonOf(*one) : Json(nullptr));
  }
  const Json json = {
      {"checks", std::move(checks)}, {"days", trend.days},          {"fewest_days", SelfcheckTrend::kFewestDays},
      {"usual", std::move(usual)},   {"drifts", std::move(drifts)}, {"note", trend.note}};
  return json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace stratalux::rig
