// SPDX-License-Identifier: Apache-2.0
// What a selftest keeps and captures go by: of this rig alone, from nobody else, whole or not at all.
#include "firmware-host/session/learnt_deadlines.h"

#include <chrono>
#include <csignal>
#include <fstream>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "firmware-host/session/capture_station.h"
#include "shared/base/unique_fd.h"
#include "tests/firmware-host/session/small_station.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using Json = nlohmann::ordered_json;

constexpr const char* kRig = R"(
[camera]
backend = "v4l2"
device = "/dev/v4l/by-id/camera-7"
width = 1392
height = 1042
[gpio]
camera_trigger = { line = "CAM" }
[plan]
projectors = 2
[[projector]]
enable = { line = "E0" }
trigger = { line = "T0" }
sync = { line = "S0" }
[[projector]]
enable = { line = "E1" }
trigger = { line = "T1" }
sync = { line = "S1" }
)";

class LearntDeadlinesFile : public ScratchFolderTest {
 protected:
  LearntDeadlinesFile() {
    delays_.sync = {{64, 0.4, 0.5, 0.05}, {64, 0.4, 0.6, 0.05}};
    delays_.frame = {60, 8.0, 8.5, 0.1};
    delays_.transfer_ms = 8.0;
    delays_.frame_period_ms = 24.0;
    delays_.exposure_ms = 16.0;
  }
  static RigConfig Config(const std::string& from = "", const std::string& to = "") {
    std::string text = kRig;
    if (!from.empty()) text.replace(text.find(from), from.size(), to);
    const Result<RigConfig> config = ParseRigConfig(text, "rig.toml");
    EXPECT_TRUE(config.ok()) << config.status().message();
    return *config;
  }
  [[nodiscard]] fs::path File() const { return folder_ / "deadlines.json"; }
  [[nodiscard]] Status Keep() const { return KeepDelays(folder_, Config(), {}, delays_); }
  void ExpectRefused(const RigConfig& config, const std::string& why) const {
    const RigDeadlines deadlines = ChooseDeadlines(folder_, config, {});
    EXPECT_EQ(deadlines.source, DeadlineSource::kDefault) << why;
    EXPECT_FALSE(deadlines.learnt) << why;
    EXPECT_FALSE(deadlines.delays) << why;
    EXPECT_EQ(deadlines.longest, FromMilliseconds(kDeadlineMs)) << why;
    EXPECT_THAT(deadlines.refused, HasSubstr(why));
    EXPECT_THAT(deadlines.refused, HasSubstr(File().string()));
  }
  void Write(const std::string& text) const {
    std::ofstream(File()) << text;
    fs::permissions(File(), fs::perms::owner_read | fs::perms::owner_write);
  }

  RigDelays delays_;
};

TEST_F(LearntDeadlinesFile, AreWhatTheSameRigGoesBy) {
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), {}).source, DeadlineSource::kDefault);
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), {}).refused, "") << "nothing was kept: nothing to say";
  ASSERT_TRUE(Keep().ok());
  const RigDeadlines deadlines = ChooseDeadlines(folder_, Config(), {});
  EXPECT_EQ(deadlines.source, DeadlineSource::kLearnt);
  EXPECT_EQ(deadlines.refused, "");
  ASSERT_TRUE(deadlines.delays);
  EXPECT_EQ(*deadlines.delays, delays_);
  EXPECT_EQ(*deadlines.learnt, DeadlinesFrom(delays_, deadlines.longest));
  EXPECT_EQ(deadlines.learnt_at.size(), std::string("2026-11-21T04:06:11Z").size());
  struct stat info {};
  ASSERT_EQ(stat(File().c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777U, 0600U);
}

TEST_F(LearntDeadlinesFile, GiveWayToWhatTheConfigurationSays) {
  ASSERT_TRUE(Keep().ok());
  const RigDeadlines deadlines = ChooseDeadlines(folder_, Config("[plan]", "[capture]\ndeadline_ms = 500\n[plan]"), {});
  EXPECT_EQ(deadlines.source, DeadlineSource::kConfigured);
  EXPECT_FALSE(deadlines.learnt);
  EXPECT_EQ(deadlines.longest, FromMilliseconds(500.0));
  EXPECT_TRUE(deadlines.delays) << "for estimates";
}

