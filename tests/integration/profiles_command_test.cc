// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit profiles` as a user runs it: pipes, files, exit codes, messages.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class ProfilesCommand : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("stratalux_profiles_" + std::to_string(getpid()));
    fs::create_directories(folder_);
    std::string text = "source,incidence_deg,exit_deg,slit_mm,u_mm,radiance\n";
    std::string questions = "source,incidence_deg,exit_deg,slit_mm,u_mm\n";
    for (int incidence : {-45, 0, 30})
      for (int k = -40; k <= 40; ++k) {
        const double u = 0.25 * k, shift = 0.3 * std::sin(incidence * 0.01745);
        const std::string row =
            "i" + std::to_string(incidence) + "," + std::to_string(incidence) + ",0,0.5," + std::to_string(u);
        text += row + "," + std::to_string(0.2 * std::exp(-std::abs(u - shift))) + "\n";
        if (incidence == 0) questions += "unseen" + row.substr(2) + "\n";
      }
    Write("in.csv", text);
    Write("questions.csv", questions);
  }
  void TearDown() override { fs::remove_all(folder_); }

  void Write(const std::string& name, const std::string& text) const { WriteText(folder_ / name, text); }
  [[nodiscard]] std::string Read(const std::string& name) const { return ReadText(folder_ / name); }
  // Runs in the folder; `command` follows "stratalux-fit profiles".
  [[nodiscard]] Outcome Run(const std::string& command) const {
    Outcome outcome = Shell("cd " + folder_.string() + " && " + STRATALUX_BIN_DIR + "/stratalux-fit profiles " +
                            command + " 2>err.txt");
    outcome.err = Read("err.txt");
    return outcome;
  }

  fs::path folder_;
};

TEST_F(ProfilesCommand, FitsAndPredictsThroughFilesAndPipesAlike) {
  ASSERT_EQ(Run("fit --in in.csv --out model.json").code, 0);
  const auto json = nlohmann::json::parse(Read("model.json"));
  EXPECT_EQ(json["layers"].size(), 20U);
  for (const char* key : {"depth_mm", "sigma_mm", "weight"}) EXPECT_TRUE(json["layers"][0].contains(key)) << key;
  for (const char* key : {"background", "divergence", "iterations", "shift_law"})
    EXPECT_TRUE(json.contains(key)) << key;
  const Outcome piped = Run("fit --in - --out - --layers 20 < in.csv");
  EXPECT_EQ(piped.code, 0);
  EXPECT_EQ(piped.out, Read("model.json"));

  ASSERT_EQ(Run("predict --model model.json --in questions.csv --out answers.csv").code, 0);
  const std::string answers = Read("answers.csv");
  EXPECT_EQ(answers.substr(0, answers.find('\n')), "source,incidence_deg,exit_deg,slit_mm,u_mm,radiance");
  EXPECT_EQ(std::count(answers.begin(), answers.end(), '\n'), 82);
  EXPECT_EQ(Run("predict --model - --in questions.csv < model.json").out, answers);
  EXPECT_EQ(Run("predict --model model.json --in - --out - < questions.csv").out, answers);
}

TEST_F(ProfilesCommand, EveryLawModeAndGainFits) {
  for (const char* options :
       {"--shift paper", "--shift refracted_sine", "--gain none", "--eta 1.33 --layers 5", "--layers 1", "--layers 32"})
    EXPECT_EQ(Run(std::string("fit --in in.csv --out m.json ") + options).code, 0) << options;
  ASSERT_EQ(Run("fit --in in.csv --out free.json --mode free").code, 0);
  EXPECT_EQ(nlohmann::json::parse(Read("free.json"))["sources"].size(), 3U);
  const Outcome refused = Run("predict --model free.json --in questions.csv --out no.csv");
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.err, HasSubstr("'unseen"));
  EXPECT_FALSE(fs::exists(folder_ / "no.csv"));
}

TEST_F(ProfilesCommand, BadInputIsNamedAndNothingIsWritten) {
  Write("column.csv", "source,incidence_deg,exit_deg,slit_mm,radiance\na,0,0,1,0.1\n");
  Write("irregular.csv",
        "source,incidence_deg,exit_deg,slit_mm,u_mm,radiance\na,0,0,1,0,1\na,0,0,1,1,1\na,0,0,1,3,1\n");
  Write("broken.json", "{\"schema\": 1");
  Write("newer.json", "{\"schema\": 9}");
  const struct {
    const char *command, *message;
    int code;
  } cases[] = {
      {"fit --in column.csv --out no", "column.csv:1: column 'u_mm' is missing", 2},
      {"fit --in irregular.csv --out no", "irregular.csv:4: source 'a': u_mm = 3 breaks the regular step", 2},
      {"fit --in nowhere.csv --out no", "nowhere.csv", 4},
      {"fit --in in.csv --out no --layers 33", "--layers", 2},
      {"fit --in in.csv --out no --eta 0.5", "--eta", 2},
      {"fit --in in.csv --out no --shift sideways", "--shift", 2},
      {"fit --in in.csv --out no --unknown", "--unknown", 2},
      {"fit --out no", "--in", 2},
      {"fit --in in.csv --out nowhere/no", "nowhere/no", 1},
      {"predict --model broken.json --in questions.csv --out no", "broken.json", 2},
      {"predict --model newer.json --in questions.csv --out no", "newer.json", 7},
      {"predict --model nowhere.json --in questions.csv --out no", "nowhere.json", 4},
  };
  for (const auto& c : cases) {
    const Outcome outcome = Run(c.command);
    EXPECT_EQ(outcome.code, c.code) << c.command << "\n" << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr(c.message)) << c.command;
    EXPECT_EQ(outcome.out, "") << c.command;
    EXPECT_FALSE(fs::exists(folder_ / "no")) << c.command;
  }
}

}  // namespace
}  // namespace stratalux
