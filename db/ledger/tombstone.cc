// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/tombstone.h"

#include "db/ledger/ledger.h"

namespace stratalux::db {

namespace fs = std::filesystem;

bool HasTombstone(const fs::path& store, const std::string& session_id) {
  const auto ledger = Ledger::Read(store);
  return !ledger.ok() || ledger->IsForgotten(session_id);
}

std::vector<fs::path> ListTombstones(const fs::path& store) {
  std::vector<fs::path> files;
  const auto ledger = Ledger::Read(store);
  if (!ledger.ok()) return files;
  for (const auto& [id, certificate] : ledger->forgotten()) files.push_back(store / "deletions" / (id + ".json"));
  return files;
}

}  // namespace stratalux::db
