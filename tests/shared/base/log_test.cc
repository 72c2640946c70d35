// SPDX-License-Identifier: Apache-2.0
#include "shared/base/log.h"

#include <array>
#include <atomic>
#include <csignal>
#include <functional>
#include <future>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include "shared/base/log_queue.h"
#include "shared/base/unique_fd.h"
#include "tests/support/sanitized.h"
#include "tests/support/text_of.h"

namespace stratalux {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

// A pipe whose write end is a stream.
class Pipe {
 public:
  Pipe() {
    int ends[2] = {};
    if (pipe2(ends, O_CLOEXEC) != 0) ADD_FAILURE() << "no pipe";
    read_ = ends[0];
    stream_ = fdopen(ends[1], "w");
  }
  ~Pipe() {
    CloseReader();
    CloseWriter();
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  [[nodiscard]] std::FILE* stream() const { return stream_; }
  // Until not a byte more goes in; how many did.
  size_t Fill() const {
    const int fd = fileno(stream_);
    fcntl(fd, F_SETFL, O_NONBLOCK);
    size_t bytes = 0;
    for (const char newline = '\n'; write(fd, &newline, 1) == 1;) ++bytes;
    fcntl(fd, F_SETFL, 0);
    return bytes;
  }
  // What is there, at least a byte.
  [[nodiscard]] std::string Read() const {
    std::array<char, 4096> some = {};
    const ssize_t n = read(read_, some.data(), some.size());
    return {some.data(), n > 0 ? static_cast<size_t>(n) : 0};
  }
  // All until the last writer is gone.
  [[nodiscard]] std::string ReadAll() const {
    std::string text;
    for (std::string some = Read(); !some.empty(); some = Read()) text += some;
    return text;
  }
  void CloseWriter() {
    if (stream_ != nullptr) std::fclose(std::exchange(stream_, nullptr));
  }
  void CloseReader() {
    if (read_ >= 0) close(std::exchange(read_, -1));
  }

 private:
  int read_ = -1;
  std::FILE* stream_ = nullptr;
};

std::vector<std::string> LinesOf(const std::string& text) {
  std::vector<std::string> lines;
  for (size_t start = 0, end = 0; (end = text.find('\n', start)) != std::string::npos; start = end + 1)
    if (end > start) lines.push_back(text.substr(start, end - start));
  return lines;
}

// A stream without a descriptor; `write` is called by the logger's thread.
class Cookie {
 public:
  explicit Cookie(std::function<void(std::string_view)> write) : write_(std::move(write)) {
    stream_ = fopencookie(this, "w", {nullptr, &Cookie::Write, nullptr, nullptr});
  }
  ~Cookie() { std::fclose(stream_); }
  Cookie(const Cookie&) = delete;
  Cookie& operator=(const Cookie&) = delete;
  [[nodiscard]] std::FILE* stream() const { return stream_; }

