// SPDX-License-Identifier: Apache-2.0
// The real lines against gpio-sim. Needs root and the kernel module gpio-sim (tests/rig-vm has it), no environment
// variables; skipped elsewhere.
#include "firmware-host/gpio/gpiod_line_bank.h"

#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <latch>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include "firmware-host/gpio/gpio_lights.h"
#include "firmware-host/safety/light_guard.h"
#include "shared/base/check.h"
#include "tests/firmware-host/gpio/gpio_sim.h"
#include "tests/support/text_of.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

enum Line { kEnable0, kTrigger0, kSync0, kReset0, kEnable1, kTrigger1, kSync1, kCamera, kStrobe, kStop, kDoor, kStart };
const std::vector<std::string> kNames = {"ENABLE0", "TRIGGER0", "SYNC0",  "RESET0",         "ENABLE1", "TRIGGER1",
                                         "SYNC1",   "CAMERA",   "STROBE", "EMERGENCY_STOP", "DOOR",    "START"};
constexpr const char* kLabel = "stratalux-test";

class GpiodLineBankTest : public ::testing::Test {
 public:
  void SetUp() override {
    sim_ = GpioSim::Create(kLabel, kNames);
    if (!sim_) GTEST_SKIP() << "no gpio-sim on this machine (needs root and `modprobe gpio-sim`)";
    log_ = std::tmpfile();
    logger_ = std::make_unique<Logger>(LogLevel::kInfo, log_);
    for (int p = 0; p < 2; ++p) {
      ProjectorLines& lines = wiring_.projectors.emplace_back();
      lines.enable = Output("ENABLE" + std::to_string(p));
      lines.trigger = Output("TRIGGER" + std::to_string(p));
      lines.sync = Input("SYNC" + std::to_string(p));
    }
    // The second projector's light is on while its line is low.
    wiring_.projectors[1].enable->active = ActiveLevel::kLow;
    wiring_.projectors[0].reset = Output("RESET0");
    wiring_.camera_trigger = Output("CAMERA");
    wiring_.strobe = Input("STROBE");
    wiring_.emergency_stop = Input("EMERGENCY_STOP");
    wiring_.door = Input("DOOR");
    wiring_.door->active = ActiveLevel::kLow;
    wiring_.start = Input("START");
    sim_->Pull(kDoor, true);
  }
  void TearDown() override {
    guard_.reset();
    bank_.reset();
    lights_.reset();
    if (log_ != nullptr) std::fclose(log_);
  }

  static LineAddress At(const std::string& name) { return {name, kLabel, -1}; }
  static OutputWiring Output(const std::string& name) { return {At(name)}; }
  static InputWiring Input(const std::string& name) { return {At(name)}; }

  void Open() {
    Result<std::unique_ptr<GpioLights>> lights = GpioLights::Open(wiring_, &events_);
    ASSERT_TRUE(lights.ok()) << lights.status().message();
    lights_ = std::move(lights).value();
    Result<std::unique_ptr<GpiodLineBank>> bank = GpiodLineBank::Open(wiring_, *logger_, &events_);
    ASSERT_TRUE(bank.ok()) << bank.status().message();
    bank_ = std::move(bank).value();
    Result<std::unique_ptr<LightGuard>> guard =
        LightGuard::Start({{lights_->enable(0)}, {lights_->enable(1)}}, lights_->interlock(), stop_);
    ASSERT_TRUE(guard.ok()) << guard.status().message();
    guard_ = std::move(guard).value();
  }
  [[nodiscard]] std::vector<OutputWiring> Enables() const {
    return {*wiring_.projectors[0].enable, *wiring_.projectors[1].enable};
  }
  Status On(int projector) { return guard_->On(projector, {1h, 1h}); }
  void PulseInput(Line line) {
    // gpio-sim merges edges that follow too soon, and the kernel threads of two lines may overtake each other.
    sim_->Pull(line, true);
    std::this_thread::sleep_for(5ms);
    sim_->Pull(line, false);
    std::this_thread::sleep_for(5ms);
  }
  [[nodiscard]] bool Lit(int projector) const {
    return projector == 0 ? sim_->Level(kEnable0) : !sim_->Level(kEnable1);
  }
  // Nobody asks the guard: its own thread sees it.
  StopReason AwaitStop() {
    stop_.Sleep(10s);
    const auto deadline = std::chrono::steady_clock::now() + 10s;
    while ((Lit(0) || Lit(1)) && std::chrono::steady_clock::now() < deadline) std::this_thread::sleep_for(1ms);
    return stop_.reason();
  }
  // What is told until `last` comes, in words.
  std::vector<std::string> TellUntil(const std::string& last) {
    std::vector<std::string> told;
    const auto deadline = std::chrono::steady_clock::now() + 10s;
    while ((told.empty() || told.back() != last) && std::chrono::steady_clock::now() < deadline) {
      pollfd waiting{events_.fd(), POLLIN, 0};
      poll(&waiting, 1, 100);
      for (const RigEvent& event : events_.Take()) told.push_back(event.ToString());
    }
    return told;
  }
  std::string LogText() {
    EXPECT_TRUE(logger_->Flush());
    return TextOf(log_);
  }

