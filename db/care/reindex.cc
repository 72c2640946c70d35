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
#include "db/catalogue/manifest.h"
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
      // withdrawals of the time before the ledger, stood here alone. Numbers in the order in which they were given,
      // which the old index knows better than a clock; what it did not know comes behind what its visitor gave before.
      "CREATE TEMP TABLE every AS SELECT * FROM main.consents;"
      "INSERT INTO temp.every SELECT * FROM old.consents o WHERE visitor IN (SELECT id FROM main.visitors) AND NOT "
      "EXISTS"
      " (SELECT 1 FROM main.consents m WHERE m.visitor = o.visitor AND m.given_wall_ns = o.given_wall_ns"
      " AND m.text_version = o.text_version);"
      "UPDATE temp.every SET withdrawn_wall_ns = (SELECT min(o.withdrawn_wall_ns) FROM old.consents o WHERE o.visitor ="
      " every.visitor AND o.given_wall_ns = every.given_wall_ns AND o.text_version = every.text_version);"
      "DELETE FROM main.consents; DELETE FROM main.sqlite_sequence WHERE name = 'consents';"
      "INSERT INTO main.consents (visitor, text_version, language, fit, research, publication, given_wall_ns,"
      " withdrawn_wall_ns) SELECT visitor, text_version, language, fit, research, publication, given_wall_ns,"
      " withdrawn_wall_ns FROM temp.every e ORDER BY coalesce((SELECT min(o.number) FROM old.consents o WHERE"
      " o.visitor = e.visitor AND o.given_wall_ns = e.given_wall_ns AND o.text_version = e.text_version),"
      " (SELECT max(o.number) FROM old.consents o WHERE o.visitor = e.visitor AND o.given_wall_ns < e.given_wall_ns), "
      "0),"
      " given_wall_ns;"
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
      // A certificate whose line in the ledger is damaged is kept, too.
      "INSERT INTO main.deletions (session_id, deleted_wall_ns, reason, certificate_json)"
      " SELECT session_id, deleted_wall_ns, reason, certificate_json FROM old.deletions WHERE TRUE"
      " ON CONFLICT (session_id) DO UPDATE SET deleted_wall_ns = excluded.deleted_wall_ns, reason = excluded.reason,"
      " certificate_json = excluded.certificate_json WHERE deletions.certificate_json = '{}'"));
  return transaction.Commit();
}

// What the old index says of a session's frames; nothing where it cannot be asked.
std::vector<KnownFrame> KnownFrames(SessionIndex& index, const std::string& id) {
  std::vector<KnownFrame> known;
  auto select = index.connection().Prepare(
      "SELECT f.segment, f.step, f.frame, f.offset, f.stored_bytes, f.hash FROM old.frames f"
      " JOIN old.sessions s ON s.number = f.session WHERE s.id = ?1 AND f.frame BETWEEN 0 AND 1000000000000"
      " ORDER BY f.frame");
  if (!select.ok()) return known;
  select->Bind(1, id);
  while (true) {
    const auto more = select->Step();
    if (!more.ok() || !*more) return known;  // damaged: what it said up to here may still be true
    known.push_back({select->Integer(0),
                     static_cast<int>(select->Integer(1)),
                     {select->Integer(2), select->Integer(3), select->Integer(4), select->Blob(5)}});
  }
}

// Its row there, where the manifest does not tell; nothing where it cannot be asked.
std::optional<SessionInfo> ListedInfo(SessionIndex& index, const fs::path& store, const fs::path& folder) {
  if (ReadManifestContents(folder).ok() && ReadManifest(folder).ok()) return std::nullopt;
  const auto version = index.connection().QueryInteger("PRAGMA old.user_version");
  const auto own = index.connection().QueryInteger("PRAGMA main.user_version");
  if (!version.ok() || !own.ok() || *version != *own) return std::nullopt;  // opening it would migrate it
  auto old = SessionIndex::Open(store, AccessMode::kReadOnly);
  const auto number = old.ok() ? old->NumberOf(folder.filename().string()) : old.status();
  const auto row = number.ok() ? old->Session(*number) : number.status();
  return row.ok() ? std::optional(row->info) : std::nullopt;
}

