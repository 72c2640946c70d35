// SPDX-License-Identifier: Apache-2.0
// The kernel's lines against gpio-sim: what gpiod_line_bank_test cannot provoke from outside. Needs the same.
#include "firmware-host/gpio/gpio_adapter.h"

#include <chrono>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include "tests/firmware-host/gpio/gpio_sim.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

class GpioAdapterTest : public ::testing::Test {
 protected:
  void SetUp() override {
    sim_ = GpioSim::Create("stratalux-test", {"A", "B", "C", ""});
    if (!sim_) GTEST_SKIP() << "no gpio-sim on this machine (needs root and `modprobe gpio-sim`)";
    const Result<FoundLine> line = FindLine(ListChips(), {"A", "stratalux-test", -1});
    ASSERT_TRUE(line.ok()) << line.status().message();
    path_ = line->chip_path;
  }
  std::unique_ptr<GpioSim> sim_;
  std::string path_;
};

// Nobody reads while the kernel's buffer overflows: the kernel drops the oldest, and its numbers tell how many.
TEST_F(GpioAdapterTest, EdgesTheKernelDroppedAreMissingInTheNumbers) {
  const auto inputs = RequestInputs(path_, {{.offset = 1}});
  ASSERT_TRUE(inputs.ok()) << inputs.status().message();
  for (int i = 0; i < 1500; ++i) {
    sim_->Pull(1, true);
    std::this_thread::sleep_for(std::chrono::microseconds(500));  // gpio-sim merges edges that follow too soon
    sim_->Pull(1, false);
  }
  const auto events = (*inputs)->Read();
  ASSERT_TRUE(events.ok());
  EXPECT_EQ(events->size(), 1024U);
  EXPECT_GT(events->front().line_number, 1U);
  for (size_t i = 1; i < events->size(); ++i) EXPECT_EQ((*events)[i].line_number, (*events)[i - 1].line_number + 1);
  const auto none = (*inputs)->Read();
  ASSERT_TRUE(none.ok());
  EXPECT_TRUE(none->empty());
}

TEST_F(GpioAdapterTest, LowActiveLinesAndHighOnesShareARequest) {
  sim_->Pull(0, true);
  sim_->Pull(1, true);
  const auto inputs = RequestInputs(path_, {{.offset = 0}, {.offset = 1, .active = ActiveLevel::kLow}});
  ASSERT_TRUE(inputs.ok()) << inputs.status().message();
  EXPECT_EQ((*inputs)->ReadActive().value(), 0b01U);
  sim_->Pull(0, false);  // no activation of line 0
  sim_->Pull(1, false);  // one of line 1
  EXPECT_EQ((*inputs)->ReadActive().value(), 0b10U);
  pollfd waiting{(*inputs)->fd(), POLLIN, 0};
  ASSERT_EQ(poll(&waiting, 1, 10'000), 1);
  const auto events = (*inputs)->Read();
  ASSERT_TRUE(events.ok());
  ASSERT_EQ(events->size(), 1U);
  EXPECT_EQ(events->front().line, 1U);
}

TEST_F(GpioAdapterTest, OutputsSwitchTogether) {
  const auto outputs = RequestOutputs(path_, {2, 0}, 0b01);
  ASSERT_TRUE(outputs.ok()) << outputs.status().message();
  EXPECT_TRUE(sim_->Level(2));
  EXPECT_FALSE(sim_->Level(0));
  EXPECT_EQ((*outputs)->Write(0b10), 0);
  EXPECT_FALSE(sim_->Level(2));
  EXPECT_TRUE(sim_->Level(0));
  const auto second = RequestOutputs(path_, {0}, 0);
  EXPECT_EQ(second.status().code(), StatusCode::kBusy);
  EXPECT_THAT(second.status().message(), HasSubstr("stratalux-rig devices"));
  sim_->Unplug();
  EXPECT_NE((*outputs)->Write(0), 0);
  uint64_t levels = 0;
  EXPECT_NE((*outputs)->Read(levels), 0);
}

}  // namespace
}  // namespace stratalux::rig
