// SPDX-License-Identifier: Apache-2.0
// One machine's share of a planned night: a night (fitter/batch/night.h) in a store of its own on this machine's disk,
// made of the sealed sessions, that leaves what was made and a manifest in a folder which all machines see.
//
// Run again it goes on: who is done is not fitted again, nor are stages that were finished. Run twice at once, the
// second steps back.
#pragma once

#include <filesystem>
#include <functional>

#include "fitter/batch/night.h"
#include "fitter/batch/shard_manifest.h"
#include "fitter/batch/shard_plan.h"

namespace stratalux::fit {

struct ShardOptions {
  // choice.run: what the plan's arguments say; its store is that of the sealed sessions.
  NightOptions night;
  std::filesystem::path results, scratch;
  Shard shard;
};

struct ShardOutcome {
  std::filesystem::path manifest;
  int fitted = 0, failed = 0, dropped = 0;  // of the shard's visitors, by this run or one before
  int waiting = 0;                          // not begun, or given back
};

// `heard`: each event of this run. kUsage where this machine or program makes other fits than the plan names;
// kTryAgain while another process works on the same shard; kNewerSchema, kFailed where its manifest cannot be read
// here.
[[nodiscard]] Result<ShardOutcome> RunShard(const ShardOptions& options, const ShardPlan& plan, int stop,
                                            const std::function<void(const NightEvent&)>& heard, Logger& logger);

}  // namespace stratalux::fit
