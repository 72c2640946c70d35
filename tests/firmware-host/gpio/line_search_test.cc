// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/gpio/line_search.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

GpioChip Chip(const std::string& path, const std::string& label, const std::vector<std::string>& names) {
  GpioChip chip{path, label, {}};
  for (const std::string& name : names) chip.lines.push_back({.name = name});
  return chip;
}

const std::vector<GpioChip> kChips = {Chip("/dev/gpiochip0", "pinctrl-rp1", {"ID_SDA", "ID_SCL", "GPIO2", ""}),
                                      Chip("/dev/gpiochip11", "expander", {"STOP", "GPIO2"})};

TEST(FindLine, ByNameWhateverTheChipsNumber) {
  EXPECT_EQ(FindLine(kChips, {"STOP", "", -1}).value(), (FoundLine{"/dev/gpiochip11", 0}));
}

TEST(FindLine, ByLabelAndOffset) {
  EXPECT_EQ(FindLine(kChips, {"", "pinctrl-rp1", 3}).value(), (FoundLine{"/dev/gpiochip0", 3}));
}

TEST(FindLine, ANameOnTwoChipsNeedsTheLabel) {
  const Status status = FindLine(kChips, {"GPIO2", "", -1}).status();
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("/dev/gpiochip0 offset 2, /dev/gpiochip11 offset 1"));
  EXPECT_EQ(FindLine(kChips, {"GPIO2", "expander", -1}).value(), (FoundLine{"/dev/gpiochip11", 1}));
}

TEST(FindLine, TwoChipsOfOneLabelAreTwoPossibilities) {
  const std::vector<GpioChip> twins = {Chip("/dev/gpiochip0", "mcp23017", {"", ""}),
                                       Chip("/dev/gpiochip1", "mcp23017", {"", ""})};
  EXPECT_EQ(FindLine(twins, {"", "mcp23017", 1}).status().code(), StatusCode::kUsage);
}

TEST(FindLine, WhatIsNotThereIsSaidWithWhatIs) {
  for (const LineAddress& address :
       {LineAddress{"GPIO99", "", -1}, LineAddress{"", "expander", 2}, LineAddress{"STOP", "pinctrl-rp1", -1}}) {
    const Status status = FindLine(kChips, address).status();
    EXPECT_EQ(status.code(), StatusCode::kNotFound);
    EXPECT_THAT(status.message(), HasSubstr("expander (/dev/gpiochip11)"));
  }
  EXPECT_THAT(FindLine(kChips, {"STOP", "gpiochip0", -1}).status().message(), HasSubstr("no chip has the label"));
  EXPECT_THAT(FindLine({}, {"STOP", "", -1}).status().message(), HasSubstr("no GPIO chip"));
}

// Unnamed lines must not answer to an empty name.
TEST(FindLine, AnAddressWithoutNameAndOffsetFindsNothing) {
  EXPECT_EQ(FindLine(kChips, {"", "expander", -1}).status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace stratalux::rig
