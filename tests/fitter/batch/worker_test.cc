// SPDX-License-Identifier: Apache-2.0
// A process that is watched: how it ended, what it took, and that it never outlives whoever watches it.
#include "fitter/batch/worker.h"

#include <csignal>
#include <thread>

#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

class WorkerTest : public ScratchFolderTest {
 protected:
  [[nodiscard]] Result<Worker> Start(const std::string& script, int threads = 1) const {
    return Worker::Start({{"/bin/sh", "-c", script}, folder_ / "log", threads, 5});
  }
  static WorkerEnd EndOf(Worker& worker) {
    pollfd ended{worker.fd(), POLLIN, 0};
    EXPECT_EQ(poll(&ended, 1, 60'000), 1) << "its end wakes nobody";
    const auto end = worker.Ended();
    EXPECT_TRUE(end);
    return end.value_or(WorkerEnd());
  }
};

TEST_F(WorkerTest, TellsHowItEndedAndWhatItSaid) {
  auto worker = Start("echo out; echo err >&2; echo threads=$STRATALUX_THREADS; cat; nice; exit 7", 3);
  ASSERT_TRUE(worker.ok()) << worker.status().message();
  const WorkerEnd end = EndOf(*worker);
  EXPECT_EQ(end.exit_code, 7);
  EXPECT_EQ(end.signal, 0);
  EXPECT_GT(end.peak_bytes, 100'000);
  EXPECT_FALSE(worker->Ended()) << "once";
  EXPECT_EQ(ReadText(folder_ / "log"), "out\nerr\nthreads=3\n" + std::to_string(nice(0) + 5) + "\n");
}

TEST_F(WorkerTest, IsHandedTheKeysOfItsVisitorAndTheWayToNoOther) {
  setenv("STRATALUX_READER_KEY", "/reader.key", 1);
  setenv("CREDENTIALS_DIRECTORY", "/credentials", 1);
  db::SessionKey key;
  key.id.fill('i');
  auto secret = std::make_shared<db::SecretKey>();
  secret->bytes.fill('k');
  key.key = std::move(secret);
  const std::string environment = "env | grep -c 'READER_KEY\\|CREDENTIALS'; ";
  auto with = Worker::Start({{"/bin/sh", "-c", environment + "cat /proc/self/fd/$STRATALUX_KEYS_FD | tail -c 48"},
                             folder_ / "with",
                             1,
                             0,
                             {key}});
  auto without = Worker::Start({{"/bin/sh", "-c", environment + "echo $STRATALUX_KEYS_FD"}, folder_ / "without"});
  unsetenv("STRATALUX_READER_KEY");
  unsetenv("CREDENTIALS_DIRECTORY");
  ASSERT_TRUE(with.ok() && without.ok());
  EndOf(*with);
  EndOf(*without);
  EXPECT_EQ(ReadText(folder_ / "with"), "0\n" + std::string(16, 'i') + std::string(32, 'k'));
  EXPECT_EQ(ReadText(folder_ / "without"), "0\n\n");
}

TEST_F(WorkerTest, TellsOfASignal) {
  auto worker = Start("kill -SEGV $$");
  ASSERT_TRUE(worker.ok());
  const WorkerEnd end = EndOf(*worker);
  EXPECT_EQ(end.exit_code, -1);
  EXPECT_EQ(end.signal, SIGSEGV);
}

TEST_F(WorkerTest, WhatIsNotThereIsSaid) {
  const auto worker = Worker::Start({{"/nowhere/stratalux-fit"}, folder_ / "log"});
  EXPECT_EQ(worker.status().code(), StatusCode::kFailed);
  EXPECT_NE(worker.status().message().find("/nowhere/stratalux-fit: No such file"), std::string::npos);
}

TEST_F(WorkerTest, GoesWithItsOwner) {
  pid_t pid = 0;
  {
    auto worker = Start("sleep 1000");
    ASSERT_TRUE(worker.ok());
    pid = worker->pid();
    Worker moved = std::move(*worker);
    EXPECT_EQ(kill(pid, 0), 0);
    EXPECT_GT(moved.ResidentBytes(), 0);
  }
  EXPECT_EQ(kill(pid, 0), -1);
}

TEST_F(WorkerTest, GoesWithItsProcessHoweverThatEnds) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  const pid_t owner = fork();
  if (owner == 0) {
    auto worker = Start("echo $$ > " + (folder_ / "pid").string() + "; exec sleep 1000");
    while (ReadText(folder_ / "pid").empty()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    kill(getpid(), SIGKILL);
  }
  close(ends[1]);
  ASSERT_EQ(waitpid(owner, nullptr, 0), owner);
  // The worker held the other end: it is closed when the worker is gone.
  pollfd gone{ends[0], POLLIN, 0};
  EXPECT_EQ(poll(&gone, 1, 60'000), 1) << "the worker lives on";
  close(ends[0]);
}

}  // namespace
}  // namespace stratalux::fit
