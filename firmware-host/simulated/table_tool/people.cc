// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/table_tool/people.h"

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include "shared/base/formatted.h"
#include "shared/base/parallel.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

constexpr double kLightDeg = 8.0;
constexpr std::array<std::array<size_t, 2>, 3> kPairs = {{{0, 1}, {0, 2}, {1, 2}}};

double Quantile(const std::vector<double>& rising, double share) {
  const double at = share * static_cast<double>(rising.size() - 1);
  const size_t below = std::min(static_cast<size_t>(at), rising.size() - 2);
  const double f = at - static_cast<double>(below);
  return (1.0 - f) * rising[below] + f * rising[below + 1];
}

std::vector<double> Rising(const std::vector<DrawnPerson>& people, const auto& of) {
  std::vector<double> values;
  for (const DrawnPerson& p : people) values.push_back(of(p));
  std::sort(values.begin(), values.end());
  return values;
}

double Mean(const std::vector<DrawnPerson>& people, const auto& of) {
  double sum = 0.0;
  for (const DrawnPerson& p : people) sum += of(p);
  return sum / static_cast<double>(people.size());
}

double Correlation(const std::vector<DrawnPerson>& people, const auto& a, const auto& b) {
  const double mean_a = Mean(people, a), mean_b = Mean(people, b);
  const auto moment = [&](const auto& u, double mean_u, const auto& v, double mean_v) {
    return Mean(people, [&](const DrawnPerson& p) { return (u(p) - mean_u) * (v(p) - mean_v); });
  };
  return moment(a, mean_a, b, mean_b) / std::sqrt(moment(a, mean_a, a, mean_a) * moment(b, mean_b, b, mean_b));
}

auto LogReflectance(size_t channel) {
  return [channel](const DrawnPerson& p) { return std::log(p.reflectance[channel]); };
}

}  // namespace

std::array<double, kSkinChannels> ReflectanceOf(const SkinTable& table, const SkinParameters& skin) {
  std::array<double, kSkinChannels> reflectance{};
  for (int c = 0; c < kSkinChannels; ++c)
    reflectance[static_cast<size_t>(c)] = table.Albedo(c, skin, RadFromDeg(kLightDeg)) + kSpecularPart;
  return reflectance;
}

std::vector<DrawnPerson> DrawPeople(const SkinTable& table, int first, int count, uint64_t seed,
                                    const Population& population) {
  std::vector<DrawnPerson> people(static_cast<size_t>(count));
  ParallelFor(count, 16, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      DrawnPerson& p = people[static_cast<size_t>(i)];
      p.person = first + static_cast<int>(i);
      p.skin = Person(p.person, seed, population);
      p.reflectance = ReflectanceOf(table, p.skin);
    }
  });
  return people;
}

double PeopleSummary::WorstQuantile() const {
  double worst = 0.0;
  for (size_t c = 0; c < quantiles.size(); ++c)
    for (size_t k = 0; k < kPeopleShares.size(); ++k)
      worst = std::max(worst, std::abs(quantiles[c][k] - kMeasuredReflectance[c][k]));
  return worst;
}

PeopleSummary Summarise(const std::vector<DrawnPerson>& people) {
  PeopleSummary s;
  for (size_t c = 0; c < kSkinChannels; ++c) {
    const auto rising = Rising(people, [c](const DrawnPerson& p) { return p.reflectance[c]; });
    for (size_t k = 0; k < kPeopleShares.size(); ++k) s.quantiles[c][k] = Quantile(rising, kPeopleShares[k]);
    s.darkest[c] = rising.front();
    s.log_correlation[c] = Correlation(people, LogReflectance(kPairs[c][0]), LogReflectance(kPairs[c][1]));
  }
  const auto scattering = [](const DrawnPerson& p) { return static_cast<double>(p.skin.scattering); };
  const auto rising = Rising(people, scattering);
  s.scattering_median = Quantile(rising, 0.5);
  s.scattering_mean = Mean(people, scattering);
  s.scattering_sd =
      std::sqrt(Mean(people, [&](const DrawnPerson& p) { return std::pow(scattering(p) - s.scattering_mean, 2); }));
  const auto share = [&](const auto& is) {
    return Mean(people, [&](const DrawnPerson& p) { return is(p) ? 1.0 : 0.0; });
  };
  s.least_melanin = share([](const DrawnPerson& p) { return p.skin.melanin <= 1.2 * SkinGrid::kMelanin.front(); });
  s.least_scattering = share([&](const DrawnPerson& p) { return scattering(p) == kPeopleScattering.front(); });
  s.most_scattering = share([&](const DrawnPerson& p) { return scattering(p) == kPeopleScattering.back(); });
  s.least_epidermis = share(
      [](const DrawnPerson& p) { return p.skin.epidermis_mm == static_cast<float>(SkinGrid::kEpidermisMm.front()); });
  return s;
}

