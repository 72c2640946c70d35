// SPDX-License-Identifier: Apache-2.0
// What visitors agreed to, withdrew and had forgotten, in files that outlive the index (docs/file-formats.md,
// "Ledger").
//
// STORE/ledger/<store id>.jsonl, one chain a store: append-only JSON lines, each with the hash of the line before it
// and its own. Chains of other stores lie beside it, as pull, restore and backup brought them; all of them bind. An
// entry names sessions, and the visitor by an HMAC of the pseudonym whose key (keys.sqlite) dies with the visitor's
// last session: from then on nothing in here leads to a person.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::db {

enum class LedgerKind {
  kConsent,     // with the first frame of a session: what it was made under
  kWithdrawal,  // of the visitor who made `sessions`
  kForgetting,  // begun: from here on the sessions cannot come back
  kForgotten,   // done: with the certificate
  kNote         // what befell the store itself, such as a restore without a newer ledger; a visitor who is forgotten
};
[[nodiscard]] const char* ToString(LedgerKind kind);

struct LedgerEntry {
  LedgerKind kind = LedgerKind::kConsent;
  WallNs at;
  std::vector<std::string> sessions;  // ids
  std::string visitor_hmac;           // 64 hex digits; empty for forgettings
  // Consent (kConsent), what is withdrawn (kWithdrawal), certificate (kForgotten), reason (kForgetting); may be empty.
  std::string detail_json;
};

// A withdrawal names the consents that it ends by when they were given, too: an index older than the visitor's first
// session, or of a visitor without any, knows them by that alone.
[[nodiscard]] std::string WithdrawalDetail(const std::vector<WallNs>& given);
// None of another kind of entry, or of a program that did not say it.
[[nodiscard]] std::vector<WallNs> ConsentsWithdrawnBy(const LedgerEntry& entry);

// The note that a visitor of whom no session is left was forgotten, by when the consents were given. It withdraws
// nothing: other stores may have sessions under the same consents. An index without any removes the visitor.
[[nodiscard]] std::string VisitorForgottenDetail(const std::vector<WallNs>& given);
// Of such a note; none of another entry.
[[nodiscard]] std::vector<WallNs> ConsentsForgottenBy(const LedgerEntry& entry);

struct LedgerMerge {
  int64_t chains = 0, entries = 0;    // that were new here
  std::vector<std::string> problems;  // damaged or forked chains: what of them could be read binds nevertheless
};

// Everything that all chains of a store say, read once. A value: it does not follow what others append later.
class Ledger {
 public:
  // A store without a ledger has an empty one. A damaged chain never hides the others nor its own readable entries: it
  // stands in problems(). kNewerSchema for a chain of a later version, kFailed for one that is there and cannot be
  // read: nobody knows whom it forgets.
  [[nodiscard]] static Result<Ledger> Read(const std::filesystem::path& store);
  // The same of a folder of chains: the `ledger/` of a source or of a backup.
  [[nodiscard]] static Result<Ledger> ReadFolder(const std::filesystem::path& folder);

  [[nodiscard]] bool IsForgotten(const std::string& session_id) const;  // once a forgetting has begun
  [[nodiscard]] std::optional<WallNs> WithdrawnAt(const std::string& session_id) const;
  // session id -> certificate; "" while its forgetting has begun and not finished.
  [[nodiscard]] const std::map<std::string, std::string>& forgotten() const { return forgotten_; }
  [[nodiscard]] const std::map<std::string, WallNs>& withdrawn() const { return withdrawn_; }
  [[nodiscard]] const std::vector<LedgerEntry>& entries() const { return entries_; }
  [[nodiscard]] const std::vector<std::string>& problems() const { return problems_; }

 private:
  friend class LedgerReader;
  std::map<std::string, std::string> forgotten_;
  std::map<std::string, WallNs> withdrawn_;
  std::vector<LedgerEntry> entries_;
  std::vector<std::string> problems_;
};

// What was appended to the chains of a store since somebody last read them.
struct LedgerNews {
  std::vector<LedgerEntry> entries;
  std::map<std::string, int64_t> heads;  // chain's file name -> bytes read of it, whole lines
  bool changed = false;                  // `heads` differ from those asked with
};
// From `heads` on; a chain that is shorter than its head is read from its start. Looks at sizes alone where nothing was
// appended. kNewerSchema as Read().
[[nodiscard]] Result<LedgerNews> ReadLedgerNews(const std::filesystem::path& store,
                                                const std::map<std::string, int64_t>& heads);

// Appends to the store's own chain (made with a fresh random store id where there is none); on the disk when this
// returns. Takes the ledger's own lock: captures, withdrawals and forgettings may meet; kBusy after ten seconds. A torn
// last line, which no append ever acknowledged, is cut. An entry that could not be written whole is taken back.
Status AppendToLedger(const std::filesystem::path& store, const LedgerEntry& entry);

// Takes over every chain of `folder` that is longer than what is here, and keeps a fork of a chain beside it under a
// name of its own, unless the fork is but a damaged copy that says nothing new. Merging twice changes nothing. A chain
// never gets shorter. kNewerSchema, with the chains that this program understands taken over, where one is of a later
// version; kFailed where one cannot be read. The tombstones of a store before the ledger lie in no such folder:
// Ledger::Read(that store) has them.
[[nodiscard]] Result<LedgerMerge> MergeLedger(const std::filesystem::path& store, const std::filesystem::path& folder);

// 32 hex digits; made with the store, the same as long as its file is there and sound. kNotFound where the store has no
// id yet, kIntegrity where it is damaged, kFailed where it cannot be read.
[[nodiscard]] Result<std::string> StoreId(const std::filesystem::path& store);
// Makes it where there is none.
Status MakeStoreId(const std::filesystem::path& store);

}  // namespace stratalux::db