  std::unique_ptr<GpioSim> sim_;
  std::FILE* log_ = nullptr;
  std::unique_ptr<Logger> logger_;
  GpioWiring wiring_;
  StopToken stop_;
  RigEvents events_{stop_};
  std::unique_ptr<GpioLights> lights_;
  std::unique_ptr<GpiodLineBank> bank_;
  std::unique_ptr<LightGuard> guard_;
};

TEST_F(GpiodLineBankTest, OpensDarkAndSwitchesEachLightByItsPolarity) {
  Open();
  EXPECT_FALSE(Lit(0));
  EXPECT_FALSE(Lit(1));
  ASSERT_TRUE(On(1).ok());
  EXPECT_FALSE(Lit(0));
  EXPECT_TRUE(Lit(1));
  ASSERT_TRUE(On(0).ok());
  ASSERT_TRUE(guard_->Off(1).ok());
  EXPECT_TRUE(Lit(0));
  EXPECT_FALSE(Lit(1));
  EXPECT_EQ(On(2).code(), StatusCode::kUsage);
}

TEST_F(GpiodLineBankTest, AllOffIsAllOff) {
  Open();
  ASSERT_TRUE(On(0).ok());
  ASSERT_TRUE(On(1).ok());
  ASSERT_TRUE(guard_->AllOff().ok());
  EXPECT_FALSE(Lit(0));
  EXPECT_FALSE(Lit(1));
}

TEST_F(GpiodLineBankTest, PulsesEndLowAndAreCounted) {
  Open();
  const auto first = bank_->TriggerProjector(-1);
  const auto second = bank_->TriggerCamera();
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(first->number, 0);
  EXPECT_EQ(second->number, 1);
  EXPECT_LT(first->time, second->time);
  for (const Line line : {kTrigger0, kTrigger1, kCamera}) EXPECT_FALSE(sim_->Level(line));
  EXPECT_EQ(bank_->TriggerProjector(5).status().code(), StatusCode::kUsage);
  EXPECT_TRUE(bank_->ResetMemory(0).ok());
  EXPECT_EQ(bank_->ResetMemory(1).code(), StatusCode::kUsage) << "projector 1 has no RESET line";
}

TEST_F(GpiodLineBankTest, APulseIsSeenOutside) {
  wiring_.camera_pulse = 1s;
  Open();
  bool high = false;
  std::latch watching(1);  // on a busy machine a thread may start later than a pulse ends
  std::thread watcher([&] {
    const auto deadline = std::chrono::steady_clock::now() + 10s;
    EXPECT_FALSE(sim_->Level(kCamera));
    watching.count_down();
    while (!high && std::chrono::steady_clock::now() < deadline) high = sim_->Level(kCamera);
  });
  watching.wait();
  EXPECT_TRUE(bank_->TriggerCamera().ok());
  watcher.join();
  EXPECT_TRUE(high);
}

