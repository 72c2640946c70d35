// SPDX-License-Identifier: Apache-2.0
#include "shared/http/access.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <sys/stat.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::http {
namespace {

constexpr int kPort = 8123;
const std::string kToken = "0123456789abcdef0123456789abcdef";

Request Asked(Method method, std::map<std::string, std::string> headers,
              std::map<std::string, std::string> query = {}) {
  Request request;
  request.method = method;
  request.path = "/sessions/s 1";
  request.headers = std::move(headers);
  request.query = std::move(query);
  request.peer = "127.0.0.1";
  return request;
}
int StatusOf(const std::optional<Response>& refusal) { return refusal ? refusal->status : 200; }
int TokenStatus(AccessGuard& guard, const Request& request, Audience audience = Audience::kHoldersOfToken) {
  return StatusOf(guard.CheckToken(request, audience));
}
std::string HeaderOf(const Response& response, const std::string& name) {
  for (const auto& [key, value] : response.headers)
    if (key == name) return value;
  return "";
}

TEST(SameSecret, IsTrueForEqualOnesAlone) {
  EXPECT_TRUE(SameSecret("abc", "abc"));
  EXPECT_FALSE(SameSecret("abd", "abc"));
  EXPECT_FALSE(SameSecret("ab", "abc"));
  EXPECT_FALSE(SameSecret("abcabc", "abc"));
  EXPECT_FALSE(SameSecret("", "abc"));
  EXPECT_FALSE(SameSecret("", ""));
}

TEST(RandomToken, IsNewEachTime) {
  const auto one = RandomToken(), two = RandomToken();
  ASSERT_TRUE(one.ok() && two.ok());
  EXPECT_EQ(one->size(), 64U);
  EXPECT_NE(*one, *two);
}

TEST(AccessGuard, KnowsItsNamesAndAddressesAlone) {
  const AccessGuard guard({.token = "", .host_names = {"Kiosk.local"}}, kPort);
  for (const char* host :
       {"127.0.0.1:8123", "localhost:8123", "LOCALHOST:8123", "[::1]:8123", "192.168.7.2:8123", "kiosk.local:8123"})
    EXPECT_EQ(StatusOf(guard.CheckHost(Asked(Method::kGet, {{"host", host}}))), 200) << host;
  for (const char* host :
       {"evil.example:8123", "localhost", "localhost:80", "127.0.0.1.evil.example:8123", "",
        "localhost:8123, evil.example", "[::1]", "[::1:8123", "127.0.0.1:8123:8123", "kiosk.local.:8123"})
    EXPECT_EQ(StatusOf(guard.CheckHost(Asked(Method::kGet, {{"host", host}}))), 421) << host;
  EXPECT_EQ(StatusOf(guard.CheckHost(Asked(Method::kGet, {}))), 400);
  // A proxy in front has a port of its own, and passes its name on.
  for (const char* host : {"kiosk.local", "kiosk.local:443", "kiosk.local:8443"})
    EXPECT_EQ(StatusOf(guard.CheckHost(Asked(Method::kGet, {{"host", host}}))), 200) << host;
  for (const char* host : {"kiosk.local:443, evil.example", "kiosk.local:8123:8123", "kiosk.local.evil.example:443"})
    EXPECT_EQ(StatusOf(guard.CheckHost(Asked(Method::kGet, {{"host", host}}))), 421) << host;
}

TEST(AccessGuard, TakesPostsOfItsOwnPagesThroughAProxy) {
  const AccessGuard guard({.token = kToken, .host_names = {"kiosk.local"}}, kPort);
  const Request post = Asked(Method::kPost, {{"host", "kiosk.local"}, {"origin", "https://kiosk.local"}});
  EXPECT_EQ(StatusOf(guard.CheckHost(post)), 200);
  EXPECT_EQ(StatusOf(guard.CheckOrigin(post)), 200);
}

TEST(AccessGuard, TakesPostsOfItsOwnPagesAlone) {
  const AccessGuard guard({.token = kToken}, kPort);
  const std::string host = "localhost:8123";
  const auto check = [&](std::map<std::string, std::string> headers) {
    headers["host"] = host;
    return StatusOf(guard.CheckOrigin(Asked(Method::kPost, std::move(headers))));
  };
  EXPECT_EQ(check({{"origin", "http://localhost:8123"}}), 200);
  EXPECT_EQ(check({{"sec-fetch-site", "same-origin"}}), 200);
  EXPECT_EQ(check({{"authorization", "Bearer " + kToken}}), 200);
  EXPECT_EQ(check({{"origin", "http://localhost:9"}}), 403);
  EXPECT_EQ(check({{"origin", "null"}}), 403);
  EXPECT_EQ(check({{"origin", "http://localhost:8123.evil.example"}}), 403);
  EXPECT_EQ(check({{"origin", "http://localhost:8123"}, {"sec-fetch-site", "cross-site"}}), 403);
  EXPECT_EQ(check({{"authorization", "Bearer wrong"}}), 403);
  EXPECT_EQ(check({}), 403);
  EXPECT_EQ(StatusOf(guard.CheckOrigin(Asked(Method::kGet, {{"origin", "http://evil.example"}}))), 200);
}

TEST(AccessGuard, ALinkOpensOneSessionOnce) {
  AccessGuard guard({.token = kToken}, kPort);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {})), 401);
  // A program that only looks at the link does not use it up.
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kHead, {}, {{"token", kToken}})), 303);
  const auto entered =
      guard.CheckToken(Asked(Method::kGet, {}, {{"token", kToken}, {"phase", "a&b"}}), Audience::kHoldersOfToken);
  ASSERT_EQ(StatusOf(entered), 303);
  EXPECT_EQ(HeaderOf(*entered, "Location"), "/sessions/s%201?phase=a%26b");
  const std::string cookie = HeaderOf(*entered, "Set-Cookie");
  EXPECT_NE(cookie.find("; HttpOnly; SameSite=Strict"), std::string::npos);
  EXPECT_EQ(cookie.find(kToken), std::string::npos);
  const std::string session = cookie.substr(0, cookie.find(';'));
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"cookie", session}})), 200);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"cookie", "other=1; " + session}})), 200);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"cookie", session + "0"}})), 401);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"cookie", "x" + session}})), 401);
  // Again: from the browser that has the session it leads on, from another it opens nothing.
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"cookie", session}}, {{"token", kToken}})), 303);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {}, {{"token", kToken}})), 401);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"authorization", "bearer " + kToken}})), 200);
}

