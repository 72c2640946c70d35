// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/forget.h"

#include <algorithm>
#include <set>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/memory_folder.h"
#include "db/base/write_lock.h"
#include "db/care/incoming.h"
#include "db/catalogue/ledger_follow.h"
#include "db/keys/key_store.h"
#include "db/ledger/ledger.h"
#include "db/privacy/access_log.h"
#include "db/privacy/forget_intent.h"
#include "db/privacy/store_scan.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

// The steps of one call, over the sessions asked for and those left from a call before.
class Forgetting {
 public:
  Forgetting(fs::path store, const ForgetRequest& request, Logger& logger)
      : store_(std::move(store)), request_(request), logger_(logger) {}
  Result<ForgetReport> Run();

 private:
  Status WriteIntents();
  Status EnterForgettings();
  Status Remove();
  Status RemoveIncoming();
  Status DestroyKeys();
  void RemoveExports();
  Status SetFoldersAside();
  Status RemoveFolder(const fs::path& folder) const;
  Status RemoveFoldersAside();
  Status RemoveRows(SessionIndex& index);
  Status RemoveVisitorKeys(SessionIndex& index);
  Status Compact(SessionIndex& index);
  Status Scan();
  Status RewriteIndex(const ScanPlan& plan);
  Status Certify(SessionIndex& index);
  Status FindGoneVisitors(SessionIndex& index);
  [[nodiscard]] std::string CertificateFor(const ForgetIntent& intent, const ForgottenSession& session,
                                           WallNs now) const;
  [[nodiscard]] bool Concerns(const StoreScanResult::Leftover& leftover, const ForgetIntent& intent) const;
  void Done(ForgetStep step) const {
    if (request_.after_step) request_.after_step(step);
  }

  const fs::path store_;
  const ForgetRequest& request_;
  Logger& logger_;
  std::vector<ForgetIntent> intents_;
  ForgetReport report_;  // sessions in the order of intents_
  std::vector<std::string> gone_visitors_;
  StoreScanResult scan_;
  std::vector<StoreScanResult::Leftover> kept_exports_;
};

std::string Without(std::string text, const std::string& pseudonym) {
  if (pseudonym.empty()) return text;
  for (size_t at = 0; (at = text.find(pseudonym, at)) != std::string::npos;)
    text.replace(at, pseudonym.size(), "(forgotten)");
  return text;
}

Status Checkpoint(Connection& connection) {
  // The first column says whether somebody kept the log from being emptied.
  SLX_ASSIGN_OR_RETURN(const int64_t busy, connection.QueryInteger("PRAGMA wal_checkpoint(TRUNCATE)"));
  if (busy != 0)
    return Status::Busy(
        "another program reads the index, whose log therefore still holds the old rows; the frames are"
        " gone: run `stratalux-db forget --resume` once it has finished");
  return Status::Ok();
}

Status Forgetting::WriteIntents() {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadWrite));
  SLX_RETURN_IF_ERROR(TidyIntents(store_));
  SLX_ASSIGN_OR_RETURN(intents_, ReadIntents(store_));
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

// Of visitors whose last session this is. Before the rows go: broken off behind it, the next call finds the visitors
// again.
Status Forgetting::RemoveVisitorKeys(SessionIndex& index) {
  std::set<std::string> names(request_.visitors.begin(), request_.visitors.end()), ids;
  for (const ForgetIntent& intent : intents_) {
    names.insert(intent.visitor);
    ids.insert(intent.session);
  }
  names.erase("");
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT id FROM sessions WHERE visitor = ?1"));
  for (const std::string& name : names) {
    bool others = false;
    select.Bind(1, name);
    while (true) {
      SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
      if (!more) break;
      others |= !ids.contains(select.Text(0));
    }
    select.Reset();
    if (others) continue;
    SLX_RETURN_IF_ERROR(DestroyVisitorKey(store_, name));
    Done(ForgetStep::kVisitorKey);
  }
  return Status::Ok();
}

Status Forgetting::DestroyKeys() {
  for (const ForgetIntent& intent : intents_) {
    if (intent.key_id.empty()) continue;
    SLX_ASSIGN_OR_RETURN(const auto bytes, FromHex(intent.key_id));
    KeyId id{};
    std::copy_n(bytes.begin(), std::min(bytes.size(), id.size()), id.begin());
    SLX_RETURN_IF_ERROR(DestroyKey(store_, id));
    Done(ForgetStep::kKey);
  }
  return Status::Ok();
}