TEST_F(GpiodLineBankTest, EdgesCarryTheirProjectorNumberAndKernelTime) {
  Open();
  const MonotonicNs before = MonotonicNow();
  PulseInput(kSync1);
  PulseInput(kSync0);
  PulseInput(kSync1);
  const struct {
    int projector;
    int64_t sequence;
  } expected[] = {{1, 0}, {0, 0}, {1, 1}};
  MonotonicNs last = before;
  for (const auto& e : expected) {
    const auto edge = bank_->WaitSync(10s);
    ASSERT_TRUE(edge.ok() && edge->has_value());
    EXPECT_EQ((*edge)->projector, e.projector);
    EXPECT_EQ((*edge)->sequence, e.sequence);
    EXPECT_LE(last, (*edge)->time);
    last = (*edge)->time;
  }
  EXPECT_LE(last, MonotonicNow());
  EXPECT_EQ(bank_->SyncCount(1), 2);
  const auto none = bank_->WaitSync(0ns);
  ASSERT_TRUE(none.ok());
  EXPECT_FALSE(none->has_value());
}

// More edges than the bank keeps for those who do not wait: it drops the oldest, and the numbers show it.
TEST_F(GpiodLineBankTest, ALostEdgeLeavesAGap) {
  Open();
  const auto deadline = std::chrono::steady_clock::now() + 60s;
  while (bank_->SyncCount(0) < 5000 && std::chrono::steady_clock::now() < deadline) {
    sim_->Pull(kSync0, true);
    sim_->Pull(kSync0, false);
  }
  ASSERT_GE(bank_->SyncCount(0), 5000);
  int64_t last = -1, seen = 0, missing = 0;
  while (true) {
    const auto edge = bank_->WaitSync(500ms);
    ASSERT_TRUE(edge.ok());
    if (!*edge) break;
    EXPECT_GT((*edge)->sequence, last);
    missing += (*edge)->sequence - last - 1;
    last = (*edge)->sequence;
    ++seen;
  }
  EXPECT_EQ(last + 1, bank_->SyncCount(0));
  EXPECT_GT(missing, 0);
  EXPECT_EQ(seen + missing, last + 1);
}

TEST_F(GpiodLineBankTest, EmergencyStopTakesTheLightAndHoldsIt) {
  Open();
  ASSERT_TRUE(On(0).ok());
  ASSERT_TRUE(On(1).ok());
  PulseInput(kStop);  // pressed for a moment
  EXPECT_EQ(AwaitStop(), StopReason::kEmergencyStop);
  EXPECT_FALSE(Lit(0));
  EXPECT_FALSE(Lit(1));
  EXPECT_FALSE(On(0).ok());
  EXPECT_FALSE(Lit(0));
  EXPECT_TRUE(guard_->Reset().ok());
  EXPECT_TRUE(On(0).ok());
  EXPECT_TRUE(Lit(0));
}

TEST_F(GpiodLineBankTest, AnOpenDoorCannotBeReset) {
  Open();
  ASSERT_TRUE(On(0).ok());
  sim_->Pull(kDoor, false);
  EXPECT_EQ(AwaitStop(), StopReason::kDoorOpen);
  EXPECT_FALSE(Lit(0));
  EXPECT_FALSE(guard_->Reset().ok());
  sim_->Pull(kDoor, true);
  EXPECT_TRUE(guard_->Reset().ok());
}

TEST_F(GpiodLineBankTest, APressedEmergencyStopIsSeenAtOpening) {
  sim_->Pull(kStop, true);
  Open();
  EXPECT_EQ(stop_.reason(), StopReason::kEmergencyStop);
  EXPECT_FALSE(On(0).ok());
}

TEST_F(GpiodLineBankTest, AnUnpluggedChipIsAnErrorNotAHang) {
  Open();
  ASSERT_TRUE(On(0).ok());
  std::thread world([this] {
    std::this_thread::sleep_for(100ms);
    sim_->Unplug();
  });
  const auto started = std::chrono::steady_clock::now();
  const auto edge = bank_->WaitSync(60s);
  world.join();
  EXPECT_FALSE(edge.ok());
  EXPECT_LT(std::chrono::steady_clock::now() - started, 30s);
  stop_.Sleep(10s);
  EXPECT_EQ(stop_.reason(), StopReason::kLinesGone);
  EXPECT_FALSE(bank_->TriggerProjector(0).ok());
  EXPECT_FALSE(On(0).ok());
  EXPECT_FALSE(guard_->AllOff().ok());
  EXPECT_FALSE(guard_->Reset().ok());
  EXPECT_THAT(LogText(), HasSubstr("GPIO lines are gone"));
}

