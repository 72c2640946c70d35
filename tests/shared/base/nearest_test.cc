// SPDX-License-Identifier: Apache-2.0
#include "shared/base/nearest.h"

#include <gtest/gtest.h>

namespace stratalux {
namespace {

const std::vector<std::string> kNames = {"show", "ls", "verify", "missing-frames", "frames"};

TEST(Nearest, CountsInsertionsDeletionsReplacementsAndSwaps) {
  EXPECT_EQ(Nearest("shw", kNames), "show");
  EXPECT_EQ(Nearest("showw", kNames), "show");
  EXPECT_EQ(Nearest("shoe", kNames), "show");
  EXPECT_EQ(Nearest("shwo", kNames), "show");
  EXPECT_EQ(Nearest("sl", kNames), "ls") << "a swap is one change, not two";
  EXPECT_EQ(Nearest("missing-frame", kNames), "missing-frames");
  EXPECT_EQ(Nearest("mising-frmaes", kNames), "missing-frames");
}

TEST(Nearest, GuessesNothingThatIsFar) {
  EXPECT_EQ(Nearest("purge", kNames), std::nullopt);
  EXPECT_EQ(Nearest("", kNames), std::nullopt);
  EXPECT_EQ(Nearest("x", {}), std::nullopt);
  EXPECT_EQ(Nearest(std::string(1'000'000, 's'), kNames), std::nullopt) << "and takes no time for it";
}

TEST(UnknownName, SaysWhichOneWasMeantOrWhichThereAre) {
  EXPECT_EQ(UnknownName("command", "shwo", kNames), "no command 'shwo'; did you mean 'show'?");
  EXPECT_EQ(UnknownName("query", "purge", {"a", "b"}), "no query 'purge'; there are: a, b");
  EXPECT_EQ(UnknownName("command", "ls", kNames), "");
}

}  // namespace
}  // namespace stratalux
