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
#include "db/ledger/ledger.h"
#include "db/segment/segment_scan.h"

namespace stratalux::db {

// Where a reindex keeps a manifest that it could not read and wrote anew.
inline constexpr const char* kDamagedManifest = "manifest.damaged.json";

struct RebuiltSession {
  SessionInfo info;
  std::optional<int64_t> number;  // its place in the order of the store, where the folder or the id tells it
  std::vector<std::pair<int64_t, SegmentFrame>> frames;  // segment number, frame; by frame
  std::vector<FitRow> fits;
  std::vector<std::string> notes;     // no damage: a record that its writer never finished, a number not known
  std::vector<std::string> problems;  // damage and contradictions, naming file and offset
  // What the session lacks (db/care/session_loss.h), without paths. Also among its reasons, and then it is not
  // complete.
  std::vector<std::string> loss;
  // Bytes of segments that belong to no listed frame. They stay where they are.
  struct Aside {
    std::filesystem::path file;
    int64_t begin = 0, end = 0;
    std::string what;
  };
  std::vector<Aside> asides;
  std::vector<std::string> segments;  // files that are there
  bool ended_here = false;            // its manifest says `recording`
  bool told_by_index = false;         // its manifest was lost; the old index knew what it said
};

// What an index that is there still knows of a session's frames.
struct KnownFrame {
  int64_t segment = 0;
  int step = 0;
  KnownPlace place;
};

// Reads all that is whole (ScanSegment), also behind damage, and where `known` says that a frame lies; listed is what
// can be read. A session still `recording` becomes `failed` with the reason, a `complete` one that lacks frames
// `degraded`. Writes nothing, no segment least of all. kIntegrity where the manifest is missing or damaged and the
// frames do not say enough, and what CheckSession (db/care/session_gate.h) refuses.
// `listed`: the row of the old index; asked where the manifest is lost, and the session is then not `complete`.
[[nodiscard]] Result<RebuiltSession> RebuildSession(const std::filesystem::path& session_folder,
                                                    const std::vector<KnownFrame>& known = {},
                                                    const std::optional<SessionInfo>& listed = {});

// A folder that was made before its session began, and is all there is of it: no manifest, no byte of a frame, and the
// ledger, which hears of a visitor's session before its first frame is acknowledged, says nothing of it.
[[nodiscard]] bool NeverBegan(const std::filesystem::path& session_folder, const Ledger& ledger);

// Rows of the session in one transaction: the visitor, its consent and the calibration as well. The number is `number`,
// else the next one.
Result<int64_t> InsertRebuilt(SessionIndex& index, const RebuiltSession& session, std::optional<int64_t> number);

// place.json: the number of a session that came from another store, where its id cannot tell it.
struct SessionPlace {
  int64_t number = 0;
  std::string from;
};
Status WritePlace(const std::filesystem::path& session_folder, const SessionPlace& place);
// The session's number in the store it lies in: of place.json, else of the id. None for a number that no store gives.
[[nodiscard]] std::optional<int64_t> PlaceOf(const std::filesystem::path& session_folder);
// s000017-0badcafe -> 17.
[[nodiscard]] std::optional<int64_t> NumberOfId(const std::string& session_id);

}  // namespace stratalux::db