// Fits that the old index listed and that are not found, unless it was said why.
void MissFits(SessionIndex& index, RebuiltSession& session) {
  auto select = index.connection().Prepare(
      "SELECT f.id FROM old.fits f JOIN old.sessions s ON s.number = f.session WHERE s.id = ?1 ORDER BY f.id");
  if (!select.ok()) return;
  select->Bind(1, session.info.id);
  while (true) {
    const auto more = select->Step();
    if (!more.ok() || !*more) return;
    const std::string id = select->Text(0);
    const auto& fits = session.fits;
    if (std::none_of(fits.begin(), fits.end(), [&id](const FitRow& fit) { return fit.id == id; }))
      session.problems.push_back("session " + session.info.id + ": fit " + id +
                                 " was listed but is missing or incomplete; it is no longer listed");
  }
}

class Lister {
 public:
  Lister(SessionIndex& index, const fs::path& store, const Ledger& ledger, ReindexReport& report)
      : index_(index), store_(store), ledger_(ledger), report_(report) {}

  Status Add(const fs::path& folder, bool has_old_index) {
    const std::string id = folder.filename().string();
    highest_ = std::max(highest_, PlaceOf(folder).value_or(0));
    if (ledger_.IsForgotten(id)) {
      report_.notes.push_back("session " + id + " was forgotten; what is left of it in " + folder.string() +
                              " was not listed");
      return Status::Ok();
    }
    const auto known = has_old_index ? KnownFrames(index_, id) : std::vector<KnownFrame>();
    if (known.empty() && NeverBegan(folder, ledger_)) {
      report_.notes.push_back(folder.string() +
                              " has no manifest and no frame: a session that never began; not listed");
      return Status::Ok();
    }
    auto session =
        has_old_index ? RebuildSession(folder, known, ListedInfo(index_, store_, folder)) : RebuildSession(folder);
    if (!session.ok()) return SetAside(folder, session.status());
    if (has_old_index) MissFits(index_, *session);
    report_.notes.insert(report_.notes.end(), session->notes.begin(), session->notes.end());
    report_.problems.insert(report_.problems.end(), session->problems.begin(), session->problems.end());
    if (session->number && !taken_.contains(*session->number)) return Insert(*session, *session->number).status();
    late_.push_back(std::move(session).value());
    return Status::Ok();
  }

  // Those whose number is unknown or taken: behind all others.
  Status AddLate() {
    for (const RebuiltSession& session : late_) {
      const int64_t number = highest_ + 1;
      SLX_ASSIGN_OR_RETURN(const bool inserted, Insert(session, number));
      if (!inserted) continue;
      report_.notes.push_back("session " + session.info.id + ": its number is taken or unknown; listed as number " +
                              std::to_string(number));
      SLX_RETURN_IF_ERROR(WritePlace(store_ / "sessions" / session.info.id, {number, "reindex"}));
    }
    return Status::Ok();
  }
  // Sessions whose manifests do not say yet how they ended, or are lost.
  [[nodiscard]] std::vector<RebuiltSession> TakeEnded() { return std::move(ended_); }
  // Ever given, also to what could not be listed.
  [[nodiscard]] int64_t highest() const { return highest_; }

 private:
  // What keeps one session out, and no other. A full disk keeps out all.
  Status SetAside(const fs::path& folder, const Status& status) {
    if (status.code() == StatusCode::kFailed || status.code() == StatusCode::kBusy) return status;
    report_.newer |= status.code() == StatusCode::kNewerSchema;
    report_.problems.push_back(status.message() + "; " + folder.string() + " is not listed");
    return Status::Ok();
  }

  Result<bool> Insert(const RebuiltSession& session, int64_t wanted) {
    const auto given = InsertRebuilt(index_, session, wanted);
    if (!given.ok()) {
      SLX_RETURN_IF_ERROR(SetAside(store_ / "sessions" / session.info.id, given.status()));
      return false;
    }
    taken_.insert(*given);
    highest_ = std::max(highest_, *given);
    ++report_.sessions;
    report_.frames += static_cast<int64_t>(session.frames.size());
    report_.fits += static_cast<int64_t>(session.fits.size());
    if (session.ended_here || session.told_by_index) ended_.push_back(session);
    return true;
  }