TEST_F(LearntDeadlinesFile, OfAnotherRigAreRefusedByName) {
  ASSERT_TRUE(Keep().ok());
  ExpectRefused(Config("camera-7", "camera-8"), "another rig (camera.device differs)");
  ExpectRefused(Config("v4l2", "libcamera"), "camera.backend differs");
  ExpectRefused(Config("width = 1392", "width = 696"), "camera.width differs");
  ExpectRefused(Config("height = 1042", "height = 520"), "camera.height differs");
  ExpectRefused(Config("\"CAM\"", "\"CAM2\""), "camera.trigger differs");
  ExpectRefused(Config("\"S1\"", "\"S7\""), "projectors.1.sync differs");
  ExpectRefused(Config("\"T0\"", "\"T7\""), "projectors.0.trigger differs");
  ExpectRefused(Config("[plan]", "[plan]\nsync_mode = \"free_running\""), "sync_mode differs");
  ExpectRefused(
      Config("[[projector]]\nenable = { line = \"E1\" }\ntrigger = { line = \"T1\" }\nsync = { line = \"S1\" }",
             "[[projector]]\nkind = \"display\"\nconnector = \"HDMI-A-1\""),
      "projectors.1 differs");
  // Delays count from the end of an exposure; ENABLE has no part in them.
  EXPECT_EQ(ChooseDeadlines(folder_, Config("[plan]", "[plan]\nexposure_ms = 30"), {}).source, DeadlineSource::kLearnt);
  EXPECT_EQ(ChooseDeadlines(folder_, Config("\"E1\"", "\"E7\""), {}).source, DeadlineSource::kLearnt);
}

TEST_F(LearntDeadlinesFile, OfTheSimulatedRigAreNoDevices) {
  SimulatedRigOptions simulated;
  ASSERT_TRUE(KeepDelays(folder_, Config(), simulated, delays_).ok());
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), {}).source, DeadlineSource::kDefault);
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), simulated).source, DeadlineSource::kLearnt);
  simulated.seed = 7;
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), simulated).source, DeadlineSource::kLearnt) << "another face";
  simulated.scene = "plane";
  EXPECT_THAT(ChooseDeadlines(folder_, Config(), simulated).refused, HasSubstr("simulated differs"));
  // Kept under the other's name, they are refused all the same.
  fs::rename(folder_ / "deadlines-simulated.json", File());
  ExpectRefused(Config(), "another rig");
}

TEST_F(LearntDeadlinesFile, OfAnybodyElseOrAnotherVersionAreRefused) {
  ASSERT_TRUE(Keep().ok());
  ASSERT_EQ(chmod(File().c_str(), 0602), 0);
  ExpectRefused(Config(), "can be written by others");
  ASSERT_EQ(chmod(File().c_str(), 0600), 0);
  std::ifstream in(File());
  const Json kept = Json::parse(in);
  Json json = kept;
  json["schema"] = 2;
  Write(json.dump());
  ExpectRefused(Config(), "schema 2, this program knows 1");
  for (const char* text : {"", "{", "[]", "7", R"({"schema": 1})", R"({"schema": 1, "rig": {}})"}) {
    Write(text);
    ExpectRefused(Config(), "");
  }
  const auto spoil = [&](const std::string& pointer, const Json& value) {
    json = kept;
    json[Json::json_pointer(pointer)] = value;
    Write(json.dump());
    ExpectRefused(Config(), "");
  };
  spoil("/frame/worst_ms", -3.0);
  spoil("/frame/worst_ms", 1e300);
  spoil("/frame/worst_ms", nullptr);
  spoil("/frame/median_ms", 9.0);  // beyond the worst
  spoil("/frame/count", 3);
  spoil("/sync/1/spread_ms", -1.0);
  spoil("/sync", Json::array());
  spoil("/sync/2", kept["sync"][0]);
  spoil("/frame_period_ms", "long");
  spoil("/learnt", 7);
  Write(kept.dump());
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), {}).source, DeadlineSource::kLearnt);
  if (geteuid() == 0) {
    ASSERT_EQ(chown(File().c_str(), 65534, 65534), 0);
    ExpectRefused(Config(), "belongs to account 65534");
  }
  fs::remove(File());
  fs::create_directory(File());
  ExpectRefused(Config(), "not a regular file");
}

TEST_F(LearntDeadlinesFile, AreNotKeptWhereTheyTeachNothingOrCannotBeWritten) {
  delays_.sync.pop_back();
  EXPECT_FALSE(Keep().ok()) << "of one projector of two";
  delays_.sync.push_back({5, 0.4, 0.5, 0.1});
  EXPECT_FALSE(Keep().ok()) << "of five pulses";
  EXPECT_TRUE(fs::is_empty(folder_));
  delays_.sync.back().count = 64;
  const Status nowhere = KeepDelays(folder_ / "none", Config(), {}, delays_);
  EXPECT_FALSE(nowhere.ok());
  EXPECT_THAT(nowhere.message(), HasSubstr((folder_ / "none").string()));
  // What a killed run left beside it stops nobody, and is not written through.
  fs::create_symlink(folder_ / "victim", folder_ / "deadlines.json.new");
  EXPECT_TRUE(Keep().ok());
  EXPECT_FALSE(fs::exists(folder_ / "victim"));
  // Nor does a program that holds on to the folder, for ever.
  const UniqueFd held(open(folder_.c_str(), O_RDONLY | O_DIRECTORY));
  ASSERT_EQ(flock(held.get(), LOCK_EX), 0);
  EXPECT_EQ(Keep().code(), StatusCode::kBusy);
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), {}).source, DeadlineSource::kLearnt) << "the old ones";
}

