// SPDX-License-Identifier: Apache-2.0
// What a rebuilt session lacks: against its manifest, against the old index and against itself. Internal to db/care.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "db/care/session_rebuild.h"
#include "db/catalogue/manifest.h"

namespace stratalux::db {

struct LossWitnesses {
  std::optional<ManifestContents> manifest;  // of a session that was finished
  std::vector<KnownFrame> known;             // to the old index
  std::map<int64_t, int> steps;              // of frames that are lost, as far as the files tell
};

// Lines for people, without paths: "78 of 492 frames are missing: 414 to 491 (steps 300 to 371)", "segment
// frames-0001.seg is missing", "step 5 (gray columns bit=3/10) has no good frame". Empty: the session is whole.
// `session.frames` are in order of their numbers, each once.
[[nodiscard]] std::vector<std::string> FindLoss(const RebuiltSession& session,
                                                const std::vector<std::string>& segments_there,
                                                const LossWitnesses& witnesses);

}  // namespace stratalux::db
