// SPDX-License-Identifier: Apache-2.0
// Keys of a shard's encrypted visitors for a task that nobody can hand a pipe, because an engine starts it hours after
// it was submitted. The task makes a key pair in its memory and asks by the public half, in RESULTS/keys; whoever holds
// the reader's key answers with the keys of that share, sealed to it. What lies in the folder opens for the asking
// process alone, and for nobody once that has ended (docs/file-formats.md, "Shards").
//
// Who may write to RESULTS may ask: that is why it is as private as the store, and why an ask must be the file of the
// answering user.
#pragma once

#include <chrono>
#include <filesystem>
#include <string>
#include <vector>

#include "db/keys/key_store.h"
#include "fitter/batch/shard_plan.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// How long a task waits where nothing else is said.
inline constexpr double kAskMinutes = 10.0;

// Asks and waits, looking `every` so often; in the end removes the ask and its answer. Each key that the answer lacks,
// or that does not open, is a warning. kNotFound: nobody answered within `wait`; kTryAgain: `stop` became readable;
// kIntegrity: an answer for another share.
[[nodiscard]] Result<std::vector<db::SessionKey>> AskForKeys(const std::filesystem::path& results,
                                                             const ShardPlan& plan, const Shard& shard,
                                                             std::chrono::milliseconds wait,
                                                             std::chrono::milliseconds every, int stop, Logger& logger);

struct KeyAnswers {
  int answered = 0;                   // asks, also of who ended meanwhile
  size_t keys = 0;                    // that went with them; each is logged before
  std::vector<std::string> problems;  // a line each: asks that are refused, keys that are not here
};
// One look: every ask that has no answer yet gets it. What goes wrong with one is a problem, and the next look tries
// again; an ask that goes meanwhile leaves nothing.
[[nodiscard]] KeyAnswers AnswerAsks(const std::filesystem::path& store, const std::filesystem::path& results,
                                    const ShardPlan& plan);

}  // namespace stratalux::fit
