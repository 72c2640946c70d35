// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/state_file.h"

#include <csignal>
#include <fstream>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "firmware-host/session/state_writer.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class StateFile : public ScratchFolderTest {
 protected:
  // As long as a state may be, and all of one number.
  static std::string StateOf(int64_t number) {
    nlohmann::ordered_json json = {{"schema", 1}, {"numbers", std::vector<int64_t>(4000, number)}};
    return json.dump();
  }
  // nullopt where the file is not whole.
  [[nodiscard]] std::optional<int64_t> Number() const {
    std::vector<int64_t> numbers;
    const Status read = ReadState(File(), 1, [&](const std::string& text) {
      numbers = nlohmann::ordered_json::parse(text).at("numbers").get<std::vector<int64_t>>();
    });
    if (!read.ok() || numbers != std::vector<int64_t>(4000, numbers.at(0))) return std::nullopt;
    return numbers[0];
  }
  [[nodiscard]] fs::path File() const { return folder_ / "state.json"; }
};

// 40 kills at any moment of a write, one after the other on the same file.
TEST_F(StateFile, IsWholeWheneverItsWriterIsKilled) {
  ASSERT_TRUE(KeepState(File(), StateOf(1'000'000'000)).ok());
  int64_t before = 1'000'000'000;
  int grown = 0;
  for (int kill_at = 0; kill_at < 40; ++kill_at) {
    const pid_t writer = fork();
    if (writer == 0)
      for (int64_t number = before + 1;; ++number)
        if (!KeepState(File(), StateOf(number)).ok()) _exit(1);
    ASSERT_GT(writer, 0);
    std::this_thread::sleep_for(std::chrono::microseconds(500 + 1373 * kill_at));
    kill(writer, SIGKILL);
    int status = 0;
    waitpid(writer, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status)) << "the writer could not write";
    const auto now = Number();
    ASSERT_TRUE(now) << "kill " << kill_at;
    ASSERT_GE(*now, before);
    grown += *now > before ? 1 : 0;
    before = *now;
  }
  EXPECT_GT(grown, 5) << "writers were killed before they wrote: it shows nothing";
  ASSERT_TRUE(KeepState(File(), StateOf(7)).ok()) << "what a killed writer left beside it is in nobody's way";
}

TEST_F(StateFile, IsItsOwnersAloneWhateverTheProcesssMaskAndLeavesThatAlone) {
  const mode_t before = umask(0);
  ASSERT_TRUE(KeepState(File(), StateOf(1)).ok());
  EXPECT_EQ(umask(before), 0U);
  struct stat info {};
  ASSERT_EQ(stat(File().c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777U, 0600U);
}

TEST_F(StateFile, OfManyThreadsIsThatOfOne) {
  std::vector<std::thread> threads;
  for (int64_t t = 1; t <= 4; ++t)
    threads.emplace_back([this, t] {
      for (int i = 0; i < 10; ++i) EXPECT_TRUE(KeepState(File(), StateOf(t)).ok());
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_TRUE(Number());
}

TEST_F(StateFile, ThatCannotBeUsedIsSetAside) {
  const auto none = [](const std::string&) {};
  EXPECT_EQ(TakeState(File(), 1, none).code(), StatusCode::kNotFound);
  ASSERT_TRUE(KeepState(File(), R"({"schema": 2})").ok());
  const Status newer = TakeState(File(), 1, none);
  EXPECT_EQ(newer.code(), StatusCode::kNewerSchema);
  EXPECT_THAT(newer.message(), HasSubstr("set aside as " + File().string() + ".newer"));
  EXPECT_FALSE(fs::exists(File()));
  EXPECT_TRUE(fs::exists(File().string() + ".newer"));
  ASSERT_TRUE(KeepState(File(), "{").ok());
  EXPECT_THAT(TakeState(File(), 1, none).message(), HasSubstr(".damaged"));
  EXPECT_TRUE(fs::exists(File().string() + ".damaged"));
  ASSERT_TRUE(KeepState(File(), R"({"schema": 1})").ok());
  EXPECT_TRUE(TakeState(File(), 1, none).ok());
  EXPECT_TRUE(fs::exists(File()));
}

TEST_F(StateFile, ThatIsSetAsideTakesNobodysPlace) {
  const auto none = [](const std::string&) {};
  const auto text = [](const fs::path& file) {
    std::string line;
    std::getline(std::ifstream(file) >> std::ws, line);
    return line;
  };
  const std::string aside = File().string() + ".damaged";
  for (const char* damaged : {"{1", "{2", "{3"}) {
    ASSERT_TRUE(KeepState(File(), damaged).ok());
    EXPECT_EQ(TakeState(File(), 1, none).code(), StatusCode::kIntegrity);
  }
  EXPECT_EQ(text(aside), "{1");
  EXPECT_EQ(text(aside + "-2"), "{2");
  EXPECT_EQ(text(aside + "-3"), "{3");
}

// Another account's, or of rights that were opened: who looks after it may still want it.
TEST_F(StateFile, ThatMayBeSomebodyElsesStaysWhereItIs) {
  ASSERT_TRUE(KeepState(File(), R"({"schema": 1})").ok());
  fs::permissions(File(), fs::perms::all);
  const Status taken = TakeState(File(), 1, [](const std::string&) {});
  EXPECT_EQ(taken.code(), StatusCode::kFailed);
  EXPECT_THAT(taken.message(), HasSubstr("it stays as it is"));
  EXPECT_TRUE(fs::exists(File()));
  EXPECT_FALSE(fs::exists(File().string() + ".damaged"));
}

TEST_F(StateFile, OfAWriterIsTheNewestWhenItGoes) {
  Logger logger{LogLevel::kError};
  {
    StateWriter writer(File(), logger);
    for (int64_t number = 1; number <= 200; ++number) writer.Keep(StateOf(number));
  }
  EXPECT_EQ(Number(), 200);
}

TEST_F(StateFile, OfAWriterWithoutAFolderIsATroubleAndEndsInTime) {
  Logger logger{LogLevel::kError};
  StateWriter writer("/nonexistent/state.json", logger);
  writer.Keep(StateOf(1));
  for (int i = 0; i < 500 && writer.trouble().empty(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_THAT(writer.trouble(), HasSubstr("/nonexistent"));
}

}  // namespace
}  // namespace stratalux::rig
