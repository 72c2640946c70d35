// SPDX-License-Identifier: Apache-2.0
// What shards made becomes the store's: held against every hash of manifest and records, copied, entered. Here alone,
// where the store lies on this machine's own disk, is its index written.
//
// Merged again, while shards are still at work, or after one was run twice, only what is new comes. Who was forgotten
// or withdrew meanwhile is not entered, and what was made of them goes. The night's log tells of it as of any night.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "fitter/batch/shard_manifest.h"
#include "fitter/batch/shard_plan.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct MergeOutcome {
  std::string night;                  // its name in STORE/nights
  int entered = 0;                    // now
  int present = 0;                    // before
  int dropped = 0;                    // forgotten, or the consent is gone
  std::vector<NightEvent> failed;     // in the workers' words
  std::vector<std::string> missing;   // sessions of which no shard has said anything that could be merged
  std::vector<std::string> problems;  // files that are not what a manifest or a record says
  std::vector<std::string> unread;    // of these: files that are there and could not be read
};

// kClose: the folder is removed afterwards, with what closes that were killed have left beside it; who is missing is
// planned anew with the next night. Its shards are over. A link to it goes with it, one that a killed close has left,
// too. kFailed, and it stays, where something of it could not be read (MergeOutcome::unread): it may hold fits.
enum class MergeMode { kKeep, kClose };

// kBusy while another merge of these results runs. What is wrong with one visitor is a problem, and the others go on.
[[nodiscard]] Result<MergeOutcome> MergeShards(const std::filesystem::path& store, const std::filesystem::path& results,
                                               MergeMode mode, Logger& logger);

}  // namespace stratalux::fit
