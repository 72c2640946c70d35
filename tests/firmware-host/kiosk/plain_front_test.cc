// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/plain_front.h"

#include <array>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;

TEST(PlainFront, ReadsCommands) {
  const KioskConfig kiosk;
  EXPECT_EQ(*ParseCommand("start", kiosk), VisitEvent(event::Start{}));
  EXPECT_EQ(*ParseCommand("  leave ", kiosk), VisitEvent(event::Leave{}));
  EXPECT_EQ(*ParseCommand("agree fit,research ja 1", kiosk), VisitEvent(event::Agree{{true, true, false, 2, 0}}));
  EXPECT_EQ(*ParseCommand("operator out_of_order", kiosk), VisitEvent(event::Operator{OperatorCommand::kOutOfOrder}));
}

TEST(PlainFront, SaysWhatIsNoCommand) {
  const KioskConfig kiosk;
  for (const char* line : {"", "begin", "start now", "agree", "agree fit", "operator", "operator sleep", "face 1 2 3"})
    EXPECT_EQ(ParseCommand(line, kiosk).status().code(), StatusCode::kUsage) << line;
  EXPECT_THAT(ParseCommand("agree fit fr", kiosk).status().message(),
              HasSubstr("'fr' is not one of [kiosk]'s: en, de, ja"));
  EXPECT_THAT(ParseCommand("agree everything en", kiosk).status().message(), HasSubstr("everything"));
  EXPECT_THAT(ParseCommand("begin", kiosk).status().message(), HasSubstr("commands: start"));
}

TEST(PlainFront, WritesScreensAsLinesOfJson) {
  EXPECT_EQ(ScreenAsJson({Phase::kIdle, Word::kNone, {}, 0, 0, {}}), R"({"screen":"idle","word":"none"})");
  EXPECT_EQ(ScreenAsJson({Phase::kClosed, Word::kNone, {Closure::kHours, Closure::kDevice}, 0, 0, {}}),
            R"({"screen":"closed","word":"none","closed_for":["hours","device"]})");
  EXPECT_EQ(ScreenAsJson({Phase::kPosition, Word::kCentre, {}, 0, 0, {1, 2, 3, 4}}),
            R"({"screen":"position","word":"centre","box":[1,2,3,4]})");
}

TEST(PlainFront, OffersToKeepOnlyWhatIsWorthKeeping) {
  EXPECT_EQ(ScreenAsJson({Phase::kGate, Word::kMoved, {}, 1, 3, {}, true}),
            R"({"screen":"gate","word":"moved","number":1,"of":3,"offers":["start","leave","refuse"]})");
  EXPECT_EQ(ScreenAsJson({Phase::kGate, Word::kProof, {}, 1, 3, {}, false}),
            R"({"screen":"gate","word":"proof","number":1,"of":3,"offers":["start","refuse"]})");
}

TEST(PlainFront, TakesLinesHoweverTheyArriveAndItsEndIsNoCommand) {
  std::array<int, 2> in{}, out{};
  ASSERT_EQ(pipe(in.data()), 0);
  ASSERT_EQ(pipe(out.data()), 0);
  Logger logger(LogLevel::kError);
  const KioskConfig kiosk;
  PlainFront front(in[0], out[1], kiosk, logger);
  EXPECT_TRUE(front.Take().empty()) << "does not wait";
  ASSERT_EQ(write(in[1], "start\nref", 9), 9);
  EXPECT_EQ(front.Take().size(), 1U);
  ASSERT_EQ(write(in[1], "use\nnonsense\n", 13), 13);
  const std::vector<VisitEvent> second = front.Take();
  ASSERT_EQ(second.size(), 1U);
  EXPECT_EQ(second[0], VisitEvent(event::Refuse{}));
  close(in[1]);
  EXPECT_TRUE(front.Take().empty());
  EXPECT_EQ(front.fd(), -1) << "nobody waits for it any more";
  EXPECT_TRUE(front.GiveTicket("7K3QZ-M0P4T-3"));
  char buffer[64];
  const ssize_t count = read(out[0], buffer, sizeof buffer);
  EXPECT_EQ(std::string(buffer, static_cast<size_t>(count)), "{\"ticket\":\"7K3QZ-M0P4T-3\"}\n");
  for (const int fd : {in[0], out[0], out[1]}) close(fd);
}

// A pipe that nobody reads, and a full disk.
TEST(PlainFront, SaysWhenATicketWentNowhere) {
  std::array<int, 2> out{};
  ASSERT_EQ(pipe2(out.data(), O_NONBLOCK), 0);
  while (write(out[1], "full", 4) > 0) continue;
  const int full = open("/dev/full", O_WRONLY | O_CLOEXEC);
  Logger logger(LogLevel::kError);
  const KioskConfig kiosk;
  for (const int fd : {out[1], full}) {
    ASSERT_GE(fd, 0);
    EXPECT_FALSE(PlainFront(-1, fd, kiosk, logger).GiveTicket("7K3QZ-M0P4T-3"));
  }
  for (const int fd : {out[0], out[1], full}) close(fd);
}

}  // namespace
}  // namespace stratalux::rig
