// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/preroll.h"

#include <gtest/gtest.h>

#include "shared/capture/plan.h"

namespace stratalux::rig {
namespace {

std::vector<double> LevelsOf(const std::vector<bool>& code) {
  std::vector<double> levels;
  for (bool white : code) levels.push_back(white ? 800.0 : 70.0);
  return levels;
}

TEST(ReadPreroll, ReadsTheCodeItself) {
  const std::vector<bool> code = PrerollCode(8);
  EXPECT_TRUE(ReadPreroll(LevelsOf(code), code, 5.0).decoded);
}

TEST(ReadPreroll, NamesEveryShiftUpToHalfTheCode) {
  const std::vector<bool> code = PrerollCode(8);
  for (int shift : {-3, -2, -1, 1, 2, 3}) {
    std::vector<bool> read(code.size(), false);
    for (int i = 0; i < 8; ++i)
      if (i - shift >= 0 && i - shift < 8) read[i] = code[i - shift];
    const PrerollReading reading = ReadPreroll(LevelsOf(read), code, 5.0);
    EXPECT_FALSE(reading.decoded) << shift;
    EXPECT_NE(reading.reason.find("shifted by " + std::to_string(shift) + " "), std::string::npos) << reading.reason;
  }
}

TEST(ReadPreroll, IsInvariantToGainAndAmbientLight) {
  const std::vector<bool> code = PrerollCode(8);
  std::vector<double> levels = LevelsOf(code);
  for (double& level : levels) level = 0.1 * level + 300.0;
  EXPECT_TRUE(ReadPreroll(levels, code, 5.0).decoded);
}

TEST(ReadPreroll, RefusesADarkRig) {
  const std::vector<bool> code = PrerollCode(8);
  EXPECT_FALSE(ReadPreroll(std::vector<double>(8, 64.0), code, 5.0).decoded);
}

}  // namespace
}  // namespace stratalux::rig