TEST(AccessGuard, ATokenOfAFileOpensSeveral) {
  AccessGuard guard({.token = kToken, .link_use = LinkUse::kAlways}, kPort);
  for (int i = 0; i < 40; ++i) EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {}, {{"token", kToken}})), 303);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kPost, {}, {{"token", kToken}})), 401);
}

TEST(AccessGuard, MakesGuessersWait) {
  auto now = std::chrono::steady_clock::time_point() + std::chrono::hours(1);
  AccessOptions options{.token = kToken, .wrong_tokens_per_minute = 3};
  options.now = [&now] { return now; };
  AccessGuard guard(options, kPort);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"authorization", "Bearer x"}})), 401);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"authorization", "Bearer " + kToken}})), 429);
  // Another peer is not kept waiting for it.
  Request other = Asked(Method::kGet, {{"authorization", "Bearer " + kToken}});
  other.peer = "192.168.7.3";
  EXPECT_EQ(TokenStatus(guard, other), 200);
  now += std::chrono::seconds(61);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {{"authorization", "Bearer " + kToken}})), 200);
}

const std::string kKeeperToken = "fedcba9876543210fedcba9876543210";
Request SigningIn(Method method, const std::string& token) {
  Request request = Asked(method, {{"authorization", "Bearer " + token}, {"host", "localhost:8123"}});
  request.path = "/operator/session";
  return request;
}

TEST(AccessGuard, KeepersAreKnownByTheirOwnTokenAlone) {
  AccessGuard guard({.token = kToken, .keeper_token = kKeeperToken}, kPort);
  const Request visitor = Asked(Method::kGet, {{"authorization", "Bearer " + kToken}});
  const Request keeper = Asked(Method::kGet, {{"authorization", "Bearer " + kKeeperToken}});
  EXPECT_EQ(TokenStatus(guard, visitor), 200);
  EXPECT_EQ(TokenStatus(guard, visitor, Audience::kKeepers), 401);
  EXPECT_EQ(TokenStatus(guard, keeper), 200);
  EXPECT_EQ(TokenStatus(guard, keeper, Audience::kKeepers), 200);
  EXPECT_EQ(TokenStatus(guard, Asked(Method::kGet, {}, {{"token", kKeeperToken}}), Audience::kKeepers), 401);
  AccessGuard open({.token = ""}, kPort);
  EXPECT_EQ(TokenStatus(open, Asked(Method::kGet, {})), 200);
  EXPECT_EQ(TokenStatus(open, Asked(Method::kGet, {}), Audience::kKeepers), 401);
  EXPECT_EQ(TokenStatus(open, Asked(Method::kGet, {{"authorization", "Bearer "}}), Audience::kKeepers), 401);
}

