// SPDX-License-Identifier: Apache-2.0
// The page over loopback, over the real machine in a scripted world.
#include "firmware-host/kiosk/kiosk_page.h"

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "firmware-host/kiosk/page_state.h"
#include "tests/firmware-host/kiosk/operator_token.h"
#include "tests/firmware-host/kiosk/page_script.h"
#include "tests/shared/http/http_client.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using http::Answer;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

// The data of the last event among what a stream has sent.
Json LastState(const std::string& text) {
  const size_t at = text.rfind("data: ");
  if (at == std::string::npos) return nullptr;
  return Json::parse(text.substr(at + 6, text.find('\n', at) - at - 6), nullptr, false);
}

class KioskPageTest : public ::testing::Test {
 protected:
  void SetUp() override { Restart({}); }
  void Restart(KioskPageOptions options) {
    options.operator_token = kOperatorToken;
    options.systemctl.clear();  // not this machine's
    kiosk_.reset();
    auto kiosk = ScriptedKiosk::Start(options, logger_);
    ASSERT_TRUE(kiosk.ok()) << kiosk.status().message();
    kiosk_ = std::move(*kiosk);
    port_ = kiosk_->page().port();
    kiosk_->Open();
  }
  // What a page that is loaded now is told.
  Json State(const std::map<std::string, std::string>& headers = {}) const {
    http::Client client(port_);
    std::string request = "GET /events HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port_) + "\r\n";
    for (const auto& [name, value] : headers) request += name + ": " + value + "\r\n";
    client.Send(request + "\r\n");
    return LastState(client.ReadUntil("}\n\n"));
  }
  [[nodiscard]] Answer Post(const std::string& place, const Json& body,
                            std::map<std::string, std::string> headers = {}) const {
    headers.emplace("Host", "127.0.0.1:" + std::to_string(port_));
    headers.emplace("Origin", "http://127.0.0.1:" + std::to_string(port_));
    headers.emplace("Connection", "close");
    return http::Ask(port_, "POST", place, headers, body.dump());
  }
  [[nodiscard]] int Press(const std::string& verb, const Json& seen, Json more = Json::object()) const {
    more["nonce"] = seen["nonce"];
    more["screen"] = seen["screen"];
    return Post("/visitor/" + verb, more).status;
  }
  [[nodiscard]] Phase phase() const { return kiosk_->state().phase; }
  // From idle to the screen that looks for a face.
  void SitDown() {
    ASSERT_EQ(Press("start", State()), 204);
    ASSERT_EQ(Press("not-sensitive", State()), 204);
    ASSERT_EQ(Press("agree", State(), {{"research", true}}), 204);
    ASSERT_EQ(phase(), Phase::kPosition);
  }
  void Capture(const std::string& how) {
    while (phase() == Phase::kPosition) kiosk_->Happen("face_good");
    while (phase() == Phase::kCountdown) kiosk_->Happen("tick");
    ASSERT_TRUE(kiosk_->Happen(how)) << how;
  }
  const std::map<std::string, std::string> keeper_ = {{"Authorization", "Bearer " + kOperatorToken}};

  Logger logger_{LogLevel::kError};
  std::unique_ptr<ScriptedKiosk> kiosk_;
  int port_ = 0;
};

TEST_F(KioskPageTest, AWholeVisitByPresses) {
  SitDown();
  Capture("captured_moved");
  EXPECT_EQ(State()["word"], "moved");
  ASSERT_EQ(Press("again", State()), 204);
  Capture("captured_good");
  const Json thanks = State();
  EXPECT_EQ(thanks["screen"], "thanks");
  EXPECT_EQ(thanks["ticket"], kScriptedTicket);
  const Answer qr = http::Get(port_, "/ticket.svg");
  EXPECT_EQ(qr.status, 200);
  EXPECT_EQ(qr.headers.at("cache-control"), "no-store");
  ASSERT_EQ(Press("done", thanks), 204);
  EXPECT_EQ(phase(), Phase::kIdle);
  EXPECT_EQ(http::Get(port_, "/ticket.svg").status, 404);
  EXPECT_FALSE(State().contains("ticket"));
  const auto agreed = std::get<event::Agree>(kiosk_->pressed().at(2)).choice;
  EXPECT_EQ(agreed, (ConsentChoice{true, true, false, 0, 0}));
}

