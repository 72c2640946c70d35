// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit batch shard|keys|submit|merge`: a planned night on other machines, and its way back into the store.
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <map>
#include <memory>
#include <optional>
#include <set>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <unistd.h>

#include "db/catalogue/session_store.h"
#include "db/keys/held_keys.h"
#include "db/keys/reader_key.h"
#include "db/privacy/access_log.h"
#include "fitter/apps/batch_flags.h"
#include "fitter/batch/key_exchange.h"
#include "fitter/batch/merge.h"
#include "fitter/batch/morning_report.h"
#include "fitter/batch/shard.h"
#include "fitter/batch/shard_keys.h"
#include "fitter/batch/slurm.h"
#include "fitter/batch/time_of_day.h"
#include "fitter/pipeline/interruption.h"
#include "shared/base/formatted.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

struct ClusterFlags {
  BatchFlags batch;
  std::string shard, results, scratch, plan, engine, task, task_store;
  std::vector<std::string> directives;
  double chunk_minutes = 60.0, every_s = 60.0, ask_minutes = kAskMinutes, look_s = 1.0;
  int cpus = 2;
  bool close = false, again = false, dry_run = false, keys = false, ask_keys = false, answer = false;
};

std::string ScratchOf(const ClusterFlags& flags) {
  if (!flags.scratch.empty()) return flags.scratch;
  const char* temporary = std::getenv("TMPDIR");
  return temporary != nullptr && *temporary != '\0' ? temporary : "/tmp";
}

Status FitShard(const ClusterFlags& flags, Logger& logger) {
  ShardOptions options;
  SLX_ASSIGN_OR_RETURN(options.shard, ParseShard(flags.shard));
  SLX_ASSIGN_OR_RETURN(const ShardPlan plan, ReadPlan(flags.results));
  if (!flags.plan.empty() && flags.plan != plan.id)
    return Status::Usage(flags.results + " has another plan than " + flags.plan + " by now");
  SLX_ASSIGN_OR_RETURN(options.night.choice.run, RunOptionsOf(plan.arguments));
  options.night.choice.run.store = flags.batch.fit.run.store;
  SLX_RETURN_IF_ERROR(SetWorkers(flags.batch, options.night));
  options.results = flags.results;
  options.scratch = ScratchOf(flags);
  if (flags.keys) {
    SLX_ASSIGN_OR_RETURN(const auto keys, db::ReadKeys(STDIN_FILENO));
    db::HoldKeys(keys);
  }
  const InterruptionAsks asks;
  if (flags.ask_keys && KeysAreMissing(options.night.choice.run.store, options.results, plan, options.shard)) {
    using Minutes = std::chrono::duration<double, std::ratio<60>>;
    const auto keys = AskForKeys(options.results, plan, options.shard,
                                 std::chrono::round<std::chrono::milliseconds>(Minutes(flags.ask_minutes)),
                                 std::chrono::seconds(1), asks.fd(), logger);
    if (keys.status().code() == StatusCode::kTryAgain) return keys.status();
    if (keys.ok()) {
      db::HoldKeys(*keys);
      logger.Info(Formatted("%zu keys received", keys->size()));
    } else {
      logger.Warning(keys.status().message() + "; visitors that need one are not fitted");
    }
  }
  NightTeller teller(logger, flags.batch);
  const auto heard = [&teller](const NightEvent& event) { teller.Hear(event); };
  SLX_ASSIGN_OR_RETURN(const ShardOutcome outcome, RunShard(options, plan, asks.fd(), heard, logger));
  SLX_RETURN_IF_ERROR(teller.written());
  if (!flags.batch.json) SLX_RETURN_IF_ERROR(WriteStdout(outcome.manifest.string() + "\n"));
  if (outcome.waiting > 0)
    return Status(StatusCode::kTryAgain,
                  Formatted("%d visitors of the shard are waiting: run it again to continue", outcome.waiting));
  if (outcome.failed > 0)
    return Status(StatusCode::kDegraded, Formatted("%d visitors could not be fitted", outcome.failed));
  return Status::Ok();
}