TEST(AccessGuard, AKeepersSessionBeginsAndEndsWhereOneSignsIn) {
  auto now = std::chrono::steady_clock::time_point() + std::chrono::hours(1);
  AccessOptions options{.token = "", .wrong_tokens_per_minute = 2, .keeper_token = kKeeperToken};
  options.sign_in = "/operator/session";
  options.now = [&now] { return now; };
  AccessGuard guard(options, kPort);
  EXPECT_FALSE(guard.CheckSignIn(Asked(Method::kPost, {})).has_value()) << "another place";
  EXPECT_FALSE(guard.CheckSignIn(SigningIn(Method::kGet, kKeeperToken)).has_value());
  EXPECT_EQ(StatusOf(guard.CheckSignIn(SigningIn(Method::kPost, kToken))), 401);
  const auto entered = guard.CheckSignIn(SigningIn(Method::kPost, kKeeperToken));
  ASSERT_EQ(StatusOf(entered), 204);
  const std::string cookie = HeaderOf(*entered, "Set-Cookie");
  EXPECT_NE(cookie.find("; HttpOnly; SameSite=Strict"), std::string::npos);
  Request asks = Asked(Method::kGet, {{"cookie", cookie.substr(0, cookie.find(';'))}, {"host", "localhost:8123"}});
  EXPECT_EQ(TokenStatus(guard, asks, Audience::kKeepers), 200);
  // Each use holds it for another half hour.
  Request orders = asks;
  orders.method = Method::kPost;
  now += std::chrono::minutes(29);
  EXPECT_EQ(TokenStatus(guard, orders, Audience::kKeepers), 200);
  now += std::chrono::minutes(29);
  EXPECT_EQ(TokenStatus(guard, asks, Audience::kKeepers), 200);
  Request ends = asks;
  ends.method = Method::kDelete;
  ends.path = "/operator/session";
  EXPECT_EQ(StatusOf(guard.CheckSignIn(ends)), 403) << "of another page";
  ends.headers["sec-fetch-site"] = "same-origin";
  EXPECT_EQ(StatusOf(guard.CheckSignIn(ends)), 204);
  EXPECT_EQ(TokenStatus(guard, asks, Audience::kKeepers), 401);
}

TEST(AccessGuard, AKeepersSessionThatNobodyUsesEnds) {
  auto now = std::chrono::steady_clock::time_point() + std::chrono::hours(1);
  AccessOptions options{.token = "", .keeper_token = kKeeperToken, .sign_in = "/operator/session"};
  options.now = [&now] { return now; };
  AccessGuard guard(options, kPort);
  const std::string cookie = HeaderOf(*guard.CheckSignIn(SigningIn(Method::kPost, kKeeperToken)), "Set-Cookie");
  const Request asks = Asked(Method::kGet, {{"cookie", cookie.substr(0, cookie.find(';'))}});
  now += std::chrono::minutes(31);
  EXPECT_EQ(TokenStatus(guard, asks, Audience::kKeepers), 401);
}

TEST(AccessGuard, MakesThoseWaitWhoGuessTheKeepersToken) {
  AccessOptions options{.token = "", .wrong_tokens_per_minute = 2, .keeper_token = kKeeperToken};
  options.sign_in = "/operator/session";
  AccessGuard guard(options, kPort);
  for (int i = 0; i < 2; ++i) EXPECT_EQ(StatusOf(guard.CheckSignIn(SigningIn(Method::kPost, "wrong"))), 401);
  EXPECT_EQ(StatusOf(guard.CheckSignIn(SigningIn(Method::kPost, kKeeperToken))), 429);
}

