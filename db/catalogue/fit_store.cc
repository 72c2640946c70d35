// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/fit_store.h"

#include <cerrno>
#include <cstring>

#include <sys/stat.h>

#include "db/base/durable_file.h"
#include "db/base/retry.h"
#include "db/base/write_lock.h"
#include "db/catalogue/calibration_store.h"
#include "db/catalogue/consent_rows.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/job_store.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/session_index.h"
#include "db/ledger/ledger.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

bool IsName(const std::string& name) {
  return !name.empty() && name.front() != '.' && name.find('/') == std::string::npos;
}

fs::path FitsOf(const fs::path& store, const std::string& session) { return store / "sessions" / session / "fits"; }

Status Forgotten(const std::string& session) {
  return Status::NotFound("session " + session +
                          " was forgotten while it was being fitted; nothing of the fit is kept");
}

Status CheckConsent(Connection& connection, int64_t session) {
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection.Prepare("SELECT id, kind, consent_json FROM sessions WHERE number = ?1"));
  SLX_RETURN_IF_ERROR(select.Bind(1, session).Step().status());
  if (select.Text(1) != ToString(SessionKind::kVisitor)) return Status::Ok();
  const std::string what = "session " + select.Text(0) + " must not be fitted: ";
  const Consent consent = ConsentFromJson(select.Text(2));
  // A session of schema 1 knows the version of its text alone, which was one for fitting.
  if (!select.Text(2).empty() && !consent.fit) return Status::Usage(what + "its visitor's consent does not cover it");
  SLX_ASSIGN_OR_RETURN(const auto withdrawn, WithdrawnOn(connection, session));
  if (withdrawn) return Status::Usage(what + "its visitor's consent was withdrawn on " + ToIso8601(*withdrawn));
  return Status::Ok();
}

// The number of the session, where a fit of it may stand in the index.
Result<int64_t> CheckFit(SessionIndex& index, const fs::path& store, const std::string& session,
                         const RegisterOptions& options) {
  SLX_ASSIGN_OR_RETURN(const bool forgotten, IsForgotten(store, session));
  if (forgotten) return Forgotten(session);
  SLX_ASSIGN_OR_RETURN(const int64_t number, index.NumberOf(session));
  SLX_RETURN_IF_ERROR(CheckConsent(index.connection(), number));
  // What a pull brought may stand in the ledger alone.
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  if (const auto withdrawn = ledger.WithdrawnAt(session))
    return Status::Usage("session " + session + " must not be fitted: its visitor's consent was withdrawn on " +
                         ToIso8601(*withdrawn));
  if (options.job_token) SLX_RETURN_IF_ERROR(CheckLease(index.connection(), *options.job_token));
  return number;
}

// Whoever opens the index while a reindex builds the next one would write into a file that nobody reads again. One that
// was open before keeps the reindex from beginning.
Result<SessionIndex> OpenLasting(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(auto mode, index.connection().Prepare("PRAGMA journal_mode"));
  SLX_RETURN_IF_ERROR(mode.Step().status());
  if (mode.Text(0) != "wal" && WriteLock::IsHeld(store))
    return Status::Busy("the index of " + store.string() + " is being rebuilt; try again when that has finished");
  return index;
}

Result<bool> IsListed(const fs::path& store, const std::string& session, const std::string& fit) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT 1 FROM sessions s JOIN fits f ON f.session ="
                                                               " s.number WHERE s.id = ?1 AND f.id = ?2"));
  return select.Bind(1, session).Bind(2, fit).Step();
}

