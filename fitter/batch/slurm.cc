// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/slurm.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "fitter/batch/key_exchange.h"
#include "fitter/batch/shard_manifest.h"
#include "shared/base/formatted.h"
#include "shared/base/json_number.h"
#include "shared/base/program.h"
#include "shared/base/read_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kJobsFile = "slurm.json";
constexpr int kRestarts = 3;
constexpr double kMemoryReserve = 1.25;  // over the most that a visitor took

// As a word of a shell.
std::string Quoted(const std::string& text) {
  std::string quoted = "'";
  for (const char c : text) quoted += c == '\'' ? "'\\''" : std::string(1, c);
  return quoted + "'";
}

// "1-3,7"; ascending.
std::string Ranges(const std::vector<int>& numbers) {
  std::string text;
  for (size_t i = 0; i < numbers.size();) {
    size_t last = i;
    while (last + 1 < numbers.size() && numbers[last + 1] == numbers[last] + 1) ++last;
    text += (text.empty() ? "" : ",") + std::to_string(numbers[i]);
    if (last > i) text += "-" + std::to_string(numbers[last]);
    i = last + 1;
  }
  return text;
}

int64_t MebibytesOf(const ShardPlan& plan) {
  int64_t most = 0;
  for (const PlannedVisit& visit : plan.visits)
    if (visit.cost) most = std::max(most, visit.cost->peak_bytes);
  return static_cast<int64_t>(std::ceil(kMemoryReserve * static_cast<double>(most) / (1 << 20)));
}

Status WriteJobs(const fs::path& results, const SlurmJobs& jobs) {
  const Json json = {{"schema", 1}, {"shards", jobs.shards}, {"jobs", jobs.ids}};
  return db::ReplaceFile(results / kJobsFile, json.dump(1) + "\n");
}

Result<std::string> SubmitArray(const fs::path& folder, const std::string& name, const std::string& script) {
  SLX_RETURN_IF_ERROR(db::MakeFolder(folder));
  const fs::path file = folder / (name + ".sh");
  SLX_RETURN_IF_ERROR(db::ReplaceFile(file, script));
  SLX_ASSIGN_OR_RETURN(const auto said, RunProgram({"sbatch", "--parsable", file.string()}));
  if (said.code != 0)
    return Status::Failed("sbatch " + file.string() + " ended with exit code " + std::to_string(said.code) + ": " +
                          said.errors);
  std::string id = said.output.substr(0, said.output.find_first_of(";\n"));
  if (id.empty()) return Status::Failed("sbatch " + file.string() + " named no job: " + said.output);
  return id;
}

}  // namespace

Status SlurmOptions::Validate() const {
  if (!(chunk_minutes > 0.0)) return Status::Usage("--chunk-minutes must be more than 0");
  if (cpus < 1) return Status::Usage("--cpus must be at least 1");
  for (const std::string& directive : directives)
    if (!directive.starts_with("--") || directive.find('\n') != std::string::npos)
      return Status::Usage("--sbatch " + directive + ": expected an option of sbatch, such as --partition=night");
  return Status::Ok();
}

Result<int> ShardCount(const ShardPlan& plan, const SlurmOptions& options) {
  double seconds = 0.0;
  for (const PlannedVisit& visit : plan.visits) {
    if (!visit.cost)
      return Status::Usage(
          "how long a visitor takes is not known yet: no visitor of this store was fitted. `stratalux-fit batch run "
          "--most 1` fits one here; then make the plan");
    seconds += visit.cost->cpu_seconds;
  }
  const double shards = std::ceil(seconds / options.cpus / 60.0 / options.chunk_minutes);
  return static_cast<int>(std::clamp(shards, 1.0, std::max(1.0, static_cast<double>(plan.visits.size()))));
}

std::vector<int> ShardsToDo(const ShardPlan& plan, const fs::path& results, int count) {
  std::vector<int> left;
  for (int i = 1; i <= count; ++i) {
    const std::vector<size_t> own = VisitsOf(plan, {i, count});
    const auto manifest = ReadManifest(ManifestFile(results, {i, count}), plan);
    const bool over = std::all_of(own.begin(), own.end(), [&](size_t place) {
      const std::string& session = plan.visits[place].session;
      return (manifest.ok() && manifest->Find(session) != nullptr) || IsMerged(results, session);
    });
    if (!over && !own.empty()) left.push_back(i);
  }
  return left;
}

