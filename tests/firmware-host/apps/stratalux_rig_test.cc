// SPDX-License-Identifier: Apache-2.0
// The command line: exit codes and messages for wrong use. Nothing here may leave a store behind.
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "db/catalogue/session_store.h"
#include "firmware-host/session/last_lights.h"
#include "firmware-host/session/state_file.h"
#include "shared/capture/finding.h"
#include "shared/capture/plan.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

Outcome Rig(const std::string& arguments) {
  return Shell("env -u STRATALUX_STORE " + std::string(STRATALUX_BIN_DIR) + "/stratalux-rig " + arguments + " 2>&1");
}

class WrongUse : public ::testing::TestWithParam<std::pair<const char*, const char*>> {};

TEST_P(WrongUse, ExitsWith2AndSaysWhy) {
  const ScratchFolder scratch;
  const auto store = scratch / "wrong-use";
  const Outcome outcome = Rig(std::string(GetParam().first) + " --store " + store.string());
  EXPECT_EQ(outcome.code, 2) << outcome.out;
  EXPECT_THAT(outcome.out, HasSubstr(GetParam().second));
  EXPECT_FALSE(std::filesystem::exists(store));
}

INSTANTIATE_TEST_SUITE_P(
    Capture, WrongUse,
    ::testing::Values(
        std::pair("capture", "--simulate"), std::pair("capture --simulate=moon", "head, plane, sphere"),
        std::pair("capture --simulate --size 696", "WIDTHxHEIGHT"),
        std::pair("capture --simulate --size 695x520", "camera width = 695"),
        std::pair("capture --simulate=white --size 158x120", "a camera of 158x120 px: too few"),
        std::pair("capture --simulate --kind party", "party"),
        std::pair("capture --simulate --exposure 0", "exposure_ms"),
        std::pair("capture --simulate --exposure bright", "expected ms, or auto"),
        std::pair("capture --simulate --exposure auto --kind dark", "only a visitor's exposure can be chosen"),
        std::pair("selftest --simulate --exposure auto", "only capture looks at who is there"),
        std::pair("capture --simulate --attempt 0", "--attempt"),
        std::pair("capture --simulate --pose 2", "--kind calibration"),
        std::pair("capture --kind calibration --pose 12 --simulate=" STRATALUX_SOURCE_DIR
                  "/docs/examples/scenes/charuco_poses.toml",
                  "poses 0 .. 11"),
        std::pair("capture --kind calibration --poses 13 --simulate=" STRATALUX_SOURCE_DIR
                  "/docs/examples/scenes/charuco_poses.toml",
                  "lists 12 poses"),
        std::pair("capture --kind calibration --pose 7 --poses 7 --simulate=" STRATALUX_SOURCE_DIR
                  "/docs/examples/scenes/charuco_poses.toml",
                  "beyond the last"),
        std::pair("capture --simulate --poses 3", "--kind calibration"),
        std::pair("capture --simulate --deadline 0.5", "--deadline 0.5 is out of range, allowed: 1 .. 600000 ms"),
        std::pair("capture --simulate --deadline nan", "--deadline nan is out of range"),
        std::pair("selftest --simulate --settle -1", "--settle -1 is out of range"),
        std::pair("capture --simulate --seed minus", "seed"),
        std::pair("capture --simulate --fault-rate nan", "--fault-rate: 'nan' is not a chance of 0 .. 1"),
        std::pair("capture --simulate --fault-rate 1.5", "'1.5' is not a chance"),
        std::pair("capture --fault-rate 0.1", "--fault-rate 0.1: only the simulated rig has it; add --simulate"),
        std::pair("capture --seed 7", "--seed 7: only the simulated rig"),
        std::pair("capture --size 696x520", "--size 696x520: only"),
        std::pair("capture --no-noise", "--no-noise: only"),
        std::pair("capture --simulate --on-start", "--simulate-events PATH takes `start`"),
        std::pair("capture --simulate --on-start --simulate-events x --kind calibration", "not for --kind calibration"),
        std::pair("capture --on-start --kind dark", "no START is wired; name its line as [gpio] start"),
        std::pair("capture --simulate-events x", "--simulate-events x: only"),
        std::pair("selftest --fault frame_lost@17", "--fault frame_lost@17: only"),
        std::pair("capture --simulate --config /dev/zero", "/dev/zero: it is a device, not a file"),
        std::pair("capture --simulate --frobnicate", "frobnicate")));

