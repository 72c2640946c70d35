// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/forget.h"

#include <algorithm>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/listing.h"
#include "db/base/memory_folder.h"
#include "db/base/write_lock.h"
#include "db/care/incoming.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/consent_rows.h"
#include "db/catalogue/forgotten_rows.h"
#include "db/catalogue/ledger_follow.h"
#include "db/keys/key_store.h"
#include "db/keys/sealed_key.h"
#include "db/ledger/ledger.h"
#include "db/privacy/forget_intent.h"
#include "db/privacy/forget_proof.h"
#include "db/privacy/store_scan.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// The first half of one call, over the sessions asked for and those left from a call before.
class Forgetting {
 public:
  Forgetting(fs::path store, const ForgetRequest& request)
      : store_(std::move(store)), request_(request), removed_(std::make_unique<ForgetProof::Removed>()) {
    removed_->store = store_;
    removed_->visitors = request.visitors;
    removed_->after_step = request.after_step;
  }
  Result<ForgetProof> Run();

 private:
  Status WriteIntents();
  Status EnterForgettings();
  [[nodiscard]] Result<std::vector<std::string>> LeavingVisitors(SessionIndex& index) const;
  Status EnterLeavingVisitors();
  Status Remove();
  Status RemoveIncoming();
  Status DestroyKeys();
  Status FindLateExports();
  void RemoveExports();
  Status SetFoldersAside();
  Status RemoveFolder(const fs::path& folder) const;
  Status RemoveFoldersAside();
  Status RemoveRows(SessionIndex& index);
  Status RemoveVisitorKeys(SessionIndex& index);
  Status WipeKeptIndexes(SessionIndex& index);
  bool NamesGoneVisitor(const std::string& database, const std::vector<std::string>& telling);
  Status Compact(SessionIndex& index);
  Status RemoveFromNights();
  Status FindGoneVisitors(SessionIndex& index);
  void Done(ForgetStep step) const {
    if (request_.after_step) request_.after_step(step);
  }

  const fs::path store_;
  const ForgetRequest& request_;
  std::unique_ptr<ForgetProof::Removed> removed_;
  std::vector<ForgetIntent>& intents_ = removed_->intents;
  ForgetReport& report_ = removed_->report;  // sessions in the order of intents_
};

Status Forgetting::WriteIntents() {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadWrite));
  SLX_RETURN_IF_ERROR(TidyIntents(store_));
  std::vector<std::string> unread;
  SLX_ASSIGN_OR_RETURN(intents_, ReadIntents(store_, unread));
  // Whoever asks to be forgotten does not wait for what another account began, which stays to be told.
  const bool asked = !request_.sessions.empty() || !request_.visitors.empty() || !request_.leftovers.empty();
  if (!unread.empty() && !asked && intents_.empty()) return Status::Failed(unread.front());
  report_.leftovers = std::move(unread);
  std::vector<std::string> fresh;
  for (const std::string& id : request_.sessions)
    if (std::none_of(intents_.begin(), intents_.end(), [&id](const ForgetIntent& i) { return i.session == id; }))
      fresh.push_back(id);
  SLX_ASSIGN_OR_RETURN(auto collected, CollectIntents(index, store_, fresh, IntentHashes::kCollected));
  for (ForgetIntent& intent : collected) {
    intent.reason = ToString(request_.reason);
    SLX_RETURN_IF_ERROR(WriteIntent(store_, intent));
    Done(ForgetStep::kIntent);
    intents_.push_back(std::move(intent));
  }
  for (const ForgetIntent& intent : intents_) report_.sessions.push_back(SessionOf(intent));
  return Status::Ok();
}

