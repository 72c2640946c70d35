// SPDX-License-Identifier: Apache-2.0
#include "db/apps/moment.h"

#include <gtest/gtest.h>

namespace stratalux::db {
namespace {

constexpr int64_t kSecond_ns = 1'000'000'000;

TEST(Moment, CountsAgesBackFromNow) {
  const WallNs now{1'000'000 * kSecond_ns};
  EXPECT_EQ(ParseMoment("30m", now)->ns, now.ns - 1800 * kSecond_ns);
  EXPECT_EQ(ParseMoment("12h", now)->ns, now.ns - 12 * 3600 * kSecond_ns);
  EXPECT_EQ(ParseMoment("7d", now)->ns, now.ns - 7 * 86400 * kSecond_ns);
  EXPECT_EQ(ParseMoment("2w", now)->ns, now.ns - 14 * 86400 * kSecond_ns);
  EXPECT_EQ(ParseMoment("0d", now)->ns, now.ns);
}

TEST(Moment, ReadsBackWhatIsPrinted) {
  for (const int64_t second :
       {int64_t{0}, int64_t{951782400}, int64_t{1795231571}, int64_t{-86400}, int64_t{4107542399}}) {
    const WallNs moment{second * kSecond_ns};
    const auto read = ParseMoment(ToIso8601(moment), {});
    ASSERT_TRUE(read.ok()) << read.status().message();
    EXPECT_EQ(read->ns, moment.ns) << ToIso8601(moment);
  }
  EXPECT_EQ(ParseMoment("2000-02-29", {})->ns, 951782400 * kSecond_ns);
  EXPECT_EQ(ParseMoment("2000-02-29T01:00", {})->ns, (951782400 + 3600) * kSecond_ns);
}

TEST(Moment, RefusesWhatIsNone) {
  for (const char* text :
       {"", "d", "7", "-7d", "7x", "7dd", "9999999999999999999d", "99999999w", "2026-02-30", "2026-13-01", "2026-1-1",
        "2026-11-21T25:00", "2026-11-21T04:06:11+01:00", "0001-01-01", " 2026-11-21", "now"})
    EXPECT_EQ(ParseMoment(text, {}).status().code(), StatusCode::kUsage) << text;
}

}  // namespace
}  // namespace stratalux::db