// What may not stand in the store goes, unless it is another one's: a listed fit, or the folder of a session that the
// index does not know yet.
Status AfterRefusal(const Status& status, const fs::path& store, const FitRow& fit) {
  const auto forgotten = IsForgotten(store, fit.session);
  bool goes = status.code() == StatusCode::kNotFound && forgotten.ok() && *forgotten;
  if (status.code() == StatusCode::kUsage) {
    const auto listed = IsListed(store, fit.session, fit.id);
    goes = listed.ok() && !*listed;
  }
  if (!goes) return status;
  const Status discarded = DiscardFit(store, fit.session, FitsOf(store, fit.session) / fit.id);
  return discarded.ok() || discarded.code() == StatusCode::kNotFound
             ? status
             : Status(status.code(), status.message() + "; " + discarded.message());
}

// Question and row in one transaction; `fit.json` in it, so that only the holder of a job writes it.
Status Enter(const fs::path& store, const FitRow& fit, const std::string& record, const RegisterOptions& options) {
  const auto attempt = [&]() -> Status {
    SLX_ASSIGN_OR_RETURN(auto index, OpenLasting(store));
    SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(index.connection()));
    SLX_ASSIGN_OR_RETURN(const int64_t number, CheckFit(index, store, fit.session, options));
    if (!record.empty()) SLX_RETURN_IF_ERROR(ReplaceFile(FitsOf(store, fit.session) / fit.id / kFitRecordFile, record));
    SLX_RETURN_IF_ERROR(index.UpsertFit(number, fit));
    return transaction.Commit();
  };
  return AfterRefusal(RetryWhileBusy(options.patience, attempt), store, fit);
}

// One level: a session's folder that is gone stays gone.
Status MakeOneFolder(const fs::path& folder) {
  if (mkdir(folder.c_str(), 0777) != 0 && errno != EEXIST)
    return Status::Failed("cannot create " + folder.string() + ": " + std::strerror(errno));
  return Status::Ok();
}

// Where making or writing a folder failed because the session's is gone, that is what to say.
Status OrForgotten(const Status& status, const fs::path& store, const std::string& session) {
  const auto forgotten = IsForgotten(store, session);
  return !status.ok() && forgotten.ok() && *forgotten ? Forgotten(session) : status;
}

Result<int64_t> FirstCheck(const fs::path& store, const std::string& session, const RegisterOptions& options) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  return CheckFit(index, store, session, options);
}

Status SyncFit(const fs::path& folder) {
  SLX_RETURN_IF_ERROR(SyncTree(folder));
  SLX_RETURN_IF_ERROR(SyncFolder(folder.parent_path()));
  return SyncFolder(folder.parent_path().parent_path());
}

// `from` takes the place of an unlisted, unfinished `to`.
Status MoveInto(const fs::path& from, const fs::path& to) {
  std::error_code error;
  SLX_RETURN_IF_ERROR(SyncTree(from));
  SLX_RETURN_IF_ERROR(MakeOneFolder(to.parent_path()));
  if (fs::exists(fs::symlink_status(to, error))) {
    const fs::path aside = to.string() + ".replaced.partial";
    fs::remove_all(aside, error);
    fs::rename(to, aside, error);
    if (error) return Status::Failed("cannot move " + to.string() + " aside: " + error.message());
    fs::remove_all(aside, error);
  }
  fs::rename(from, to, error);
  if (error) return Status::Failed("cannot move " + from.string() + " to " + to.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncFolder(from.parent_path()));
  return SyncFit(to);
}

}  // namespace

Result<FitRow> ReadProvenFit(const fs::path& folder, const std::string& session) {
  std::error_code error;
  if (!fs::exists(folder / kFitRecordFile, error))
    return Status::Integrity(folder.string() + " has no " + kFitRecordFile + ": it is not a complete fit");
  SLX_RETURN_IF_ERROR(CheckFitFiles(folder));
  SLX_ASSIGN_OR_RETURN(FitRow fit, ReadFitRecord(folder, session));
  SLX_ASSIGN_OR_RETURN(const auto calibration, ReadFitCalibration(folder));
  fit.calibration_json = calibration.value_or("");
  return fit;
}