// A store or key that cannot be read is said at once, not to the first task that asks.
Status CheckAnswerer(const ClusterFlags& flags, Logger& logger) {
  const fs::path store = flags.batch.fit.run.store;
  SLX_RETURN_IF_ERROR(db::SessionStore::Open(store, db::AccessMode::kReadOnly).status());
  const auto reader = db::ReaderKey::OfEnvironment();
  if (!reader.ok() && reader.status().code() != StatusCode::kNotFound) return reader.status();
  std::error_code error;
  if (!reader.ok() && !fs::exists(store / "keys.sqlite", error))
    return Status::NotFound(store.string() + " has no keys.sqlite, and " + reader.status().message() +
                            ": there is no key to give");
  if (ReadPlan(flags.results).status().code() == StatusCode::kNotFound)
    logger.Info("no plan in " + flags.results + " yet; waiting for one");
  return Status::Ok();
}

// Until the time of day, or until it is told to stop.
Status AnswerKeys(const ClusterFlags& flags, Logger& logger) {
  if (!flags.shard.empty()) return Status::Usage("--answer serves every shard: leave out " + flags.shard);
  std::optional<std::chrono::seconds> time;
  if (!flags.batch.until.empty()) {
    SLX_ASSIGN_OR_RETURN(time, TimeUntil(flags.batch.until, std::time(nullptr)));
  }
  SLX_RETURN_IF_ERROR(CheckAnswerer(flags, logger));
  const InterruptionAsks asks;
  const auto begun = std::chrono::steady_clock::now();
  std::set<std::string> told;
  KeyAnswers all;
  Result<ShardPlan> plan = Status::NotFound("");
  fs::file_time_type of_plan;
  logger.Info("answering requests for keys in " + flags.results + " ...");
  while (true) {
    // The plan may come later, and another after it.
    std::error_code error;
    const auto now_of_plan = fs::last_write_time(fs::path(flags.results) / "plan.json", error);
    if (error || !plan.ok() || now_of_plan != of_plan) plan = ReadPlan(flags.results);
    of_plan = now_of_plan;
    KeyAnswers now;
    if (plan.ok())
      now = AnswerAsks(flags.batch.fit.run.store, flags.results, *plan);
    else if (plan.status().code() != StatusCode::kNotFound)
      now.problems.push_back(plan.status().message());
    for (const std::string& problem : now.problems)
      if (told.insert(problem).second) logger.Warning(problem);
    if (now.answered > 0) logger.Info(Formatted("%d shards answered, %zu keys", now.answered, now.keys));
    all.answered += now.answered;
    all.keys += now.keys;
    pollfd asked{asks.fd(), POLLIN, 0};
    if (time && std::chrono::steady_clock::now() - begun >= *time) break;
    if (poll(&asked, 1, static_cast<int>(1000.0 * flags.look_s)) > 0) break;
  }
  logger.Info(Formatted("%d shards answered in all, %zu keys", all.answered, all.keys));
  if (told.empty()) return Status::Ok();
  return Status(StatusCode::kDegraded, Formatted("%zu problems", told.size()));
}

// Logged before they leave, one by one: who fits elsewhere has them until it ends.
Status SendKeys(const ClusterFlags& flags, Logger& logger) {
  if (flags.answer) return AnswerKeys(flags, logger);
  if (flags.shard.empty()) return Status::Usage("whose keys? I/N names one share; --answer serves all shards that ask");
  const std::string& store = flags.batch.fit.run.store;
  SLX_RETURN_IF_ERROR(db::CheckKeyPipe(STDOUT_FILENO));
  SLX_ASSIGN_OR_RETURN(const Shard shard, ParseShard(flags.shard));
  SLX_ASSIGN_OR_RETURN(const ShardPlan plan, ReadPlan(flags.results));
  SLX_ASSIGN_OR_RETURN(const ShardKeys found, KeysOf(store, plan, shard));
  for (const std::string& session : found.sessions)
    SLX_RETURN_IF_ERROR(
        db::LogAccess(store, "batch keys", session, "to shard " + flags.shard + " of " + flags.results));
  SLX_RETURN_IF_ERROR(db::WriteKeys(STDOUT_FILENO, found.keys));
  for (const std::string& missing : found.missing) logger.Warning(missing);
  logger.Info(Formatted("%zu keys sent", found.keys.size()));
  if (found.missing.empty()) return Status::Ok();
  return Status(StatusCode::kDegraded, Formatted("%zu keys are not here", found.missing.size()));
}

