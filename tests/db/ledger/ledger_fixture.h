// SPDX-License-Identifier: Apache-2.0
// A folder for a ledger, and its entries by the shortest names.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "db/ledger/ledger.h"
#include "shared/base/read_file.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {

class LedgerTest : public ::testing::Test {
 protected:
  void SetUp() override {
    store_ = NewStore("a");
    ASSERT_TRUE(MakeStoreId(store_).ok());
  }
  void TearDown() override { std::filesystem::remove_all(root_); }

  [[nodiscard]] std::filesystem::path NewStore(const std::string& name) const {
    std::filesystem::create_directories(root_ / name);
    return root_ / name;
  }
  [[nodiscard]] static std::filesystem::path ChainOf(const std::filesystem::path& store) {
    return store / "ledger" / (*StoreId(store) + ".jsonl");
  }
  static Status Append(const std::filesystem::path& store, LedgerKind kind, const std::string& session,
                       int64_t at = 100) {
    return AppendToLedger(store, {kind, {at}, {session}, std::string(64, 'a'), R"({"reason":"forget"})"});
  }
  static Ledger ReadOf(const std::filesystem::path& store) {
    auto ledger = Ledger::Read(store);
    EXPECT_TRUE(ledger.ok()) << ledger.status().message();
    return ledger.ok() ? *ledger : Ledger();
  }
  [[nodiscard]] static std::vector<std::string> LinesOf(const std::filesystem::path& file) {
    std::vector<std::string> lines;
    const std::string text = ReadFile(file).value();
    for (size_t at = 0; at < text.size();) {
      const size_t end = text.find('\n', at);
      lines.push_back(text.substr(at, end - at));
      at = end == std::string::npos ? text.size() : end + 1;
    }
    return lines;
  }

  const std::filesystem::path root_ = [] {
    std::string name = (TemporaryFolder() / "stratalux-ledger-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    return name;
  }();
  std::filesystem::path store_;
};

}  // namespace stratalux::db
