// SPDX-License-Identifier: Apache-2.0
// A planned night as job arrays of Slurm (https://slurm.schedmd.com/sbatch.html): one task a shard of some minutes, one
// sbatch a thousand tasks. A task that was stopped or killed has itself queued again, three times at most.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "fitter/batch/shard_plan.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct SlurmOptions {
  std::filesystem::path store, results;  // as the nodes see them
  // What a task runs, words of a shell: "apptainer exec stratalux.sif stratalux-fit".
  std::string program;
  double chunk_minutes = 60.0;          // of a task, by the clock
  int cpus = 2;                         // of a task; a visitor's stages share them
  bool ask_keys = false;                // of encrypted visitors (key_exchange.h)
  std::vector<std::string> directives;  // of sbatch, too: "--partition=night"
  // One less than Slurm's MaxArraySize (1001 where nobody raised it).
  int most_tasks = 1000;

  [[nodiscard]] Status Validate() const;
};

// So many that each has `chunk_minutes` to do by what earlier fits took. kUsage where nothing was measured yet.
[[nodiscard]] Result<int> ShardCount(const ShardPlan& plan, const SlurmOptions& options);
// Of `count` shards, those in which a visitor has not ended by the shard's manifest; ascending, from 1.
[[nodiscard]] std::vector<int> ShardsToDo(const ShardPlan& plan, const std::filesystem::path& results, int count);
// Divided into arrays that Slurm takes.
[[nodiscard]] std::vector<std::vector<int>> ArraysOf(const std::vector<int>& shards, int most_tasks);
// The script of one array: `shards` of `count`, each a task.
[[nodiscard]] std::string SbatchScript(const ShardPlan& plan, const SlurmOptions& options,
                                       const std::vector<int>& shards, int count);

// What was submitted of a plan, RESULTS/slurm.json.
struct SlurmJobs {
  int shards = 0;
  std::vector<std::string> ids;  // of arrays, as sbatch said them
};
// kNotFound where nothing was.
[[nodiscard]] Result<SlurmJobs> ReadSlurmJobs(const std::filesystem::path& results);
// An array after the other, each written to RESULTS/slurm/ and noted as soon as Slurm has it. kNotFound: no sbatch
// here; kFailed with its words.
[[nodiscard]] Result<SlurmJobs> SubmitSlurm(const ShardPlan& plan, const SlurmOptions& options,
                                            const std::vector<std::vector<int>>& arrays, SlurmJobs jobs);

}  // namespace stratalux::fit