TEST_F(KioskPageTest, TheGateKeepsOnlyWhatIsWorthIt) {
  SitDown();
  Capture("captured_failed");
  EXPECT_EQ(State()["usable"], false);
  EXPECT_EQ(Press("keep", State()), 409) << "nothing would be kept";
  EXPECT_EQ(phase(), Phase::kGate);
  ASSERT_EQ(Press("again", State()), 204);
  Capture("captured_moved");
  EXPECT_EQ(State()["usable"], true);
  EXPECT_EQ(Press("keep", State()), 204);
  EXPECT_EQ(phase(), Phase::kThanks);
  EXPECT_FALSE(State().contains("usable"));
}

TEST_F(KioskPageTest, APressOfAnotherVisitIsRefused) {
  const Json before = State();
  ASSERT_EQ(Press("start", before), 204);
  const Json visit = State();
  EXPECT_NE(before["nonce"], visit["nonce"]);
  ASSERT_EQ(Press("leave", visit), 204);
  const Json after = State();
  EXPECT_EQ(after["screen"], "idle");
  EXPECT_EQ(Press("start", before), 403);
  EXPECT_EQ(Press("leave", visit), 403);
  Json guess = after;
  guess["nonce"] = std::string(64, '0');
  EXPECT_EQ(Press("start", guess), 403);
  guess["nonce"] = "";
  EXPECT_EQ(Press("start", guess), 403);
  EXPECT_EQ(phase(), Phase::kIdle);
}

TEST_F(KioskPageTest, APressOfAnotherScreenOrTwiceDoesNothing) {
  ASSERT_EQ(Press("start", State()), 204);
  const Json question = State();
  ASSERT_EQ(Press("not-sensitive", question), 204);
  EXPECT_EQ(Press("sensitive", question), 409) << "that screen is gone";
  EXPECT_EQ(Press("start", State()), 409) << "there is no such button";
  EXPECT_EQ(phase(), Phase::kConsent);
  kiosk_->Happen("leave");
  kiosk_->Happen("estop");
  EXPECT_EQ(Press("start", State()), 409);
  EXPECT_EQ(Press("dance", State()), 404);
}

TEST(PageState, ATapThatCameTwiceCountsOnceButForLeaving) {
  PageState state({"en"});
  const PageState::Moment begin = PageState::Moment() + std::chrono::hours(1);
  state.Show({Phase::kConsent, Word::kNone, {}, 0, 0, {}}, "nonce", begin);
  const PagePress agree{"agree", "nonce", "consent", "", false, false},
      leave{"leave", "nonce", "consent", "", false, false};
  EXPECT_EQ(state.Press(agree, begin).status, 204);
  EXPECT_EQ(state.Press(agree, begin + std::chrono::milliseconds(200)).status, 409);
  EXPECT_EQ(state.Press(leave, begin + std::chrono::milliseconds(300)).status, 204);
  EXPECT_EQ(state.Press(agree, begin + std::chrono::milliseconds(1400)).status, 204);
}

TEST(PageState, TheNextVisitIsGreetedInTheFirstLanguage) {
  PageState state({"en", "de"});
  const PageState::Moment begin = PageState::Moment() + std::chrono::hours(1);
  state.Show({Phase::kIdle, Word::kNone, {}, 0, 0, {}}, "nonce", begin);
  PagePress german{"language", "nonce", "idle", "de", false, false};
  EXPECT_TRUE(state.Press(german, begin).changed);
  EXPECT_THAT(state.Json(), HasSubstr(R"("language":"de")"));
  EXPECT_FALSE(state.Rest(begin + std::chrono::seconds(59)));
  EXPECT_TRUE(state.Rest(begin + std::chrono::seconds(61)));
  EXPECT_THAT(state.Json(), HasSubstr(R"("language":"en")"));
  EXPECT_FALSE(state.Rest(begin + std::chrono::seconds(62)));
  german.language = "tlh";
  EXPECT_EQ(state.Press(german, begin).status, 400);
}