// An intent that was written before a power cut may have no entry yet.
Status Forgetting::EnterForgettings() {
  if (intents_.empty()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  for (const ForgetIntent& intent : intents_) {
    if (ledger.IsForgotten(intent.session)) continue;
    const Json detail = {{"reason", intent.reason}};
    SLX_RETURN_IF_ERROR(
        AppendToLedger(store_, {LedgerKind::kForgetting, intent.began, {intent.session}, "", detail.dump()}));
    Done(ForgetStep::kEntered);
  }
  return Status::Ok();
}

Status Forgetting::RemoveIncoming() {
  std::vector<std::string> ids = request_.leftovers;
  for (const ForgetIntent& intent : intents_) ids.push_back(intent.session);
  SLX_ASSIGN_OR_RETURN(const auto wiped, WipeIncoming(store_, ids, request_.visitors));
  for (const fs::path& folder : wiped) report_.incoming.push_back(folder.lexically_relative(store_).string());
  Done(ForgetStep::kIncoming);
  return Status::Ok();
}

// Whose last session this is.
Result<std::vector<std::string>> Forgetting::LeavingVisitors(SessionIndex& index) const {
  std::set<std::string> names(request_.visitors.begin(), request_.visitors.end()), ids;
  for (const ForgetIntent& intent : intents_) {
    names.insert(intent.visitor);
    ids.insert(intent.session);
  }
  names.erase("");
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT id FROM sessions WHERE visitor = ?1"));
  std::vector<std::string> leaving;
  for (const std::string& name : names) {
    bool others = false;
    select.Bind(1, name);
    while (true) {
      SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
      if (!more) break;
      others |= !ids.contains(select.Text(0));
    }
    select.Reset();
    if (!others) leaving.push_back(name);
  }
  return leaving;
}

// An index of before their first session names them by their consents alone.
Status Forgetting::EnterLeavingVisitors() {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto leaving, LeavingVisitors(index));
  if (leaving.empty()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  std::set<int64_t> entered;
  for (const LedgerEntry& entry : ledger.entries())
    for (const WallNs given : ConsentsForgottenBy(entry)) entered.insert(given.ns);
  for (const std::string& visitor : leaving) {
    if (visitor == kSimulatedVisitor) continue;  // nobody
    SLX_ASSIGN_OR_RETURN(const auto given, ConsentMoments(index.connection(), visitor, ConsentsThat::kWereGiven));
    if (std::ranges::all_of(given, [&](WallNs at) { return at.ns == 0 || entered.contains(at.ns); })) continue;
    SLX_RETURN_IF_ERROR(AppendToLedger(store_, {LedgerKind::kNote, WallNow(), {}, "", VisitorForgottenDetail(given)}));
    Done(ForgetStep::kEntered);
  }
  return Status::Ok();
}

// Before the rows go: broken off behind it, the next call finds the visitors again.
Status Forgetting::RemoveVisitorKeys(SessionIndex& index) {
  SLX_ASSIGN_OR_RETURN(const auto leaving, LeavingVisitors(index));
  for (const std::string& visitor : leaving) {
    SLX_RETURN_IF_ERROR(DestroyVisitorKey(store_, visitor));
    Done(ForgetStep::kVisitorKey);
  }
  return Status::Ok();
}

Status Forgetting::DestroyKeys() {
  for (const ForgetIntent& intent : intents_) {
    SLX_RETURN_IF_ERROR(WipeSealedKeys(store_ / "sessions" / intent.session));
    if (intent.key_id.empty()) continue;
    SLX_ASSIGN_OR_RETURN(const auto bytes, FromHex(intent.key_id));
    KeyId id{};
    std::copy_n(bytes.begin(), std::min(bytes.size(), id.size()), id.begin());
    SLX_RETURN_IF_ERROR(DestroyKey(store_, id));
    Done(ForgetStep::kKey);
  }
  return Status::Ok();
}

// Whoever begins an export from now on sees the ledger's entry, and who began before has a row.
Status Forgetting::FindLateExports() {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadOnly));
  std::set<std::string> changed;
  SLX_RETURN_IF_ERROR(VisitExports(index.connection(), [&](const std::string& session, const std::string& place) {
    for (ForgetIntent& intent : intents_)
      if (intent.session == session &&
          std::find(intent.exports.begin(), intent.exports.end(), place) == intent.exports.end()) {
        intent.exports.push_back(place);
        changed.insert(session);
      }
  }));
  for (const ForgetIntent& intent : intents_)
    if (changed.contains(intent.session)) SLX_RETURN_IF_ERROR(WriteIntent(store_, intent));
  return Status::Ok();
}

void Forgetting::RemoveExports() {
  for (size_t i = 0; i < intents_.size(); ++i)
    for (const std::string& place : intents_[i].exports) {
      const auto state = RemoveExport(place, intents_[i].session);
      report_.sessions[i].exports.push_back({place, state.ok() ? *state : ExportState::kKept});
      // A folder we may not write keeps no frame alive: it is named, and the next call tries again.
      if (!state.ok())
        removed_->kept_exports.push_back(
            {intents_[i].session, intents_[i].visitor, "export " + place + ": " + state.status().message(), {}});
      Done(ForgetStep::kExport);
    }
}

