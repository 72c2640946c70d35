// SPDX-License-Identifier: Apache-2.0
// START, door and E-STOP as lines, opened as the rig opens them, over the scripted chip.
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include "firmware-host/gpio/gpio_lights.h"
#include "firmware-host/gpio/gpiod_line_bank.h"
#include "firmware-host/safety/light_guard.h"
#include "tests/firmware-host/safety/scripted_gpio.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

enum Line { kEnable, kEmergencyStop, kDoor, kStart };

class GpioEventsTest : public ::testing::Test {
 protected:
  void Open() {
    auto at = [](Line line) { return LineAddress{"LINE" + std::to_string(line), "scripted", -1}; };
    GpioWiring wiring;
    wiring.projectors.emplace_back().enable = OutputWiring{at(kEnable)};
    wiring.emergency_stop = InputWiring{at(kEmergencyStop)};
    wiring.door = InputWiring{at(kDoor)};
    wiring.start = InputWiring{at(kStart)};
    lights_ = GpioLights::Open(wiring, &events_).value();
    bank_ = GpiodLineBank::Open(wiring, logger_, &events_).value();
    guard_ = LightGuard::Start({{lights_->enable(0)}}, lights_->interlock(), stop_).value();
  }
  void SetUp() override { new (&TheGpio()) ScriptedGpio; }
  // What is told until `last` is, in words; on a loaded machine, too.
  std::vector<std::string> TellUntil(const std::string& last) {
    std::vector<std::string> told;
    const auto deadline = std::chrono::steady_clock::now() + 20s;
    while ((told.empty() || told.back() != last) && std::chrono::steady_clock::now() < deadline) {
      pollfd waiting{events_.fd(), POLLIN, 0};
      poll(&waiting, 1, 100);
      for (const RigEvent& event : events_.Take()) told.emplace_back(event.ToString());
    }
    return told;
  }
  static void Lower(Line line) { TheGpio().lines[line].level.store(0); }

  StopToken stop_;
  RigEvents events_{stop_};
  Logger logger_{LogLevel::kError};
  std::unique_ptr<GpioLights> lights_;
  std::unique_ptr<GpiodLineBank> bank_;
  std::unique_ptr<LightGuard> guard_;
};

TEST_F(GpioEventsTest, DoorAndEmergencyStopAreToldWhenTheyOpenAndWhenTheyClose) {
  Open();
  for (const auto& [line, opens, closes] : {std::tuple(kDoor, "door open", "door closed"),
                                            std::tuple(kEmergencyStop, "E-STOP pressed", "E-STOP released")}) {
    TheGpio().Raise(line, true);
    EXPECT_THAT(TellUntil(opens), ElementsAre(opens));
    EXPECT_TRUE(stop_.stopped());
    Lower(line);
    EXPECT_THAT(TellUntil(closes), ElementsAre(closes));
    ASSERT_TRUE(guard_->Reset().ok());
    TheGpio().Raise(line, false);
    EXPECT_THAT(TellUntil(closes), ElementsAre(opens, closes)) << "for a moment";
    ASSERT_TRUE(guard_->Reset().ok());
  }
}

TEST_F(GpioEventsTest, ADoorThatIsOpenWhenTheRigIsOpenedIsTold) {
  TheGpio().lines[kDoor].level.store(1);
  Open();
  EXPECT_THAT(TellUntil("door open"), ElementsAre("door open"));
}

TEST_F(GpioEventsTest, APressOfStartIsOneAndNoneWhenItIsLetGo) {
  Open();
  std::this_thread::sleep_for(500ms);  // seen at rest
  const MonotonicNs before = MonotonicNow();
  TheGpio().Raise(kStart, true);
  for (int bounce = 0; bounce < 5; ++bounce) TheGpio().Raise(kStart, true);
  EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
  std::this_thread::sleep_for(300ms);  // held
  for (int bounce = 0; bounce < 5; ++bounce) TheGpio().Raise(kStart, false);
  std::this_thread::sleep_for(500ms);
  EXPECT_THAT(events_.Take(), IsEmpty());
  EXPECT_EQ(events_.merged(), 0);
  TheGpio().Raise(kStart, false);
  EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
  EXPECT_LT(before, MonotonicNow());
}

TEST_F(GpioEventsTest, AStartThatIsHeldWhenTheRigIsOpenedStartsNothing) {
  TheGpio().lines[kStart].level.store(1);
  Open();
  std::this_thread::sleep_for(300ms);
  for (int bounce = 0; bounce < 3; ++bounce) TheGpio().Raise(kStart, false);
  std::this_thread::sleep_for(300ms);
  EXPECT_THAT(events_.Take(), IsEmpty());
}

TEST_F(GpioEventsTest, LinesThatCannotBeReadAreToldAsGone) {
  Open();
  TheGpio().lines[kDoor].refuse_reads.store(-1);
  EXPECT_THAT(TellUntil("GPIO lines gone"), ElementsAre("GPIO lines gone"));
  EXPECT_EQ(stop_.reason(), StopReason::kLinesGone);
  TheGpio().lines[kDoor].refuse_reads.store(0);
  EXPECT_THAT(TellUntil("GPIO lines back"), ElementsAre("GPIO lines back"));
  TheGpio().lines[kStart].refuse_reads.store(-1);
  EXPECT_THAT(TellUntil("GPIO lines gone"), ElementsAre("GPIO lines gone"));
}

}  // namespace
}  // namespace stratalux::rig