TEST_F(LearntDeadlinesFile, TwoSelftestsAndAKillLeaveAWholeFile) {
  ASSERT_TRUE(Keep().ok());
  std::vector<pid_t> writers;
  for (int k = 0; k < 3; ++k) {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      delays_.frame.count = 100 + k;
      while (true) static_cast<void>(Keep().ok());
    }
    writers.push_back(child);
  }
  int read = 0;
  const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(600);
  while (std::chrono::steady_clock::now() < end || read < 200) {
    const RigDeadlines deadlines = ChooseDeadlines(folder_, Config(), {});
    EXPECT_EQ(deadlines.refused, "");
    ASSERT_EQ(deadlines.source, DeadlineSource::kLearnt);
    ++read;
  }
  for (const pid_t writer : writers) {
    kill(writer, SIGKILL);
    waitpid(writer, nullptr, 0);
  }
  EXPECT_EQ(ChooseDeadlines(folder_, Config(), {}).source, DeadlineSource::kLearnt);
  EXPECT_TRUE(Keep().ok());
  EXPECT_EQ(*ChooseDeadlines(folder_, Config(), {}).delays, delays_);
}

// A station goes by them until a capture finds the rig slower.
class LearntDeadlinesStation : public ScratchFolderTest {
 protected:
  LearntDeadlinesStation() : options_(SmallStation(folder_)) {
    setenv("STATE_DIRECTORY", folder_.c_str(), 1);
    request_.plan = options_.config.plan;
    delays_.sync.assign(4, {64, 0.4, 0.4, 0.0});
    delays_.frame = {60, 8.02, 8.02, 0.0};
    delays_.frame_period_ms = 24.0;
    delays_.exposure_ms = 16.0;
  }
  ~LearntDeadlinesStation() override { unsetenv("STATE_DIRECTORY"); }
  std::unique_ptr<CaptureStation> Open() {
    auto station = CaptureStation::Open(options_, stop_, logger_);
    EXPECT_TRUE(station.ok()) << station.status().message();
    return std::move(*station);
  }
  CaptureReport Capture(CaptureStation& station) {
    const auto outcome = station.Capture(request_);
    EXPECT_TRUE(outcome.ok()) << outcome.status().message();
    EXPECT_EQ(outcome->report.status, SessionStatus::kComplete) << outcome->report.FaultSummary();
    return outcome->report;
  }

  StationOptions options_;
  CaptureRequest request_;
  RigDelays delays_;
  StopToken stop_;
  Logger logger_{LogLevel::kError};
};

TEST_F(LearntDeadlinesStation, GoesByThemWhereTheRigIsAsItWas) {
  ASSERT_TRUE(KeepDelays(folder_, options_.config, options_.simulated, delays_).ok());
  const auto station = Open();
  EXPECT_EQ(station->deadlines().source, DeadlineSource::kLearnt);
  EXPECT_TRUE(Capture(*station).slow.empty());
  EXPECT_TRUE(station->deadlines().learnt);
}

TEST_F(LearntDeadlinesStation, LeavesThemWhereACaptureFoundTheRigSlower) {
  options_.simulated->faults.script = {{FaultKind::kFrameSlow, 40, 1, 60.0}};  // 35 ms beyond its deadline
  ASSERT_TRUE(KeepDelays(folder_, options_.config, options_.simulated, delays_).ok());
  const auto station = Open();
  ASSERT_EQ(station->deadlines().source, DeadlineSource::kLearnt);
  const CaptureReport report = Capture(*station);
  ASSERT_EQ(report.slow.size(), 1U);
  EXPECT_EQ(report.slow[0].late, 1);
  EXPECT_EQ(report.retried, 1);
  EXPECT_FALSE(station->deadlines().learnt);
  EXPECT_TRUE(Capture(*station).slow.empty());
}

TEST_F(LearntDeadlinesStation, OpensWithWhatItCannotUse) {
  std::ofstream(folder_ / "deadlines-simulated.json") << "{";
  const auto station = Open();
  EXPECT_EQ(station->deadlines().source, DeadlineSource::kDefault);
  EXPECT_NE(station->deadlines().refused, "");
  EXPECT_TRUE(Capture(*station).slow.empty());
}

}  // namespace
}  // namespace stratalux::rig
