// SPDX-License-Identifier: Apache-2.0
// What a rebuilt session lacks: against its manifest, against the old index and against itself. Internal to db/care.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "db/care/session_rebuild.h"
#include "db/catalogue/manifest.h"
#include "shared/base/number_ranges.h"
#include "shared/capture/plan.h"

namespace stratalux::db {

struct LossWitnesses {
  std::optional<ManifestContents> manifest;  // of a session that was finished
  std::vector<KnownFrame> known;             // to the old index
  std::map<int64_t, int> steps;              // of frames that are lost, as far as the files tell
};

// Lines for people, without paths: "78 of 492 frames are missing: 414 to 491 (steps 300 to 371)", "segment
// frames-0001.seg is missing", "planned steps without a good frame: 5 to 6". Empty: the session is whole.
// `session.frames` are in order of their numbers, each once.
[[nodiscard]] std::vector<std::string> FindLoss(const RebuiltSession& session,
                                                const std::vector<std::string>& segments_there,
                                                const LossWitnesses& witnesses);

// The steps of the plan that are not among `good`, those with a frame that its level check did not refute.
[[nodiscard]] std::vector<NumberRange> LackingSteps(const CapturePlan& plan, const std::set<int>& good);

}  // namespace stratalux::db