// In one step each: the deletion of a large session takes a second, and captures would wait for it. Where that cannot
// be (a session that is a mount, a full disk), they wait.
Status Forgetting::SetFoldersAside() {
  const fs::path aside = ForgettingFolder(store_);
  for (const ForgetIntent& intent : intents_) {
    const fs::path folder = store_ / "sessions" / intent.session;
    std::error_code error;
    if (!fs::exists(fs::symlink_status(folder, error))) continue;
    const bool made = MakeFolder(aside).ok();
    if (made) {
      SLX_RETURN_IF_ERROR(RemoveFolder(aside / intent.session));  // it was set aside before, and came back since
      fs::rename(folder, aside / intent.session, error);
    }
    if (!made || error) {
      SLX_RETURN_IF_ERROR(RemoveFolder(folder));
    } else {
      SLX_RETURN_IF_ERROR(SyncFolder(aside));
    }
    Done(ForgetStep::kSetAside);
  }
  return SyncFolder(store_ / "sessions");
}

Status Forgetting::RemoveFolder(const fs::path& folder) const {
  SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> files, FilesUnder(folder));
  std::error_code error;
  for (const fs::path& file : files) {
    fs::remove(file, error);
    if (error) return Status::Failed("cannot delete " + file.string() + ": " + error.message());
    Done(ForgetStep::kFile);
  }
  fs::remove_all(folder, error);
  if (error) return Status::Failed("cannot delete " + folder.string() + ": " + error.message());
  return Status::Ok();
}

// Also what another forgetting left that was broken off.
Status Forgetting::RemoveFoldersAside() {
  const fs::path aside = ForgettingFolder(store_);
  std::error_code error;
  if (!fs::is_directory(fs::symlink_status(aside, error))) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> folders, EntriesOf(aside));
  for (const fs::path& folder : folders) SLX_RETURN_IF_ERROR(RemoveFolder(folder));
  if (!folders.empty()) SLX_RETURN_IF_ERROR(SyncFolder(aside));
  fs::remove(aside, error);  // stays where another forgetting has just set something aside
  return SyncFolder(store_);
}

Status Forgetting::RemoveRows(SessionIndex& index) {
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_ASSIGN_OR_RETURN(auto tombstone,
                       connection.Prepare("INSERT OR IGNORE INTO deletions (session_id, deleted_wall_ns, reason,"
                                          " certificate_json) VALUES (?1, ?2, ?3, '{}')"));
  std::vector<VisitorSession> rows;
  for (const ForgetIntent& intent : intents_) {
    SLX_RETURN_IF_ERROR(tombstone.Bind(1, intent.session).Bind(2, intent.began.ns).Bind(3, intent.reason).Run());
    rows.push_back({intent.session, intent.visitor});
  }
  SLX_RETURN_IF_ERROR(RemoveForgottenRows(index, rows, request_.visitors));
  return transaction.Commit();
}

// Copies of the index from before a migration or a reindex hold the rows as they were: each goes with its logs.
Status Forgetting::WipeKeptIndexes(SessionIndex& index) {
  SLX_ASSIGN_OR_RETURN(const auto telling, TellingPseudonyms(index, removed_->gone_visitors));
  std::map<std::string, bool> holds;  // name of the database -> whether anything of it tells
  SLX_ASSIGN_OR_RETURN(std::vector<fs::path> entries, EntriesOf(store_));
  const auto kept_as = [](const fs::path& entry) {
    const std::string name = entry.filename().string();
    const size_t end = name.starts_with("index-before-") ? name.find(".sqlite") : std::string::npos;
    return end == std::string::npos ? std::string() : name.substr(0, end) + ".sqlite";
  };
  for (const fs::path& entry : entries) {
    const std::string name = kept_as(entry);
    if (name.empty()) continue;
    SLX_ASSIGN_OR_RETURN(const bool tells, HoldsMarker(entry, intents_, telling));
    holds[name] |= tells;
  }
  for (auto& [name, tells] : holds)
    if (!tells) tells = NamesGoneVisitor(name, telling);
  SLX_ASSIGN_OR_RETURN(entries, EntriesOf(store_));  // to look into one may have made a log
  for (const fs::path& entry : entries)
    if (const auto found = holds.find(kept_as(entry)); found != holds.end() && found->second)
      SLX_RETURN_IF_ERROR(WipeFile(entry));
  return Status::Ok();
}

