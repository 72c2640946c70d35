// SPDX-License-Identifier: Apache-2.0
// What visitor, operator and cables do to a station on the simulated rig, told from outside where a program would be.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/stat.h>

#include "firmware-host/session/capture_station.h"
#include "firmware-host/session/start_wait.h"
#include "tests/firmware-host/session/small_station.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

using namespace std::chrono_literals;
using ::testing::AnyOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using enum RigSignal;
using enum SignalLevel;

class SurroundingsTest : public ScratchFolderTest {
 protected:
  SurroundingsTest() : options_(SmallStation(folder_)) { request_.plan = options_.config.plan; }
  ~SurroundingsTest() override {
    station_.reset();
    std::fclose(log_);
  }
  void Open() {
    auto station = CaptureStation::Open(options_, stop_, logger_);
    ASSERT_TRUE(station.ok()) << station.status().message();
    station_ = std::move(*station);
  }
  void Happen(RigSignal signal, SignalLevel level) { station_->rig().simulation->Happen(signal, level); }
  // What is told until `last` is, in words.
  std::vector<std::string> TellUntil(const std::string& last) {
    std::vector<std::string> told;
    const auto deadline = std::chrono::steady_clock::now() + 20s;
    while ((told.empty() || told.back() != last) && std::chrono::steady_clock::now() < deadline) {
      pollfd waiting{station_->events().fd(), POLLIN, 0};
      poll(&waiting, 1, 100);
      for (const RigEvent& event : station_->events().Take()) told.emplace_back(event.ToString());
    }
    return told;
  }
  [[nodiscard]] bool Dark() const {
    const auto switches = station_->rig().simulation->switches();
    return std::none_of(switches.begin(), switches.end(), [](LightSwitch* light) {
      bool on = true;
      return light->Read(on) != 0 || on;
    });
  }
  std::string LogText() {
    EXPECT_TRUE(logger_.Flush());
    return ReadText(folder_ / "log");
  }
  // Until the log says it, behind what was awaited before; who says it may be another thread.
  void AwaitLog(const std::string& text) {
    const auto deadline = std::chrono::steady_clock::now() + 20s;
    size_t at = std::string::npos;
    while ((at = LogText().find(text, read_)) == std::string::npos && std::chrono::steady_clock::now() < deadline)
      std::this_thread::sleep_for(1ms);
    ASSERT_NE(at, std::string::npos) << text << ", in: " << LogText();
    read_ = at + text.size();
  }
  void ExpectComplete() {
    const auto outcome = station_->Capture(request_);
    ASSERT_TRUE(outcome.ok()) << outcome.status().message();
    EXPECT_EQ(outcome->report.status, SessionStatus::kComplete)
        << (outcome->report.Reasons().empty() ? "" : outcome->report.Reasons().front());
  }
  // At step 40 of a capture.
  class At40 final : public CaptureObserver {
   public:
    explicit At40(std::function<void()> act) : act_(std::move(act)) {}
    Status BeforeShot(const PlanStep& step, int retry) override {
      if (step.index == 40 && retry == 0) act_();
      return Status::Ok();
    }

   private:
    std::function<void()> act_;
  };

  StationOptions options_;
  CaptureRequest request_;
  StopToken stop_;
  std::FILE* log_ = std::fopen((folder_ / "log").c_str(), "a");
  size_t read_ = 0;  // of the log
  Logger logger_{LogLevel::kInfo, log_};
  std::unique_ptr<CaptureStation> station_;
};

TEST_F(SurroundingsTest, AnUnpluggedCameraEndsTheCaptureAndTheNextVisitWorksOnceItIsBack) {
  Open();
  for (int visit = 0; visit < 2; ++visit) {
    At40 unplugs([this] { Happen(kCamera, kActive); });
    const auto lost = station_->Capture(request_, &unplugs);
    ASSERT_TRUE(lost.ok()) << lost.status().message();
    EXPECT_TRUE(Dark());
    EXPECT_EQ(lost->report.status, SessionStatus::kFailed);
    EXPECT_EQ(lost->report.findings.front().kind, FindingKind::kStopped);
    EXPECT_THAT(lost->report.Reasons().front(), HasSubstr("the camera was unplugged"));
    EXPECT_THAT(TellUntil("camera unplugged"), ElementsAre("camera unplugged"));
    // Nothing begins before it is back, whatever was reset.
    EXPECT_EQ(station_->ReopenCamera().code(), StatusCode::kNotFound);
    EXPECT_FALSE(station_->Capture(request_).ok());
    ASSERT_TRUE(station_->light().Reset().ok());
    EXPECT_THAT(station_->Capture(request_).status().message(), HasSubstr("the camera is unplugged"));
    EXPECT_FALSE(station_->Snap(16.0).ok());
    Happen(kCamera, kRest);
    EXPECT_THAT(TellUntil("camera plugged in"), ElementsAre("camera plugged in"));
    ASSERT_TRUE(station_->ReopenCamera().ok());
    ExpectComplete();
  }
}