// A keeper's browser whose page asks every three seconds.
class KeepersPage : public ::testing::Test {
 protected:
  KeepersPage() : guard_(Options(), kPort) {
    const std::string cookie = HeaderOf(*guard_.CheckSignIn(SigningIn(Method::kPost, kKeeperToken)), "Set-Cookie");
    session_ = {{"cookie", cookie.substr(0, cookie.find(';'))}};
  }
  AccessOptions Options() {
    AccessOptions options{.token = kToken, .keeper_token = kKeeperToken, .sign_in = "/operator/session"};
    options.now = [this] { return now_; };
    return options;
  }
  [[nodiscard]] int Ask(Method method, Audience audience, const std::string& touched = "") {
    Request request = Asked(method, session_);
    if (!touched.empty()) request.headers["stratalux-touched"] = touched;
    return TokenStatus(guard_, request, audience);
  }
  // The last answer to what the page asks by itself: the keepers' figures, and whether the program is there.
  [[nodiscard]] int PollFor(std::chrono::minutes time) {
    int status = 0;
    for (const auto end = now_ + time; now_ < end; now_ += std::chrono::seconds(3)) {
      (void)Ask(Method::kGet, Audience::kHoldersOfToken);
      (void)Ask(Method::kHead, Audience::kKeepers);
      status = Ask(Method::kGet, Audience::kKeepers);
    }
    return status;
  }

  std::chrono::steady_clock::time_point now_ = std::chrono::steady_clock::time_point() + std::chrono::hours(1);
  AccessGuard guard_;
  std::map<std::string, std::string> session_;
};

TEST_F(KeepersPage, ThatAsksByItselfHoldsNoSession) {
  EXPECT_EQ(PollFor(std::chrono::minutes(29)), 200);
  EXPECT_EQ(PollFor(std::chrono::minutes(2)), 401);
  EXPECT_EQ(Ask(Method::kPost, Audience::kKeepers), 401) << "what is over stays over";
}

TEST_F(KeepersPage, HoldsItsSessionByOrdersAndByWhatIsTouched) {
  EXPECT_EQ(PollFor(std::chrono::minutes(29)), 200);
  EXPECT_EQ(Ask(Method::kPost, Audience::kKeepers), 200);
  EXPECT_EQ(PollFor(std::chrono::minutes(29)), 200);
  EXPECT_EQ(Ask(Method::kGet, Audience::kKeepers, "1"), 200);
  EXPECT_EQ(PollFor(std::chrono::minutes(29)), 200);
  EXPECT_EQ(PollFor(std::chrono::minutes(2)), 401);
}

// The display on which an operator signed in, and which visitors press since.
TEST_F(KeepersPage, IsNotHeldByVisitorsInTheSameBrowser) {
  EXPECT_EQ(PollFor(std::chrono::minutes(29)), 200);
  EXPECT_EQ(Ask(Method::kPost, Audience::kHoldersOfToken), 200);
  EXPECT_EQ(PollFor(std::chrono::minutes(2)), 401);
}

class TokenFile : public ScratchFolderTest {
 protected:
  Result<std::string> Read(const std::string& text, mode_t mode = 0600) const {
    std::ofstream(file_, std::ios::binary | std::ios::trunc) << text;
    chmod(file_.c_str(), mode);
    return ReadTokenFile(file_);
  }
  std::string file_ = (folder_ / "token").string();
};

TEST_F(TokenFile, IsItsFirstLine) {
  EXPECT_EQ(*Read(kToken + "\n# a note\n"), kToken);
  EXPECT_EQ(*Read(kToken + "\r\n"), kToken);
}

TEST_F(TokenFile, ThatOthersReadOrThatIsNoneIsRefused) {
  EXPECT_NE(Read(kToken, 0640).status().message().find("chmod 600"), std::string::npos);
  EXPECT_EQ(Read("short\n").status().code(), StatusCode::kUsage);
  EXPECT_EQ(Read("").status().code(), StatusCode::kUsage);
  EXPECT_EQ(Read("has a blank in its line\n").status().code(), StatusCode::kUsage);
  EXPECT_EQ(Read(std::string(600, 'a')).status().code(), StatusCode::kUsage);
  EXPECT_EQ(ReadTokenFile(file_ + "-not-there").status().code(), StatusCode::kUsage);
  EXPECT_EQ(ReadTokenFile("/dev/zero").status().code(), StatusCode::kUsage);
  EXPECT_EQ(ReadTokenFile(std::filesystem::temp_directory_path()).status().code(), StatusCode::kUsage);
}

}  // namespace
}  // namespace stratalux::http
