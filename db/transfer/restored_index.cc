// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/restored_index.h"

#include <set>
#include <string>
#include <vector>

#include "db/care/reindex.h"
#include "db/care/session_rebuild.h"
#include "db/catalogue/forgotten_rows.h"
#include "db/catalogue/ledger_follow.h"
#include "db/transfer/adopt.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Result<std::vector<VisitorSession>> SessionsOfIndex(Connection& connection) {
  std::vector<VisitorSession> sessions;
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT id, visitor FROM sessions ORDER BY number"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return sessions;
    sessions.push_back({select.Text(0), select.Text(1)});
  }
}

// A damaged list of the backup's files may lack a fit's record, without which it is none.
Status DropFitsWithoutRecord(Connection& connection, const fs::path& store, RestoreReport& report) {
  struct ListedFit {
    int64_t number = 0;
    std::string session, fit;
  };
  std::vector<ListedFit> gone;
  {
    SLX_ASSIGN_OR_RETURN(auto select,
                         connection.Prepare("SELECT sessions.number, sessions.id, fits.id FROM fits JOIN sessions ON"
                                            " sessions.number = fits.session"));
    while (true) {
      SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
      if (!more) break;
      ListedFit fit{select.Integer(0), select.Text(1), select.Text(2)};
      std::error_code error;
      if (!fs::exists(store / "sessions" / fit.session / "fits" / fit.fit / "fit.json", error))
        gone.push_back(std::move(fit));
    }
  }
  if (gone.empty()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_ASSIGN_OR_RETURN(auto figures, connection.Prepare("DELETE FROM metrics WHERE session = ?1 AND fit = ?2"));
  SLX_ASSIGN_OR_RETURN(auto row, connection.Prepare("DELETE FROM fits WHERE session = ?1 AND id = ?2"));
  for (const ListedFit& fit : gone) {
    SLX_RETURN_IF_ERROR(figures.Bind(1, fit.number).Bind(2, fit.fit).Run());
    SLX_RETURN_IF_ERROR(row.Bind(1, fit.number).Bind(2, fit.fit).Run());
    report.problems.push_back("fit " + fit.fit + " of session " + fit.session +
                              " was not restored: its fit.json is missing");
  }
  return transaction.Commit();
}

Status ListFolder(SessionIndex& index, const fs::path& folder, const std::string& from) {
  SLX_RETURN_IF_ERROR(CheckFolder(folder).status());
  SLX_ASSIGN_OR_RETURN(const RebuiltSession session, RebuildSession(folder));
  SLX_ASSIGN_OR_RETURN(auto taken, index.connection().Prepare("SELECT 1 FROM sessions WHERE number = ?1"));
  if (session.number) {
    SLX_ASSIGN_OR_RETURN(const bool is_taken, taken.Bind(1, *session.number).Step());
    if (!is_taken) return InsertRebuilt(index, session, session.number).status();
  }
  SLX_ASSIGN_OR_RETURN(const int64_t number, NextNumber(index));
  SLX_RETURN_IF_ERROR(WritePlace(folder, {number, from}));
  return InsertRebuilt(index, session, number).status();
}

// But what was forgotten, whatever its folder holds.
Status ListUnlisted(SessionIndex& index, const fs::path& store, const Ledger& ledger, const std::string& from,
                    RestoreReport& report) {
  SLX_ASSIGN_OR_RETURN(const auto sessions, SessionsOfIndex(index.connection()));
  std::set<std::string> listed;
  for (const VisitorSession& row : sessions) listed.insert(row.session);
  std::error_code error;
  std::set<fs::path> unlisted;
  for (const auto& entry : fs::directory_iterator(store / "sessions", error))
    if (const std::string id = entry.path().filename().string(); !listed.contains(id) && !ledger.IsForgotten(id))
      unlisted.insert(entry.path());
  for (const fs::path& folder : unlisted) {
    const Status added = ListFolder(index, folder, from);
    if (IsTroubleOfAll(added)) return added;
    if (!added.ok())
      report.problems.push_back("session " + folder.filename().string() + " is not listed: " + added.message());
  }
  return Status::Ok();
}

}  // namespace

Result<bool> ForgetRows(SessionIndex& index, const Ledger& ledger) {
  SLX_ASSIGN_OR_RETURN(auto forgotten, SessionsOfIndex(index.connection()));
  std::erase_if(forgotten, [&](const VisitorSession& row) { return !ledger.IsForgotten(row.session); });
  SLX_RETURN_IF_ERROR(RemoveForgottenRows(index, forgotten));
  SLX_ASSIGN_OR_RETURN(const bool visitors, RemoveForgottenVisitors(index, ledger.entries()));
  return visitors || !forgotten.empty();
}

Status PrepareIndex(const fs::path& store, const fs::path& work, const std::string& from, RestoreReport& report) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(work, AccessMode::kReadWrite));
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(const auto sessions, SessionsOfIndex(connection));
  bool any_forgotten = false;
  {
    SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
    SLX_ASSIGN_OR_RETURN(auto remove, connection.Prepare("DELETE FROM sessions WHERE id = ?1"));
    for (const VisitorSession& row : sessions) {
      std::error_code error;
      if (ledger.IsForgotten(row.session) || fs::exists(store / "sessions" / row.session, error)) continue;
      SLX_RETURN_IF_ERROR(remove.Bind(1, row.session).Run());
    }
    SLX_ASSIGN_OR_RETURN(any_forgotten, ForgetRows(index, ledger));
    SLX_RETURN_IF_ERROR(transaction.Commit());
  }
  if (any_forgotten) SLX_RETURN_IF_ERROR(connection.Execute("VACUUM"));
  SLX_RETURN_IF_ERROR(DropFitsWithoutRecord(connection, store, report));
  SLX_RETURN_IF_ERROR(ListUnlisted(index, store, ledger, from, report));
  return connection.Execute("PRAGMA journal_mode = WAL; PRAGMA wal_checkpoint(TRUNCATE)");
}

Status RebuildIndex(const fs::path& store, const Status& why, Logger& logger, RestoreReport& report) {
  SLX_ASSIGN_OR_RETURN(const ReindexReport built, Reindex(store, logger));
  report.notes.push_back("the index of the backup could not be used (" + why.message() +
                         "): it was built again from the folders; access log and jobs are in none of them");
  report.notes.insert(report.notes.end(), built.notes.begin(), built.notes.end());
  report.problems.insert(report.problems.end(), built.problems.begin(), built.problems.end());
  return Status::Ok();
}

}  // namespace stratalux::db