Json JsonOf(const MergeOutcome& outcome, const fs::path& report) {
  Json failed = Json::array();
  for (const NightEvent& event : outcome.failed)
    failed.push_back({{"session", event.session}, {"state", ToString(event.kind)}, {"reason", event.reason}});
  return {{"night", outcome.night},     {"report", report.string()},   {"entered", outcome.entered},
          {"present", outcome.present}, {"dropped", outcome.dropped},  {"failed", failed},
          {"missing", outcome.missing}, {"problems", outcome.problems}};
}

Status TellMerge(const ClusterFlags& flags, const MergeOutcome& outcome, Logger& logger) {
  for (const std::string& problem : outcome.problems) logger.Error(problem);
  for (const NightEvent& event : outcome.failed) logger.Error(event.session + " failed: " + event.reason);
  constexpr size_t kNamed = 10;
  for (size_t i = 0; i < std::min(kNamed, outcome.missing.size()); ++i)
    logger.Warning(outcome.missing[i] + " is missing: its shard was lost, or is still at work");
  if (outcome.missing.size() > kNamed)
    logger.Warning(Formatted("and %zu more (--json names them)", outcome.missing.size() - kNamed));
  logger.Info(Formatted("%d fits entered, %d already there, %d visitors dropped, %zu failed, %zu missing",
                        outcome.entered, outcome.present, outcome.dropped, outcome.failed.size(),
                        outcome.missing.size()));
  SLX_ASSIGN_OR_RETURN(const fs::path report, WriteMorningReport(flags.batch.fit.run.store, outcome.night));
  const std::string text = JsonOf(outcome, report).dump(1, ' ', false, Json::error_handler_t::replace);
  SLX_RETURN_IF_ERROR(WriteStdout((flags.batch.json ? text : report.string()) + "\n"));
  if (outcome.failed.empty() && outcome.missing.empty() && outcome.problems.empty()) return Status::Ok();
  return Status(StatusCode::kDegraded,
                Formatted("%zu visitors failed, %zu are missing, %zu problems", outcome.failed.size(),
                          outcome.missing.size(), outcome.problems.size()));
}

Status Merge(const ClusterFlags& flags, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const MergeOutcome outcome,
                       MergeShards(flags.batch.fit.run.store, flags.results,
                                   flags.close ? MergeMode::kClose : MergeMode::kKeep, logger));
  return TellMerge(flags, outcome, logger);
}

// The one that is there, or a new one; of a dry run it is not written.
Result<ShardPlan> PlanToSubmit(const ClusterFlags& flags, Logger& logger) {
  auto plan = ReadPlan(flags.results);
  const bool chosen = flags.batch.most > 0 || !GivenArguments(flags.batch.fit_options).empty();
  if (plan.ok() && chosen)
    return Status::Usage(flags.results + " already has a plan, which says who is fitted and how");
  if (plan.ok() || plan.status().code() != StatusCode::kNotFound) return plan;
  SLX_ASSIGN_OR_RETURN(ChoiceOptions options, ChoiceOf(flags.batch));
  options.key = KeyHere::kNot;
  SLX_ASSIGN_OR_RETURN(const NightChoice choice, ChooseNight(options, logger));
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(options.run.store, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const CostHistory history, CostHistory::Read(store));
  plan = PlanOf(choice, history, GivenArguments(flags.batch.fit_options));
  logger.Info(Formatted("%zu visitors to fit, %zu left out", plan->visits.size(), plan->left_out.size()));
  if (!flags.dry_run) SLX_RETURN_IF_ERROR(WritePlan(flags.results, *plan).status());
  return plan;
}

