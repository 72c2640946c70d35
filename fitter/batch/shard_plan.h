// SPDX-License-Identifier: Apache-2.0
// Who is fitted by other machines, in order, written down once where the store is (RESULTS/plan.json), and how the
// shards divide them (docs/file-formats.md, "Shards").
//
// A list, not a rule such as the hash of a session's id: shards begin at different times, and each must mean the same
// visitors though some came or were forgotten meanwhile, and who is missing in the end must be known.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "fitter/batch/night_choice.h"
#include "fitter/batch/night_log.h"
#include "fitter/batch/visit_cost.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct PlannedVisit {
  std::string session, fit;
  int64_t sites = 0;              // of the camera's mosaic
  std::optional<VisitCost> cost;  // foreseen; nullopt: nothing was fitted yet
};

struct ShardPlan {
  std::string id;  // hash of the file; what is made by it names it
  WallNs made;
  std::string isa, program;            // instruction set and version that its fits are named for
  std::vector<std::string> arguments;  // of `stratalux-fit run`, for every visitor
  std::vector<PlannedVisit> visits;    // in the order of their fitting
  std::vector<NightEvent> left_out;
};

// Of what was chosen (KeyHere::kNot).
[[nodiscard]] ShardPlan PlanOf(const NightChoice& choice, const CostHistory& history,
                               const std::vector<std::string>& arguments);
// Makes the folder. kUsage where it has a plan: its shards may be at work.
[[nodiscard]] Result<std::filesystem::path> WritePlan(const std::filesystem::path& results, const ShardPlan& plan);
// kNotFound; kIntegrity for a damaged file; kNewerSchema.
[[nodiscard]] Result<ShardPlan> ReadPlan(const std::filesystem::path& results);

// Ids of sessions and fits become names of folders: kIntegrity for what is none.
Status CheckId(const std::string& id);

struct Shard {
  int index = 1, count = 1;  // index: from 1
};
// "3/20"; kUsage.
[[nodiscard]] Result<Shard> ParseShard(const std::string& text);
// Places in plan.visits, ascending; every visit is in exactly one of the `count` shards. In the plan's order each goes
// to whichever shard has the least to do so far, by the foreseen processor seconds.
[[nodiscard]] std::vector<size_t> VisitsOf(const ShardPlan& plan, const Shard& shard);

}  // namespace stratalux::fit