  SessionIndex& index_;
  const fs::path& store_;
  const Ledger& ledger_;
  ReindexReport& report_;
  std::set<int64_t> taken_;
  int64_t highest_ = 0;
  std::vector<RebuiltSession> late_, ended_;
};

Status InsertSessions(SessionIndex& index, const fs::path& store, const std::vector<fs::path>& folders,
                      bool has_old_index, const Ledger& ledger, Logger& logger, ReindexReport& report,
                      std::vector<RebuiltSession>& ended) {
  Progress progress(logger, "reindex", static_cast<int64_t>(folders.size()));
  Lister lister(index, store, ledger, report);
  for (const fs::path& folder : folders) {
    progress.Advance();
    SLX_RETURN_IF_ERROR(lister.Add(folder, has_old_index));
  }
  SLX_RETURN_IF_ERROR(lister.AddLate());
  ended = lister.TakeEnded();
  return RaiseSequence(index, ledger, lister.highest());
}

Status Build(const fs::path& store, const fs::path& work, Logger& logger, ReindexReport& report,
             std::vector<RebuiltSession>& ended) {
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
  // Not IMMEDIATE, which would ask for the old index, too: ReleaseIndex holds it against writers.
  SLX_RETURN_IF_ERROR(connection.Execute("BEGIN"));
  SLX_RETURN_IF_ERROR(InsertSessions(index, store, folders, attached, ledger, logger, report, ended));
  const Status taken = attached ? TakeOver(index) : Status::Failed("it cannot be opened");
  if (!taken.ok())
    report.notes.push_back("access log, jobs and consents without a session were not taken over from the old index: " +
                           taken.message());
  // Whatever the old index said, or nobody any more: withdrawn stays withdrawn, forgotten stays forgotten.
  SLX_RETURN_IF_ERROR(FollowLedger(index, store));
  SLX_RETURN_IF_ERROR(connection.Execute("COMMIT"));
  if (attached) SLX_RETURN_IF_ERROR(connection.Execute("DETACH old"));
  return connection.Execute(
      "PRAGMA main.synchronous = FULL; PRAGMA main.journal_mode = WAL;"
      "PRAGMA main.wal_checkpoint(TRUNCATE)");
}

// A damaged manifest stays beside the new one.
Status WriteEnding(const fs::path& folder, const RebuiltSession& session) {
  std::error_code error;
  if (session.told_by_index && fs::exists(folder / "manifest.json", error))
    SLX_RETURN_IF_ERROR(KeepFile(folder / "manifest.json", folder / kDamagedManifest));
  return WriteManifest(folder, session.info, static_cast<int64_t>(session.frames.size()), session.segments);
}

}  // namespace

Result<ReindexReport> Reindex(const fs::path& store, Logger& logger, const std::function<void()>& before_swap) {
  std::error_code error;
  if (!fs::is_directory(store / "sessions", error))
    return Status::NotFound("no store in " + store.string() + " (it has no folder 'sessions')");
  if (const auto old = SessionIndex::Open(store, AccessMode::kReadOnly);
      old.status().code() == StatusCode::kNewerSchema)
    return old.status();
  SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(store));
  SLX_ASSIGN_OR_RETURN(auto held, ReleaseIndex(store));
  ReindexReport report;
  const fs::path work = store / kWorkFolder;
  std::vector<RebuiltSession> ended;
  Status built = Build(store, work, logger, report, ended);
  if (built.ok()) {
    if (before_swap) before_swap();
    auto kept = SwapIndex(store, work / "index.sqlite");
    if (kept.ok()) report.kept = *kept;
    built = kept.status();
  }
  held.reset();
  fs::remove_all(work, error);
  if (!built.ok()) {
    (void)ResumeIndex(store).ok();  // a damaged one cannot
    return built.WithContext("the old index stays as it was");
  }
  // As a recovery would: manifest and index say the same of how a session ended, and the next rebuild, too.
  for (const RebuiltSession& session : ended)
    if (const Status said = WriteEnding(store / "sessions" / session.info.id, session); !said.ok())
      report.problems.push_back(said.message());
  return report;
}

}  // namespace stratalux::db