TEST(StrataluxRig, AnUnknownConfigurationKeyIsNamedWithItsLine) {
  const ScratchFolder scratch;
  const auto file = scratch / "test.toml";
  std::ofstream(file) << "[plan]\nmotion_whites = 2\nmotion_blacks = 2\n";
  const Outcome outcome = Rig("plan show --config " + file.string());
  EXPECT_EQ(outcome.code, 2);
  EXPECT_THAT(outcome.out, HasSubstr(file.string() + ":3"));
  EXPECT_THAT(outcome.out, HasSubstr("motion_blacks"));
}

TEST(StrataluxRig, AKindThatThePatternMemoriesDoNotHoldIsRefused) {
  const ScratchFolder scratch;
  const auto& folder = scratch.path();
  std::ofstream(folder / "rig.toml") << "[memory]\nsections = [\"visitor\"]\n";
  const std::string flags =
      " --simulate=white --config " + (folder / "rig.toml").string() + " --store " + (folder / "store").string();
  for (const char* kind : {"calibration", "dark", "flat", "response"}) {
    const Outcome outcome = Rig("capture --yes --kind " + std::string(kind) + flags);
    EXPECT_EQ(outcome.code, 2) << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr("rig.toml:1: the pattern memories hold no section '" + std::string(kind)));
    EXPECT_THAT(outcome.out, HasSubstr("plan render"));
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "store"));
  std::ofstream(folder / "rig.toml") << "[memory]\nsections = [\"visitor\"]\ncapacity = 100\n";
  const Outcome outcome = Rig("plan show --config " + (folder / "rig.toml").string());
  EXPECT_EQ(outcome.code, 2);
  EXPECT_THAT(outcome.out, HasSubstr("rig.toml:3"));
  EXPECT_THAT(outcome.out, HasSubstr("memory.capacity = 100"));
}

TEST(StrataluxRig, FlagsOverrideTheConfiguration) {
  const ScratchFolder scratch;
  const auto file = scratch / "kinds.toml";
  std::ofstream(file) << "[plan]\nkind = \"flat\"\nprojectors = 1\npreroll_markers = 0\n";
  EXPECT_THAT(Rig("plan show --config " + file.string()).out, HasSubstr("\n91 frames"));
  EXPECT_THAT(Rig("plan show --kind dark --config " + file.string()).out, HasSubstr("\n48 frames"));
}

TEST(StrataluxRig, AStoreMustBeNamed) {
  if (std::filesystem::exists("/etc/stratalux/rig.toml")) GTEST_SKIP() << "this machine's configuration may name one";
  const Outcome outcome = Rig("capture --simulate");
  EXPECT_EQ(outcome.code, 2);
  EXPECT_THAT(outcome.out, HasSubstr("STRATALUX_STORE"));
}

// Before the rig is opened. A disk of a megabyte, which is gone with the shell's name space.
TEST(StrataluxRig, NobodyIsLitForASessionThatTheDiskCannotTake) {
  const ScratchFolder scratch;
  const std::string disk = (scratch / "small-disk").string();
  std::filesystem::create_directories(disk);
  const std::string within = "unshare --map-root-user --mount sh -c 'mount -t tmpfs -o size=1m small " + disk + " && ";
  if (Shell(within + "true' 2>&1").code != 0) GTEST_SKIP() << "no mounts of one's own on this machine";
  const Outcome outcome =
      Shell(within + std::string(STRATALUX_BIN_DIR) + "/stratalux-rig capture --simulate --size 696x520 --store " +
            disk + "/store; code=$?; ls -A " + disk + "; exit $code' 2>&1");
  EXPECT_EQ(outcome.code, 1) << outcome.out;
  EXPECT_THAT(outcome.out, HasSubstr("has 0.00 GB free, the session may take 0.34 GB: make room"));
  EXPECT_THAT(outcome.out, Not(HasSubstr("\nstore\n"))) << "nothing was made";
}

// Before any device is looked for: the lines and the camera of this file do not exist.
TEST(StrataluxRig, NobodyIsCapturedWithoutAConsent) {
  const ScratchFolder scratch;
  const auto file = scratch / "wired.toml";
  const auto store = scratch / "no-consent";
  std::ofstream(file) << "[camera]\nbackend = \"v4l2\"\ndevice = \"/dev/no-such-camera\"\n[plan]\nprojectors = 1\n"
                         "[[projector]]\nenable = { line = \"no-such-line\" }\n"
                         "trigger = { line = \"t\" }\nsync = { line = \"s\" }\n";
  const std::string capture = "capture --config " + file.string() + " --store " + store.string();
  for (const char* visitor : {"", " --visitor simulated"}) {
    const Outcome outcome = Rig(capture + visitor);
    EXPECT_EQ(outcome.code, 2) << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr("needs a pseudonym"));
  }
  const Outcome flat = Rig(capture + " --kind flat --yes");
  EXPECT_EQ(flat.code, 4) << flat.out;
  EXPECT_THAT(flat.out, HasSubstr("no-such-line"));
  EXPECT_FALSE(std::filesystem::exists(store));
}

