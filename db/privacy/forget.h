// SPDX-License-Identifier: Apache-2.0
// Removes sessions from a store so that nothing of them is left in it, and proves it.
//
// In this order: an intent that outlives a power cut and an entry in the ledger (from here on the session cannot come
// back), the key with its sealed copies, logged exports on this machine, the session's folder, what a broken-off
// transfer left of it in incoming/ and the fitter's nights say of it, the rows, the visitor's key with the last
// session. So far under the store's write lock, within a second: captures start again. Then the folder's files are
// deleted: nothing of the session can be read any more, and how long that took does not depend on the other sessions of
// the store (BeginForget). Beside captures again, a scan of every file of the store for what would give the session
// away, and the certificate into the ledger (ForgetProof). Broken off anywhere, the next call finishes it.
//
// The rows go without VACUUM, which would rewrite the whole index: SQLite zeroes deleted cells and freed pages
// (secure_delete), and the log is cut to nothing. What a page may keep of a row that it once moved elsewhere, the scan
// finds; then, and only then, VACUUM runs, under the lock, and the index is scanned again.
//
// The scan looks for: the session's id, its key id, the first 8 bytes of each payload hash (not of frames that a
// remaining session shares, such as black ones without noise), and the pseudonym once no session of the visitor is
// left.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "db/privacy/export_marker.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::db {

enum class ForgetReason { kForget, kPurge };
[[nodiscard]] const char* ToString(ForgetReason reason);

enum class ForgetStep {
  kIntent,   // written; the session is not yet forgotten
  kEntered,  // in the ledger: from here on it is, and so is a visitor of whom nothing is left
  kKey,
  kExport,
  kSetAside,  // out of sessions/
  kIncoming,
  kVisitorKey,
  kRows,
  kCompacted,
  kUnlocked,  // captures start again
  kFile,      // deleted
  kRemoved,   // the end of the first half
  kScanned,
  kEntry,      // certificates stand in the ledger
  kCertified,  // and in the index
  kDone
};

struct ForgetRequest {
  std::vector<std::string> sessions;  // ids
  std::vector<std::string>
      visitors;  // removed with their consents, also without a session; their sessions must be listed
  ForgetReason reason = ForgetReason::kForget;
  // May be empty; kIntent, kEntered, kKey .. kSetAside, kVisitorKey, kFile, kEntry, kCertified come once for each
  // session, key, export, file, visitor.
  std::function<void(ForgetStep)> after_step;
  std::vector<std::string> leftovers = {};  // ids that incoming/ alone knows: wiped there, with no entry in the ledger
};

struct ForgottenExport {
  std::string place;  // host:/folder
  ExportState state = ExportState::kElsewhere;
};

struct ForgottenSession {
  std::string id;
  int64_t frames = 0, fits = 0;
  int64_t files = 0, bytes = 0;  // of its folder
  bool encrypted = false;
  bool visitor_removed = false;
  std::vector<ForgottenExport> exports;
};

struct ForgetReport {
  std::vector<ForgottenSession> sessions;
  std::vector<std::string> incoming;  // folders below incoming/, relative to the store
  int64_t markers = 0, scanned_files = 0, scanned_bytes = 0;
  // File, offset and what was found, and exports that could not be deleted: to be removed by hand, then forgotten
  // again.
  std::vector<std::string> leftovers;
};

// What Forget would do; changes no byte. The state of an export on this machine is kDeleted where it would be.
[[nodiscard]] Result<ForgetReport> PlanForget(const std::filesystem::path& store, const ForgetRequest& request);
// The part of such a plan that is of one export; `place` is host:/folder.
[[nodiscard]] ForgottenExport PlanExport(const std::string& place, const std::string& session_id);
// Session id -> the places it was exported to, as the access log has them; of sessions that are here and that are gone.
[[nodiscard]] Result<std::map<std::string, std::vector<std::string>>> LoggedExports(const std::filesystem::path& store);

// The second half of a forgetting: search and certificate, in this order: Search, RewriteIndex where it is needed,
// Certify. One that goes before, as its program ends, leaves what the next BeginForget takes up. Used by one thread.
class ForgetProof {
 public:
  struct Removed;  // db/privacy/forget_proof.h
  explicit ForgetProof(std::unique_ptr<Removed> removed);
  ForgetProof(ForgetProof&&) noexcept;
  ForgetProof& operator=(ForgetProof&&) noexcept;
  ~ForgetProof();

  // Before its search: one that was begun before it and waits is done by this one, too. (What the later one took up of
  // it by itself counts once.)
  void Include(ForgetProof earlier);
  // Reads every file of the store, which takes its time, and holds no lock of it meanwhile. What another proof has
  // certified by now is left out. `goes_on`, asked for each MiB, may end it: kTryAgain.
  Status Search(Logger& logger, const std::function<bool()>& goes_on = {});
  // Whether a page of the index still holds what it once moved elsewhere.
  [[nodiscard]] bool NeedsIndexRewritten() const;
  // Under the store's write lock, seconds for a large index; and searches it again. kBusy while a session is written.
  // `goes_on`, asked all along, may end it: kTryAgain, and the index is as it was.
  Status RewriteIndex(const std::function<bool()>& goes_on = {});
  // What was not clean stays begun: the next BeginForget takes it up.
  Result<ForgetReport> Certify();

 private:
  std::unique_ptr<Removed> removed_;
};

// The first half. Also takes up what an earlier call began. kBusy as of Forget.
[[nodiscard]] Result<ForgetProof> BeginForget(const std::filesystem::path& store, const ForgetRequest& request);

// Both halves. Also finishes what an earlier call began. kBusy while a session is written (call again when it is
// finished) or another program reads the index (then the files are gone already; call again). Leftovers are no error:
// they stand in the report and in the certificate, and the next call looks again.
[[nodiscard]] Result<ForgetReport> Forget(const std::filesystem::path& store, const ForgetRequest& request,
                                          Logger& logger);

// Does a forgotten session lie in the store again, put back by hand or left by a transfer? Forget removes it then.
[[nodiscard]] Result<bool> HasReturned(const std::filesystem::path& store, const std::string& session_id);

// Sessions whose forgetting was begun and not finished.
[[nodiscard]] Result<std::vector<std::string>> UnfinishedForgets(const std::filesystem::path& store);

}  // namespace stratalux::db