Result<SlurmOptions> SlurmOf(const ClusterFlags& flags) {
  SlurmOptions options;
  options.store = fs::absolute(flags.task_store.empty() ? flags.batch.fit.run.store : flags.task_store);
  options.results = fs::absolute(flags.results);
  options.program = flags.task;
  if (options.program.empty()) {
    SLX_ASSIGN_OR_RETURN(const fs::path own, OwnProgram());
    options.program = "'" + own.string() + "'";
  }
  options.chunk_minutes = flags.chunk_minutes;
  options.cpus = flags.cpus;
  options.ask_keys = flags.ask_keys;
  options.directives = flags.directives;
  SLX_RETURN_IF_ERROR(options.Validate());
  return options;
}

// What came since, again and again; shards write manifests, of which a look at the folder tells, so that no one asks
// the engine.
Status MergeAsItComes(const ClusterFlags& flags, std::chrono::seconds time, Logger& logger) {
  const InterruptionAsks asks;
  const auto end = std::chrono::steady_clock::now() + time;
  std::map<fs::path, fs::file_time_type> before;
  std::set<std::string> told;
  for (bool pending = true;;) {
    std::map<fs::path, fs::file_time_type> now;
    std::error_code error;
    if (const auto files = ManifestFiles(flags.results); files.ok())
      for (const fs::path& file : *files) now[file] = fs::last_write_time(file, error);
    pollfd asked{asks.fd(), POLLIN, 0};
    const bool over = std::chrono::steady_clock::now() >= end || poll(&asked, 1, 0) > 0;
    if (pending || over || now != before) {
      const auto outcome = MergeShards(flags.batch.fit.run.store, flags.results, MergeMode::kKeep, logger);
      if (outcome.ok() && (over || outcome->missing.empty())) return TellMerge(flags, *outcome, logger);
      // Somebody merges by hand, a disk or a network file system fails once: the next look may find it otherwise.
      const StatusCode code = outcome.status().code();
      pending = outcome.ok() ? !outcome->unread.empty() : code == StatusCode::kBusy || code == StatusCode::kFailed;
      if (!outcome.ok() && (over || !pending)) return outcome.status();
      using Lines = std::vector<std::string>;
      for (const std::string& problem : outcome.ok() ? outcome->problems : Lines{outcome.status().message()})
        if (told.insert(problem).second) logger.Warning(problem);
      if (outcome.ok() && outcome->entered > 0)
        logger.Info(Formatted("%d fits entered, %zu missing", outcome->entered, outcome->missing.size()));
    }
    before = std::move(now);
    poll(&asked, 1, static_cast<int>(1000.0 * flags.every_s));
  }
}