TEST(StrataluxRig, SafeFailsWhereItCannotKeepItsWord) {
  const ScratchFolder scratch;
  const auto file = scratch / "safe.toml";
  setenv("STATE_DIRECTORY", "/nonexistent", 1);
  std::ofstream(file) << "[plan]\nprojectors = 1\n";
  const Outcome unwired = Rig("safe --config " + file.string());
  EXPECT_EQ(unwired.code, 2);
  EXPECT_THAT(unwired.out, HasSubstr("wires no light"));
  std::ofstream(file) << "[plan]\nprojectors = 1\n[[projector]]\nenable = { line = \"no-such-line\" }\n"
                         "trigger = { line = \"t\" }\nsync = { line = \"s\" }\n";
  const Outcome missing = Rig("safe --config " + file.string());
  EXPECT_EQ(missing.code, 4);
  EXPECT_THAT(missing.out, HasSubstr("no-such-line"));
  unsetenv("STATE_DIRECTORY");
}

// A typo in the configuration keeps nobody's light on.
TEST(StrataluxRig, SafeGoesByTheLightsThatWereOpenedLast) {
  const ScratchFolder scratch;
  const auto& folder = scratch.path();
  const auto config = folder / "typo.toml";
  std::ofstream(config) << "[projectr]\n";
  ASSERT_TRUE(rig::KeepLights(folder, {{{{"the-last-line", "", -1}, rig::ActiveLevel::kHigh}}, {}}).ok());
  setenv("STATE_DIRECTORY", folder.c_str(), 1);
  const Outcome last = Rig("safe --config " + config.string());
  EXPECT_EQ(last.code, 4) << last.out;
  EXPECT_THAT(last.out, HasSubstr("the-last-line"));
  EXPECT_THAT(last.out, HasSubstr("projectr"));
  std::filesystem::permissions(folder / "lights.json", std::filesystem::perms::all);
  const Outcome refused = Rig("safe --config " + config.string());
  EXPECT_EQ(refused.code, 2) << refused.out;
  EXPECT_THAT(refused.out, HasSubstr("can be written by others"));
  unsetenv("STATE_DIRECTORY");
}

TEST(StrataluxRig, EachCommandHasExamplesOfItsOwn) {
  for (const char* command : {"selftest", "plan", "plan show", "safe"}) {
    const Outcome outcome = Rig(std::string(command) + " --help");
    EXPECT_THAT(outcome.out, HasSubstr(std::string("stratalux-rig ") + command));
    EXPECT_THAT(outcome.out, Not(HasSubstr("stratalux-rig capture"))) << command;
  }
}

TEST(StrataluxRig, HelpShowsExamples) {
  const Outcome outcome = Rig("--help");
  EXPECT_EQ(outcome.code, 0);
  EXPECT_THAT(outcome.out, HasSubstr("stratalux-rig capture --simulate --store store"));
}

TEST(StrataluxRig, ThePlanHas500Frames) {
  const Outcome outcome = Rig("plan show");
  EXPECT_EQ(outcome.code, 0);
  EXPECT_THAT(outcome.out, HasSubstr("500 frames"));
}

TEST(StrataluxRig, PlanShowReckonsWithTheSimulatedRigWhereThatIsAskedFor) {
  const std::string scene = "--simulate=" STRATALUX_SOURCE_DIR "/docs/examples/scenes/overlapped.toml";
  EXPECT_THAT(Rig("plan show").out, HasSubstr("serial read-out"));
  EXPECT_THAT(Rig("plan show " + scene).out, HasSubstr("overlapped read-out"));
  const Outcome no_scene = Rig("plan show --simulate=/no/such/scene.toml");
  EXPECT_EQ(no_scene.code, 2) << no_scene.out;
  EXPECT_THAT(no_scene.out, HasSubstr("/no/such/scene.toml"));
}