void Forgetting::RemoveExports() {
  for (size_t i = 0; i < intents_.size(); ++i)
    for (const std::string& place : intents_[i].exports) {
      const auto state = RemoveExport(place, intents_[i].session);
      report_.sessions[i].exports.push_back({place, state.ok() ? *state : ExportState::kKept});
      // A folder we may not write keeps no frame alive: it is named, and the next call tries again.
      if (!state.ok())
        kept_exports_.push_back(
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
  std::error_code error;
  std::vector<fs::path> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder, error))
    if (!entry.is_directory()) files.push_back(entry.path());
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
  std::vector<fs::path> folders;
  for (const auto& entry : fs::directory_iterator(aside, error)) folders.push_back(entry.path());
  for (const fs::path& folder : folders) SLX_RETURN_IF_ERROR(RemoveFolder(folder));
  if (!folders.empty()) SLX_RETURN_IF_ERROR(SyncFolder(aside));
  fs::remove(aside, error);  // stays where another forgetting has just set something aside
  return SyncFolder(store_);
}

Status Forgetting::RemoveRows(SessionIndex& index) {
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_ASSIGN_OR_RETURN(auto session, connection.Prepare("DELETE FROM sessions WHERE id = ?1"));
  SLX_ASSIGN_OR_RETURN(auto access,
                       connection.Prepare("UPDATE access_log SET detail = replace(detail, ?2, '(forgotten)') WHERE"
                                          " session_id = ?1 AND ?2 <> ''"));
  SLX_ASSIGN_OR_RETURN(auto tombstone,
                       connection.Prepare("INSERT OR IGNORE INTO deletions (session_id, deleted_wall_ns, reason,"
                                          " certificate_json) VALUES (?1, ?2, ?3, '{}')"));
  SLX_ASSIGN_OR_RETURN(auto visitor, connection.Prepare("DELETE FROM visitors WHERE id = ?1 AND NOT EXISTS"
                                                        " (SELECT 1 FROM sessions WHERE visitor = ?1)"));
  for (const ForgetIntent& intent : intents_) {
    SLX_RETURN_IF_ERROR(session.Bind(1, intent.session).Run());
    SLX_RETURN_IF_ERROR(access.Bind(1, intent.session).Bind(2, intent.visitor).Run());
    SLX_RETURN_IF_ERROR(tombstone.Bind(1, intent.session).Bind(2, intent.began.ns).Bind(3, intent.reason).Run());
  }
  for (const ForgetIntent& intent : intents_) SLX_RETURN_IF_ERROR(visitor.Bind(1, intent.visitor).Run());
  for (const std::string& id : request_.visitors) SLX_RETURN_IF_ERROR(visitor.Bind(1, id).Run());
  return transaction.Commit();
}

Status Forgetting::Compact(SessionIndex& index) {
  // Copies of the index from before a migration hold the rows as they were.
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(store_, error)) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with("index-before-") || !name.ends_with(".sqlite")) continue;
    SLX_ASSIGN_OR_RETURN(const bool holds, HoldsMarker(entry.path(), intents_));
    if (holds) SLX_RETURN_IF_ERROR(WipeFile(entry.path()));
  }
  return Checkpoint(index.connection());
}

Status Forgetting::FindGoneVisitors(SessionIndex& index) {
  std::set<std::string> names(request_.visitors.begin(), request_.visitors.end());
  for (const ForgetIntent& intent : intents_) names.insert(intent.visitor);
  names.erase("");
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT count(*) FROM visitors WHERE id = ?1"));
  for (const std::string& name : names) {
    SLX_RETURN_IF_ERROR(select.Bind(1, name).Step().status());
    if (select.Integer(0) == 0) gone_visitors_.push_back(name);
    select.Reset();
  }
  for (size_t i = 0; i < intents_.size(); ++i)
    report_.sessions[i].visitor_removed =
        std::find(gone_visitors_.begin(), gone_visitors_.end(), intents_[i].visitor) != gone_visitors_.end();
  return Status::Ok();
}

bool Forgetting::Concerns(const StoreScanResult::Leftover& leftover, const ForgetIntent& intent) const {
  return leftover.session.empty() ? leftover.visitor == intent.visitor : leftover.session == intent.session;
}

std::string Forgetting::CertificateFor(const ForgetIntent& intent, const ForgottenSession& session, WallNs now) const {
  Json exports = Json::array(), leftovers = Json::array();
  for (const ForgottenExport& e : session.exports)
    exports.push_back({{"place", Without(e.place, intent.visitor)}, {"state", ToString(e.state)}});
  for (const auto& leftover : scan_.leftovers)
    if (Concerns(leftover, intent)) leftovers.push_back(Without(leftover.text, intent.visitor));
  const Json json = {{"schema", 1},
                     {"session", intent.session},
                     {"reason", intent.reason},
                     {"deleted", ToIso8601(now)},
                     {"deleted_wall_ns", now.ns},
                     {"by", OperatingSystemUser()},
                     {"program_version", kVersion},
                     {"frames", session.frames},
                     {"fits", session.fits},
                     {"files", session.files},
                     {"bytes", session.bytes},
                     {"key_destroyed", session.encrypted},
                     {"visitor_removed", session.visitor_removed},
                     {"exports", exports},
                     {"verification",
                      {{"clean", leftovers.empty()},
                       {"markers", scan_.markers},
                       {"files_read", scan_.files},
                       {"bytes_read", scan_.bytes},
                       {"leftovers", leftovers}}}};
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);  // as the ledger writes it
}

