// SPDX-License-Identifier: Apache-2.0
// The rows of the index: opening and migrating it, and one function a question. Internal to db/.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/segment.h"
#include "db/session_store.h"
#include "db/sqlite.h"

namespace stratalux::db {

[[nodiscard]] std::string SegmentName(int64_t number);  // frames-0001.seg

class SessionIndex {
 public:
  static Status Create(const std::filesystem::path& folder);
  static Result<SessionIndex> Open(const std::filesystem::path& folder, AccessMode mode);

  // Gives info.id; returns the session's number.
  Result<int64_t> InsertSession(SessionInfo& info);
  struct Ending {
    SessionStatus status = SessionStatus::kFailed;
    std::vector<std::string> reasons;
    WallNs finished_wall;
  };
  Status SetStatus(int64_t number, const Ending& ending);
  // Frames, proofs and totals in one transaction: the group's commit.
  Status InsertFrames(int64_t number, const std::vector<std::pair<int64_t, SegmentFrame>>& frames);
  // Gives frames that are there already another place, size and hash, in one transaction.
  Status MoveFrames(int64_t number, const std::vector<std::pair<int64_t, SegmentFrame>>& frames);
  Result<std::vector<SessionRow>> Sessions();
  Result<int64_t> NumberOf(const std::string& id);
  struct Place {
    int64_t frame, segment, offset, bytes;
    std::vector<uint8_t> hash;
  };
  Result<std::vector<Place>> Places(int64_t number);
  Status UpsertFit(int64_t number, const FitRow& fit);
  Result<std::vector<FitRow>> Fits(int64_t number, const std::string& session);

 private:
  explicit SessionIndex(Connection connection) : connection_(std::move(connection)) {}
  static Status Migrate(Connection& connection, const std::filesystem::path& folder);
  Connection connection_;
};

}  // namespace stratalux::db
