// SPDX-License-Identifier: Apache-2.0
// How light people are, drawn beside measured, and the fit that makes the drawn ones like the measured.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "firmware-host/simulated/skin/population.h"
#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {

inline constexpr std::array<double, 5> kPeopleShares = {0.05, 0.25, 0.5, 0.75, 0.95};
using ReflectanceQuantiles = std::array<std::array<double, kPeopleShares.size()>, kSkinChannels>;  // R, G, B

// Reflectance factor of 100 forearms, 8 degrees / hemispherical, the specular part included, interpolated linearly to
// our wavelengths: Cooksey, Allen, Tsai, J. Res. NIST 122:26 (2017), file M38597.
inline constexpr ReflectanceQuantiles kMeasuredReflectance = {{{0.3623, 0.5158, 0.5549, 0.5791, 0.6121},
                                                               {0.1845, 0.3019, 0.3351, 0.3637, 0.4024},
                                                               {0.1339, 0.2687, 0.3067, 0.3328, 0.3626}}};
inline constexpr std::array<double, kSkinChannels> kMeasuredDarkest = {0.2339, 0.1082, 0.0816};
// Of the logarithms: R and G, R and B, G and B.
inline constexpr std::array<double, 3> kMeasuredLogCorrelation = {0.976, 0.975, 0.976};
inline constexpr double kSpecularPart = 0.04;              // of the measured reflectance
inline constexpr double kMeasuredScatteringSpread = 0.23;  // SD over the mean (population.h)

struct DrawnPerson {
  int person = 0;
  SkinParameters skin;
  std::array<double, kSkinChannels> reflectance{};  // R, G, B: the table's for light at 8 degrees, and kSpecularPart
};

[[nodiscard]] std::array<double, kSkinChannels> ReflectanceOf(const SkinTable& table, const SkinParameters& skin);
// People first .. first + count - 1.
[[nodiscard]] std::vector<DrawnPerson> DrawPeople(const SkinTable& table, int first, int count, uint64_t seed,
                                                  const Population& population = {});

struct PeopleSummary {
  ReflectanceQuantiles quantiles{};
  std::array<double, kSkinChannels> darkest{};
  std::array<double, 3> log_correlation{};
  double scattering_median = 0.0, scattering_mean = 0.0, scattering_sd = 0.0;
  // Shares of people at the table's least melanin (within a fifth of it), least and most scattering, least thickness.
  double least_melanin = 0.0, least_scattering = 0.0, most_scattering = 0.0, least_epidermis = 0.0;

  // Largest |drawn - measured| of all quantiles.
  [[nodiscard]] double WorstQuantile() const;
};
// Precondition: three people at least. Quantiles lie between neighbours, linearly.
[[nodiscard]] PeopleSummary Summarise(const std::vector<DrawnPerson>& people);

// Markdown for people: drawn beside measured.
[[nodiscard]] std::string PeopleText(const PeopleSummary& summary);
// person,melanin,blood,epidermis_mm,scattering,reflectance_630,reflectance_532,reflectance_465
[[nodiscard]] std::string PeopleCsv(const std::vector<DrawnPerson>& people);
[[nodiscard]] std::string PeopleJson(const std::vector<DrawnPerson>& people, const PeopleSummary& summary);

// What the fit makes small: the eighth powers (so that the worst counts) of the quantiles' deviations over 0.025, the
// darkest's over 0.05, the correlations' over 0.02 and the scattering's relative SD's over 0.03.
[[nodiscard]] double PeopleCost(const PeopleSummary& summary);
// The fitted members of `start` by Nelder and Mead's simplex over people 0 .. count - 1. `progress`: the cost so far.
[[nodiscard]] Population FitPopulation(const SkinTable& table, const Population& start, int count, uint64_t seed,
                                       const std::function<void(int round, double cost)>& progress);

}  // namespace stratalux::rig