// By its rows. One that cannot be asked is left over where its bytes did not tell either.
bool Forgetting::NamesGoneVisitor(const std::string& database, const std::vector<std::string>& telling) {
  for (const std::string& visitor : removed_->gone_visitors) {
    if (visitor == kSimulatedVisitor) continue;
    const auto named = RowsName(store_ / database, visitor);
    if (named.ok() && *named) return true;
    if (!named.ok() && std::find(telling.begin(), telling.end(), visitor) == telling.end())
      removed_->kept_exports.push_back(
          {"", visitor, database + ": cannot be read, and may hold the pseudonym: " + named.status().message(), {}});
  }
  return false;
}

Status Forgetting::Compact(SessionIndex& index) {
  SLX_RETURN_IF_ERROR(WipeKeptIndexes(index));
  return Checkpoint(index.connection());
}

// What the fitter's nights say of them (fitter/batch/night_log.h): files of their own, and pages that name them among
// others, which `stratalux-fit batch report` makes again.
Status Forgetting::RemoveFromNights() {
  SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> files, FilesUnder(store_ / "nights"));
  for (const fs::path& file : files) {
    std::error_code error;
    if (!fs::is_regular_file(file, error)) continue;
    const std::string name = file.filename().string();
    bool theirs = std::any_of(intents_.begin(), intents_.end(),
                              [&name](const ForgetIntent& intent) { return name.starts_with(intent.session); });
    if (!theirs) {
      SLX_ASSIGN_OR_RETURN(theirs, HoldsMarker(file, intents_));
    }
    if (theirs) SLX_RETURN_IF_ERROR(WipeFile(file));
  }
  return Status::Ok();
}

Status Forgetting::FindGoneVisitors(SessionIndex& index) {
  std::set<std::string> names(request_.visitors.begin(), request_.visitors.end());
  for (const ForgetIntent& intent : intents_) names.insert(intent.visitor);
  names.erase("");
  std::vector<std::string>& gone = removed_->gone_visitors;
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT count(*) FROM visitors WHERE id = ?1"));
  for (const std::string& name : names) {
    SLX_RETURN_IF_ERROR(select.Bind(1, name).Step().status());
    if (select.Integer(0) == 0) gone.push_back(name);
    select.Reset();
  }
  for (size_t i = 0; i < intents_.size(); ++i)
    report_.sessions[i].visitor_removed = std::find(gone.begin(), gone.end(), intents_[i].visitor) != gone.end();
  return Status::Ok();
}

// All that happens under the lock.
Status Forgetting::Remove() {
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store_));
  {
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadWrite));
    SLX_RETURN_IF_ERROR(TakeOverTombstones(index, store_));
  }
  SLX_RETURN_IF_ERROR(WriteIntents());
  SLX_RETURN_IF_ERROR(EnterForgettings());
  SLX_RETURN_IF_ERROR(EnterLeavingVisitors());
  SLX_RETURN_IF_ERROR(FindLateExports());
  SLX_RETURN_IF_ERROR(DestroyKeys());
  RemoveExports();
  SLX_RETURN_IF_ERROR(SetFoldersAside());
  SLX_RETURN_IF_ERROR(RemoveIncoming());
  SLX_RETURN_IF_ERROR(RemoveFromNights());
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadWrite));
  SLX_RETURN_IF_ERROR(RemoveVisitorKeys(index));
  SLX_RETURN_IF_ERROR(RemoveRows(index));
  Done(ForgetStep::kRows);
  SLX_RETURN_IF_ERROR(FindGoneVisitors(index));
  SLX_RETURN_IF_ERROR(Compact(index));
  Done(ForgetStep::kCompacted);
  return Status::Ok();
}

Result<ForgetProof> Forgetting::Run() {
  const Status removed = Remove();
  if (removed.ok()) Done(ForgetStep::kUnlocked);
  SLX_RETURN_IF_ERROR(RemoveFoldersAside());  // whoever reads the index keeps no frame alive
  RemoveAbandonedMemory();                    // what a killed run of it left plain
  SLX_RETURN_IF_ERROR(removed);
  Done(ForgetStep::kRemoved);
  return ForgetProof(std::move(removed_));
}

}  // namespace

const char* ToString(ForgetReason reason) { return reason == ForgetReason::kPurge ? "purge" : "forget"; }

Result<ForgetProof> BeginForget(const fs::path& store, const ForgetRequest& request) {
  return Forgetting(store, request).Run();
}

Result<ForgetReport> Forget(const fs::path& store, const ForgetRequest& request, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(ForgetProof proof, BeginForget(store, request));
  SLX_RETURN_IF_ERROR(proof.Search(logger));
  if (proof.NeedsIndexRewritten()) SLX_RETURN_IF_ERROR(proof.RewriteIndex());
  return proof.Certify();
}

}  // namespace stratalux::db