TEST(PageState, StepsOfACaptureAreToldFiveTimesASecond) {
  PageState state({"en"});
  const PageState::Moment begin = PageState::Moment() + std::chrono::hours(1);
  int told = 0;
  for (int i = 0; i <= 490; ++i)  // in 10 s
    told += state.Show({Phase::kCapture, Word::kNone, {}, i, 490, {}}, "n", begin + i * std::chrono::milliseconds(20))
                ? 1
                : 0;
  EXPECT_GE(told, 48);
  EXPECT_LE(told, 52);
  EXPECT_THAT(state.Json(), HasSubstr(R"("number":490)"));
  EXPECT_FALSE(state.Rest(begin + std::chrono::seconds(10)));
  const PageState::Moment later = begin + std::chrono::seconds(11);
  EXPECT_TRUE(state.Show({Phase::kCapture, Word::kNone, {}, 1, 490, {}}, "n", later));
  EXPECT_FALSE(state.Show({Phase::kCapture, Word::kNone, {}, 2, 490, {}}, "n", later));
  EXPECT_TRUE(state.Rest(later)) << "the last of a burst is told, if late";
  EXPECT_FALSE(state.Rest(later));
}

TEST_F(KioskPageTest, APageThatIsLoadedAgainShowsTheSameAndGoesOn) {
  SitDown();
  const Json once = State(), again = State({{"Last-Event-ID", "1"}});
  EXPECT_EQ(once, again);
  ASSERT_EQ(Press("leave", again), 204);
  EXPECT_EQ(phase(), Phase::kIdle);
}