TEST_F(SurroundingsTest, ReopeningTheCameraLiftsNoOtherStop) {
  Open();
  Happen(kDoor, kActive);
  ASSERT_TRUE(stop_.Sleep(20s));
  Happen(kCamera, kActive);
  Happen(kCamera, kRest);
  ASSERT_TRUE(station_->ReopenCamera().ok());
  EXPECT_EQ(stop_.reason(), StopReason::kDoorOpen);
  EXPECT_FALSE(station_->light().Reset().ok()) << "it is open";
  Happen(kDoor, kRest);
  ASSERT_TRUE(station_->light().Reset().ok());
  ExpectComplete();
}

TEST_F(SurroundingsTest, DoorAndEmergencyStopTakeTheLightAndAreTold) {
  Open();
  for (const auto& [signal, opened, closed, reason] :
       {std::tuple(kDoor, "door open", "door closed", StopReason::kDoorOpen),
        std::tuple(kEmergencyStop, "E-STOP pressed", "E-STOP released", StopReason::kEmergencyStop)}) {
    At40 opens([this, which = signal] { Happen(which, kActive); });
    const auto stopped = station_->Capture(request_, &opens);
    ASSERT_TRUE(stopped.ok()) << stopped.status().message();
    EXPECT_EQ(stopped->report.status, SessionStatus::kFailed);
    EXPECT_THAT(stopped->report.Reasons().front(), HasSubstr(ToString(reason)));
    EXPECT_TRUE(Dark());
    EXPECT_THAT(TellUntil(opened), ElementsAre(opened));
    EXPECT_FALSE(station_->light().Reset().ok());
    Happen(signal, kRest);
    EXPECT_THAT(TellUntil(closed), ElementsAre(closed));
    ASSERT_TRUE(station_->light().Reset().ok());
  }
  // Nobody captures: the guard sees it all the same.
  Happen(kEmergencyStop, kActive);
  Happen(kEmergencyStop, kRest);
  EXPECT_TRUE(stop_.Sleep(20s));
  EXPECT_EQ(stop_.reason(), StopReason::kEmergencyStop) << "pressed for a moment";
}

TEST_F(SurroundingsTest, ScriptedFaultsAreToldAsWhatTheyStandFor) {
  options_.simulated->faults.script = {*ParseFault("emergency_stop@30")};
  Open();
  const auto stopped = station_->Capture(request_);
  ASSERT_TRUE(stopped.ok());
  EXPECT_EQ(stopped->report.status, SessionStatus::kFailed);
  EXPECT_THAT(TellUntil("E-STOP released"), ElementsAre("E-STOP pressed", "E-STOP released"));
}

TEST_F(SurroundingsTest, LinesThatGoEndTheCapture) {
  Open();
  At40 unplugs([this] { Happen(kLines, kActive); });
  const auto lost = station_->Capture(request_, &unplugs);
  ASSERT_TRUE(lost.ok());
  EXPECT_EQ(lost->report.status, SessionStatus::kFailed);
  EXPECT_THAT(lost->report.Reasons().front(), AnyOf(HasSubstr("GPIO lines gone"), HasSubstr("the chip is gone")));
  EXPECT_TRUE(Dark());
  EXPECT_THAT(TellUntil("GPIO lines gone"), ElementsAre("GPIO lines gone"));
  Happen(kStart, kActive);
  EXPECT_THAT(station_->events().Take(), IsEmpty()) << "a button on lines that are gone";
  Happen(kLines, kRest);
  ASSERT_TRUE(station_->light().Reset().ok());
  ExpectComplete();
}