// In the ledger, which the index follows. Two forgets that finish the same session certify it twice.
Status Forgetting::Certify(SessionIndex& index) {
  for (size_t i = 0; i < intents_.size(); ++i) {
    const WallNs now = WallNow();
    const std::string certificate = CertificateFor(intents_[i], report_.sessions[i], now);
    SLX_RETURN_IF_ERROR(AppendToLedger(store_, {LedgerKind::kForgotten, now, {intents_[i].session}, "", certificate}));
    Done(ForgetStep::kEntry);
  }
  SLX_RETURN_IF_ERROR(FollowLedger(index, store_));
  Done(ForgetStep::kCertified);
  // What is not clean stays begun, so that the next call looks again.
  for (const ForgetIntent& intent : intents_) {
    if (std::any_of(scan_.leftovers.begin(), scan_.leftovers.end(),
                    [&](const auto& leftover) { return Concerns(leftover, intent); }))
      continue;
    SLX_RETURN_IF_ERROR(WipeIntent(store_, intent.session));
  }
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
  SLX_RETURN_IF_ERROR(DestroyKeys());
  RemoveExports();
  SLX_RETURN_IF_ERROR(SetFoldersAside());
  SLX_RETURN_IF_ERROR(RemoveIncoming());
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadWrite));
  SLX_RETURN_IF_ERROR(RemoveVisitorKeys(index));
  SLX_RETURN_IF_ERROR(RemoveRows(index));
  Done(ForgetStep::kRows);
  SLX_RETURN_IF_ERROR(Compact(index));
  Done(ForgetStep::kCompacted);
  return FindGoneVisitors(index);
}

// A page still holds what it once moved elsewhere: written anew, no page ever held it.
Status Forgetting::RewriteIndex(const ScanPlan& plan) {
  {
    SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store_));
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadWrite));
    SLX_RETURN_IF_ERROR(index.connection().Execute("VACUUM"));
    SLX_RETURN_IF_ERROR(Checkpoint(index.connection()));
  }
  SLX_ASSIGN_OR_RETURN(const auto again, ScanIndex(store_, intents_, plan));
  std::erase_if(scan_.leftovers, [](const auto& leftover) { return IsOfIndex(leftover.file); });
  scan_.leftovers.insert(scan_.leftovers.end(), again.leftovers.begin(), again.leftovers.end());
  return Status::Ok();
}

// Index closed: it is read as a file, and closing that drops the locks of this process on it.
Status Forgetting::Scan() {
  if (intents_.empty() && gone_visitors_.empty()) return Status::Ok();  // nothing to look for
  ScanPlan plan;
  {
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadOnly));
    SLX_ASSIGN_OR_RETURN(plan, PlanScan(index, intents_, gone_visitors_));
  }
  SLX_ASSIGN_OR_RETURN(scan_, ScanStore(store_, intents_, plan, logger_));
  if (std::any_of(scan_.leftovers.begin(), scan_.leftovers.end(),
                  [](const auto& leftover) { return IsOfIndex(leftover.file); }))
    SLX_RETURN_IF_ERROR(RewriteIndex(plan));
  scan_.leftovers.insert(scan_.leftovers.end(), kept_exports_.begin(), kept_exports_.end());
  Done(ForgetStep::kScanned);
  return Status::Ok();
}

Result<ForgetReport> Forgetting::Run() {
  const Status removed = Remove();
  if (removed.ok()) Done(ForgetStep::kUnlocked);
  SLX_RETURN_IF_ERROR(RemoveFoldersAside());  // whoever reads the index keeps no frame alive
  RemoveAbandonedMemory();                    // what a killed run of it left plain
  SLX_RETURN_IF_ERROR(removed);
  SLX_RETURN_IF_ERROR(Scan());
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadWrite));
  SLX_RETURN_IF_ERROR(Certify(index));
  (void)Checkpoint(index.connection()).ok();  // of the certificate alone: a reader may keep that in the log
  Done(ForgetStep::kDone);
  report_.markers = scan_.markers;
  report_.scanned_files = scan_.files;
  report_.scanned_bytes = scan_.bytes;
  for (const auto& leftover : scan_.leftovers) report_.leftovers.push_back(leftover.text);
  return std::move(report_);
}

}  // namespace

const char* ToString(ForgetReason reason) { return reason == ForgetReason::kPurge ? "purge" : "forget"; }

Result<ForgetReport> Forget(const fs::path& store, const ForgetRequest& request, Logger& logger) {
  return Forgetting(store, request, logger).Run();
}

}  // namespace stratalux::db