Status Submit(const ClusterFlags& flags, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const SlurmOptions options, SlurmOf(flags));
  const std::time_t now = std::time(nullptr);
  SLX_ASSIGN_OR_RETURN(const bool is_time, IsTimeForANight(flags.batch, now, logger));
  if (!is_time) return Status::Ok();
  std::chrono::seconds time{0};
  if (!flags.batch.until.empty()) {
    SLX_ASSIGN_OR_RETURN(time, TimeUntil(flags.batch.until, now));
  }
  SLX_ASSIGN_OR_RETURN(const ShardPlan plan, PlanToSubmit(flags, logger));
  auto jobs = ReadSlurmJobs(options.results);
  if (jobs.ok() && !flags.again)
    return Status::Usage(flags.results + " was submitted, as job " + (jobs->ids.empty() ? "?" : jobs->ids.back()) +
                         "; once that is over, --again submits the shards that are not done");
  if (!jobs.ok() && jobs.status().code() != StatusCode::kNotFound) return jobs.status();
  if (!jobs.ok()) {
    jobs = SlurmJobs{};
    SLX_ASSIGN_OR_RETURN(jobs->shards, ShardCount(plan, options));
  }
  const std::vector<int> shards = ShardsToDo(plan, options.results, jobs->shards);
  logger.Info(Formatted("%zu of %d shards to do", shards.size(), jobs->shards));
  const auto arrays = ArraysOf(shards, options.most_tasks);
  if (flags.dry_run) {
    std::string scripts;
    for (const auto& array : arrays) scripts += SbatchScript(plan, options, array, jobs->shards);
    return WriteStdout(scripts);
  }
  const size_t earlier = jobs->ids.size();
  SLX_ASSIGN_OR_RETURN(jobs, SubmitSlurm(plan, options, arrays, *jobs));
  for (size_t i = earlier; i < jobs->ids.size(); ++i) logger.Info("submitted to Slurm as job " + jobs->ids[i]);
  return flags.batch.until.empty() ? Status::Ok() : MergeAsItComes(flags, time, logger);
}

// Which share, of whose plan.
CLI::Option* AddShare(CLI::App& verb, ClusterFlags& flags) {
  auto* shard = verb.add_option("shard", flags.shard, "I/N, I from 1 to N");
  AddStore(verb, flags.batch);
  verb.add_option("--results", flags.results, "Folder of `batch plan --out`")->required();
  return shard;
}

}  // namespace