TEST_F(SurroundingsTest, StartDuringACaptureIsSaidAndStartsNothing) {
  Open();
  At40 presses([this] {
    for (int i = 0; i < 3; ++i) Happen(kStart, kActive);
  });
  const auto outcome = station_->Capture(request_, &presses);
  ASSERT_TRUE(outcome.ok());
  EXPECT_EQ(outcome->report.status, SessionStatus::kComplete);
  EXPECT_THAT(station_->events().Take(), IsEmpty()) << "queued for the next visitor";
  EXPECT_EQ(station_->events().dropped_starts(), 3);
  EXPECT_THAT(LogText(), HasSubstr("START was pressed during the capture (3 times)"));
  Happen(kStart, kActive);
  EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
}

class StartWaitTest : public SurroundingsTest {
 protected:
  void Begin() {
    Open();
    BeginWaiting();
  }
  void BeginWaiting() {
    waiting_ = std::thread([this] { ended_ = AwaitStart(*station_, stop_, logger_); });
    AwaitLog("waiting for START");
  }
  Status End() {
    waiting_.join();
    return ended_;
  }
  Status ended_;
  std::thread waiting_;
};

TEST_F(StartWaitTest, StartEndsItAndWhatWasPressedBeforeDoesNot) {
  Open();
  Happen(kStart, kActive);
  BeginWaiting();
  EXPECT_TRUE(Dark());
  std::this_thread::sleep_for(50ms);
  EXPECT_THAT(LogText(), Not(HasSubstr("refused")));
  Happen(kStart, kActive);
  EXPECT_TRUE(End().ok());
  ExpectComplete();
}

TEST_F(StartWaitTest, WhatSpeaksAgainstItIsSaidUntilItIsOver) {
  Begin();
  for (const auto& [signal, opened, closed] :
       {std::tuple(kDoor, "door open", "door closed"), std::tuple(kEmergencyStop, "E-STOP pressed", "E-STOP released"),
        std::tuple(kCamera, "camera unplugged", "camera plugged in")}) {
    Happen(signal, kActive);
    AwaitLog(std::string(opened) + ": START is refused until that is over");
    Happen(kStart, kActive);
    AwaitLog(std::string("START refused: ") + opened);
    Happen(signal, kRest);
    AwaitLog(closed);
    AwaitLog("START is accepted again");
    EXPECT_FALSE(stop_.stopped());
  }
  Happen(kStart, kActive);
  EXPECT_TRUE(End().ok());
  ExpectComplete();
}

TEST_F(StartWaitTest, ADoorThatWasOpenBeforeIsWaitedForToo) {
  Open();
  Happen(kDoor, kActive);
  BeginWaiting();
  AwaitLog("door open: START is refused until that is over");
  Happen(kDoor, kRest);
  AwaitLog("START is accepted again");
  Happen(kStart, kActive);
  EXPECT_TRUE(End().ok());
}

TEST_F(StartWaitTest, AnOperatorEndsItAlsoBehindAnOpenDoor) {
  for (const bool open : {false, true}) {
    if (!station_) {
      Begin();
    } else {
      BeginWaiting();
    }
    if (open) {
      Happen(kDoor, kActive);
      AwaitLog("door open: START is refused");
      ASSERT_TRUE(stop_.Sleep(20s));
    }
    stop_.Request(StopReason::kOperator);
    EXPECT_THAT(End().message(), HasSubstr("interrupted"));
    if (open) {
      // It was not answered by what reset the door.
      Happen(kDoor, kRest);
      EXPECT_TRUE(station_->light().Reset().ok());
      EXPECT_EQ(stop_.reason(), StopReason::kOperator);
    }
    ASSERT_TRUE(station_->light().Reset().ok());
    EXPECT_FALSE(stop_.stopped());
  }
}

// Between two visits nobody listens: the next wait opens what went and came.
TEST_F(StartWaitTest, ACameraThatWentAndCameBeforeIsOpenedAgain) {
  Open();
  Happen(kCamera, kActive);
  Happen(kCamera, kRest);
  BeginWaiting();
  AwaitLog("START is accepted again");
  Happen(kStart, kActive);
  EXPECT_TRUE(End().ok());
  ExpectComplete();
}

TEST_F(StartWaitTest, LinesThatGoEndIt) {
  Begin();
  Happen(kLines, kActive);
  EXPECT_THAT(End().message(), HasSubstr("GPIO lines gone"));
}