// Of an array the highest index is limited, not only how many there are.
std::vector<std::vector<int>> ArraysOf(const std::vector<int>& shards, int most_tasks) {
  std::vector<std::vector<int>> arrays;
  for (const int shard : shards) {
    if (arrays.empty() || shard - arrays.back().front() >= most_tasks) arrays.emplace_back();
    arrays.back().push_back(shard);
  }
  return arrays;
}

std::string SbatchScript(const ShardPlan& plan, const SlurmOptions& options, const std::vector<int>& shards,
                         int count) {
  const int before = shards.front() - 1;  // array indices are small, whatever the shard
  std::vector<int> indices;
  for (const int shard : shards) indices.push_back(shard - 1 - before);
  const int64_t memory = MebibytesOf(plan);
  const double waits = options.ask_keys ? kAskMinutes : 0.0;
  const int minutes = static_cast<int>(std::ceil(2.0 * options.chunk_minutes + waits)) + 10;
  std::string script = "#!/bin/bash\n#SBATCH --job-name=stratalux-" + plan.id.substr(0, 8) +
                       "\n#SBATCH --array=" + Ranges(indices) +
                       "\n#SBATCH --cpus-per-task=" + std::to_string(options.cpus) + "\n";
  if (memory > 0) script += "#SBATCH --mem=" + std::to_string(memory) + "M\n";
  // Asked to stop, a shard ends its workers within ten seconds and says what is left.
  script += "#SBATCH --time=" + std::to_string(minutes) + "\n#SBATCH --signal=B:TERM@60\n#SBATCH --requeue\n";
  script += "#SBATCH --open-mode=append\n#SBATCH --output=" + (options.results / "slurm" / "%A_%a.log").string() + "\n";
  for (const std::string& directive : options.directives) script += "#SBATCH " + directive + "\n";
  // Before the shard begins: Slurm may ask at once.
  script += "work= asked=\ntrap 'asked=1; [ -z \"$work\" ] || kill -TERM \"$work\" 2>/dev/null' TERM\n";
  script += "shard=$((" + std::to_string(before + 1) + " + SLURM_ARRAY_TASK_ID))\n" + options.program +
            " batch shard \"$shard/" + std::to_string(count) + "\" --plan " + plan.id + " --store " +
            Quoted(options.store.string()) + " --results " + Quoted(options.results.string()) +
            " --workers 1 --threads " + std::to_string(options.cpus);
  if (options.ask_keys) script += " --ask-keys";
  if (memory > 0) script += Formatted(" --memory %.3f", static_cast<double>(memory) / 1024.0);
  script +=
      " &\nwork=$!\n"
      "[ -z \"$asked\" ] || kill -TERM \"$work\" 2>/dev/null\n"
      "while true; do\n"
      "  wait \"$work\"\n"
      "  code=$?\n"
      "  kill -0 \"$work\" 2>/dev/null || break  # a signal ended the waiting\n"
      "done\n"
      "# 75: visitors are left; above 128: a signal ended it.\n"
      "if { [ \"$code\" -eq 75 ] || [ \"$code\" -gt 128 ]; } && [ \"${SLURM_RESTART_COUNT:-0}\" -lt " +
      std::to_string(kRestarts) +
      " ]; then\n"
      "  scontrol requeue \"${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID\"\n"
      "fi\n"
      "exit \"$code\"\n";
  return script;
}

Result<SlurmJobs> ReadSlurmJobs(const fs::path& results) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(results / kJobsFile));
  try {
    const Json json = Json::parse(text);
    SlurmJobs jobs;
    jobs.shards = WholeAt<int>(json, "shards");
    json.at("jobs").get_to(jobs.ids);
    return jobs;
  } catch (const Json::exception& error) {
    return Status::Integrity((results / kJobsFile).string() + ": " + error.what());
  }
}

Result<SlurmJobs> SubmitSlurm(const ShardPlan& plan, const SlurmOptions& options,
                              const std::vector<std::vector<int>>& arrays, SlurmJobs jobs) {
  for (const std::vector<int>& shards : arrays) {
    SLX_ASSIGN_OR_RETURN(const std::string id,
                         SubmitArray(options.results / "slurm", Formatted("array-%03zu", jobs.ids.size() + 1),
                                     SbatchScript(plan, options, shards, jobs.shards)));
    jobs.ids.push_back(id);
    SLX_RETURN_IF_ERROR(WriteJobs(options.results, jobs));
  }
  return jobs;
}

}  // namespace stratalux::fit
