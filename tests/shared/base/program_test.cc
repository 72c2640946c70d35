// SPDX-License-Identifier: Apache-2.0
#include "shared/base/program.h"

#include <chrono>
#include <csignal>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::HasSubstr;

Result<ProgramOutcome> RunShell(const std::string& script, std::optional<milliseconds> limit = std::nullopt) {
  return RunProgram({"sh", "-c", script}, limit ? std::optional(ProgramLimit{*limit}) : std::nullopt);
}

// Far beyond the limit that a test gives, far below what its program would take: a busy machine passes.
constexpr seconds kSoon(30);

class LimitedProgram : public ScratchFolderTest {
 protected:
  // Whether the process whose number the script left is gone, or will be within seconds.
  [[nodiscard]] bool IsGone(const std::string& name) const {
    pid_t pid = 0;
    std::ifstream(folder_ / name) >> pid;
    EXPECT_GT(pid, 0);
    for (int i = 0; i < 1000; ++i) {
      if (kill(pid, 0) != 0) return true;
      std::string state;
      std::ifstream stat("/proc/" + std::to_string(pid) + "/stat");
      for (int field = 0; field < 3; ++field) stat >> state;
      if (state == "Z") return true;  // nobody waits for it where the machine has no init
      usleep(10'000);
    }
    return false;
  }
  [[nodiscard]] std::string Noted(const std::string& name) const { return (folder_ / name).string(); }
};

TEST(Program, GivesCodeAndBothOutputs) {
  const auto ran = RunShell("echo out; echo err >&2; exit 3");
  ASSERT_TRUE(ran.ok()) << ran.status().message();
  EXPECT_EQ(ran->code, 3);
  EXPECT_EQ(ran->output, "out\n");
  EXPECT_EQ(ran->errors, "err\n");
  EXPECT_EQ(RunShell("kill -9 $$")->code, 128 + SIGKILL);
  EXPECT_EQ(RunProgram({"/nonexistent/program"}).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(RunProgram({"/etc/passwd"}).status().code(), StatusCode::kFailed) << "not to be run";
  EXPECT_EQ(RunProgram({"/nonexistent/program"}, ProgramLimit{seconds(20)}).status().code(), StatusCode::kNotFound);
}

TEST(Program, OfALimitIsTheSameWithinIt) {
  const auto ran = RunShell("head -c 300000 /dev/zero; echo err >&2; exit 3", seconds(60));
  ASSERT_TRUE(ran.ok()) << ran.status().message();
  EXPECT_EQ(ran->code, 3);
  EXPECT_EQ(ran->output.size(), 300'000U);
  EXPECT_EQ(ran->errors, "err\n");
}

TEST(Program, GetsOurEnvironmentWithoutWhatSystemdGaveUsAlone) {
  for (const char* name : {"NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC", "LISTEN_PID", "LISTEN_FDS",
                           "LISTEN_FDNAMES", "NOTIFY_SOCKET_OF_OURS"})
    setenv(name, "given", 1);
  const auto ran = RunProgram({"env"});
  for (const char* name :
       {"NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC", "LISTEN_PID", "LISTEN_FDS", "LISTEN_FDNAMES"}) {
    EXPECT_THAT(ran->output, ::testing::Not(HasSubstr(name + std::string("=")))) << name;
    EXPECT_STREQ(getenv(name), "given") << "ours stays";
    unsetenv(name);
  }
  EXPECT_THAT(ran->output, HasSubstr("NOTIFY_SOCKET_OF_OURS=given\n"));
  EXPECT_THAT(ran->output, HasSubstr("PATH="));
  unsetenv("NOTIFY_SOCKET_OF_OURS");
}

TEST(Program, HearsTheSignalsThatOurThreadBlocks) {
  sigset_t blocked, before;
  sigemptyset(&blocked);
  sigaddset(&blocked, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &blocked, &before);
  const auto ran = RunShell("kill $$; echo deaf");
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  EXPECT_EQ(ran->code, 128 + SIGTERM);
  EXPECT_EQ(ran->output, "");
}

TEST_F(LimitedProgram, IsEndedWhateverItDoes) {
  const std::string note = "echo $$ >" + Noted("pid") + "; ";
  for (const std::string& script : {note + "exec sleep 600",                              // hangs
                                    note + "trap '' TERM INT HUP; sleep 600; sleep 600",  // hears no signal
                                    note + "exec >/dev/null 2>&1; sleep 600",             // closes what we read
                                    note + "kill -STOP $$",                               // stands still
                                    note + "while :; do echo more; done"}) {              // never stops talking
    const auto begun = std::chrono::steady_clock::now();
    const auto ran = RunShell(script, milliseconds(300));
    EXPECT_LT(std::chrono::steady_clock::now() - begun, kSoon) << script;
    EXPECT_EQ(ran.status().code(), StatusCode::kTryAgain) << script;
    EXPECT_THAT(ran.status().message(), HasSubstr("sh did not end within 300 ms"));
    EXPECT_TRUE(IsGone("pid")) << script;
  }
}

TEST_F(LimitedProgram, MayEndByItselfWithinItsGrace) {
  const std::string script = "trap 'echo ended >" + Noted("word") + "; exit 0' TERM; sleep 600 & wait";
  const auto ran = RunProgram({"sh", "-c", script}, ProgramLimit{milliseconds(300), seconds(20)});
  EXPECT_EQ(ran.status().code(), StatusCode::kTryAgain) << "its time was over all the same";
  std::string word;
  std::ifstream(folder_ / "word") >> word;
  EXPECT_EQ(word, "ended");
}

TEST_F(LimitedProgram, TakesWhatItStartedAlong) {
  const auto ran = RunShell("sleep 600 & echo $! >" + Noted("child") + "; wait", milliseconds(300));
  EXPECT_EQ(ran.status().code(), StatusCode::kTryAgain);
  EXPECT_TRUE(IsGone("child"));
}

// The pipe's end stays open with the one that is left.
TEST_F(LimitedProgram, ThatEndedAndLeftAnotherBehindHasEnded) {
  const auto begun = std::chrono::steady_clock::now();
  const auto ran = RunShell("sleep 600 & echo $! >" + Noted("child") + "; echo said; exit 3", milliseconds(500));
  EXPECT_LT(std::chrono::steady_clock::now() - begun, kSoon);
  ASSERT_TRUE(ran.ok()) << ran.status().message();
  EXPECT_EQ(ran->code, 3);
  EXPECT_EQ(ran->output, "said\n");
  EXPECT_TRUE(IsGone("child"));
}

// A session of its own is out of reach; nobody waits for it either.
TEST_F(LimitedProgram, IsNotWaitedForBeyondTheLimitThroughAnothersSession) {
  const auto begun = std::chrono::steady_clock::now();
  const auto ran =
      RunShell("setsid sh -c 'echo $$ >" + Noted("child") + "; exec sleep 60' & sleep 1; echo said", seconds(3));
  EXPECT_LT(std::chrono::steady_clock::now() - begun, kSoon);
  ASSERT_TRUE(ran.ok()) << ran.status().message();
  EXPECT_EQ(ran->output, "said\n");
  pid_t child = 0;
  std::ifstream(folder_ / "child") >> child;
  if (child > 0) kill(child, SIGKILL);
}

}  // namespace
}  // namespace stratalux
