// SPDX-License-Identifier: Apache-2.0
// Scripts and seeds of faults. What captures make of them: tests/firmware-host/soak.
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/fault_script.h"
#include "shared/config/toml_reader.h"

namespace stratalux::rig {
namespace {

TEST(Faults, SeedsDecideAndRepeat) {
  const FaultOptions options{{}, 7, 0.1, {}};
  const FaultScript one(options), same(options), other({{}, 8, 0.1, {}});
  int ones = 0, differences = 0;
  for (int64_t n = 0; n < 5000; ++n) {
    const auto a = one.AtExposure(n), b = same.AtExposure(n), c = other.AtExposure(n);
    ASSERT_EQ(a.size(), b.size());
    if (!a.empty()) {
      ASSERT_EQ(a[0].kind, b[0].kind);
      EXPECT_FALSE(IsLineFault(a[0].kind));
      ++ones;
    }
    differences += a.size() != c.size();
    for (const Fault& fault : one.AtPulse(n)) EXPECT_TRUE(IsLineFault(fault.kind));
  }
  EXPECT_NEAR(ones, 500, 5 * std::sqrt(450.0));
  EXPECT_GT(differences, 500);
}

TEST(Faults, ComeInRunsAndInPairsOfTwoKinds) {
  FaultOptions options{{}, 7, 0.02, {}};
  const FaultScript alone(options);
  options.burst = 5;
  options.pair = 0.3;
  const FaultScript script(options);
  int faulty = 0, pairs = 0, run = 0, longest = 0;
  for (int64_t n = 0; n < 20000; ++n) {
    const auto faults = script.AtExposure(n);
    EXPECT_TRUE(alone.AtExposure(n).empty() || !faults.empty()) << "a run begins where a single fault would be";
    run = faults.empty() ? 0 : run + 1;
    longest = std::max(longest, run);
    faulty += !faults.empty();
    if (faults.size() < 2) continue;
    EXPECT_NE(faults[0].kind, faults[1].kind);
    ++pairs;
  }
  EXPECT_NEAR(faulty, 400.0 * 3.0, 150.0);  // runs of 3 on average, less where they meet
  EXPECT_NEAR(pairs, 0.3 * faulty, 5.0 * std::sqrt(0.21 * faulty));
  EXPECT_GE(longest, 5);
}

TEST(Faults, TextAndTablesAreReadAndWrongOnesNamed) {
  const auto fault = ParseFault("lamp_drift@40x3=0.95");
  ASSERT_TRUE(fault.ok());
  EXPECT_EQ(fault->kind, FaultKind::kLampDrift);
  EXPECT_EQ(fault->at, 40);
  EXPECT_EQ(fault->count, 3);
  EXPECT_EQ(fault->value, 0.95);
  for (const char* wrong :
       {"frame_lost", "frame_lost@", "frame_lost@x", "frame_lost@-1", "lost@3", "frame_lost@3x0", "frame_lost@3=", "@3",
        "", "frame_lost@3 ", "lamp_drift@0=nan", "frame_late@3=inf", "lamp_drift@0=-inf", "lamp_drift@0=1e7",
        "frame_lost@1x9223372036854775807", "frame_lost@1073741825"})
    EXPECT_EQ(ParseFault(wrong).status().code(), StatusCode::kUsage) << wrong;
  auto root = TomlTable::ParseText(
      "[[fault]]\nkind = \"edge_lost\"\nat = 3\n[faults]\nrate = 0.5\nkinds = [\"frame_lost\"]\nburst = 3\npair = "
      "0.25\n",
      "f.toml");
  const auto faults = ReadFaults(*root);
  ASSERT_TRUE(faults.ok() && root->Finish().ok());
  EXPECT_EQ(faults->script[0].kind, FaultKind::kEdgeLost);
  EXPECT_EQ(faults->kinds[0], FaultKind::kFrameLost);
  EXPECT_EQ(faults->burst, 3);
  EXPECT_EQ(faults->pair, 0.25);
  auto sway = TomlTable::ParseText(
      "[[fault]]\nkind = \"subject_swayed\"\nat = 3\ncount = 9\nvalue = 0.5\nalong = [0, 0, 2]\n", "f.toml");
  const auto swayed = ReadFaults(*sway);
  ASSERT_TRUE(swayed.ok() && sway->Finish().ok());
  EXPECT_EQ(swayed->script[0].along, (std::array<double, 3>{0, 0, 2}));
  for (const char* wrong : {"[0, 0, 0]", "[1, 2]"}) {
    auto nowhere = TomlTable::ParseText(
        "[[fault]]\nkind = \"subject_swayed\"\nat = 3\nalong = " + std::string(wrong) + "\n", "f.toml");
    EXPECT_EQ(ReadFaults(*nowhere).status().code(), StatusCode::kUsage) << wrong;
  }
  auto unknown = TomlTable::ParseText("[[fault]]\nkind = \"gremlin\"\nat = 3\n", "f.toml");
  EXPECT_THAT(ReadFaults(*unknown).status().message(), ::testing::HasSubstr("f.toml:2"));
}

}  // namespace
}  // namespace stratalux::rig
