// SPDX-License-Identifier: Apache-2.0
#include <set>
#include <system_error>

#include "db/care/incoming.h"
#include "db/care/row_comparison.h"
#include "db/care/session_rebuild.h"
#include "db/care/verify.h"
#include "db/catalogue/calibration_store.h"
#include "db/catalogue/ledger_follow.h"
#include "db/catalogue/session_index.h"
#include "db/keys/readers.h"
#include "db/ledger/ledger.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Status CheckDatabase(const SessionStore& store, VerifyDepth depth, VerifyReport& report) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store.folder(), AccessMode::kReadOnly));
  Connection& connection = index.connection();
  const std::string file = (store.folder() / "index.sqlite").string();
  const char* pragma = depth == VerifyDepth::kDeep ? "PRAGMA integrity_check" : "PRAGMA quick_check";
  for (const char* question : {pragma, "PRAGMA foreign_key_check"}) {
    SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare(question));
    while (true) {
      const auto more = select.Step();
      if (!more.ok()) {  // damage that stops even the check
        report.problems.push_back(more.status().message());
        break;
      }
      if (!*more) break;
      if (select.Text(0) != "ok") report.problems.push_back(file + ": " + question + ": " + select.Text(0));
    }
  }
  return Status::Ok();
}

// The ledger as a file, and that the index says of withdrawals and forgettings what it says.
Status CheckLedger(const SessionStore& store, const Ledger& ledger, VerifyReport& report) {
  report.problems.insert(report.problems.end(), ledger.problems().begin(), ledger.problems().end());
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store.folder(), AccessMode::kReadOnly));
  Connection& connection = index.connection();
  const std::string folder = (store.folder() / "ledger").string();
  SLX_ASSIGN_OR_RETURN(auto heads, connection.Prepare("SELECT chain, bytes FROM ledger_heads WHERE chain <> ''"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, heads.Step());
    if (!more) break;
    std::error_code error;
    const auto size = fs::file_size(folder + "/" + heads.Text(0), error);
    if (error || static_cast<int64_t>(size) < heads.Integer(1))
      report.problems.push_back(folder + "/" + heads.Text(0) + " was " + std::to_string(heads.Integer(1)) +
                                " bytes long and " + (error ? "is gone" : "is " + std::to_string(size) + " now") +
                                ": restore it from a backup (`stratalux-db restore --merge`)");
  }
  SLX_ASSIGN_OR_RETURN(const bool follows, FollowsLedger(index, store.folder()));
  if (!follows) return Status::Ok();  // the next opening for writing tells the index
  SLX_ASSIGN_OR_RETURN(auto holding,
                       connection.Prepare("SELECT 1 FROM consents c JOIN sessions s ON s.visitor = c.visitor"
                                          " WHERE s.id = ?1 AND s.visitor <> '' AND c.withdrawn_wall_ns IS"
                                          " NULL AND c.given_wall_ns <= ?2"));
  for (const auto& [session, at] : ledger.withdrawn()) {
    SLX_ASSIGN_OR_RETURN(const bool holds, holding.Bind(1, session).Bind(2, at.ns).Step());
    if (holds)
      report.problems.push_back("session " + session +
                                ": its visitor has withdrawn consent, which the index does not"
                                " know: `stratalux-db reindex`");
    holding.Reset();
  }
  SLX_ASSIGN_OR_RETURN(const auto held, HoldingThoughWithdrawn(index, ledger));
  for (const WallNs given : held)
    report.problems.push_back("a consent of " + ToIso8601(given) +
                              " is withdrawn, which the index does not know: `stratalux-db reindex`; or, where several"
                              " visitors gave theirs at that very moment, `stratalux-db consent withdraw`");
  return Status::Ok();
}

bool IsOurs(const std::string& name) {
  static const std::set<std::string> kNames = {
      "index.sqlite", "index.sqlite-wal", "index.sqlite-shm", "write.lock",      "sessions",       "deletions",
      "ledger",       "keys.sqlite",      "keys.sqlite-wal",  "keys.sqlite-shm", "incoming",       "incoming.lock",
      "reindex.new",  "lost+found",       "backup.json",      "rig.key",         "transcode.json", "forgetting",
      "visits",       "nights",           kReadersFolder};
  return kNames.contains(name) || name.starts_with("index-before-") || name.ends_with(".toml");
}

void CheckFolders(const SessionStore& store, const std::set<std::string>& known, const Ledger& ledger,
                  VerifyReport& report) {
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(store.folder(), error))
    if (!IsOurs(entry.path().filename().string()))
      report.notes.push_back(entry.path().string() + " is not a file of a store");
  for (const auto& entry : fs::directory_iterator(ForgettingFolder(store.folder()), error))
    report.problems.push_back(
        entry.path().string() +
        " belongs to a session whose forgetting was interrupted or is still running: `stratalux-db forget"
        " --resume`");
  for (const auto& entry : fs::directory_iterator(store.folder() / "sessions", error)) {
    const std::string id = entry.path().filename().string();
    if (ledger.IsForgotten(id)) {
      report.problems.push_back(entry.path().string() +
                                " belongs to a session that was forgotten; `stratalux-db forget " + id + "` again");
    } else if (!known.contains(id) && NeverBegan(entry.path(), ledger)) {
      report.notes.push_back(entry.path().string() + " has no manifest and no frame: a session that never began");
    } else if (!known.contains(id)) {
      report.problems.push_back(entry.path().string() +
                                " is not in the index: `stratalux-db reindex` lists it, if it is a session");
    }
  }
}

// What a pull or restore that was broken off left. While one runs, it is at work there.
void CheckIncoming(const SessionStore& store, const Ledger& ledger, VerifyReport& report) {
  const bool at_work = IncomingLock::IsHeld(store.folder());
  for (const IncomingSession& session : ListIncoming(store.folder()))
    for (const fs::path& place : session.places) {
      if (ledger.IsForgotten(session.id)) {
        report.problems.push_back(place.string() + " belongs to a session that was forgotten; `stratalux-db forget " +
                                  session.id + "` again, or the next pull, wipes it");
      } else if (!at_work) {
        report.notes.push_back(place.string() +
                               " was left by an interrupted pull or restore: the next one continues or wipes it,"
                               " and `stratalux-db purge` once it is due");
      }
    }
}

}  // namespace

Result<VerifyReport> VerifyStore(const SessionStore& store, const VerifyOptions& options) {
  VerifyReport report;
  SLX_RETURN_IF_ERROR(CheckDatabase(store, options.depth, report));
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store.folder()));
  SLX_RETURN_IF_ERROR(CheckLedger(store, ledger, report));
  SLX_ASSIGN_OR_RETURN(const auto sessions, store.ListSessions());
  std::set<std::string> known;
  for (const SessionSummary& row : sessions) {
    known.insert(row.info.id);
    if (ledger.IsForgotten(row.info.id))
      report.problems.push_back("session " + row.info.id + " was forgotten, but the index lists it");
  }
  CheckFolders(store, known, ledger, report);
  CheckIncoming(store, ledger, report);
  if (const auto readers = ListReaders(store.folder()); !readers.ok())
    report.problems.push_back(readers.status().message());
  SLX_ASSIGN_OR_RETURN(const auto rows, CompareStore(store.folder()));
  report.problems.insert(report.problems.end(), rows.begin(), rows.end());
  SLX_ASSIGN_OR_RETURN(const auto calibrations, CheckCalibrations(store.folder()));
  report.problems.insert(report.problems.end(), calibrations.begin(), calibrations.end());
  return report;
}

}  // namespace stratalux::db
