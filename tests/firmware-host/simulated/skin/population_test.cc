// SPDX-License-Identifier: Apache-2.0
// People drawn beside people measured: reflectance of 100 forearms, scattering of 3,809 probes (population.h).
#include "firmware-host/simulated/skin/population.h"

#include <cmath>
#include <cstdio>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "firmware-host/simulated/table_tool/people.h"
#include "shared/base/random.h"
#include "tests/firmware-host/simulated/skin/shipped_table.h"
#include "tests/support/run_program.h"

namespace stratalux::rig {
namespace {

void ExpectQuantiles(const PeopleSummary& s, double most) {
  for (size_t c = 0; c < kSkinChannels; ++c)
    for (size_t k = 0; k < kPeopleShares.size(); ++k)
      EXPECT_NEAR(s.quantiles[c][k], kMeasuredReflectance[c][k], most)
          << "channel " << c << ", share " << kPeopleShares[k];
}

TEST(Population, TwoHundredPeopleAreAsLightAsTheMeasured) {
  ExpectQuantiles(Summarise(DrawPeople(ShippedTable(), 0, 200, kPeopleSeed)), 0.03);
}

// Of the same sequence, and of other seeds; 200 people leave a little to chance.
TEST(Population, SoAreTwoHundredOthers) {
  for (const auto& [first, seed] : {std::pair{200, 1}, {5000, 1}, {999800, 1}, {0, 2}, {0, 3}})
    ExpectQuantiles(Summarise(DrawPeople(ShippedTable(), first, 200, seed)), 0.035);
}

TEST(Population, ColoursGoTogetherAsMeasured) {
  for (const int first : {0, 200, 5000}) {
    const PeopleSummary s = Summarise(DrawPeople(ShippedTable(), first, 200, kPeopleSeed));
    for (size_t k = 0; k < 3; ++k) EXPECT_NEAR(s.log_correlation[k], kMeasuredLogCorrelation[k], 0.021) << k;
  }
}

// Median of 3,809 people at 475 nm over the formula of tissue samples there; SD over mean of 1,734.
TEST(Population, ScatteringIsThatOfLivingSkin) {
  const double formula = 4.6 * std::pow(475.0 / 500.0, -1.421), measured = 3.22 / formula;
  for (const int first : {0, 200, 5000}) {
    const PeopleSummary s = Summarise(DrawPeople(ShippedTable(), first, 200, kPeopleSeed));
    EXPECT_NEAR(s.scattering_median, measured, 0.02) << first;
    EXPECT_NEAR(s.scattering_sd / s.scattering_mean, 0.72 / 3.16, 0.03) << first;
  }
}

// One source of variation at a time, and what visitors were before there was a population.
TEST(Population, LessThanAllOfItIsNotTheMeasured) {
  Population melanin_alone;
  melanin_alone.scattering_spread = melanin_alone.blood_spread = melanin_alone.epidermis_spread = 0.0;
  const PeopleSummary alone = Summarise(DrawPeople(ShippedTable(), 0, 200, kPeopleSeed, melanin_alone));
  EXPECT_GT(alone.WorstQuantile(), 0.05);
  EXPECT_LT(alone.scattering_sd, 1e-6);

  Population samples;  // tissue samples' scattering
  samples.scattering_median = 1.0;
  EXPECT_GT(Summarise(DrawPeople(ShippedTable(), 0, 200, kPeopleSeed, samples)).WorstQuantile(), 0.04);

  std::vector<DrawnPerson> visitors;
  for (int seed = 0; seed < 200; ++seed) {
    Random random(static_cast<uint64_t>(seed), 2);
    DrawnPerson visitor;
    visitor.skin.melanin = static_cast<float>(0.012 * std::pow(8.0, random.Uniform()));
    visitor.skin.blood = static_cast<float>(random.Uniform(0.003, 0.008));
    visitor.reflectance = ReflectanceOf(ShippedTable(), visitor.skin);
    visitors.push_back(visitor);
  }
  const PeopleSummary before = Summarise(visitors);
  EXPECT_GT(before.WorstQuantile(), 0.06);
  std::printf("worst quantile: melanin alone %.3f, visitors by seed %.3f\n", alone.WorstQuantile(),
              before.WorstQuantile());
}

TEST(Population, APersonDoesNotHangOnTheOthers) {
  const auto together = DrawPeople(ShippedTable(), 100, 60, kPeopleSeed);
  const auto backwards = DrawPeople(ShippedTable(), 137, 1, kPeopleSeed);
  EXPECT_EQ(together[37].person, 137);
  for (const SkinParameters& skin : {together[37].skin, backwards[0].skin, Person(137)}) {
    EXPECT_EQ(skin.melanin, Person(137).melanin);
    EXPECT_EQ(skin.blood, Person(137).blood);
    EXPECT_EQ(skin.epidermis_mm, Person(137).epidermis_mm);
    EXPECT_EQ(skin.scattering, Person(137).scattering);
  }
  EXPECT_EQ(together[37].reflectance, backwards[0].reflectance);
  EXPECT_NE(Person(137).scattering, Person(138).scattering);
  EXPECT_NE(Person(137, 1).blood, Person(137, 2).blood);
}

TEST(Population, EveryoneIsWithinTheTable) {
  for (int person = 0; person < kMostPeople; person += 97) {
    const SkinParameters skin = Person(person);
    ASSERT_GE(skin.melanin, static_cast<float>(SkinGrid::kMelanin.front())) << person;
    ASSERT_LE(skin.melanin, static_cast<float>(SkinGrid::kMelanin.back())) << person;
    ASSERT_GE(skin.blood, static_cast<float>(SkinGrid::kBlood.front())) << person;
    ASSERT_LE(skin.blood, static_cast<float>(SkinGrid::kBlood.back())) << person;
    ASSERT_GE(skin.epidermis_mm, static_cast<float>(SkinGrid::kEpidermisMm.front())) << person;
    ASSERT_LE(skin.epidermis_mm, static_cast<float>(SkinGrid::kEpidermisMm.back())) << person;
    ASSERT_TRUE(ShippedTable().CheckScattering(skin.scattering).ok()) << person;
  }
}

// A step of a tenth away from any fitted number, to either side, is worse over the people that were fitted.
TEST(Population, TheNumbersAreWhereTheFitEnds) {
  const auto cost = [](const Population& population) {
    return PeopleCost(Summarise(DrawPeople(ShippedTable(), 0, 400, kPeopleSeed, population)));
  };
  const double shipped = cost({});
  for (double Population::*fitted :
       {&Population::melanin_span, &Population::melanin_shift, &Population::scattering_spread,
        &Population::blood_median, &Population::blood_spread})
    for (const double factor : {0.9, 1.1}) {
      Population other;
      other.*fitted *= factor;
      EXPECT_GT(cost(other), shipped) << factor << " of " << Population().*fitted;
    }
}

std::string Command(const std::string& arguments, int code) {
  const Outcome run = Shell(std::string(STRATALUX_BIN_DIR) + "/stratalux-skin-table population " + arguments);
  EXPECT_EQ(run.code, code) << run.out;
  return run.out;
}

TEST(PopulationCommand, CsvSaysEachPerson) {
  std::istringstream csv(Command("--people 7 --first 130 --csv -", 0));
  std::string line;
  ASSERT_TRUE(std::getline(csv, line));
  EXPECT_EQ(line, "person,melanin,blood,epidermis_mm,scattering,reflectance_630,reflectance_532,reflectance_465");
  int rows = 0;
  while (std::getline(csv, line)) {
    int number = -1;
    SkinParameters skin;
    std::array<double, 3> reflectance{};
    ASSERT_EQ(std::sscanf(line.c_str(), "%d,%f,%f,%f,%f,%lf,%lf,%lf", &number, &skin.melanin, &skin.blood,
                          &skin.epidermis_mm, &skin.scattering, &reflectance[0], &reflectance[1], &reflectance[2]),
              8)
        << line;
    const SkinParameters drawn = Person(130 + rows);
    EXPECT_EQ(number, 130 + rows);
    EXPECT_EQ(skin.melanin, drawn.melanin);
    EXPECT_EQ(skin.blood, drawn.blood);
    EXPECT_EQ(skin.epidermis_mm, drawn.epidermis_mm);
    EXPECT_EQ(skin.scattering, drawn.scattering);
    for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(reflectance[c], ReflectanceOf(ShippedTable(), drawn)[c], 1e-6);
    ++rows;
  }
  EXPECT_EQ(rows, 7);
}

TEST(PopulationCommand, JsonHoldsWhatTheTextSays) {
  const auto json = nlohmann::json::parse(Command("--people 20 --json", 0));
  EXPECT_EQ(json["people"].size(), 20U);
  EXPECT_EQ(json["people"][3]["scattering"].get<float>(), Person(3).scattering);
  const PeopleSummary summary = Summarise(DrawPeople(ShippedTable(), 0, 20, kPeopleSeed));
  EXPECT_DOUBLE_EQ(json["summary"]["worst_quantile"].get<double>(), summary.WorstQuantile());
  char median[32];
  std::snprintf(median, sizeof median, "median %.3f", summary.scattering_median);
  EXPECT_THAT(Command("--people 20", 0), ::testing::HasSubstr(median));
}

TEST(PopulationCommand, RefusesWhoIsNotThere) {
  EXPECT_THAT(Command("--first 999900 --people 200 2>&1", 2), ::testing::HasSubstr("people are 0 .. 999999"));
  Command("--first -1 2>&1", 2);
  Command("--people 2 2>&1", 2);
  Command("--csv /nonexistent/people.csv --people 3 2>&1", 1);
}

}  // namespace
}  // namespace stratalux::rig
