// SPDX-License-Identifier: Apache-2.0
// The worked example of docs/file-formats.md, "Ledger", is what the code writes.
#include <numeric>

#include "db/base/sqlite.h"
#include "db/catalogue/manifest.h"
#include "db/keys/key_store.h"
#include "db/ledger/ledger_line.h"
#include "tests/db/ledger/ledger_fixture.h"

namespace stratalux::db {
namespace {

constexpr const char* kStoreId = "0123456789abcdef0123456789abcdef";
constexpr const char* kVisitor = "v-5f3a91c2";

// The visitor's key is 0, 1, ... 31.
std::string NameUnderTheExamplesKey(const std::filesystem::path& store) {
  EXPECT_TRUE(NameVisitor(store, kVisitor).ok());
  std::vector<uint8_t> key(32);
  std::iota(key.begin(), key.end(), uint8_t{0});
  auto connection = Connection::Open(KeyFile(store), Connection::Mode::kReadWrite);
  auto update = connection->Prepare("UPDATE visitor_keys SET key = ?1");
  EXPECT_TRUE(update->Bind(1, std::span<const uint8_t>(key)).Run().ok());
  return FindVisitorName(store, kVisitor).value();
}

TEST_F(LedgerTest, TheWorkedExampleIsWhatTheCodeWrites) {
  WriteText(store_ / "ledger" / "store.id", std::string(kStoreId) + "\n");
  const std::string name = NameUnderTheExamplesKey(store_), id = "s000017-0badcafe";
  const Consent consent{"2026-03", "de", true, false, false, {1795262563000000000}};
  for (const LedgerEntry& entry :
       {LedgerEntry{LedgerKind::kConsent, {1795262570000000000}, {id}, name, ConsentToJson(consent)},
        LedgerEntry{LedgerKind::kWithdrawal, {1795348970000000000}, {id}, name, WithdrawalDetail({consent.given_wall})},
        LedgerEntry{LedgerKind::kForgetting, {1795348980000000000}, {id}, "", R"({"reason":"forget"})"}})
    ASSERT_TRUE(AppendToLedger(store_, entry).ok());
  const std::string page = ReadFile(std::string(STRATALUX_SOURCE_DIR) + "/docs/file-formats.md").value();
  const std::string chain = ReadFile(ChainOf(store_)).value();
  EXPECT_NE(page.find("```\n" + chain + "```\n"), std::string::npos) << chain;
}

// Its detail is kept as text and written again: neither may recurse without end.
TEST_F(LedgerTest, ALineThatNestsWithoutEndIsNotUnderstood) {
  const std::string deep = R"({"reason": )" + std::string(200'000, '[') + std::string(200'000, ']') + "}";
  ChainEnd end{0, ChainStart(kStoreId)};
  const LedgerEntry entry{LedgerKind::kForgetting, {1}, {"s000017-0badcafe"}, "", deep};
  const std::string as_text = MakeLine(entry, end);
  EXPECT_EQ(ParseLine(as_text).state, LineState::kWhole);
  std::string hostile = R"({"schema":1,"n":1,"prev":")" + ChainStart(kStoreId) +
                        R"(","kind":"forgetting","at_wall_ns":1,"sessions":[],"visitor":"","detail":)" + deep + "}";
  const LedgerLine line = ParseLine(hostile);
  EXPECT_FALSE(line.entry.has_value());
  EXPECT_NE(line.state, LineState::kWhole);
}

}  // namespace
}  // namespace stratalux::db
