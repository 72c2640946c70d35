// SPDX-License-Identifier: Apache-2.0
// The page as the front of the real loop, on a small simulated rig: a visit by requests of a browser.
#include "firmware-host/kiosk/page_front.h"

#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <poll.h>

#include "db/catalogue/session_store.h"
#include "db/privacy/open_visits.h"
#include "db/privacy/ticket.h"
#include "firmware-host/kiosk/kiosk.h"
#include "tests/firmware-host/kiosk/operator_token.h"
#include "tests/firmware-host/kiosk/small_kiosk.h"
#include "tests/shared/http/http_client.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::json;

class PageFrontTest : public ScratchFolderTest {
 protected:
  void Start() {
    KioskPageOptions options;
    options.operator_token = kOperatorToken;
    options.store = folder_ / "store";
    auto front = PageFront::Start(options, logger_);
    ASSERT_TRUE(front.ok()) << front.status().message();
    front_ = std::move(*front);
  }
  [[nodiscard]] int port() const { return front_->page().port(); }
  [[nodiscard]] Json State() const {
    http::Client client(port());
    client.Send("GET /events HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port()) + "\r\n\r\n");
    const std::string text = client.ReadUntil("}\n\n");
    const size_t at = text.rfind("data: ");
    return at == std::string::npos ? Json() : Json::parse(text.substr(at + 6, text.find('\n', at) - at - 6));
  }
  // What is shown once it is `screen`.
  [[nodiscard]] Json Until(const std::string& screen) const {
    Json state;
    for (int i = 0; i < 1200 && state["screen"] != screen; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      state = State();
    }
    EXPECT_EQ(state["screen"], screen);
    return state;
  }
  [[nodiscard]] int Post(const std::string& place, const Json& body,
                         std::map<std::string, std::string> headers = {}) const {
    headers["Host"] = "127.0.0.1:" + std::to_string(port());
    headers["Origin"] = "http://" + headers["Host"];
    headers["Connection"] = "close";
    return http::Ask(port(), "POST", place, headers, body.dump()).status;
  }
  void Press(const std::string& verb, const std::string& screen) const {
    const Json seen = Until(screen);
    EXPECT_EQ(Post("/visitor/" + verb, {{"nonce", seen["nonce"]}, {"screen", screen}}), 204) << verb;
  }

  Logger logger_{LogLevel::kError};
  std::unique_ptr<PageFront> front_;
};

TEST_F(PageFrontTest, APressWakesTheLoopAndASecondIsABeat) {
  Start();
  pollfd readable{front_->fd(), POLLIN, 0};
  front_->Take();
  EXPECT_EQ(Post("/operator/clean", {}, {{"Authorization", "Bearer " + kOperatorToken}}), 202);
  ASSERT_EQ(poll(&readable, 1, 500), 1);
  const auto taken = front_->Take();
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_EQ(std::get<event::Operator>(taken[0]).command, OperatorCommand::kClean);
  EXPECT_EQ(poll(&readable, 1, 2000), 1) << "nobody would know that the loop stands still";
  EXPECT_TRUE(front_->Take().empty());
}

TEST_F(PageFrontTest, AVisitOnASimulatedRigIsKeptAndWithdrawnByItsTicket) {
  KioskOptions options = SmallKiosk(folder_);
  StopToken stop;
  auto station = CaptureStation::Open(options.station, stop, logger_);
  ASSERT_TRUE(station.ok()) << station.status().message();
  Start();
  const std::map<std::string, std::string> keeper = {{"Authorization", "Bearer " + kOperatorToken}};
  EXPECT_EQ(Post("/operator/withdraw", {{"ticket", "7K3QZ-M0P4T-3"}}, keeper), 409) << "no kiosk runs yet";
  std::thread loop([&] {
    const auto report = RunKiosk(**station, options, *front_, stop, logger_);
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_EQ(report->tickets, 1);
  });
  Press("start", "idle");
  Press("not-sensitive", "question");
  Press("agree", "consent");
  const Json thanks = Until("thanks");
  const std::string ticket = thanks.value("ticket", "");
  const auto visitor = db::VisitorOfTicket(ticket);
  EXPECT_TRUE(visitor.ok()) << ticket;
  EXPECT_EQ(http::Get(port(), "/ticket.svg").status, 200);
  EXPECT_EQ(Post("/operator/withdraw", {{"ticket", ticket}}, keeper), 409) << "somebody still reads the ticket";
  Press("done", "thanks");
  (void)Until("idle");
  EXPECT_EQ(Json::parse(http::Get(port(), "/operator/status", keeper).body)["today"]["visits"]["kept"], 1);
  EXPECT_EQ(Post("/operator/withdraw", {{"ticket", ticket}}, keeper), 204);
  EXPECT_EQ(Post("/operator/withdraw", {{"ticket", ticket}}, keeper), 404) << "nothing is left of it";
  stop.Request(StopReason::kOperator);
  loop.join();
}

// The operator's page looks on at all of it; no screen of visitors is there.
TEST_F(PageFrontTest, AVisitWhoseTicketNoScreenFetchedIsNotKept) {
  KioskOptions options = SmallKiosk(folder_);
  StopToken stop;
  auto station = CaptureStation::Open(options.station, stop, logger_);
  ASSERT_TRUE(station.ok()) << station.status().message();
  Start();
  std::thread loop([&] {
    const auto report = RunKiosk(**station, options, *front_, stop, logger_);
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_EQ(report->tickets, 0);
  });
  Press("start", "idle");
  Press("not-sensitive", "question");
  Press("agree", "consent");
  Press("done", "thanks");
  (void)Until("idle");
  const auto status = http::Get(port(), "/operator/status", {{"Authorization", "Bearer " + kOperatorToken}});
  EXPECT_EQ(Json::parse(status.body)["today"]["visits"].value("kept", 0), 0) << "nor is it counted as kept";
  stop.Request(StopReason::kOperator);
  loop.join();
  const auto open = db::OpenVisits(folder_ / "store");
  ASSERT_TRUE(open.ok()) << open.status().message();
  EXPECT_EQ(open->size(), 1U) << "the next forgetting or start takes it";
}

}  // namespace
}  // namespace stratalux::rig