TEST_F(GpiodLineBankTest, StartAndStrobeAreTimed) {
  Open();
  EXPECT_FALSE(bank_->LastStrobe().has_value());
  const MonotonicNs before = MonotonicNow();
  PulseInput(kStrobe);
  std::this_thread::sleep_for(500ms);  // seen at rest
  sim_->Pull(kStart, true);
  for (int bounce = 0; bounce < 3; ++bounce) PulseInput(kStart);
  EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
  EXPECT_EQ(events_.merged(), 0) << "bounces are no presses";
  ASSERT_TRUE(bank_->LastStrobe().has_value());
  EXPECT_LE(before, *bank_->LastStrobe());
}

TEST_F(GpiodLineBankTest, DoorAndEmergencyStopAreToldWhenTheyOpenAndWhenTheyClose) {
  Open();
  sim_->Pull(kDoor, false);  // active low
  EXPECT_THAT(TellUntil("door open"), ElementsAre("door open"));
  sim_->Pull(kDoor, true);
  EXPECT_THAT(TellUntil("door closed"), ElementsAre("door closed"));
  PulseInput(kStop);
  EXPECT_THAT(TellUntil("E-STOP released"), ElementsAre("E-STOP pressed", "E-STOP released"));
}

TEST_F(GpiodLineBankTest, LinesInUseAreBusyAndCannotBeMadeSafeByAnother) {
  Open();
  EXPECT_EQ(GpiodLineBank::Open(wiring_, *logger_).status().code(), StatusCode::kBusy);
  EXPECT_EQ(GpioLights::Open(wiring_).status().code(), StatusCode::kBusy);
  const Status safe = DriveEnablesOff(Enables());
  EXPECT_EQ(safe.code(), StatusCode::kBusy);
  EXPECT_THAT(safe.message(), HasSubstr("ENABLE of projector 0"));
}

// A released line of gpio-sim goes back to its pull, so that darkness can only be seen while it is held.
TEST_F(GpiodLineBankTest, SafeDrivesEveryEnableOff) {
  sim_->Pull(kEnable0, true);
  sim_->Pull(kEnable1, false);
  ASSERT_TRUE(Lit(0) && Lit(1)) << "pulled to light";
  std::atomic<bool> dark[2] = {false, false}, stop = false;
  std::thread watcher([&] {
    while (!stop)
      for (int p = 0; p < 2; ++p)
        if (!Lit(p)) dark[p] = true;
  });
  const auto deadline = std::chrono::steady_clock::now() + 20s;
  while (!(dark[0] && dark[1]) && std::chrono::steady_clock::now() < deadline) {
    if (!DriveEnablesOff(Enables()).ok()) break;
  }
  stop = true;
  watcher.join();
  EXPECT_TRUE(dark[0]);
  EXPECT_TRUE(dark[1]);
}

GpiodLineBankTest* g_failing_test = nullptr;

// In the process that fails: between the hook and its end, the lines are still held.
TEST_F(GpiodLineBankTest, AFailedCheckTakesTheLight) {
  sim_->Pull(kEnable0, true);
  sim_->Pull(kEnable1, false);
  g_failing_test = this;
  EXPECT_EXIT(
      {
        Open();
        static_cast<void>(On(0));
        static_cast<void>(On(1));
        if (!Lit(0) || !Lit(1)) std::_Exit(3);
        std::signal(SIGABRT, [](int) { std::_Exit(g_failing_test->Lit(0) || g_failing_test->Lit(1) ? 4 : 0); });
        SLX_CHECK(1 + 1 == 3);
      },
      ::testing::ExitedWithCode(0), "check failed");
}

TEST_F(GpiodLineBankTest, AWrongNameNamesTheChips) {
  wiring_.projectors[0].enable = Output("NO_SUCH_LINE");
  const auto lights = GpioLights::Open(wiring_);
  EXPECT_EQ(lights.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(lights.status().message(), HasSubstr(kLabel));
}

}  // namespace
}  // namespace stratalux::rig
