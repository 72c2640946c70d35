// SPDX-License-Identifier: Apache-2.0
#include "shared/http/target.h"

#include <gtest/gtest.h>

#include "shared/base/random.h"
#include "shared/http/router.h"

namespace stratalux::http {
namespace {

TEST(ParseTarget, DecodesAfterItSplits) {
  const auto target = ParseTarget("/sessions/s%20a?phase=a%26b&x=1+2&phase=later&empty");
  ASSERT_TRUE(target.ok()) << target.status().message();
  EXPECT_EQ(target->segments, (std::vector<std::string>{"sessions", "s a"}));
  EXPECT_EQ(target->path(), "/sessions/s a");
  EXPECT_EQ(target->query.at("phase"), "a&b");
  EXPECT_EQ(target->query.at("x"), "1 2");
  EXPECT_EQ(target->query.at("empty"), "");
  EXPECT_EQ(ParseTarget("/")->path(), "/");
  EXPECT_EQ(ParseTarget("/a/")->path(), "/a");
}

TEST(ParseTarget, RefusesWhatCouldMeanAnotherPlace) {
  for (const char* text : {"",
                           "a",
                           "*",
                           "http://x/",
                           "//",
                           "//etc",
                           "/a//b",
                           "/.",
                           "/..",
                           "/a/../b",
                           "/%2e%2e/b",
                           "/%2E./b",
                           "/a%2fb",
                           "/a%5cb",
                           "/a\\b",
                           "/a%00b",
                           "/a%0ab",
                           "/%",
                           "/%4",
                           "/%zz",
                           "/%c0%ae%c0%ae/b",
                           "/%ff",
                           "/%ed%a0%80",
                           "/a?x=%",
                           "/a?%4",
                           "/..%2f..%2fetc%2fpasswd",
                           "/%7f"})
    EXPECT_FALSE(ParseTarget(text).ok()) << text;
  // Once decoded it is done: what looks like an escape then is a name.
  EXPECT_EQ(ParseTarget("/%252e%252e")->segments.front(), "%2e%2e");
}

TEST(ParseTarget, NoBytesGiveASegmentThatClimbs) {
  Random random(15);
  const std::string alphabet = "/.%2ef5c0\\?&=a\xc3\xa9";
  for (int round = 0; round < 20'000; ++round) {
    std::string text = "/";
    for (uint64_t n = random.Bits() % 16; n > 0; --n) text += alphabet[random.Bits() % alphabet.size()];
    const auto target = ParseTarget(text);
    if (!target.ok()) continue;
    for (const std::string& segment : target->segments) {
      EXPECT_NE(segment, "..") << text;
      EXPECT_EQ(segment.find_first_of("/\\"), std::string::npos) << text;
      EXPECT_FALSE(segment.empty()) << text;
    }
  }
}

TEST(PercentEncode, IsUndoneByDecoding) {
  std::string all;
  for (int c = 0; c < 256; ++c) all += static_cast<char>(c);
  EXPECT_EQ(*PercentDecode(PercentEncode(all)), all);
  EXPECT_EQ(PercentEncode("a/b?c#d\"<>"), "a%2Fb%3Fc%23d%22%3C%3E");
}

TEST(Router, FindsByPatternAndSaysWhatIsAllowed) {
  Router router;
  const auto answer = [](const std::string& text) {
    return [text](const Request&) { return Response::Text(200, text); };
  };
  router.Add(Method::kGet, "/", answer("root"));
  router.Add(Method::kGet, "/a/{x}", answer("one"));
  router.Add(Method::kPost, "/a/{x}", answer("post"), Audience::kEverybody);
  router.Add(Method::kGet, "/a/{x}/files/{rest...}", answer("rest"));
  const auto find = [&router](Method method, const char* path) { return router.Find(method, *ParseTarget(path)); };
  EXPECT_NE(find(Method::kGet, "/").handler, nullptr);
  EXPECT_EQ(find(Method::kGet, "/a/7").wildcards.at("x"), "7");
  EXPECT_NE(find(Method::kHead, "/a/7").handler, nullptr);
  EXPECT_EQ(find(Method::kPost, "/a/7").audience, Audience::kEverybody);
  EXPECT_EQ(find(Method::kGet, "/a/7/files/b/c.png").wildcards.at("rest"), "b/c.png");
  EXPECT_EQ(find(Method::kGet, "/a/7/files").handler, nullptr);
  const auto refused = find(Method::kDelete, "/a/7");
  EXPECT_EQ(refused.handler, nullptr);
  EXPECT_EQ(refused.allowed, (std::vector<Method>{Method::kGet, Method::kHead, Method::kPost}));
  EXPECT_TRUE(find(Method::kGet, "/b").allowed.empty());
}

}  // namespace
}  // namespace stratalux::http
