// SPDX-License-Identifier: Apache-2.0
#include "db/care/reindex.h"

#include <algorithm>
#include <optional>
#include <set>

#include "db/base/durable_file.h"
#include "db/base/write_lock.h"
#include "db/care/index_swap.h"
#include "db/care/session_rebuild.h"
#include "db/catalogue/ledger_follow.h"
#include "db/ledger/ledger.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
constexpr const char* kWorkFolder = "reindex.new";

// In the order that ids and place.json tell; sessions without a number come last, by id.
Result<std::vector<fs::path>> SessionFolders(const fs::path& store) {
  std::error_code error;
  std::vector<fs::path> folders;
  for (auto entry = fs::directory_iterator(store / "sessions", error); !error && entry != fs::directory_iterator();
       entry.increment(error))
    if (entry->is_directory(error)) folders.push_back(entry->path());
  if (error) return Status::NotFound("no store in " + store.string() + ": " + error.message());
  std::sort(folders.begin(), folders.end());
  return folders;
}

// Numbers of forgotten sessions are not given again.
Status RaiseSequence(SessionIndex& index, const Ledger& ledger, int64_t highest) {
  for (const auto& [id, certificate] : ledger.forgotten()) highest = std::max(highest, NumberOfId(id).value_or(0));
  Connection& connection = index.connection();
  SLX_RETURN_IF_ERROR(connection.Execute("DELETE FROM sqlite_sequence WHERE name = 'sessions'"));
  SLX_ASSIGN_OR_RETURN(auto insert,
                       connection.Prepare("INSERT INTO sqlite_sequence (name, seq) VALUES ('sessions', ?1)"));
  return insert.Bind(1, highest).Run();
}

// What lies in no file of a session.
Status TakeOver(SessionIndex& index) {
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(const int64_t version, connection.QueryInteger("PRAGMA old.user_version"));
  SLX_ASSIGN_OR_RETURN(const int64_t own, connection.QueryInteger("PRAGMA main.user_version"));
  if (version != own) return Status::Failed("it has schema " + std::to_string(version));
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_RETURN_IF_ERROR(connection.Execute(
      "INSERT INTO main.visitors (id, created_wall_ns) SELECT id, created_wall_ns FROM old.visitors WHERE true"
      " ON CONFLICT (id) DO UPDATE SET created_wall_ns = excluded.created_wall_ns;"
      // What sessions were made under stands in their manifests; consents that no session was made under, and
      // withdrawals of the time before the ledger, stood here alone. Numbers in the order in which they were given.
      "CREATE TEMP TABLE every AS SELECT * FROM main.consents;"
      "INSERT INTO temp.every SELECT * FROM old.consents o WHERE visitor IN (SELECT id FROM main.visitors) AND NOT "
      "EXISTS"
      " (SELECT 1 FROM main.consents m WHERE m.visitor = o.visitor AND m.given_wall_ns = o.given_wall_ns"
      " AND m.text_version = o.text_version);"
      "UPDATE temp.every SET withdrawn_wall_ns = (SELECT min(o.withdrawn_wall_ns) FROM old.consents o WHERE o.visitor ="
      " every.visitor AND o.given_wall_ns = every.given_wall_ns AND o.text_version = every.text_version);"
      "DELETE FROM main.consents;"
      "INSERT INTO main.consents (visitor, text_version, language, fit, research, publication, given_wall_ns,"
      " withdrawn_wall_ns) SELECT visitor, text_version, language, fit, research, publication, given_wall_ns,"
      " withdrawn_wall_ns FROM temp.every ORDER BY given_wall_ns;"
      "DROP TABLE temp.every;"
      "INSERT INTO main.access_log (number, at_wall_ns, who, action, session_id, detail)"
      " SELECT number, at_wall_ns, who, action, session_id, detail FROM old.access_log;"
      "INSERT INTO main.jobs (id, key, session, kind, state, priority, options_json, created_wall_ns,"
      " not_before_wall_ns, attempts, max_attempts, owner, fence, boot, until_boot_ns, last_error, finished_wall_ns)"
      " SELECT j.id, j.key, j.session, j.kind, j.state, j.priority, j.options_json, j.created_wall_ns,"
      " j.not_before_wall_ns, j.attempts, j.max_attempts, j.owner, j.fence, j.boot, j.until_boot_ns, j.last_error,"
      " j.finished_wall_ns FROM old.jobs j LEFT JOIN old.sessions o ON o.number = j.session"
      " LEFT JOIN main.sessions n ON n.number = o.number AND n.id = o.id"
      " WHERE j.session IS NULL OR n.number IS NOT NULL;"
      "UPDATE main.job_fence SET last = (SELECT last FROM old.job_fence);"
      "INSERT OR IGNORE INTO main.deletions (session_id, deleted_wall_ns, reason, certificate_json)"
      " SELECT session_id, deleted_wall_ns, reason, certificate_json FROM old.deletions"));
  return transaction.Commit();
}

void CutTails(const RebuiltSession& session, ReindexReport& report) {
  for (const auto& tail : session.tails)
    if (const Status cut = CutFile(tail.file, tail.keep); !cut.ok()) report.problems.push_back(cut.message());
}