std::string PeopleText(const PeopleSummary& s) {
  std::string text =
      "| share of people | R drawn | measured | G drawn | measured | B drawn | measured "
      "|\n|---|---|---|---|---|---|---|\n";
  const auto row = [&](const std::string& name, const auto& drawn, const auto& measured) {
    text += "| " + name + " |";
    for (size_t c = 0; c < kSkinChannels; ++c) text += Formatted(" %.3f | %.3f |", drawn(c), measured(c));
    text += "\n";
  };
  for (size_t k = 0; k < kPeopleShares.size(); ++k)
    row(
        Formatted("%g %%", 100.0 * kPeopleShares[k]), [&](size_t c) { return s.quantiles[c][k]; },
        [&](size_t c) { return kMeasuredReflectance[c][k]; });
  row(
      "darkest", [&](size_t c) { return s.darkest[c]; }, [](size_t c) { return kMeasuredDarkest[c]; });
  text += Formatted("\nlargest deviation of a quantile: %.4f\n", s.WorstQuantile());
  text += Formatted(
      "correlation of log reflectance, R and G %.3f (measured %.3f), R and B %.3f (%.3f), G and B %.3f (%.3f)\n",
      s.log_correlation[0], kMeasuredLogCorrelation[0], s.log_correlation[1], kMeasuredLogCorrelation[1],
      s.log_correlation[2], kMeasuredLogCorrelation[2]);
  text += Formatted(
      "scattering over that of tissue samples: median %.3f, SD over mean %.3f (measured 0.65 at 475 nm, %.2f)\n",
      s.scattering_median, s.scattering_sd / s.scattering_mean, kMeasuredScatteringSpread);
  text += Formatted(
      "at the table's ends: least melanin (within a fifth) %.1f %% of people, least scattering %.1f %%, most %.1f %%, "
      "thinnest epidermis %.1f %%\n",
      100.0 * s.least_melanin, 100.0 * s.least_scattering, 100.0 * s.most_scattering, 100.0 * s.least_epidermis);
  return text;
}

std::string PeopleCsv(const std::vector<DrawnPerson>& people) {
  std::string csv = "person,melanin,blood,epidermis_mm,scattering,reflectance_630,reflectance_532,reflectance_465\n";
  for (const DrawnPerson& p : people)
    csv += Formatted("%d,%.9g,%.9g,%.9g,%.9g,%.6f,%.6f,%.6f\n", p.person, p.skin.melanin, p.skin.blood,
                     p.skin.epidermis_mm, p.skin.scattering, p.reflectance[0], p.reflectance[1], p.reflectance[2]);
  return csv;
}

std::string PeopleJson(const std::vector<DrawnPerson>& people, const PeopleSummary& s) {
  using Json = nlohmann::ordered_json;
  Json list = Json::array();
  for (const DrawnPerson& p : people)
    list.push_back({{"person", p.person},
                    {"melanin", p.skin.melanin},
                    {"blood", p.skin.blood},
                    {"epidermis_mm", p.skin.epidermis_mm},
                    {"scattering", p.skin.scattering},
                    {"reflectance", p.reflectance}});
  const Json summary = {{"shares", kPeopleShares},
                        {"quantiles", s.quantiles},
                        {"measured_quantiles", kMeasuredReflectance},
                        {"worst_quantile", s.WorstQuantile()},
                        {"darkest", s.darkest},
                        {"log_correlation", s.log_correlation},
                        {"scattering_median", s.scattering_median},
                        {"scattering_mean", s.scattering_mean},
                        {"scattering_sd", s.scattering_sd}};
  return Json{{"wavelengths_nm", kSkinWavelengthNm}, {"summary", summary}, {"people", list}}.dump(2) + "\n";
}

}  // namespace stratalux::rig
