// SPDX-License-Identifier: Apache-2.0
// The server over real sockets of this machine's loopback.
#include "shared/http/server.h"

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <iterator>
#include <stdexcept>
#include <thread>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <unistd.h>

#include "shared/http/event_stream.h"
#include "tests/shared/http/http_client.h"
#include "tests/support/text_of.h"

namespace stratalux::http {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

class ServerTest : public ::testing::Test {
 protected:
  ServerTest() : log_(std::tmpfile()), logger_(LogLevel::kInfo, log_), stream_(std::make_shared<EventStream>()) {}
  ~ServerTest() override { std::fclose(log_); }

  Router Routes() {
    Router router;
    const auto open = Audience::kEverybody;
    router.Add(
        Method::kGet, "/", [](const Request&) { return Response::Of("text/html", "<p>root"); }, open);
    router.Add(Method::kGet, "/secret", [](const Request&) { return Response::Text(200, "inside"); });
    router.Add(
        Method::kGet, "/echo/{x}",
        [](const Request& r) { return Response::Text(200, r.Wildcard("x") + "|" + r.Query("q") + "|" + r.peer); },
        open);
    router.Add(
        Method::kPost, "/post", [](const Request& r) { return Response::Text(200, r.body); }, open);
    router.Add(
        Method::kGet, "/throws", [](const Request&) -> Response { throw std::runtime_error("no luck"); }, open);
    router.Add(
        Method::kPost, "/slow/{text}",
        [this](const Request& r) {
          return Response::Later([this, text = r.Wildcard("text")]() -> Response {
            ++slow_begun_;
            if (text == "throws") throw std::runtime_error("no luck");
            for (int ms = 0; slow_waits_ && ms < 20'000; ++ms) std::this_thread::sleep_for(1ms);
            return Response::Text(200, text);
          });
        },
        open);
    router.Add(
        Method::kGet, "/generator",
        [](const Request&) {
          Response response;
          response.body = Generator([left = 100'000](std::span<char> buffer) mutable {
            const size_t bytes = std::min<size_t>(buffer.size(), static_cast<size_t>(left));
            std::fill_n(buffer.begin(), bytes, 'g');
            left -= static_cast<int>(bytes);
            return bytes;
          });
          return response;
        },
        open);
    router.Add(
        Method::kGet, "/file",
        [](const Request&) {
          Response response;
          response.body = FileBody{UniqueFd(open_self()), 1000};
          return response;
        },
        open);
    router.Add(
        Method::kGet, "/events", [this](const Request&) { return Response::Events(stream_); }, open);
    return router;
  }
  static int open_self() { return ::open("/proc/self/exe", O_RDONLY | O_CLOEXEC); }
  Server Started(ServerOptions options = {}) {
    auto server = Server::Start(std::move(options), Routes(), logger_);
    EXPECT_TRUE(server.ok()) << server.status().message();
    return std::move(server).value();
  }
  static std::string Header(int port, const std::string& target) {
    return "GET " + target + " HTTP/1.1\r\nHost: localhost:" + std::to_string(port) + "\r\n";
  }

  // As our own pages ask.
  const std::map<std::string, std::string> kOwn = {{"Sec-Fetch-Site", "same-origin"}};
  static std::string SlowPost(int port, const std::string& text) {
    return "POST /slow/" + text + " HTTP/1.1\r\nHost: localhost:" + std::to_string(port) +
           "\r\nSec-Fetch-Site: same-origin\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
  }
  void AwaitSlow() {
    for (const auto start = Clock::now(); slow_begun_ < 1 && Clock::now() - start < 5s;)
      std::this_thread::sleep_for(1ms);
    ASSERT_GE(slow_begun_, 1);
  }

  std::FILE* log_;
  Logger logger_;
  std::shared_ptr<EventStream> stream_;
  std::atomic<bool> slow_waits_ = false;
  std::atomic<int> slow_begun_ = 0;
};

TEST_F(ServerTest, AnswersWithItsHeadersAndDecodesOnce) {
  const Server server = Started();
  EXPECT_EQ(server.url(), "http://127.0.0.1:" + std::to_string(server.port()));
  const Answer root = Get(server.port(), "/");
  EXPECT_EQ(root.status, 200);
  EXPECT_EQ(root.body, "<p>root");
  EXPECT_THAT(root.headers.at("content-security-policy"), HasSubstr("default-src 'self'"));
  EXPECT_THAT(root.headers.at("content-security-policy"), HasSubstr("frame-ancestors 'none'"));
  EXPECT_EQ(root.headers.at("content-security-policy").find("unsafe"), std::string::npos);
  EXPECT_EQ(root.headers.at("x-content-type-options"), "nosniff");
  EXPECT_EQ(root.headers.at("referrer-policy"), "no-referrer");
  EXPECT_EQ(root.headers.at("cache-control"), "no-store");
  EXPECT_EQ(Get(server.port(), "/echo/a%20b?q=%2526").body, "a b|%26|127.0.0.1\n");
  const std::string generated = Get(server.port(), "/generator").body;  // in chunks, whose sizes are hexadecimal
  EXPECT_EQ(std::count(generated.begin(), generated.end(), 'g'), 100'000);
  EXPECT_EQ(Get(server.port(), "/file").body.substr(1, 3), "ELF");
  EXPECT_EQ(Get(server.port(), "/file").body.size(), 1000U);
}

TEST_F(ServerTest, AnswersEveryWrongRequestByItsNumberAndWithItsHeaders) {
  const Server server = Started({.access = {.token = "0123456789abcdef"}});
  const int port = server.port();
  const auto expect = [](const Answer& answer, int status) {
    EXPECT_EQ(answer.status, status);
    EXPECT_EQ(answer.headers.count("content-security-policy"), 1U) << status;
    EXPECT_EQ(answer.headers.count("cache-control"), 1U) << status;
  };
  const std::map<std::string, std::string> bearer = {{"Authorization", "Bearer 0123456789abcdef"}};
  expect(Get(port, "/secret", bearer), 200);
  expect(Get(port, "/secret"), 401);
  expect(Get(port, "/nowhere"), 401);  // a stranger does not learn what there is
  expect(Get(port, "/nowhere", bearer), 404);
  const Answer wrong_method = Ask(port, "POST", "/secret", bearer);
  expect(wrong_method, 405);
  EXPECT_EQ(wrong_method.headers.at("allow"), "GET, HEAD");
  expect(Ask(port, "BREW", "/secret", bearer), 405);
  expect(Get(port, "/a/../secret", bearer), 400);
  expect(Get(port, "/%2e%2e/secret", bearer), 400);
  expect(Get(port, "/echo/%", bearer), 400);
  expect(Get(port, "/", {{"Host", "evil.example:" + std::to_string(port)}}), 421);
  expect(Ask(port, "POST", "/post", {{"Origin", "http://evil.example"}}, "x"), 403);
  expect(Get(port, "/", {{"X", std::string(8 << 10, 'x')}}), 431);
  expect(Get(port, "/", {{"X", std::string(7 << 10, 'x')}}), 200);
  EXPECT_EQ(Get(port, "/", {{"X", std::string(200 << 10, 'x')}}).status / 100, 4);  // by the library alone
  expect(Ask(port, "POST", "/post", bearer, std::string(4096, 'b')), 200);
  expect(Ask(port, "POST", "/post", bearer, std::string(4097, 'b')), 413);
}

TEST_F(ServerTest, CountsABodyThatComesInChunks) {
  const Server server = Started({.access = {.token = "0123456789abcdef"}});
  const auto post = [&server](int chunks) {
    Client client(server.port());
    client.Send(
        "POST /post HTTP/1.1\r\nHost: localhost:" + std::to_string(server.port()) +
        "\r\nAuthorization: Bearer 0123456789abcdef\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n");
    for (int i = 0; i < chunks; ++i) client.Send("400\r\n" + std::string(1024, 'c') + "\r\n");
    client.Send("0\r\n\r\n");
    return ParseAnswer(client.ReadAll());
  };
  EXPECT_EQ(post(4).body, std::string(4096, 'c') + "\n");
  EXPECT_EQ(post(5).status, 413);
}

TEST_F(ServerTest, HeadHasTheHeadersAlone) {
  const Server server = Started();
  const Answer head = Ask(server.port(), "HEAD", "/");
  EXPECT_EQ(head.status, 200);
  EXPECT_EQ(head.headers.at("content-length"), "7");
  EXPECT_TRUE(head.body.empty());
  EXPECT_EQ(Ask(server.port(), "HEAD", "/events").status, 200);
}

TEST_F(ServerTest, AnExceptionEndsOneRequestAndIsToldInTheLog) {
  const Server server = Started();
  const Answer answer = Get(server.port(), "/throws");
  EXPECT_EQ(answer.status, 500);
  EXPECT_EQ(answer.body.find("no luck"), std::string::npos);
  ASSERT_TRUE(logger_.Flush());
  EXPECT_THAT(TextOf(log_), HasSubstr("GET %2Fthrows: no luck"));
  EXPECT_EQ(Get(server.port(), "/").status, 200);
}

// One thread serves all; a slow answer must not have it.
TEST_F(ServerTest, ServesOthersWhileASlowAnswerIsMade) {
  slow_waits_ = true;
  const Server server = Started({.limits = {.idle = 1s, .slow_answers = 2}});
  std::vector<Client> clients;
  for (const char* text : {"a", "b", "c"}) {
    clients.emplace_back(server.port());
    clients.back().Send(SlowPost(server.port(), text));
    AwaitSlow();
    // Whose one thread has read what came before.
    for (int i = 0; i < 3; ++i) EXPECT_EQ(Get(server.port(), "/").status, 200);
  }
  EXPECT_EQ(Ask(server.port(), "POST", "/slow/d", kOwn).status, 503) << "two wait already";
  // Longer than a connection may be idle.
  const auto start = Clock::now();
  while (Clock::now() - start < 1500ms) EXPECT_EQ(Get(server.port(), "/").status, 200);
  slow_waits_ = false;
  for (size_t i = 0; i < clients.size(); ++i) {
    const Answer answer = ParseAnswer(clients[i].ReadAll());
    EXPECT_EQ(answer.status, 200);
    EXPECT_EQ(answer.body, std::string(1, static_cast<char>('a' + i)) + "\n");
    EXPECT_EQ(answer.headers.count("content-security-policy"), 1U);
  }
  EXPECT_EQ(Ask(server.port(), "POST", "/slow/throws", kOwn).status, 500);
}

TEST_F(ServerTest, StopsWhileSlowAnswersWaitAndTheirReadersAreGone) {
  for (const bool leave : {false, true}) {
    slow_waits_ = true;
    slow_begun_ = 0;
    Server server = Started({.threads = 2});
    std::vector<Client> clients;
    for (int i = 0; i < 3; ++i) {
      clients.emplace_back(server.port());
      clients.back().Send(SlowPost(server.port(), "x"));
    }
    AwaitSlow();
    std::this_thread::sleep_for(20ms);
    if (leave) clients.clear();
    std::thread ends([this] {
      std::this_thread::sleep_for(100ms);
      slow_waits_ = false;
    });
    server.Stop();
    EXPECT_FALSE(slow_waits_) << "the one that ran was waited for";
    EXPECT_EQ(slow_begun_, 1) << "those that waited are not begun any more";
    ends.join();
    for (Client& client : clients) EXPECT_TRUE(client.SeesEnd());
  }
}

TEST_F(ServerTest, SaysThatThePortIsTaken) {
  const Server first = Started();
  const auto second = Server::Start({.port = first.port()}, Routes(), logger_);
  ASSERT_FALSE(second.ok());
  EXPECT_EQ(second.status().code(), StatusCode::kBusy);
  EXPECT_THAT(second.status().message(), HasSubstr(std::to_string(first.port()) + ": another program listens there"));
  EXPECT_EQ(Get(first.port(), "/").status, 200);
  EXPECT_EQ(Server::Start({.address = "nonsense"}, Routes(), logger_).status().code(), StatusCode::kUsage);
  EXPECT_EQ(Server::Start({.port = 70000}, Routes(), logger_).status().code(), StatusCode::kUsage);
  EXPECT_EQ(Server::Start({.address = "203.0.113.9"}, Routes(), logger_).status().code(), StatusCode::kFailed);
}

TEST_F(ServerTest, ListensOnTheOtherLoopback) {
  auto server = Server::Start({.address = "::1"}, Routes(), logger_);
  if (!server.ok()) GTEST_SKIP() << "no IPv6 here: " << server.status().message();
  EXPECT_EQ(server->url(), "http://[::1]:" + std::to_string(server->port()));
  Client client(server->port(), Client::Family::kV6);
  client.Send("GET / HTTP/1.1\r\nHost: [::1]:" + std::to_string(server->port()) + "\r\nConnection: close\r\n\r\n");
  EXPECT_EQ(ParseAnswer(client.ReadAll()).status, 200);
}

// A byte now and then keeps a connection busy, but not for longer than a request may take.
TEST_F(ServerTest, EndsARequestThatNeverEnds) {
  const Server server = Started({.limits = {.idle = 1s}});
  Client silent(server.port()), dripping(server.port());
  const auto start = Clock::now();
  dripping.Send(Header(server.port(), "/"));
  bool open = true;
  while (open && Clock::now() - start < 8s) {
    open = dripping.Send("X: y\r\n");
    std::this_thread::sleep_for(100ms);
  }
  EXPECT_FALSE(open);
  EXPECT_TRUE(silent.SeesEnd());
  EXPECT_LT(Clock::now() - start, 8s);
  EXPECT_EQ(Get(server.port(), "/").status, 200);
}

TEST_F(ServerTest, HoldsNoMoreConnectionsThanItMay) {
  const Server server = Started({.limits = {.connections = 8, .connections_per_peer = 4, .idle = 2s}});
  std::vector<Client> clients;
  int most = 0;
  for (int i = 0; i < 30; ++i) {
    clients.emplace_back(server.port());
    clients.back().Send(Header(server.port(), "/"));
    most = std::max(most, server.connections());
  }
  std::this_thread::sleep_for(200ms);
  EXPECT_LE(std::max(most, server.connections()), 4);
  EXPECT_GT(server.connections(), 0);
  // Those that waste its time are ended, and it serves again.
  const auto start = Clock::now();
  while (Get(server.port(), "/").status != 200 && Clock::now() - start < 10s) std::this_thread::sleep_for(100ms);
  EXPECT_EQ(Get(server.port(), "/").status, 200);
}

TEST_F(ServerTest, StreamsEventsToAllAndAgainToWhoComesBack) {
  const Server server = Started({.threads = 2});
  Client one(server.port()), two(server.port());
  for (Client* client : {&one, &two}) {
    client->Send(Header(server.port(), "/events") + "\r\n");
    EXPECT_THAT(client->ReadUntil("retry: 2000"), HasSubstr("text/event-stream"));
  }
  stream_->Publish("state", "idle");
  EXPECT_THAT(one.ReadUntil("data: idle"), HasSubstr("id: 1"));
  EXPECT_THAT(two.ReadUntil("data: idle"), HasSubstr("id: 1"));
  stream_->Publish("state", "consent");
  stream_->Publish("state", "capture");
  Client back(server.port());
  back.Send(Header(server.port(), "/events") + "Last-Event-ID: 1\r\n\r\n");
  EXPECT_THAT(back.ReadUntil("data: capture"), HasSubstr("data: consent"));
  EXPECT_EQ(Get(server.port(), "/").status, 200);  // those who wait keep nobody waiting
}

TEST_F(ServerTest, FindsOutWhoIsGone) {
  const Server server = Started({.limits = {.keep_alive = 50ms}});
  {
    Client client(server.port());
    client.Send(Header(server.port(), "/events") + "\r\n");
    EXPECT_THAT(client.ReadUntil(": keep-alive"), HasSubstr("keep-alive"));
    EXPECT_EQ(stream_->viewers(), 1U);
  }
  const auto start = Clock::now();
  while (stream_->viewers() > 0 && Clock::now() - start < 5s) std::this_thread::sleep_for(10ms);
  EXPECT_EQ(stream_->viewers(), 0U);
}

TEST_F(ServerTest, DropsAViewerWhoDoesNotRead) {
  stream_ = std::make_shared<EventStream>(EventStreamOptions{.kept_bytes = 1 << 10, .viewer_bytes = 64 << 10});
  const Server server = Started({.limits = {.idle = 2s}});
  Client slow(server.port());
  slow.Send(Header(server.port(), "/events") + "\r\n");
  const auto start = Clock::now();
  while (stream_->viewers() == 0 && Clock::now() - start < 5s) std::this_thread::sleep_for(5ms);
  // More than its socket takes; then its share is full, then it is ended.
  while (stream_->viewers() > 0 && Clock::now() - start < 15s) {
    stream_->Publish("a", std::string(60 << 10, 'x'));
    std::this_thread::sleep_for(1ms);
  }
  EXPECT_EQ(stream_->viewers(), 0U);
}

TEST_F(ServerTest, StopsWhileItStreams) {
  for (int round = 0; round < 10; ++round) {
    stream_ = std::make_shared<EventStream>();
    Server server = Started({.threads = 1 + round % 3});
    std::vector<Client> clients;
    for (int i = 0; i < 6; ++i) {
      clients.emplace_back(server.port());
      clients.back().Send(Header(server.port(), "/events") + "\r\n");
      if (i % 2 == 0) (void)clients.back().ReadUntil("retry: 2000");
    }
    std::atomic<bool> publishing = true;
    std::thread publisher([&] {
      while (publishing) stream_->Publish("n", "x");
    });
    std::this_thread::sleep_for(5ms);
    const auto start = Clock::now();
    server.Stop();
    EXPECT_LT(Clock::now() - start, 3s);
    publishing = false;
    publisher.join();
    EXPECT_EQ(stream_->viewers(), 0U);
    for (Client& client : clients) EXPECT_TRUE(client.SeesEnd());
  }
}

TEST_F(ServerTest, LeavesNoDescriptorBehind) {
  const auto descriptors = [] {
    return std::distance(std::filesystem::directory_iterator("/proc/self/fd"), std::filesystem::directory_iterator());
  };
  const auto before = descriptors();
  for (int i = 0; i < 5; ++i) {
    Server server = Started();
    EXPECT_EQ(Get(server.port(), "/file").status, 200);
    Client client(server.port());
    client.Send(Header(server.port(), "/events") + "\r\n");
    (void)client.ReadUntil("retry");
  }
  EXPECT_EQ(descriptors(), before);
}

// Bytes that are no request end in a refusal or a closed connection, never in a server that is gone.
TEST_F(ServerTest, SurvivesRandomBytes) {
  const Server server = Started({.limits = {.idle = 1s}});
  uint32_t state = 15;
  for (int round = 0; round < 200; ++round) {
    std::string bytes = round % 2 == 0 ? "GET /echo/" : "";
    for (int i = 0; i < 200; ++i) {
      state = state * 1664525 + 1013904223;
      bytes += static_cast<char>(state >> 24);
    }
    Client client(server.port());
    client.Send(bytes + "\r\n\r\n");
  }
  const auto start = Clock::now();
  while (Get(server.port(), "/").status != 200 && Clock::now() - start < 10s) std::this_thread::sleep_for(50ms);
  EXPECT_EQ(Get(server.port(), "/").status, 200);
}

}  // namespace
}  // namespace stratalux::http