Status InsertSessions(SessionIndex& index, const fs::path& store, const std::vector<fs::path>& folders,
                      const Ledger& ledger, Logger& logger, ReindexReport& report) {
  Progress progress(logger, "reindex", static_cast<int64_t>(folders.size()));
  std::set<int64_t> taken;
  std::vector<RebuiltSession> late;  // whose number is unknown or taken: behind all others
  auto insert = [&](const RebuiltSession& session, std::optional<int64_t> number) -> Status {
    SLX_ASSIGN_OR_RETURN(const int64_t given, InsertRebuilt(index, session, number));
    taken.insert(given);
    ++report.sessions;
    report.frames += static_cast<int64_t>(session.frames.size());
    report.fits += static_cast<int64_t>(session.fits.size());
    return Status::Ok();
  };
  for (const fs::path& folder : folders) {
    progress.Advance();
    if (ledger.IsForgotten(folder.filename().string())) {
      report.notes.push_back("session " + folder.filename().string() + " was forgotten; what is left of it in " +
                             folder.string() + " was not listed");
      continue;
    }
    auto session = RebuildSession(folder);
    if (!session.ok()) {
      report.problems.push_back(session.status().message());
      continue;
    }
    CutTails(*session, report);
    report.notes.insert(report.notes.end(), session->notes.begin(), session->notes.end());
    if (!session->number || taken.contains(*session->number)) {
      late.push_back(std::move(session).value());
      continue;
    }
    SLX_RETURN_IF_ERROR(insert(*session, session->number));
  }
  for (const RebuiltSession& session : late) {
    const int64_t number = taken.empty() ? 1 : *taken.rbegin() + 1;
    report.notes.push_back("session " + session.info.id + ": its number is taken or unknown; listed as number " +
                           std::to_string(number));
    SLX_RETURN_IF_ERROR(insert(session, number));
    SLX_RETURN_IF_ERROR(WritePlace(store / "sessions" / session.info.id, {number, "reindex"}));
  }
  return RaiseSequence(index, ledger, taken.empty() ? 0 : *taken.rbegin());
}

Status Build(const fs::path& store, const fs::path& work, Logger& logger, ReindexReport& report) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  report.forgotten = static_cast<int64_t>(ledger.forgotten().size());
  report.problems.insert(report.problems.end(), ledger.problems().begin(), ledger.problems().end());
  SLX_ASSIGN_OR_RETURN(const auto folders, SessionFolders(store));
  std::error_code error;
  fs::remove_all(work, error);
  SLX_RETURN_IF_ERROR(SessionIndex::Create(work));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(work, AccessMode::kReadWrite));
  Connection& connection = index.connection();
  // Nobody sees this file before it is whole and synced; should the power fail, it is built anew.
  SLX_RETURN_IF_ERROR(
      connection.Execute("PRAGMA journal_mode = MEMORY; PRAGMA synchronous = OFF;"
                         "PRAGMA cache_size = -65536"));
  bool attached = false;
  if (fs::exists(store / "index.sqlite", error)) attached = connection.Attach(store / "index.sqlite", "old").ok();
  {
    SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
    SLX_RETURN_IF_ERROR(InsertSessions(index, store, folders, ledger, logger, report));
    const Status taken = attached ? TakeOver(index) : Status::Failed("it cannot be opened");
    if (!taken.ok())
      report.notes.push_back(
          "access log, jobs and consents without a session were not taken over from the old index: " + taken.message());
    // Whatever the old index said, or nobody any more: withdrawn stays withdrawn, forgotten stays forgotten.
    SLX_RETURN_IF_ERROR(FollowLedger(index, store));
    SLX_RETURN_IF_ERROR(transaction.Commit());
  }
  if (attached) SLX_RETURN_IF_ERROR(connection.Execute("DETACH old"));
  return connection.Execute(
      "PRAGMA synchronous = FULL; PRAGMA journal_mode = WAL;"
      "PRAGMA wal_checkpoint(TRUNCATE)");
}

}  // namespace

Result<ReindexReport> Reindex(const fs::path& store, Logger& logger) {
  std::error_code error;
  if (!fs::is_directory(store / "sessions", error))
    return Status::NotFound("no store in " + store.string() + " (it has no folder 'sessions')");
  if (const auto old = SessionIndex::Open(store, AccessMode::kReadOnly);
      old.status().code() == StatusCode::kNewerSchema)
    return old.status();
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store));
  SLX_RETURN_IF_ERROR(ReleaseIndex(store));
  ReindexReport report;
  const fs::path work = store / kWorkFolder;
  Status built = Build(store, work, logger, report);
  if (built.ok()) {
    auto kept = SwapIndex(store, work / "index.sqlite");
    if (kept.ok()) report.kept = *kept;
    built = kept.status();
  }
  fs::remove_all(work, error);
  if (!built.ok()) {
    (void)ResumeIndex(store).ok();  // a damaged one cannot
    return built.WithContext("the old index stays as it was");
  }
  return report;
}

}  // namespace stratalux::db