class ControlPipeTest : public SurroundingsTest {
 protected:
  ControlPipeTest() : pipe_(folder_ / "rig") { options_.simulated->control_pipe = pipe_; }
  void Say(const std::string& text) const { std::ofstream(pipe_) << text << std::flush; }
  const std::filesystem::path pipe_;
};

TEST_F(ControlPipeTest, WhatIsSaidOutsideHappens) {
  Open();
  const auto mode = std::filesystem::status(pipe_);
  EXPECT_EQ(mode.type(), std::filesystem::file_type::fifo);
  EXPECT_EQ(mode.permissions(), std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  // Several writers, one after the other and at once.
  Say("door open\n");
  EXPECT_THAT(TellUntil("door open"), ElementsAre("door open"));
  EXPECT_TRUE(stop_.Sleep(20s));
  EXPECT_EQ(stop_.reason(), StopReason::kDoorOpen);
  std::ofstream one(pipe_), other(pipe_);
  one << "door closed\r\n" << std::flush;
  EXPECT_THAT(TellUntil("door closed"), ElementsAre("door closed"));
  other << "\n  start \n" << std::flush;
  EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
  one << "estop press\nestop release\nunplug camera\nplug camera\n" << std::flush;
  EXPECT_THAT(TellUntil("camera plugged in"),
              ElementsAre("E-STOP pressed", "E-STOP released", "camera unplugged", "camera plugged in"));
  station_.reset();
  EXPECT_FALSE(std::filesystem::exists(pipe_)) << "made and left behind";
}

TEST_F(ControlPipeTest, WhatIsNothingIsAnsweredInTheLogAndNothingElseComesOfIt) {
  Open();
  Say("open sesame\n" + std::string(5000, 'x') + "\ndoor open\n");
  EXPECT_THAT(TellUntil("door open"), ElementsAre("door open"));
  AwaitLog("'open sesame' is not an event of a rig; there are: door closed, door open");
  AwaitLog("a line of more than 200 bytes was dropped");
}

TEST_F(ControlPipeTest, HalfALineOfAWriterThatDiedIsNotTheNextOnesBeginning) {
  Open();
  for (int i = 0; i < 3; ++i) {
    Say("door o");
    AwaitLog("a line without an end was dropped");
    Say("start\n");
    EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
  }
}

TEST_F(ControlPipeTest, OnePipeHasOneReader) {
  Open();
  StopToken stop;
  const auto second = CaptureStation::Open(options_, stop, logger_);
  EXPECT_EQ(second.status().code(), StatusCode::kBusy) << second.status().message();
  Say("start\n");
  EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
  EXPECT_TRUE(std::filesystem::exists(pipe_)) << "taken away by who could not have it";
}

TEST_F(ControlPipeTest, OneThatIsThereIsTakenIfItIsOursAloneAndLeftWhereItIs) {
  ASSERT_EQ(mkfifo(pipe_.c_str(), 0600), 0);
  Open();
  Say("start\n");
  EXPECT_THAT(TellUntil("START pressed"), ElementsAre("START pressed"));
  station_.reset();
  ASSERT_TRUE(std::filesystem::exists(pipe_));
  auto refusal = [this] { return CaptureStation::Open(options_, stop_, logger_).status(); };
  std::filesystem::permissions(pipe_, std::filesystem::perms::group_write, std::filesystem::perm_options::add);
  EXPECT_EQ(refusal().code(), StatusCode::kUsage) << "others may write";
  std::filesystem::remove(pipe_);
  std::ofstream(pipe_) << "start\n";
  EXPECT_THAT(refusal().message(), HasSubstr("not a FIFO"));
  EXPECT_EQ(std::filesystem::file_size(pipe_), 6U) << "touched";
  std::filesystem::remove(pipe_);
  std::filesystem::create_symlink("/dev/null", pipe_);
  EXPECT_EQ(refusal().code(), StatusCode::kUsage);
  std::filesystem::remove(pipe_);
  options_.simulated->control_pipe = folder_ / "none" / "rig";
  EXPECT_EQ(refusal().code(), StatusCode::kFailed);
}

TEST_F(ControlPipeTest, APathThatWasReplacedMeanwhileIsNotRemoved) {
  Open();
  std::filesystem::remove(pipe_);
  std::ofstream(pipe_) << "somebody's file";
  station_.reset();
  EXPECT_TRUE(std::filesystem::exists(pipe_));
}

}  // namespace
}  // namespace stratalux::rig