void AddClusterCommands(CLI::App& batch, int& exit_code) {
  auto worked = std::make_shared<ClusterFlags>();
  auto* shard =
      batch.add_subcommand("shard", "Fit one of N shares of a planned night, on any machine that sees the store");
  shard->footer(
      "Reads sealed sessions and the ledger of STORE, and writes only to RESULTS. Run it again to continue; exit\n"
      "code 75: it was stopped and has visitors left.\n"
      "Examples:\n"
      "  stratalux-fit batch plan --store store --out results\n"
      "  stratalux-fit batch shard 1/2 --store store --results results\n"
      "  parallel -j 2 stratalux-fit batch shard {}/2 --store store --results results ::: 1 2\n"
      "  stratalux-fit batch merge results --store store");
  AddShare(*shard, *worked)->required();
  shard->add_option("--scratch", worked->scratch,
                    "Folder on a disk of this machine for its index of the sessions (default: $TMPDIR, or /tmp)");
  shard->add_option("--plan", worked->plan, "Refuse any plan but the one with this id");
  auto* from_pipe =
      shard->add_flag("--keys", worked->keys, "Read keys from standard input, as `batch keys` writes them");
  auto* ask = shard->add_flag("--ask-keys", worked->ask_keys,
                              "Ask in RESULTS for keys that this machine lacks, and wait until `batch keys --answer` "
                              "gives them");
  ask->excludes(from_pipe);
  shard
      ->add_option("--ask-minutes", worked->ask_minutes, "With --ask-keys: wait this long, then go on without the keys")
      ->needs(ask)
      ->check(CLI::Range(0.0, 1e5))
      ->capture_default_str();
  AddWorkers(*shard, worked->batch);
  AddAttempts(*shard, worked->batch);
  shard->add_flag("--json", worked->batch.json, "One line per event, as it happens");
  OnCall(*shard, exit_code, [worked](Logger& logger) { return FitShard(*worked, logger); });

  auto given = std::make_shared<ClusterFlags>();
  auto* keys = batch.add_subcommand("keys",
                                    "Give the keys of a share's encrypted visitors into a pipe, or to the shards "
                                    "that ask; logged");
  keys->footer(
      "For machines without the reader's key; they hold these keys in memory. Exit code 3: some keys are not here, "
      "or\n"
      "a request was refused.\n"
      "Examples:\n"
      "  stratalux-fit batch keys 1/2 --store store --results results |\n"
      "      ssh node1 stratalux-fit batch shard 1/2 --store store --results results --keys\n"
      "  stratalux-fit batch keys --answer --store store --results results --until 07:00");
  AddShare(*keys, *given);
  auto* answer = keys->add_flag(
      "--answer", given->answer,
      "Keep running, and give each shard that asks (`batch shard --ask-keys`) the keys of its share, sealed to it");
  keys->add_option("--until", given->batch.until,
                   "With --answer: time of day to stop at (default: run until told to stop)")
      ->needs(answer);
  keys->add_option("--every", given->look_s, "With --answer: seconds between two looks")
      ->needs(answer)
      ->check(CLI::Range(0.05, 3600.0))
      ->capture_default_str();
  OnCall(*keys, exit_code, [given](Logger& logger) { return SendKeys(*given, logger); });

  auto submitted = std::make_shared<ClusterFlags>();
  auto* submit =
      batch.add_subcommand("submit", "Give a planned night to a cluster's engine; makes the plan if there is none");
  submit->footer(
      "`batch merge` brings the fits back; with --until they come back as they are made. It must be known how long a\n"
      "visitor takes: if no visitor of the store was fitted yet, fit one here first.\n"
      "Examples:\n"
      "  stratalux-fit batch submit --engine slurm --store store --results /shared/night --dry-run\n"
      "  stratalux-fit batch submit --engine slurm --store store --results /shared/night --until 07:00 \\\n"
      "      --chunk-minutes 60 --cpus 4 --sbatch=--partition=night");
  AddChoice(*submit, submitted->batch);
  submit->add_option("--engine", submitted->engine, "slurm")->required()->check(CLI::IsMember({"slurm"}));
  submit->add_option("--results", submitted->results, "Folder that this machine and all nodes see")->required();
  submit->add_option("--task-store", submitted->task_store, "Where nodes see the store (default: --store)");
  submit->add_option(
      "--task", submitted->task,
      "What nodes run as stratalux-fit, such as 'apptainer exec stratalux.sif stratalux-fit' (default: this program)");
  submit->add_option("--chunk-minutes", submitted->chunk_minutes, "Minutes per task, judged by what earlier fits took")
      ->check(CLI::Range(0.001, 1e5))
      ->capture_default_str();
  submit->add_option("--cpus", submitted->cpus, "Cores per task")->check(CLI::Range(1, 1024))->capture_default_str();
  submit->add_flag("--ask-keys", submitted->ask_keys,
                   "Tasks ask for the keys of their visitors: `batch keys --answer` gives them");
  submit->add_option("--sbatch", submitted->directives, "Additional option for sbatch; may be repeated");
  auto* until = submit->add_option("--until", submitted->batch.until,
                                   "Time of day; until then keep running, and merge what comes");
  AddFrom(*submit, submitted->batch, *until);
  submit->add_option("--every", submitted->every_s, "With --until: seconds between two looks")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
  submit->add_flag("--again", submitted->again, "Resubmit the shards of a submitted plan that are not done");
  submit->add_flag("--dry-run", submitted->dry_run, "Print the script of each array; submit nothing");
  OnCall(*submit, exit_code, [submitted](Logger& logger) { return Submit(*submitted, logger); });

  auto merged = std::make_shared<ClusterFlags>();
  auto* merge = batch.add_subcommand("merge", "Verify what shards made and enter it into the store; safe to repeat");
  merge->footer(
      "Run it where the store lies on the machine's own disk; shards may still be at work. Exit code 3: somebody "
      "failed\n"
      "or is missing.\n"
      "Example:\n"
      "  stratalux-fit batch merge results --store store");
  merge->add_option("results", merged->results, "Folder of `batch plan --out`")->required();
  AddStore(*merge, merged->batch);
  merge->add_flag("--json", merged->batch.json, "Machine-readable");
  merge->add_flag("--close", merged->close,
                  "Then remove RESULTS: its shards are over, and missing visitors are planned again another night");
  OnCall(*merge, exit_code, [merged](Logger& logger) { return Merge(*merged, logger); });
}

}  // namespace stratalux::fit
