// SPDX-License-Identifier: Apache-2.0
// The rows of the index: opening and migrating it, and one function a question. Internal to db/.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "db/base/sqlite.h"
#include "db/catalogue/session_store.h"
#include "db/segment/segment.h"

namespace stratalux::db {

[[nodiscard]] std::string SegmentName(int64_t number);  // frames-0001.seg

class SessionIndex {
 public:
  // An existing index is left as it is (kOk).
  static Status Create(const std::filesystem::path& folder);
  // Create(), but kIntegrity where sessions lie without their index: an empty one would hide them.
  static Status CreateNew(const std::filesystem::path& folder);
  static Result<SessionIndex> Open(const std::filesystem::path& folder, AccessMode mode);
  // An empty one of the newest schema that no file holds: for rows to be compared with.
  static Result<SessionIndex> InMemory();
  // Of that one the empty tables of SessionTables() (db/care/row_comparison.h) alone, made in a tenth of the time.
  static Result<SessionIndex> TablesInMemory();

  // Gives info.id where it is empty; returns the session's number: `known_number`, else the next one.
  Result<int64_t> InsertSession(SessionInfo& info, std::optional<int64_t> known_number = {});
  struct Ending {
    SessionStatus status = SessionStatus::kFailed;
    std::vector<std::string> reasons;
    WallNs finished_wall;
    CaptureFindings found;
  };
  // With the ending the frames that it withdraws fail (WithdrawFrames), in one transaction.
  Status SetStatus(int64_t number, const Ending& ending);
  // `level_check` of frames of steps that the findings withdraw (shared/capture/finding.h) becomes `failed`; their
  // segments keep what was said of them when they were stored.
  Status WithdrawFrames(int64_t number, const std::vector<Finding>& findings);
  // Frames, proofs and totals in one transaction: the group's commit.
  Status InsertFrames(int64_t number, const std::vector<std::pair<int64_t, SegmentFrame>>& frames);
  // Gives frames that are there already another place, size and hash, in one transaction.
  Status MoveFrames(int64_t number, const std::vector<std::pair<int64_t, SegmentFrame>>& frames);
  // Newest first; the second: of one visitor.
  Result<std::vector<SessionSummary>> Sessions();
  Result<std::vector<SessionSummary>> SessionsOf(const std::string& visitor);
  // Whole rows: of one session; of the sessions that are recorded, newest first.
  Result<SessionRow> Session(int64_t number);
  Result<std::vector<SessionRow>> Recording();
  Result<bool> HasUnfinished();
  // Numbers of the sessions that `selector` (SessionStore::FindSession) may mean: three at most, none where none does.
  Result<std::vector<int64_t>> Select(const std::string& selector);
  Result<int64_t> NumberOf(const std::string& id);
  struct Place {
    int64_t frame, segment, offset, bytes;
    std::vector<uint8_t> hash;
    bool failed = false;  // when it was stored, or withdrawn since
  };
  Result<std::vector<Place>> Places(int64_t number);
  // The row, and its figures in `metrics`.
  Status UpsertFit(int64_t number, const FitRow& fit);
  Result<std::vector<FitRow>> Fits(int64_t number, const std::string& session);
  Result<bool> IsEncrypted(const std::string& id);
  Status SetKeyId(int64_t number, std::span<const uint8_t> key_id);
  // For statements of one purpose (rebuilding, checking, forgetting).
  [[nodiscard]] Connection& connection() { return connection_; }

 private:
  explicit SessionIndex(Connection connection) : connection_(std::move(connection)) {}
  static Status Migrate(Connection& connection, const std::filesystem::path& folder);
  static Status MigrateOnce(Connection& connection, const std::filesystem::path& folder);
  // The newest schema without a row, in place of an empty database.
  static Status FillWithSchema(Connection& connection);
  Connection connection_;
};

[[nodiscard]] SessionIndex::Ending EndingOf(const SessionInfo& info);

}  // namespace stratalux::db
