// SPDX-License-Identifier: Apache-2.0
// The proof of a forget: every file of the store is read and searched for what would give the sessions away. Internal
// to db/privacy.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "db/privacy/forget_intent.h"
#include "shared/base/log.h"

namespace stratalux::db {

struct StoreScanResult {
  int64_t markers = 0, files = 0, bytes = 0;
  struct Leftover {
    std::string session, visitor;  // whose; a pseudonym has no session
    std::string text;              // "sessions/x/y.json, offset 12: session id"
    std::filesystem::path file;    // within the store; empty for others
  };
  std::vector<Leftover> leftovers;
};

// What the index says before the scan.
struct ScanPlan {
  std::map<std::string, int64_t>
      ids_in_index;                     // session -> how often its id stands in rows of deletions and access_log
  std::vector<std::string> pseudonyms;  // of visitors without a session, as far as a scan can tell them
  std::set<uint64_t> shared_hashes;     // of frames that remaining sessions hold, too: found rightly; as in an intent
};
// After the removal, without the store's lock: every frame of the index is looked at.
// Left to the rows: pseudonyms that are short, have no digit or are part of one that remains cannot be told from
// chance.
[[nodiscard]] Result<ScanPlan> PlanScan(SessionIndex& index, const std::vector<ForgetIntent>& intents,
                                        const std::vector<std::string>& gone_visitors);

// The intents' own files are left out: they go next. A session's id may stand in the chains of the ledger and, as often
// as the plan says, in the index. Others may write to the store meanwhile: what they remove is passed over, and
// SQLite's log, whose pages are copies of the index's, may hold ids as often as it likes. `goes_on` may end it:
// kTryAgain.
[[nodiscard]] Result<StoreScanResult> ScanStore(const std::filesystem::path& store,
                                                const std::vector<ForgetIntent>& intents, const ScanPlan& plan,
                                                Logger& logger, const std::function<bool()>& goes_on = {});

// The same of the index and its log alone, without a progress bar.
[[nodiscard]] Result<StoreScanResult> ScanIndex(const std::filesystem::path& store,
                                                const std::vector<ForgetIntent>& intents, const ScanPlan& plan);
[[nodiscard]] bool IsOfIndex(const std::filesystem::path& file);

// True where a file holds any marker of the intents, or one of these pseudonyms.
[[nodiscard]] Result<bool> HoldsMarker(const std::filesystem::path& file, const std::vector<ForgetIntent>& intents,
                                       const std::vector<std::string>& pseudonyms = {});

// Those of visitors without a session that bytes can tell, as PlanScan has it.
[[nodiscard]] Result<std::vector<std::string>> TellingPseudonyms(SessionIndex& index,
                                                                 const std::vector<std::string>& gone_visitors);

// Whether rows of a database that is another program's, or an old one, name the visitor. An error where it cannot be
// asked.
[[nodiscard]] Result<bool> RowsName(const std::filesystem::path& database, const std::string& visitor);

}  // namespace stratalux::db