 private:
  static ssize_t Write(void* self, const char* bytes, size_t size) {
    static_cast<Cookie*>(self)->write_({bytes, size});
    return static_cast<ssize_t>(size);
  }
  std::function<void(std::string_view)> write_;
  std::FILE* stream_;
};

#if defined(__SANITIZE_THREAD__)
#define SKIP_WITHOUT_THREADS_IN_A_CHILD() GTEST_SKIP() << "ThreadSanitizer allows no thread in a child of fork()"
#else
#define SKIP_WITHOUT_THREADS_IN_A_CHILD() static_cast<void>(0)
#endif
// Where another thread allocates while a child is made: AddressSanitizer's allocator (GCC 12) leaves its lock taken in
// the child. glibc's does not.
#define SKIP_WITHOUT_A_HEAP_IN_A_CHILD() \
  if (kUnderAddressSanitizer) GTEST_SKIP() << "AddressSanitizer's heap may be locked in a child of fork()"

// What `life` returned in a process of its own; -1 if it was killed, as by the alarm of one that hangs.
int InChild(const std::function<int()>& life) {
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child == 0) {
    alarm(60);
    _exit(life());
  }
  int status = 0;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

constexpr int kMany = 10'000;

// The number a line begins with, behind its level.
int NumberOf(const std::string& line) { return std::stoi(line.substr(line.find(": ") + 2)); }

void FlushAtLast(Logger& logger) {
  while (!logger.Flush()) std::this_thread::sleep_for(1ms);
}

TEST(Logger, NobodyWaitsForAPipeThatNobodyReads) {
  Pipe pipe;
  std::future<std::string> text;
  int64_t dropped = 0;
  {
    Logger logger(LogLevel::kInfo, pipe.stream());
    for (int i = 0; i < kMany; ++i) logger.Info(std::to_string(i) + std::string(100, '.'));
    // This is the proof: the calls returned, and nobody has read a byte.
    EXPECT_FALSE(logger.Flush());
    dropped = logger.dropped();
    EXPECT_GE(dropped, kMany - static_cast<int>(LogQueue::kMaxLines) - 1000) << "the pipe takes 64 KiB";
    text = std::async(std::launch::async, [&pipe] { return pipe.ReadAll(); });
    FlushAtLast(logger);
    logger.Info(std::to_string(kMany));
    EXPECT_TRUE(logger.Flush());
    EXPECT_EQ(logger.dropped(), dropped) << "there was room again";
  }
  pipe.CloseWriter();
  int written = 0, last = -1, told = 0;
  for (const std::string& line : LinesOf(text.get())) {
    if (line.starts_with("warning: ")) {
      EXPECT_THAT(line, HasSubstr(" lines were dropped: the log did not take them"));
      EXPECT_LT(last, kMany) << "it stands where the lines would have stood";
      told += NumberOf(line);
      continue;
    }
    EXPECT_GT(NumberOf(line), last);
    last = NumberOf(line);
    ++written;
  }
  EXPECT_EQ(last, kMany);
  EXPECT_EQ(told, dropped);
  EXPECT_EQ(written + dropped, kMany + 1);
}

TEST(Logger, TellsOfDroppedLinesWhereTheyWouldHaveStood) {
  Pipe pipe;
  const size_t filling = pipe.Fill();
  std::future<std::string> text;
  {
    Logger logger(LogLevel::kInfo, pipe.stream());
    for (size_t i = 0; i < LogQueue::kMaxLines + 5; ++i) logger.Info("before");
    EXPECT_EQ(logger.dropped(), 5);
    // Room for some lines: the rest are still queued when the next one comes.
    for (size_t got = 0; got < filling / 4;) got += pipe.Read().size();
    for (int64_t dropped = -1; dropped != logger.dropped(); std::this_thread::sleep_for(1ms)) {
      dropped = logger.dropped();
      logger.Info("behind");
    }
    text = std::async(std::launch::async, [&pipe] { return pipe.ReadAll(); });
    FlushAtLast(logger);
  }
  pipe.CloseWriter();
  const std::vector<std::string> lines = LinesOf(text.get());
  EXPECT_EQ(lines.size(), LogQueue::kMaxLines + 2);
  ASSERT_GT(lines.size(), 2U);
  EXPECT_THAT(lines[lines.size() - 2], HasSubstr(" lines were dropped: the log did not take them"));
  EXPECT_EQ(lines.back(), "info: behind");
}

TEST(Logger, BytesAreBoundedToo) {
  Pipe pipe;
  pipe.Fill();
  Logger logger(LogLevel::kInfo, pipe.stream());
  constexpr int kLines = 40;
  for (int i = 0; i < kLines; ++i) logger.Info(std::string(60'000, 'x'));
  constexpr int kRoom = static_cast<int>(LogQueue::kMaxBytes / (60'000 + std::string_view("info: \n").size()));
  EXPECT_EQ(logger.dropped(), kLines - kRoom);
}

TEST(Logger, TwoThreadsKeepTheirOrderAndLoseNothing) {
  constexpr int kEach = 1500;  // fit into the queue
  std::FILE* file = std::tmpfile();
  {
    Logger logger(LogLevel::kInfo, file);
    const auto log = [&logger](const char* who) {
      for (int i = 0; i < kEach; ++i) logger.Info(std::to_string(i) + who);
    };
    std::thread other(log, "b");
    log("a");
    other.join();
  }
  const std::vector<std::string> lines = LinesOf(TextOf(file));
  std::fclose(file);
  int next_a = 0, next_b = 0;
  for (const std::string& line : lines) EXPECT_EQ(NumberOf(line), line.back() == 'a' ? next_a++ : next_b++);
  EXPECT_EQ(next_a, kEach);
  EXPECT_EQ(next_b, kEach);
}

TEST(Logger, ALongLineArrivesWholeAndAnEndlessOneIsCutBetweenCharacters) {
  Pipe pipe;
  auto text = std::async(std::launch::async, [&pipe] { return pipe.ReadAll(); });
  const std::string longest(65'536, 'x');
  {
    Logger logger(LogLevel::kInfo, pipe.stream());
    logger.Info(longest);
    logger.Info(longest.substr(1) + "ë" + "yy");
  }
  pipe.CloseWriter();
  EXPECT_EQ(text.get(), "info: " + longest + "\ninfo: " + longest.substr(1) + "... (4 bytes cut off)\n");
}

TEST(Logger, EndsThoughNobodyReads) {
  Pipe pipe;
  pipe.Fill();
  const auto start = std::chrono::steady_clock::now();
  {
    Logger logger(LogLevel::kInfo, pipe.stream());
    logger.Info("never read");
  }
  const auto took = std::chrono::steady_clock::now() - start;
  EXPECT_GE(took, LogQueue::kPatience) << "a reader that is only slow has its second";
  EXPECT_LT(took, 20s);
}

// Ctrl-S.
TEST(Logger, NobodyWaitsForATerminalThatIsStopped) {
  const UniqueFd screen(posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC));
  if (!screen.ok() || grantpt(screen.get()) != 0 || unlockpt(screen.get()) != 0) GTEST_SKIP() << "no terminals here";
  std::FILE* terminal = std::fopen(ptsname(screen.get()), "r+");
  ASSERT_NE(terminal, nullptr);
  ASSERT_EQ(tcflow(fileno(terminal), TCOOFF), 0);
  {
    Logger logger(LogLevel::kInfo, terminal);
    for (int i = 0; i < kMany; ++i) logger.Info("line");
    EXPECT_EQ(logger.dropped(), kMany - static_cast<int>(LogQueue::kMaxLines)) << "the terminal takes nothing";
  }
  ASSERT_EQ(tcflow(fileno(terminal), TCOON), 0);
  {
    Logger logger(LogLevel::kInfo, terminal);
    Progress(logger, "work", 2).Advance();
    EXPECT_TRUE(logger.Flush());
  }
  std::array<char, 4096> shown = {};
  const ssize_t bytes = read(screen.get(), shown.data(), shown.size());
  ASSERT_GT(bytes, 0);
  EXPECT_THAT(std::string(shown.data(), static_cast<size_t>(bytes)), HasSubstr("\rwork                     [####"));
  std::fclose(terminal);
}

TEST(Logger, LeavesAThreadBehindThatIsStuckInTheSink) {
  std::promise<void> let_go;
  std::atomic<bool> entered = false, came_back = false;
  // Closed at exit: nobody can know when the thread is done with it.
  static Cookie cookie([&](std::string_view) {
    EXPECT_FALSE(entered) << "a line was taken after the logger";
    entered = true;
    let_go.get_future().wait();
    came_back = true;
  });
  {
    Logger logger(LogLevel::kInfo, cookie.stream());
    logger.Info("stuck");
    while (!entered) std::this_thread::sleep_for(1ms);
    logger.Info("behind it");
  }
  EXPECT_FALSE(came_back);
  // The logger is gone; its thread goes on with what is its own and takes no further line.
  let_go.set_value();
  while (!came_back) std::this_thread::sleep_for(1ms);
  std::this_thread::sleep_for(50ms);
}

TEST(Logger, AChildOfForkHasAQueueOfItsOwn) {
  SKIP_WITHOUT_THREADS_IN_A_CHILD();
  Pipe stuck;
  const size_t filling = stuck.Fill();
  std::FILE* file = std::tmpfile();
  {
    Logger full(LogLevel::kInfo, stuck.stream()), free(LogLevel::kInfo, file);
    full.Info("of the parent");
    free.Info("of the parent");
    EXPECT_TRUE(free.Flush());
    EXPECT_EQ(InChild([&] {
                free.Info("of the child");
                // Nothing of the parent's is queued here.
                return free.Flush() && full.Flush() ? 0 : 1;
              }),
              0);
    free.Info("of the parent again");
    auto text = std::async(std::launch::async, [&] {
      std::string got;
      while (LinesOf(got).empty()) got += stuck.Read();
      return got;
    });
    FlushAtLast(full);
    EXPECT_THAT(LinesOf(text.get()), ElementsAre("info: of the parent"));
    EXPECT_GT(filling, 0U);
  }
  EXPECT_THAT(LinesOf(TextOf(file)),
              ElementsAre("info: of the parent", "info: of the child", "info: of the parent again"));
  std::fclose(file);
}

TEST(Logger, AForkAmidOthersLoggingHangsNobody) {
  SKIP_WITHOUT_THREADS_IN_A_CHILD();
  SKIP_WITHOUT_A_HEAP_IN_A_CHILD();
  Cookie nowhere([](std::string_view) {});
  Logger logger(LogLevel::kInfo, nowhere.stream());
  std::atomic<bool> done = false;
  std::thread busy([&] {
    while (!done) {
      logger.Info("busy");
      Logger(LogLevel::kInfo, nowhere.stream()).Info("short-lived");
    }
  });
  std::FILE* file = std::tmpfile();
  Logger told(LogLevel::kInfo, file);
  for (int i = 0; i < 50; ++i)
    EXPECT_EQ(InChild([&] {
                logger.Info("of the child");
                told.Info("of the child");
                return told.Flush() ? 0 : 1;
              }),
              0);
  done = true;
  busy.join();
  EXPECT_EQ(LinesOf(TextOf(file)).size(), 50U);
  std::fclose(file);
}

std::atomic<int> g_pipe_signals = 0;

TEST(Logger, AReaderThatLeftRaisesNoSignalForTheProcess) {
  struct sigaction count = {}, before = {};
  count.sa_handler = [](int) { ++g_pipe_signals; };
  sigaction(SIGPIPE, &count, &before);
  Pipe pipe;
  pipe.CloseReader();
  Logger logger(LogLevel::kInfo, pipe.stream());
  logger.Error("to nobody");
  EXPECT_TRUE(logger.Flush());
  EXPECT_EQ(logger.dropped(), 1);
  logger.Error("to nobody");
  EXPECT_TRUE(logger.Flush());
  EXPECT_EQ(logger.dropped(), 2);
  EXPECT_EQ(g_pipe_signals, 0);
  sigaction(SIGPIPE, &before, nullptr);
}

TEST(Logger, AClosedStderrIsNotTheFileThatIsOpenedNext) {
  SKIP_WITHOUT_THREADS_IN_A_CHILD();
  EXPECT_EQ(InChild([] {
              close(STDERR_FILENO);
              Logger logger;
              std::FILE* file = std::tmpfile();
              if (file == nullptr || fileno(file) != STDERR_FILENO) return 1;
              logger.Error("not into the file");
              if (!logger.Flush() || logger.dropped() != 1) return 2;
              return TextOf(file).empty() ? 0 : 3;
            }),
            0);
}

TEST(Logger, ItsThreadIsOrdinaryAndTakesNoSignalsButThoseOfACrash) {
  sigset_t blocked = {};
  int policy = -1;
  Cookie cookie([&](std::string_view) {
    pthread_sigmask(SIG_SETMASK, nullptr, &blocked);
    policy = sched_getscheduler(0);
  });
  sigset_t own = {};
  bool is_realtime = false;
  std::thread([&] {
    const sched_param least = {.sched_priority = 1};
    is_realtime = pthread_setschedparam(pthread_self(), SCHED_FIFO, &least) == 0;
    Logger(LogLevel::kInfo, cookie.stream()).Info("first");
    pthread_sigmask(SIG_SETMASK, nullptr, &own);
  }).join();
  for (const int signal : {SIGPIPE, SIGINT, SIGTERM, SIGHUP, SIGALRM}) {
    EXPECT_EQ(sigismember(&blocked, signal), 1) << strsignal(signal);
    EXPECT_EQ(sigismember(&own, signal), 0) << strsignal(signal);
  }
  for (const int signal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT})
    EXPECT_EQ(sigismember(&blocked, signal), 0) << strsignal(signal);
  EXPECT_EQ(policy, SCHED_OTHER);
  if (!is_realtime) GTEST_SKIP() << "no right to a real-time priority: that it is not inherited was not seen";
}

TEST(Logger, ExitWritesWhatALivingLoggerHolds) {
  SKIP_WITHOUT_THREADS_IN_A_CHILD();
  Pipe pipe;
  const size_t filling = pipe.Fill();
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child == 0) {
    pipe.CloseReader();
    Logger logger(LogLevel::kInfo, pipe.stream());
    for (int i = 0; i < 100; ++i) logger.Info("line");
    std::exit(7);
  }
  pipe.CloseWriter();
  std::this_thread::sleep_for(200ms);  // by then it is in exit()
  EXPECT_EQ(pipe.ReadAll().size(), filling + 100 * std::string_view("info: line\n").size());
  int status = 0;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(WEXITSTATUS(status), 7);
}

TEST(Logger, WhatIsSaidStandsBehindTheLines) {
  SKIP_WITHOUT_THREADS_IN_A_CHILD();
  SKIP_WITHOUT_A_HEAP_IN_A_CHILD();
  Pipe pipe;
  auto text = std::async(std::launch::async, [&pipe] { return pipe.ReadAll(); });
  EXPECT_EQ(InChild([&pipe] {
              dup2(fileno(pipe.stream()), STDERR_FILENO);
              Logger logger;
              for (int i = 0; i < 1000; ++i) logger.Warning("\x1b[31m");
              Say(LogLevel::kError, "program: \x1b failed\n");
              return 0;
            }),
            0);
  pipe.CloseWriter();
  const std::vector<std::string> lines = LinesOf(text.get());
  ASSERT_EQ(lines.size(), 1001U);
  EXPECT_EQ(lines[999], "warning: \\x1b[31m");
  EXPECT_EQ(lines[1000], "program: \\x1b failed");
}

TEST(Logger, WhatIsSaidWaitsForNobodyEither) {
  SKIP_WITHOUT_THREADS_IN_A_CHILD();
  Pipe pipe;
  pipe.Fill();
  EXPECT_EQ(InChild([&pipe] {
              dup2(fileno(pipe.stream()), STDERR_FILENO);
              Logger logger;
              logger.Error("never read");
              Say(LogLevel::kError, "never read\n");
              return 5;
            }),
            5);
}

TEST(Progress, StandsInOrderWithTheLines) {
  std::FILE* file = std::tmpfile();
  {
    Logger logger(LogLevel::kInfo, file);
    logger.Info("before");
    Progress(logger, "work", 2).Advance(2);
    logger.Info("behind");
  }
  const std::vector<std::string> lines = LinesOf(TextOf(file));
  std::fclose(file);
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines[0], "info: before");
  EXPECT_THAT(lines[1], HasSubstr("work: 100 % ("));
  EXPECT_EQ(lines[2], "info: behind");
}

TEST(Progress, WaitsForNobodyAndIsNotCountedAsDropped) {
  Pipe pipe;
  pipe.Fill();
  Logger logger(LogLevel::kInfo, pipe.stream());
  for (size_t i = 0; i < LogQueue::kMaxLines; ++i) logger.Info("x");
  for (int i = 0; i < 10; ++i) Progress(logger, "work", 1).Advance();
  EXPECT_EQ(logger.dropped(), 0);
  logger.Info("x");
  EXPECT_EQ(logger.dropped(), 1);
}

}  // namespace
}  // namespace stratalux
