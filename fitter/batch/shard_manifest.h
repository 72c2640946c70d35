// SPDX-License-Identifier: Apache-2.0
// What a shard made, RESULTS/shard-<i>-of-<N>.json: of each visitor how it ended, in the worker's words, and the hash
// of every record of what was made, which names size and hash of each file. With a hash of its own: half a manifest is
// none. Written anew after each visitor, so that a shard that is killed has said what it finished.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "fitter/batch/night_log.h"
#include "fitter/batch/shard_plan.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// A folder of RESULTS/sessions/<id>.
struct MadeFolder {
  std::string place;        // artifacts/<stage>-<key>, fits/<fit>
  std::string record_hash;  // XXH3-128 of its artifact.json or fit.json, 32 hex digits
};

struct ShardVisit {
  NightEvent end;                // kDone, kFailed, kSetAside, kDropped
  std::vector<MadeFolder> made;  // kDone
};

struct ShardManifest {
  std::string plan;  // its id
  Shard shard;
  std::vector<ShardVisit> visits;  // who ended
  [[nodiscard]] const ShardVisit* Find(const std::string& session) const;
  // In the place of what was said of that session before.
  void Say(ShardVisit visit);
};

[[nodiscard]] std::filesystem::path ManifestFile(const std::filesystem::path& results, const Shard& shard);
// Those that are there, by name; of a folder that is not there none. kFailed where it cannot be listed.
[[nodiscard]] Result<std::vector<std::filesystem::path>> ManifestFiles(const std::filesystem::path& results);
Status WriteManifest(const std::filesystem::path& results, const ShardManifest& manifest);
// kNotFound; kIntegrity for half a file or a damaged one, and for one of another plan; kNewerSchema.
[[nodiscard]] Result<ShardManifest> ReadManifest(const std::filesystem::path& file, const ShardPlan& plan);

// Where a shard's workers make what is of one session. Merged: its fit is in the store, and what was made is gone.
[[nodiscard]] std::filesystem::path ResultsOf(const std::filesystem::path& results, const std::string& session);
[[nodiscard]] bool IsMerged(const std::filesystem::path& results, const std::string& session);
// Removed, and marked as merged.
Status MarkMerged(const std::filesystem::path& results, const std::string& session);
// All of it: of somebody who may not be fitted any more.
Status RemoveResults(const std::filesystem::path& results, const std::string& session);
// Its whole artifacts, and the fit. kNotFound where the fit is not there.
[[nodiscard]] Result<std::vector<MadeFolder>> ListMade(const std::filesystem::path& session_results,
                                                       const std::string& fit);
// The records are those that the manifest speaks of. kIntegrity, kNotFound; kFailed where one cannot be read.
Status CheckRecords(const std::filesystem::path& session_results, const std::vector<MadeFolder>& made);

}  // namespace stratalux::fit
