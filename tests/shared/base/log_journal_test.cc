// SPDX-License-Identifier: Apache-2.0
// The journal's native protocol against a socket of the test's own.
#include <array>
#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "shared/base/log_queue.h"
#include "shared/base/unique_fd.h"
#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::Pair;
using Fields = std::map<std::string, std::string>;

// What journald reads out of a datagram.
Fields Parsed(const std::string& datagram) {
  Fields fields;
  size_t at = 0;
  while (at < datagram.size()) {
    const size_t name_end = datagram.find_first_of("=\n", at);
    const std::string name = datagram.substr(at, name_end - at);
    size_t start = name_end + 1, size = datagram.find('\n', start) - start;
    if (datagram[name_end] == '\n') {
      size = 0;
      for (size_t i = 0; i < 8; ++i)
        size |= static_cast<size_t>(static_cast<unsigned char>(datagram[start + i])) << 8 * i;
      start += 8;
    }
    EXPECT_TRUE(fields.emplace(name, datagram.substr(start, size)).second) << name << " twice";
    at = start + size + 1;
    EXPECT_EQ(datagram.at(at - 1), '\n');
  }
  return fields;
}

class JournalTest : public ScratchFolderTest {
 public:
  void SetUp() override { Listen(); }
  [[nodiscard]] std::string path() const { return folder_ / "socket"; }
  void Listen() {
    listener_ = UniqueFd(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    sockaddr_un address = {};
    address.sun_family = AF_UNIX;
    path().copy(address.sun_path, sizeof address.sun_path - 1);
    ASSERT_EQ(bind(listener_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    const timeval patience = {.tv_sec = 20, .tv_usec = 0};
    setsockopt(listener_.get(), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  }
  void Hush() {
    listener_ = UniqueFd();
    std::filesystem::remove(path());
  }
  // The next datagram; nothing after 20 s without one.
  Fields Receive() {
    static std::array<char, 1 << 18> datagram;  // more than the kernel lets through
    const ssize_t size = recv(listener_.get(), datagram.data(), datagram.size(), 0);
    return size < 0 ? Fields() : Parsed({datagram.data(), static_cast<size_t>(size)});
  }

  UniqueFd listener_;
};

TEST_F(JournalTest, GetsLevelTextAndFieldsApart) {
  Logger logger(LogLevel::kDebug, JournalSink(path()));
  logger.Write(LogLevel::kWarning, "frame lost", {{"SESSION", "s=1"}, {"STEP", "12"}});
  EXPECT_THAT(Receive(), ElementsAre(Pair("MESSAGE", "frame lost"), Pair("PRIORITY", "4"), Pair("SESSION", "s=1"),
                                     Pair("STEP", "12"), Pair("SYSLOG_IDENTIFIER", program_invocation_short_name)));
  logger.Debug("d");
  EXPECT_EQ(Receive()["PRIORITY"], "7");
  logger.Info("i");
  EXPECT_EQ(Receive()["PRIORITY"], "6");
  logger.Error("e");
  EXPECT_EQ(Receive()["PRIORITY"], "3");
}

TEST_F(JournalTest, GetsLineEndsWithinMessageAndFields) {
  Logger logger(LogLevel::kInfo, JournalSink(path()));
  const std::string many = "a\nPRIORITY=0\n" + std::string(300, 'b');
  logger.Write(LogLevel::kInfo, "first\nMESSAGE=second \x1b", {{"NOTE", many}});
  const Fields got = Receive();
  EXPECT_EQ(got.at("MESSAGE"), "first\nMESSAGE=second \\x1b");
  EXPECT_EQ(got.at("NOTE"), many);
  EXPECT_EQ(got.at("PRIORITY"), "6");
}

TEST_F(JournalTest, GetsProgressWithoutLineEnds) {
  Logger logger(LogLevel::kInfo, JournalSink(path()));
  Progress(logger, "work", 1).Advance();
  EXPECT_THAT(Receive().at("MESSAGE"), ::testing::StartsWith("work: 100 % ("));
}

TEST_F(JournalTest, NobodyWaitsForAJournalThatDoesNotRead) {
  constexpr int kMany = 10'000;
  int written = 0, told = 0, last = -1;
  int64_t dropped = 0;
  {
    Logger logger(LogLevel::kInfo, JournalSink(path()));
    for (int i = 0; i < kMany; ++i) logger.Info(std::to_string(i));
    EXPECT_FALSE(logger.Flush());
    dropped = logger.dropped();
    EXPECT_GT(dropped, 0);
    while (written + told < kMany) {
      const Fields got = Receive();
      ASSERT_FALSE(got.empty()) << written << " written, " << told << " told";
      const int number = std::stoi(got.at("MESSAGE"));
      if (got.at("PRIORITY") == "6") {
        EXPECT_GT(number, last);
        last = number;
        ++written;
      } else {
        EXPECT_THAT(got.at("MESSAGE"), ::testing::HasSubstr("lines were dropped: the journal did not take them"));
        told += number;
      }
    }
  }
  EXPECT_EQ(told, dropped);
}

TEST_F(JournalTest, ALineThatFitsNoDatagramIsCountedAndKeepsNothingUp) {
  Logger logger(LogLevel::kInfo, JournalSink(path()));
  logger.Write(LogLevel::kInfo, "too much", {{"BLOB", std::string(900'000, 'x')}});
  EXPECT_EQ(Receive().at("MESSAGE"), "1 line was dropped: the journal did not take them");
  logger.Info("next");
  EXPECT_EQ(Receive().at("MESSAGE"), "next");
  EXPECT_EQ(logger.dropped(), 1);
}

TEST_F(JournalTest, AnotherJournalIsFound) {
  Logger logger(LogLevel::kInfo, JournalSink(path()));
  logger.Info("before");
  EXPECT_EQ(Receive().at("MESSAGE"), "before");
  Hush();
  logger.Info("meanwhile");
  std::this_thread::sleep_for(100ms);
  Listen();
  EXPECT_EQ(Receive().at("MESSAGE"), "meanwhile");
  EXPECT_EQ(logger.dropped(), 0);
}

TEST_F(JournalTest, IsNotChosenWhereNobodyListens) {
  Hush();
  EXPECT_EQ(JournalSink(path()), nullptr);
  EXPECT_EQ(JournalSink(std::string(200, 'x')), nullptr) << "longer than an address";
}

TEST(IsJournal, ByDeviceAndInodeOfTheDescriptor) {
  struct stat status = {};
  ASSERT_EQ(fstat(STDERR_FILENO, &status), 0);
  const std::string device = std::to_string(status.st_dev), inode = std::to_string(status.st_ino);
  EXPECT_TRUE(IsJournal(STDERR_FILENO, (device + ":" + inode).c_str()));
  EXPECT_FALSE(IsJournal(STDERR_FILENO, (device + ":" + inode + "1").c_str())) << "redirected since";
  EXPECT_FALSE(IsJournal(STDERR_FILENO, ("1" + device + ":" + inode).c_str()));
  EXPECT_FALSE(IsJournal(STDERR_FILENO, (device + ":" + inode + " ").c_str()));
  for (const char* wrong : {"", ":", "1", "1:", "x:y"}) EXPECT_FALSE(IsJournal(STDERR_FILENO, wrong)) << wrong;
  EXPECT_FALSE(IsJournal(STDERR_FILENO, nullptr));
  EXPECT_FALSE(IsJournal(-1, (device + ":" + inode).c_str()));
}

TEST(LogFieldName, IsWhatJournaldKeeps) {
  static_assert(LogFieldName::IsAllowed("SESSION") && LogFieldName::IsAllowed("A_1"));
  static_assert(!LogFieldName::IsAllowed("") && !LogFieldName::IsAllowed("session") && !LogFieldName::IsAllowed("A=B"));
  static_assert(!LogFieldName::IsAllowed("_TRUSTED") && !LogFieldName::IsAllowed("1A"));
  static_assert(!LogFieldName::IsAllowed("MESSAGE") && !LogFieldName::IsAllowed("PRIORITY"));
  EXPECT_TRUE(LogFieldName::IsAllowed(std::string(64, 'A')));
  EXPECT_FALSE(LogFieldName::IsAllowed(std::string(65, 'A')));
}

}  // namespace
}  // namespace stratalux
