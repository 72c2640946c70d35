// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/ticket.h"

#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "db/catalogue/consent.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::MatchesRegex;

// The check symbols 3 and 1 were reckoned by hand: the number of the ten symbols, modulo 37.
TEST(Ticket, NamesItsVisitorHoweverItIsWritten) {
  for (const char* code : {"7K3QZ-M0P4T-3", "7k3qz-m0p4t-3", "7K3QZM0P4T3", " 7K3QZ MOP4T 3 "})
    EXPECT_EQ(*VisitorOfTicket(code), "t-7k3qzm0p4t3") << code;
  EXPECT_EQ(*VisitorOfTicket("i2345-67890-l"), "t-12345678901");
}

TEST(Ticket, FindsEveryWrongSymbolAndEveryTwoThatChangedPlaces) {
  const std::string symbols = "0123456789ABCDEFGHJKMNPQRSTVWXYZ", good = "7K3QZM0P4T3";
  for (size_t at = 0; at < good.size(); ++at) {
    for (const char wrong : symbols) {
      std::string code = good;
      code[at] = wrong;
      EXPECT_EQ(VisitorOfTicket(code).ok(), code == good) << code;
    }
    if (at + 1 == good.size()) continue;
    std::string code = good;
    std::swap(code[at], code[at + 1]);
    EXPECT_EQ(VisitorOfTicket(code).ok(), code == good) << code;
  }
}

TEST(Ticket, SaysWhatIsWrongWithIt) {
  EXPECT_THAT(VisitorOfTicket("").status().message(), HasSubstr("has 0 symbols"));
  EXPECT_THAT(VisitorOfTicket("7K3QZ-M0P4T").status().message(), HasSubstr("has 10 symbols"));
  EXPECT_THAT(VisitorOfTicket("7K3QZ-M0P4T-U").status().message(), HasSubstr("has a symbol that no code has"));
  EXPECT_THAT(VisitorOfTicket("7K3QZ-M0P4T-4").status().message(), HasSubstr("is mistyped"));
  EXPECT_EQ(VisitorOfTicket("'; DROP TABLE").status().code(), StatusCode::kUsage);
}

TEST(Ticket, IsDrawnReadableAndAGoodPseudonym) {
  std::set<std::string> codes;
  for (int i = 0; i < 2000; ++i) {
    const std::string code = DrawTicket();
    EXPECT_THAT(code, MatchesRegex("[0-9A-HJKMNP-TV-Z]{5}-[0-9A-HJKMNP-TV-Z]{5}-[0-9A-HJKMNP-TV-Z]"));
    const auto visitor = VisitorOfTicket(code);
    ASSERT_TRUE(visitor.ok()) << visitor.status().message();
    EXPECT_TRUE(CheckNewPseudonym(*visitor).ok()) << *visitor;
    codes.insert(code);
  }
  EXPECT_EQ(codes.size(), 2000U);
}

}  // namespace
}  // namespace stratalux::db
