// SPDX-License-Identifier: Apache-2.0
// The ledger of a store, for a program that asks of one session after the other: a page of pictures would read ten
// years of entries for each of them.
#pragma once

#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::db {

// Answers as Ledger::Read() would, errors too, and reads only when a chain has come, gone or changed since (inode,
// size, times). Keeps ids and moments alone. Thread-safe.
class KeptLedger {
 public:
  explicit KeptLedger(std::filesystem::path store) : store_(std::move(store)) {}

  [[nodiscard]] Result<bool> IsForgotten(const std::string& session_id);
  [[nodiscard]] Result<std::optional<WallNs>> WithdrawnAt(const std::string& session_id);

 private:
  Status Follow();

  const std::filesystem::path store_;
  std::mutex mutex_;
  std::string seen_;  // of the chains; empty: nothing is kept
  std::set<std::string> forgotten_;
  std::map<std::string, WallNs> withdrawn_;
};

}  // namespace stratalux::db