Status RegisterFit(const fs::path& store, FitRow fit, const RegisterOptions& options) {
  if (!IsName(fit.id) || !IsName(fit.session))
    return Status::Usage("'" + fit.id + "' of session '" + fit.session + "' is not the name of a fit");
  const fs::path folder = FitsOf(store, fit.session) / fit.id;
  const Status allowed = FirstCheck(store, fit.session, options).status();
  if (!allowed.ok() && allowed.code() != StatusCode::kBusy) return AfterRefusal(allowed, store, fit);
  // Its files first: a fit that is listed is whole.
  const auto prepare = [&]() -> Result<std::string> {
    SLX_RETURN_IF_ERROR(MakeOneFolder(folder.parent_path()));
    SLX_RETURN_IF_ERROR(MakeOneFolder(folder));
    SLX_ASSIGN_OR_RETURN(const auto calibration, ReadFitCalibration(folder));
    fit.calibration_json = calibration.value_or("");
    SLX_ASSIGN_OR_RETURN(std::string record, FitRecordOf(folder, fit));
    SLX_RETURN_IF_ERROR(SyncFit(folder));
    return record;
  };
  const auto record = prepare();
  if (!record.ok()) return OrForgotten(record.status(), store, fit.session);
  const Status entered = Enter(store, fit, *record, options);
  return entered.code() == StatusCode::kFailed ? OrForgotten(entered, store, fit.session) : entered;
}

Result<bool> AdoptFit(const fs::path& store, const std::string& session, const fs::path& fit_folder,
                      const RegisterOptions& options) {
  const std::string id = fit_folder.filename().string();
  if (!IsName(id) || !IsName(session) || fit_folder.extension() == ".partial")
    return Status::Usage("'" + id + "' of session '" + session + "' is not the name of a fit");
  SLX_RETURN_IF_ERROR(FirstCheck(store, session, options).status());
  SLX_ASSIGN_OR_RETURN(const bool listed, IsListed(store, session, id));
  const fs::path place = FitsOf(store, session) / id;
  std::error_code error;
  const bool recorded = fs::exists(place / kFitRecordFile, error);
  if (listed && recorded) return false;
  if (recorded) {
    // Moved by an adoption, or written by a registration, that ended before its row.
    if (const auto fit = ReadProvenFit(place, session); fit.ok()) {
      SLX_RETURN_IF_ERROR(SyncFit(place));
      SLX_RETURN_IF_ERROR(Enter(store, *fit, "", options));
      return true;
    }
  }
  if (!fs::is_directory(fs::symlink_status(fit_folder, error)))
    return Status::NotFound("no fit in " + fit_folder.string());
  SLX_ASSIGN_OR_RETURN(const FitRow fit, ReadProvenFit(fit_folder, session));
  SLX_RETURN_IF_ERROR(OrForgotten(MoveInto(fit_folder, place), store, session));
  SLX_RETURN_IF_ERROR(Enter(store, fit, "", options));
  return true;
}

Status DiscardFit(const fs::path& store, const std::string& session, const fs::path& fit_folder) {
  const fs::path fits = FitsOf(store, session);
  if (!IsName(session) || !IsName(fit_folder.filename().string()) || fit_folder.parent_path() != fits)
    return Status::Usage(fit_folder.string() + " is not the folder of a fit of session " + session);
  std::error_code error;
  fs::remove_all(fit_folder, error);
  if (error) return Status::Failed("cannot delete " + fit_folder.string() + ": " + error.message());
  SLX_ASSIGN_OR_RETURN(const bool forgotten, IsForgotten(store, session));
  if (!forgotten) return fs::exists(fits, error) ? SyncFolder(fits) : Status::Ok();
  // Empty ones alone: what the forgetting itself has yet to remove is its own.
  fs::remove(fits, error);
  fs::remove(fits.parent_path(), error);
  SLX_RETURN_IF_ERROR(SyncFolder(store / "sessions"));
  return Forgotten(session);
}

}  // namespace stratalux::db
