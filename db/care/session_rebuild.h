// SPDX-License-Identifier: Apache-2.0
// A session's rows out of its folder alone: manifest, segments, fits. What `reindex`, `pull` and `restore` insert.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "db/catalogue/session_index.h"
#include "db/catalogue/session_store.h"
#include "db/segment/segment.h"

namespace stratalux::db {

struct RebuiltSession {
  SessionInfo info;
  std::optional<int64_t> number;  // its place in the order of the store, where the folder or the id tells it
  std::vector<std::pair<int64_t, SegmentFrame>> frames;  // segment number, frame; by frame
  std::vector<FitRow> fits;
  std::vector<std::string> notes;  // what was damaged or cut off, for people
  struct Tail {
    std::filesystem::path file;
    int64_t keep = 0;  // bytes up to the last whole frame
  };
  std::vector<Tail> tails;  // of segments without a footer, where bytes lie behind the last whole frame
};

// Sealed segments by their footer alone; others are walked, every payload hashed, up to the last whole frame. A damaged
// footer: walked as well. A session still `recording` becomes `failed` with the reason. kIntegrity where the manifest
// is missing or damaged and the frames do not say enough; writes nothing.
[[nodiscard]] Result<RebuiltSession> RebuildSession(const std::filesystem::path& session_folder);

// Rows of the session in one transaction: the visitor, its consent and the calibration as well. The number is `number`,
// else the next one.
Result<int64_t> InsertRebuilt(SessionIndex& index, const RebuiltSession& session, std::optional<int64_t> number);

// place.json: the number of a session that came from another store, where its id cannot tell it.
struct SessionPlace {
  int64_t number = 0;
  std::string from;
};
Status WritePlace(const std::filesystem::path& session_folder, const SessionPlace& place);
// The session's number in the store it lies in: of place.json, else of the id.
[[nodiscard]] std::optional<int64_t> PlaceOf(const std::filesystem::path& session_folder);
// s000017-0badcafe -> 17.
[[nodiscard]] std::optional<int64_t> NumberOfId(const std::string& session_id);

}  // namespace stratalux::db