TEST_F(KioskPageTest, WhoComesBackReadsNothingOfTheVisitBefore) {
  SitDown();
  Capture("captured_good");
  ASSERT_EQ(Press("done", State()), 204);
  http::Client client(port_);
  client.Send("GET /events HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port_) + "\r\nLast-Event-ID: 0\r\n\r\n");
  const std::string all = client.ReadUntil("}\n\n");
  EXPECT_THAT(all, HasSubstr("idle"));
  EXPECT_THAT(all, Not(HasSubstr(kScriptedTicket)));
}

TEST_F(KioskPageTest, TwoBrowsersSeeOneVisit) {
  http::Client other(port_);
  other.Send("GET /events HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port_) + "\r\n\r\n");
  EXPECT_EQ(LastState(other.ReadUntil("}\n\n"))["screen"], "idle");
  const Json idle = State();
  ASSERT_EQ(Press("start", idle), 204);
  Json seen;
  for (int i = 0; i < 3 && seen["screen"] != "question"; ++i) seen = LastState(other.ReadUntil("}\n\n"));
  EXPECT_EQ(seen["screen"], "question");
  EXPECT_EQ(seen, State());
  EXPECT_EQ(Press("start", idle), 403) << "the other browser was slower";
  EXPECT_EQ(kiosk_->pressed().size(), 1U);
}

TEST_F(KioskPageTest, OtherPagesMethodsSizesAndPathsAreRefused) {
  const Json body = {{"nonce", State()["nonce"]}, {"screen", "idle"}};
  EXPECT_EQ(Post("/visitor/start", body, {{"Origin", "http://evil.example"}}).status, 403);
  EXPECT_EQ(Post("/visitor/start", body, {{"Origin", "null"}}).status, 403);
  EXPECT_EQ(http::Get(port_, "/visitor/start").status, 405);
  EXPECT_EQ(Post("/", body).status, 405);
  EXPECT_EQ(Post("/visitor/start", {{"nonce", std::string(5000, 'x')}}).status, 413);
  EXPECT_EQ(Post("/visitor/start", Json::array({1})).status, 400);
  EXPECT_EQ(http::Get(port_, "/page/..%2fkiosk_page.cc").status, 400);
  EXPECT_EQ(http::Get(port_, "/page/none.js").status, 404);
  EXPECT_EQ(http::Get(port_, "/languages/fr.json").status, 404);
  EXPECT_EQ(http::Get(port_, "/", {{"Host", "evil.example:" + std::to_string(port_)}}).status, 421);
  EXPECT_TRUE(kiosk_->pressed().empty());
  const Answer page = http::Get(port_, "/");
  EXPECT_EQ(page.status, 200);
  EXPECT_THAT(page.headers.at("content-security-policy"), HasSubstr("default-src 'self'"));
  EXPECT_EQ(page.headers.count("set-cookie"), 0U);
  EXPECT_THAT(page.body, Not(HasSubstr("<script>")));
  EXPECT_THAT(page.body, Not(HasSubstr("style=")));
}

TEST_F(KioskPageTest, OnlyItsOperatorOrders) {
  for (const char* place : {"/operator/clean", "/operator/withdraw", "/operator/status"}) {
    const bool reads = std::string(place) == "/operator/status";
    const auto ask = [&](const std::map<std::string, std::string>& headers) {
      return reads ? http::Get(port_, place, headers).status : Post(place, {{"ticket", "x"}}, headers).status;
    };
    EXPECT_EQ(ask({}), 401) << place;
    EXPECT_EQ(ask({{"Authorization", "Bearer wrong"}}), 401) << place;
    EXPECT_NE(ask(keeper_), 401) << place;
  }
  EXPECT_EQ(phase(), Phase::kClosed);
  EXPECT_EQ(State()["closures"], Json::array({"cleaning"}));
  EXPECT_EQ(Post("/operator/open", {}, keeper_).status, 202);
  EXPECT_EQ(phase(), Phase::kIdle);
  EXPECT_EQ(Post("/operator/dance", {}, keeper_).status, 404);
  EXPECT_EQ(Post("/operator/withdraw", {{"ticket", kScriptedTicket}}, keeper_).status, 204);
  const Answer unknown = Post("/operator/withdraw", {{"ticket", "none"}}, keeper_);
  EXPECT_EQ(unknown.status, 404);
  EXPECT_THAT(unknown.body, HasSubstr("no ticket 'none'"));
}

TEST_F(KioskPageTest, PicturesOfSessionsAreTheOperatorsBetweenVisits) {
  const char* place = "/operator/sessions/s000001-00000000/picture.jpg";
  EXPECT_EQ(http::Get(port_, place).status, 401);
  EXPECT_EQ(http::Get(port_, place, keeper_).status, 404) << "no store";
  KioskPageOptions options;
  options.store = "/nonexistent";
  Restart(options);
  SitDown();
  EXPECT_EQ(http::Get(port_, place, keeper_).status, 409);
  kiosk_->Happen("leave");
  EXPECT_EQ(http::Get(port_, place, keeper_).status, 404);
}

TEST_F(KioskPageTest, AnOperatorSignsInAndOut) {
  const Answer entered = Post("/operator/session", {}, keeper_);
  ASSERT_EQ(entered.status, 204);
  const std::string cookie = entered.headers.at("set-cookie");
  const std::map<std::string, std::string> session = {{"Cookie", cookie.substr(0, cookie.find(';'))}};
  EXPECT_EQ(http::Get(port_, "/operator/status", session).status, 200);
  auto headers = session;
  headers["Host"] = "127.0.0.1:" + std::to_string(port_);
  headers["Origin"] = "http://" + headers["Host"];
  EXPECT_EQ(http::Ask(port_, "DELETE", "/operator/session", headers).status, 204);
  EXPECT_EQ(http::Get(port_, "/operator/status", session).status, 401);
}

TEST_F(KioskPageTest, GuessersOfTheOperatorsTokenWait) {
  int last = 0;
  for (int i = 0; i < 25; ++i) last = Post("/operator/session", {}, {{"Authorization", "Bearer guess"}}).status;
  EXPECT_EQ(last, 429);
}

TEST_F(KioskPageTest, ThePreviewIsThereWhileSomebodyIsLookedAtAlone) {
  const Image<uint16_t> frame(696, 520, 1, 800);
  FrameRecord record;
  const auto look = [&] {
    kiosk_->page().ShowPreview(record, frame.view());
    return http::Get(port_, "/preview.jpg");
  };
  EXPECT_EQ(look().status, 404);
  SitDown();
  const Answer seen = look();
  ASSERT_EQ(seen.status, 200);
  EXPECT_EQ(seen.headers.at("content-type"), "image/jpeg");
  EXPECT_EQ(seen.headers.at("cache-control"), "no-store");
  EXPECT_EQ(seen.body.substr(0, 2), "\xff\xd8");
  EXPECT_EQ(State()["preview"], 1);
  Capture("captured_good");
  EXPECT_EQ(http::Get(port_, "/preview.jpg").status, 404);
  EXPECT_EQ(look().status, 404);
  ASSERT_EQ(Press("done", State()), 204);
  SitDown();
  EXPECT_FALSE(State().contains("preview")) << "of the visitor before";
}

TEST_F(KioskPageTest, FiveLooksASecondAreTakenAtMost) {
  SitDown();
  const Image<uint16_t> frame(64, 48, 1, 800);
  const auto begin = std::chrono::steady_clock::now();
  while (std::chrono::steady_clock::now() - begin < std::chrono::milliseconds(1100)) {
    kiosk_->page().ShowPreview({}, frame.view());
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  const int taken = State()["preview"];
  EXPECT_GE(taken, 1);
  EXPECT_LE(taken, 6);
}

TEST_F(KioskPageTest, HealthAndReadinessSayWhatIsWrong) {
  EXPECT_EQ(http::Get(port_, "/healthz").status, 200);
  EXPECT_EQ(http::Get(port_, "/readyz").status, 200);
  kiosk_->Happen("space_low");
  const Answer full = http::Get(port_, "/readyz");
  EXPECT_EQ(full.status, 503);
  EXPECT_THAT(full.body, HasSubstr("closed"));
  EXPECT_THAT(full.body, HasSubstr("space"));
  kiosk_->Happen("estop");
  EXPECT_THAT(http::Get(port_, "/readyz").body, HasSubstr("safe emergency_stop"));
}

TEST_F(KioskPageTest, ATokenForAllIsForAll) {
  KioskPageOptions options;
  options.token = "page-0123456789abcdef";
  Restart(options);
  for (const char* place : {"/", "/operator", "/events", "/page/visitor.js", "/languages.json", "/healthz", "/metrics",
                            "/preview.jpg", "/none"})
    EXPECT_EQ(http::Get(port_, place).status, 401) << place;
  EXPECT_EQ(http::Get(port_, "/?token=" + options.token).status, 303);
  EXPECT_EQ(http::Get(port_, "/", {{"Authorization", "Bearer " + options.token}}).status, 200);
  EXPECT_EQ(http::Get(port_, "/operator/status", {{"Authorization", "Bearer " + options.token}}).status, 401);
}

TEST(KioskPageOptions, AskForATokenWhereOthersReachThePage) {
  KioskPageOptions options;
  options.address = "192.168.7.2";
  EXPECT_THAT(options.Validate().message(), HasSubstr("needs a token"));
  options.token = options.operator_token = kOperatorToken;
  EXPECT_THAT(options.Validate().message(), HasSubstr("operator's token"));
  options.operator_token = "another-0123456789";
  EXPECT_TRUE(options.Validate().ok());
  options.ticket_text = "https://museum.example/withdraw";
  EXPECT_THAT(options.Validate().message(), HasSubstr("{code}"));
}

TEST_F(KioskPageTest, AThousandConnectionsAreBoundedAndThePageAnswersAfterwards) {
  int open = 0;
  {
    std::vector<std::unique_ptr<http::Client>> crowd;
    for (int i = 0; i < 1000; ++i) {
      crowd.push_back(std::make_unique<http::Client>(port_, http::Client::Family::kV4, 1));
      crowd.back()->Send("GET /events HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port_) + "\r\n\r\n");
    }
    // Those beyond the bound are closed at once; a stream that is open has its first event.
    for (auto& client : crowd) open += LastState(client->ReadUntil("}\n\n")).is_object() ? 1 : 0;
  }
  EXPECT_GE(open, 1);
  EXPECT_LE(open, 64);
  // Those who are gone are found out by the next comments in their streams.
  int status = 0;
  const auto patience = std::chrono::steady_clock::now() + std::chrono::seconds(40);
  while (status != 200 && std::chrono::steady_clock::now() < patience) {
    status = http::Get(port_, "/readyz").status;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  EXPECT_EQ(status, 200);
}

// A wire that was loose for a second while the screen stood still, or another run of the program whose numbers are the
// same: the page has to hear that all is well.
TEST_F(KioskPageTest, WhoComesBackIsToldHowThingsStandWhateverItSawLast) {
  const Json now = State();
  ASSERT_EQ(now["screen"], "idle");
  for (int last = 1; last <= 8; ++last) EXPECT_EQ(State({{"Last-Event-ID", std::to_string(last)}}), now) << last;
}

// The page's clock, which holds the operator's figures up.
class HeldFigures {
 public:
  WallNs Ask() {
    if (!holds_) return WallNow();
    ++begun_;
    while (!released_) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return WallNow();
  }
  void HoldNewOnes() { holds_ = true; }
  void LetNewOnesPass() { holds_ = false; }
  void Release() { released_ = true; }
  [[nodiscard]] bool Begun(int count, std::chrono::milliseconds patience) const {
    const auto end = std::chrono::steady_clock::now() + patience;
    while (begun_ < count && std::chrono::steady_clock::now() < end)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return begun_ >= count;
  }

 private:
  std::atomic<bool> holds_ = false, released_ = false;
  std::atomic<int> begun_ = 0;
};

TEST_F(KioskPageTest, AVisitorsStopIsAnsweredWhileTheOperatorsFiguresAreNot) {
  const auto figures = std::make_shared<HeldFigures>();
  KioskPageOptions options;
  options.wall = [figures] { return figures->Ask(); };
  Restart(options);
  SitDown();
  const Json seen = State();
  const auto ask = [this](http::Client& client, const std::string& place) {
    client.Send("GET " + place + " HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port_) +
                "\r\nAuthorization: " + keeper_.at("Authorization") + "\r\nConnection: close\r\n\r\n");
  };
  figures->HoldNewOnes();
  http::Client one(port_), two(port_), picture(port_, http::Client::Family::kV4, 1);
  ask(one, "/operator/status");
  EXPECT_TRUE(figures->Begun(1, std::chrono::seconds(20)));
  ask(two, "/operator/status");
  EXPECT_FALSE(figures->Begun(2, std::chrono::milliseconds(300))) << "one after another";
  ask(picture, "/operator/sessions/s000001-00000000/picture.jpg");
  figures->LetNewOnesPass();  // the machine asks for the time, too
  EXPECT_EQ(Press("leave", seen), 204);
  EXPECT_EQ(phase(), Phase::kIdle);
  EXPECT_EQ(picture.ReadUntil("HTTP/"), "") << "pictures wait where figures do";
  figures->Release();
  EXPECT_EQ(http::ParseAnswer(one.ReadAll()).status, 200);
  EXPECT_EQ(http::ParseAnswer(two.ReadAll()).status, 200);
}

}  // namespace
}  // namespace stratalux::rig
