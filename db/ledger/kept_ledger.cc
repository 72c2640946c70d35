// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/kept_ledger.h"

#include <sstream>

#include <sys/stat.h>

#include "db/ledger/ledger.h"
#include "db/ledger/ledger_folder.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

// Empty where it cannot be told: of a store from before the ledger, and where something cannot be looked at.
Result<std::string> StateOf(const fs::path& store) {
  std::error_code error;
  if (fs::exists(fs::symlink_status(store / "deletions", error))) return std::string();
  SLX_ASSIGN_OR_RETURN(const auto chains, ListChains(LedgerFolder(store)));
  std::ostringstream state("chains:");
  for (const ChainFile& chain : chains) {
    struct stat info {};
    if (lstat(chain.path.c_str(), &info) != 0) return std::string();
    state << ' ' << chain.path.filename().string() << ' ' << info.st_dev << ' ' << info.st_ino << ' ' << info.st_mode
          << ' ' << info.st_size;
    for (const timespec& time : {info.st_mtim, info.st_ctim}) state << ' ' << time.tv_sec << ' ' << time.tv_nsec;
  }
  return state.str();
}

}  // namespace

Status KeptLedger::Follow() {
  SLX_ASSIGN_OR_RETURN(const std::string state, StateOf(store_));  // before it is read: what comes later is seen next
  if (!state.empty() && state == seen_) return Status::Ok();
  seen_.clear();
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  forgotten_.clear();
  for (const auto& [session, certificate] : ledger.forgotten()) forgotten_.insert(session);
  withdrawn_ = ledger.withdrawn();
  seen_ = state;
  return Status::Ok();
}

Result<bool> KeptLedger::IsForgotten(const std::string& session_id) {
  const std::lock_guard lock(mutex_);
  SLX_RETURN_IF_ERROR(Follow());
  return forgotten_.contains(session_id);
}

Result<std::optional<WallNs>> KeptLedger::WithdrawnAt(const std::string& session_id) {
  const std::lock_guard lock(mutex_);
  SLX_RETURN_IF_ERROR(Follow());
  const auto found = withdrawn_.find(session_id);
  return found == withdrawn_.end() ? std::nullopt : std::optional(found->second);
}

}  // namespace stratalux::db