// A program that waits in the dark, with a pipe to tell it what happens; gone with this object.
class WaitingCapture : public ScratchFolderTest {
 protected:
  void Begin() {
    WriteText(folder_ / "small.toml",
              "[plan]\nprojector_width = 128\nprojector_height = 96\ncomb_period = 32\n"
              "spot_pitch = 32\nspot_radius = 2\n");
    const std::string log = (folder_ / "log").string(), pipe = (folder_ / "rig").string(),
                      config = (folder_ / "small.toml").string(), store = (folder_ / "store").string(),
                      program = std::string(STRATALUX_BIN_DIR) + "/stratalux-rig";
    std::filesystem::remove(log);  // of the one before
    child_ = fork();
    ASSERT_GE(child_, 0);
    if (child_ == 0) {
      static_cast<void>(!std::freopen(log.c_str(), "w", stderr));
      static_cast<void>(!std::freopen("/dev/null", "w", stdout));
      execl(program.c_str(), program.c_str(), "capture", "--simulate=plane", "--no-scattering", "--size", "88x66",
            "--config", config.c_str(), "--store", store.c_str(), "--on-start", "--simulate-events", pipe.c_str(),
            nullptr);
      _exit(127);
    }
    AwaitLog("waiting for START");
  }
  ~WaitingCapture() override {
    if (child_ > 0) kill(child_, SIGKILL);
    if (child_ > 0) waitpid(child_, nullptr, 0);
  }
  void AwaitLog(const std::string& text) const {
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(30);
    while (ReadText(folder_ / "log").find(text) == std::string::npos && std::chrono::steady_clock::now() < deadline)
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    ASSERT_THAT(ReadText(folder_ / "log"), HasSubstr(text));
  }
  void Tell(const std::string& line) const { WriteText(folder_ / "rig", line + "\n"); }
  int End() {
    int status = 0;
    waitpid(std::exchange(child_, -1), &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  pid_t child_ = -1;
};

TEST_F(WaitingCapture, BeginsWithStartAndNotWhileTheDoorIsOpen) {
  Begin();
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store")) << "before anybody pressed START";
  Tell("door open");
  AwaitLog("door open: START is refused");
  Tell("start");
  AwaitLog("START refused: door open");
  Tell("door closed");
  AwaitLog("START is accepted again");
  Tell("start");
  EXPECT_EQ(End(), 0) << ReadText(folder_ / "log");
  EXPECT_FALSE(std::filesystem::exists(folder_ / "rig"));
  const auto store = db::SessionStore::Open(folder_ / "store", db::AccessMode::kReadOnly);
  ASSERT_TRUE(store.ok());
  EXPECT_EQ(store->ListSessions()->size(), 1U);
}

TEST_F(WaitingCapture, ASignalEndsItAlsoBehindAnOpenDoorAndTheStoreIsAsItWas) {
  for (const bool open : {false, true}) {
    Begin();
    if (open) {
      Tell("door open");
      AwaitLog("door open: START is refused");
    }
    kill(child_, SIGTERM);
    EXPECT_EQ(End(), 1);
    EXPECT_THAT(ReadText(folder_ / "log"), HasSubstr("interrupted"));
    EXPECT_FALSE(std::filesystem::exists(folder_ / "store"));
    EXPECT_FALSE(std::filesystem::exists(folder_ / "rig"));
  }
}

// What it left lies in nobody's way.
TEST_F(WaitingCapture, AKilledOnesPipeIsTakenByTheNext) {
  Begin();
  kill(child_, SIGKILL);
  EXPECT_EQ(End(), 128 + SIGKILL);
  ASSERT_TRUE(std::filesystem::exists(folder_ / "rig"));
  Begin();
  Tell("start");
  EXPECT_EQ(End(), 0);
  EXPECT_TRUE(std::filesystem::exists(folder_ / "rig")) << "it did not make it";
}

class LearntDeadlinesProgram : public ScratchFolderTest {
 protected:
  LearntDeadlinesProgram() { setenv("STATE_DIRECTORY", folder_.c_str(), 1); }
  ~LearntDeadlinesProgram() override { unsetenv("STATE_DIRECTORY"); }
  // A rig whose timing is what `timing` says, always under the same name.
  [[nodiscard]] std::string Scene(const std::string& timing) const {
    const auto file = folder_ / "rig.toml";
    std::ofstream(file) << "[subject]\nshape = \"white\"\n[timing]\n" << timing;
    return "--simulate=" + file.string() + " ";
  }
  [[nodiscard]] std::string Config(const std::string& capture) const {
    const auto file = folder_ / "config.toml";
    std::ofstream(file) << "[capture]\n"
                        << capture
                        << "\n[plan]\nprojector_width = 128\nprojector_height = 96\ncomb_period = 32\n"
                           "spot_pitch = 32\nspot_radius = 2\n[camera]\nwidth = 88\nheight = 66\n";
    return "--config " + file.string() + " ";
  }
  [[nodiscard]] std::string Store() const { return "--store " + (folder_ / "store").string(); }
};

TEST_F(LearntDeadlinesProgram, ASelftestTeachesPlanAndCaptureUntilTheRigIsSlower) {
  const std::string rig = Scene("sync_delay_ms = 0.4\n") + Config("");
  EXPECT_THAT(Rig("plan show " + rig).out, HasSubstr("the default: `stratalux-rig selftest` learns shorter ones"));
  const Outcome selftest = Rig("selftest " + rig);
  EXPECT_EQ(selftest.code, 0) << selftest.out;
  EXPECT_THAT(selftest.out, HasSubstr("kept in " + (folder_ / "deadlines-simulated.json").string()));
  EXPECT_THAT(selftest.out, HasSubstr("TRIGGER to SYNC, projector 3   median 0.400 ms, worst 0.400 ms"));
  EXPECT_THAT(Rig("plan show " + rig).out, HasSubstr("after their exposure, learnt by selftest 20"));
  EXPECT_THAT(Rig("plan show " + rig + "--deadline 300").out,
              HasSubstr("300 ms for SYNC and for a frame, as --deadline"));
  EXPECT_THAT(Rig("plan show " + Scene("") + Config("deadline_ms = 400")).out,
              HasSubstr("400 ms for SYNC and for a frame, as [capture] deadline_ms says"));
  const Outcome same = Rig("capture " + Scene("sync_delay_ms = 0.4\n") + Config("") + Store());
  EXPECT_EQ(same.code, 0) << same.out;
  EXPECT_THAT(same.out, Not(HasSubstr("selftest")));
  const Outcome slower = Rig("capture " + Scene("sync_delay_ms = 8.4\nreadout_ms = 15\n") + Config("") + Store());
  EXPECT_EQ(slower.code, 0) << slower.out;
  EXPECT_THAT(slower.out, HasSubstr("run `stratalux-rig selftest` again"));
  EXPECT_THAT(slower.out, HasSubstr(", 0 shot again"));
  const Outcome json =
      Rig("capture " + Scene("sync_delay_ms = 8.4\n") + Config("") + "--json " + Store() + " 2>/dev/null");
  EXPECT_THAT(json.out, HasSubstr("\"slower_than_learnt\": [\n    {\n      \"projector\": 0"));
  // Learnt again, it is as it should be; and what no deadline can come from is said once, and no more than that.
  EXPECT_EQ(Rig("selftest " + Scene("sync_delay_ms = 8.4\n") + Config("")).code, 0);
  EXPECT_THAT(Rig("capture " + Scene("sync_delay_ms = 8.4\n") + Config("") + Store()).out, Not(HasSubstr("selftest")));
  std::filesystem::permissions(folder_ / "deadlines-simulated.json", std::filesystem::perms::all);
  const Outcome refused = Rig("capture " + Scene("") + Config("") + Store());
  EXPECT_EQ(refused.code, 0) << refused.out;
  const std::string why = "can be written by others";
  EXPECT_THAT(refused.out, HasSubstr(why));
  EXPECT_EQ(refused.out.find(why), refused.out.rfind(why));
}

TEST_F(LearntDeadlinesProgram, TheTrendOfSelfchecksIsPrintedWithoutADevice) {
  const Outcome none = Rig("selftest --trend");
  EXPECT_EQ(none.code, 4);
  EXPECT_THAT(none.out, HasSubstr("the kiosk keeps its self-checks there"));
  std::string checks;
  for (int64_t day = 0; day < 11; ++day)
    checks += (day == 0 ? "" : ",") + std::string("{\"at\":") + std::to_string(int64_t{1'795'507'200} + day * 86'400) +
              R"(,"passed":true,"exposure_ms":16,"width":88,"height":66,"figures":{"level":[)" +
              (day < 10 ? "1900" : "1500") +
              R"(],"dark":[62],"red_green":[],"blue_green":[],"even":[0.8],"lit":[1],"sync":[0.4],"frame_rate":[28]}})";
  ASSERT_TRUE(rig::KeepState(folder_ / "selfchecks.json", R"({"schema":1,"checks":[)" + checks + "]}").ok());
  const Outcome text = Rig("selftest --trend");
  EXPECT_EQ(text.code, 0) << text.out;
  EXPECT_THAT(text.out, HasSubstr("drift: level of projector 0: 1500, usually 1900 +- 19 (10 days)"));
  const Outcome json = Rig("selftest --trend --json");
  EXPECT_THAT(json.out, HasSubstr(R"("drifts":[{"figure":"level","projector":0,"value":1500.0,"median":1900.0)"));
  EXPECT_EQ(Rig("selftest --trend --simulate").code, 4) << "the simulated rig's are others";
}

TEST_F(LearntDeadlinesProgram, ASelftestThatCanKeepNothingPasses) {
  setenv("STATE_DIRECTORY", "/nonexistent", 1);
  const Outcome selftest = Rig("selftest " + Scene("") + Config(""));
  EXPECT_EQ(selftest.code, 0) << selftest.out;
  EXPECT_THAT(selftest.out, HasSubstr("skipped"));
  EXPECT_THAT(selftest.out, HasSubstr("not kept: cannot write in /nonexistent"));
  EXPECT_THAT(selftest.out, HasSubstr("selftest passed"));
  setenv("STATE_DIRECTORY", folder_.c_str(), 1);
  const Outcome failed = Rig("selftest " + Scene("") + Config("") + "--fault frame_lost@40");
  EXPECT_EQ(failed.code, 1) << failed.out;
  EXPECT_THAT(failed.out, HasSubstr("none are learnt from a rig that fails"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "deadlines-simulated.json"));
}

TEST_F(LearntDeadlinesProgram, AStoppedCaptureListsTheStepsThatItLacksAsRanges) {
  const Outcome stopped = Execute(
      "stratalux-rig capture " + Scene("") + Config("") + "--fault emergency_stop@40 --json " + Store(), Show::kStdout);
  EXPECT_EQ(stopped.code, 1) << stopped.out;
  const auto json = nlohmann::json::parse(stopped.out, nullptr, false);
  ASSERT_TRUE(json.is_object()) << stopped.out;
  const auto ranges = json["missing_steps"].get<std::vector<std::pair<int, int>>>();
  ASSERT_THAT(ranges, ::testing::SizeIs(::testing::AllOf(::testing::Ge(1U), ::testing::Le(3U)))) << stopped.out;
  int missing = 0;
  for (const auto& [first, last] : ranges) missing += last - first + 1;
  EXPECT_EQ(missing, json["planned"].get<int>() - json["captured"].get<int>());
  EXPECT_GT(missing, 20);
  EXPECT_EQ(ranges.back().second, json["planned"].get<int>() - 1);
}

TEST(CaptureProgram, TellsVisitAttemptAndWhatItFoundApartFromReasons) {
  const ScratchFolder scratch;
  const auto store = scratch / "store";
  // Hardly any light comes back from what stands so dark: the pre-scan finds it dim, the proof is whole.
  const auto scene = scratch / "dark.toml";
  std::ofstream(scene) << "[subject]\nshape = \"head\"\n[skin]\nopaque = true\nmelanin = 0.3\n";
  const Outcome outcome =
      Shell("env -u STRATALUX_STORE " + std::string(STRATALUX_BIN_DIR) +
            "/stratalux-rig capture --simulate=" + scene.string() +
            " --size 174x130 --visit v-7 --attempt 2 --exposure auto --json 2>/dev/null --store " + store.string());
  const auto json = nlohmann::json::parse(outcome.out, nullptr, false);
  ASSERT_TRUE(json.is_object()) << outcome.out;
  if (json["status"] == "complete") {
    EXPECT_EQ(json["reasons"].size(), 0U) << json["reasons"];
  }
  const auto opened = db::SessionStore::Open(store, db::AccessMode::kReadOnly);
  ASSERT_TRUE(opened.ok()) << opened.status().message();
  const auto row = opened->FindSession("latest");
  ASSERT_TRUE(row.ok()) << row.status().message();
  EXPECT_EQ(row->info.visit, "v-7");
  EXPECT_EQ(row->info.attempt, 2);
  EXPECT_EQ(row->info.reasons, json["reasons"].get<std::vector<std::string>>());
  EXPECT_EQ(nlohmann::json::parse(FindingsToJson(row->info.found.findings)), json["findings"]);
  EXPECT_GT(PlanOptionsFromJson(row->info.plan_json)->exposure_ms, 16.0) << "dark skin gets more light";
}

}  // namespace
}  // namespace stratalux
