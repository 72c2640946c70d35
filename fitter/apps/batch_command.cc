// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit batch`: the visitors of a store, fitted in a night.
#include <algorithm>
#include <chrono>
#include <ctime>
#include <memory>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <unistd.h>

#include "db/catalogue/job_store.h"
#include "fitter/apps/batch_flags.h"
#include "fitter/apps/run_command.h"
#include "fitter/apps/scale_command.h"
#include "fitter/batch/morning_report.h"
#include "fitter/batch/night_status.h"
#include "fitter/batch/shard_plan.h"
#include "fitter/batch/visit_cost.h"
#include "fitter/pipeline/interruption.h"
#include "shared/base/formatted.h"
#include "shared/base/printable.h"
#include "shared/base/read_file.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

std::string Text(const Json& json) { return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n"; }

Status PrintPlan(const BatchFlags& flags, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(NightOptions night, NightOf(flags, std::time(nullptr)));
  if (!flags.out.empty()) night.choice.key = KeyHere::kNot;
  SLX_ASSIGN_OR_RETURN(const NightChoice choice, ChooseNight(night.choice, logger));
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(night.choice.run.store, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const CostHistory history, CostHistory::Read(store));
  if (!flags.out.empty()) {
    const ShardPlan shards = PlanOf(choice, history, night.arguments);
    SLX_ASSIGN_OR_RETURN(const fs::path file, WritePlan(flags.out, shards));
    logger.Info(Formatted("%zu visitors to fit, %zu left out", shards.visits.size(), shards.left_out.size()));
    return WriteStdout(file.string() + "\n");
  }
  double cpu_seconds = 0.0;
  bool known = true;
  Json visits = Json::array(), left_out = Json::array();
  std::string text;
  for (const ChosenVisit& visit : choice.visits) {
    const auto cost = history.Foresee(visit.sites);
    known = known && cost.has_value();
    cpu_seconds += cost ? cost->cpu_seconds : 0.0;
    visits.push_back({{"session", visit.session},
                      {"fit", visit.fit},
                      {"cpu_seconds", cost ? Json(cost->cpu_seconds) : Json()},
                      {"peak_bytes", cost ? Json(cost->peak_bytes) : Json()}});
    text += visit.session + "  fit " + visit.fit +
            (cost ? Formatted("  %.0f s of processor, %.2f GiB", cost->cpu_seconds,
                              static_cast<double>(cost->peak_bytes) / kGib)
                  : "") +
            "\n";
  }
  for (const LeftOutVisit& visit : choice.left_out) {
    left_out.push_back({{"session", visit.session}, {"why", ToString(visit.why)}, {"reason", visit.reason}});
    text += visit.session + "  left out (" + ToString(visit.why) + "): " + visit.reason + "\n";
  }
  const double hours = cpu_seconds / (night.workers * night.threads) / 3600.0;
  if (flags.json)
    return WriteStdout(Text({{"visits", visits},
                             {"left_out", left_out},
                             {"workers", night.workers},
                             {"threads", night.threads},
                             {"memory_bytes", night.memory_bytes},
                             {"hours", known ? Json(hours) : Json()}}));
  text += Formatted("%zu to fit, %zu left out; %d workers of %d threads", choice.visits.size(), choice.left_out.size(),
                    night.workers, night.threads);
  if (!choice.visits.empty())
    text += known ? Formatted(", %.1f hours at least\n", hours) : ", duration unknown until the first is fitted\n";
  else
    text += "\n";
  return WriteStdout(PrintableLines(text));
}

Status RunBatch(const BatchFlags& flags, Logger& logger) {
  // Asked once: between two looks --until may pass, and the next one is a day away.
  const std::time_t now = std::time(nullptr);
  SLX_ASSIGN_OR_RETURN(const bool is_time, IsTimeForANight(flags, now, logger));
  if (!is_time) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const NightOptions night, NightOf(flags, now));
  const InterruptionAsks asks;
  NightTeller teller(logger, flags);
  const auto heard = [&teller](const NightEvent& event) { teller.Hear(event); };
  SLX_ASSIGN_OR_RETURN(const NightChoice choice, ChooseNight(night.choice, logger));
  SLX_ASSIGN_OR_RETURN(const NightOutcome outcome, RunNight(night, choice, asks.fd(), heard, logger));
  SLX_RETURN_IF_ERROR(teller.written());
  SLX_ASSIGN_OR_RETURN(const fs::path report,
                       WriteMorningReport(night.choice.run.store, outcome.folder.filename().string()));
  if (!flags.json) SLX_RETURN_IF_ERROR(WriteStdout(report.string() + "\n"));
  if (outcome.waiting > 0)
    logger.Info(Formatted("%lld visitors wait for the next night", static_cast<long long>(outcome.waiting)));
  if (outcome.failed > 0)
    return Status(StatusCode::kDegraded,
                  Formatted("%d visitors could not be fitted; `stratalux-fit batch status` says why", outcome.failed));
  return Status::Ok();
}

Result<std::pair<std::string, NightStatus>> NewestNight(const std::string& store) {
  const auto nights = Nights(store);
  if (nights.empty())
    return Status::NotFound("store " + store + " has had no night; `stratalux-fit batch run` makes one");
  const fs::path folder = fs::path(store) / "nights" / nights.back();
  SLX_ASSIGN_OR_RETURN(const NightRecord record, ReadNight(folder));
  return std::pair(folder.string(), StatusOf(record.events));
}

Json VisitJson(const NightVisit& visit) {
  return {{"session", visit.session},       {"fit", visit.fit},         {"state", ToString(visit.kind)},
          {"attempts", visit.attempts},     {"seconds", visit.seconds}, {"cpu_seconds", visit.cpu_seconds},
          {"peak_bytes", visit.peak_bytes}, {"reason", visit.reason}};
}

std::string StatusText(const NightStatus& night, const std::map<db::JobState, int64_t>& counts) {
  std::string text = "night of " + ToIso8601(night.began) + ": " +
                     (night.ended ? "over since " + ToIso8601(*night.ended) : std::string("running")) +
                     (night.end_reason.empty() ? "" : " (" + night.end_reason + ")") + "\n";
  text += Formatted("%d of %lld fitted, %d failed, %d dropped, %zu left out\n", night.Count(NightEventKind::kDone),
                    static_cast<long long>(night.chosen),
                    night.Count(NightEventKind::kFailed) + night.Count(NightEventKind::kSetAside),
                    night.Count(NightEventKind::kDropped), night.left_out.size());
  for (const NightVisit& visit : night.visits)
    if (visit.kind != NightEventKind::kDone)
      text +=
          "  " + visit.session + "  " + ToString(visit.kind) + (visit.reason.empty() ? "" : ": " + visit.reason) + "\n";
  text += "queue:";
  for (const auto& [state, count] : counts)
    text += Formatted(" %lld %s", static_cast<long long>(count), ToString(state));
  return text + (counts.empty() ? " empty\n" : "\n");
}

Status PrintStatus(const BatchFlags& flags) {
  const std::string& store = flags.fit.run.store;
  SLX_ASSIGN_OR_RETURN(const auto newest, NewestNight(store));
  const NightStatus& night = newest.second;
  SLX_ASSIGN_OR_RETURN(auto jobs, db::JobStore::Open(store));
  SLX_ASSIGN_OR_RETURN(const auto counts, jobs.Count("fit"));
  if (!flags.json) return WriteStdout(PrintableLines(StatusText(night, counts)));
  Json json = {{"night", newest.first},
               {"began", ToIso8601(night.began)},
               {"ended", night.ended ? Json(ToIso8601(*night.ended)) : Json()},
               {"reason", night.end_reason},
               {"chosen", night.chosen},
               {"visits", Json::array()},
               {"left_out", Json::array()},
               {"queue", Json::object()}};
  for (const NightVisit& visit : night.visits) json["visits"].push_back(VisitJson(visit));
  for (const NightEvent& event : night.left_out)
    json["left_out"].push_back({{"session", event.session}, {"why", event.why}, {"reason", event.reason}});
  for (const auto& [state, count] : counts) json["queue"][ToString(state)] = count;
  return WriteStdout(Text(json));
}

Status PrintReport(const BatchFlags& flags) {
  const std::string& store = flags.fit.run.store;
  const auto nights = Nights(store);
  if (nights.empty())
    return Status::NotFound("store " + store + " has had no night; `stratalux-fit batch run` makes one");
  const std::string night = flags.night == "latest" ? nights.back() : flags.night;
  if (std::find(nights.begin(), nights.end(), night) == nights.end())
    return Status::NotFound("store " + store + " has no night '" + night + "'; the newest is " + nights.back());
  SLX_ASSIGN_OR_RETURN(const fs::path page, WriteMorningReport(store, night));
  if (!flags.text) return WriteStdout(page.string() + "\n");
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(page.parent_path() / "report.txt"));
  return WriteStdout(text);
}

// Until the night is over, or Ctrl-C; a new picture a second on a terminal, elsewhere when something changed.
Status WatchNight(const BatchFlags& flags) {
  const std::string& store = flags.fit.run.store;
  const InterruptionAsks asks;
  const bool terminal = isatty(STDOUT_FILENO) == 1;
  for (std::string before;;) {
    SLX_ASSIGN_OR_RETURN(const auto newest, NewestNight(store));
    SLX_ASSIGN_OR_RETURN(auto jobs, db::JobStore::Open(store));
    SLX_ASSIGN_OR_RETURN(const auto counts, jobs.Count("fit"));
    const std::string text = PrintableLines(StatusText(newest.second, counts));
    if (text != before) SLX_RETURN_IF_ERROR(WriteStdout((terminal ? "\x1b[H\x1b[2J" : "") + text));
    before = text;
    pollfd asked{asks.fd(), POLLIN, 0};
    constexpr int kSecondMs = 1000;
    if (newest.second.ended || poll(&asked, 1, kSecondMs) > 0) return Status::Ok();
  }
}

Status Retry(const BatchFlags& flags, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(auto jobs, db::JobStore::Open(flags.fit.run.store));
  std::vector<int64_t> ids = flags.jobs;
  if (flags.all) {
    for (const db::JobState state : {db::JobState::kFailed, db::JobState::kSetAside, db::JobState::kCancelled}) {
      SLX_ASSIGN_OR_RETURN(const auto ended, jobs.List(state));
      for (const db::Job& job : ended) ids.push_back(job.id);
    }
  } else if (ids.empty()) {
    return Status::Usage("which jobs? Name their numbers, or --all");
  }
  for (const int64_t id : ids) SLX_RETURN_IF_ERROR(jobs.Requeue(id));
  logger.Info(Formatted("%zu jobs start again with the next `batch run`", ids.size()));
  return Status::Ok();
}

}  // namespace

void AddBatchCommands(CLI::App& app, int& exit_code) {
  auto* batch = app.add_subcommand("batch", "Fit the visitors of a store in a night");
  batch->require_subcommand(1);
  batch->footer(
      "Examples:\n"
      "  stratalux-fit batch plan --store store\n"
      "  stratalux-fit batch run --store store --until 07:00\n"
      "  stratalux-fit batch status --store store");
  auto planned = std::make_shared<BatchFlags>();
  auto* plan = batch->add_subcommand("plan",
                                     "Show who would be fitted, who would not and why, and how long it takes; "
                                     "changes nothing");
  plan->footer(
      "Examples:\n  stratalux-fit batch plan --store store --json\n"
      "  stratalux-fit batch plan --store store --out results   # for `batch shard`, `batch submit` and `batch merge`");
  AddChoice(*plan, *planned);
  AddWorkers(*plan, *planned);
  plan->add_option("--out", planned->out,
                   "Write the plan to FOLDER/plan.json for shards on other machines; their results go there, too");
  OnCall(*plan, exit_code, [planned](Logger& logger) { return PrintPlan(*planned, logger); });

  auto ran = std::make_shared<BatchFlags>();
  auto* run = batch->add_subcommand("run",
                                    "Fit the visitors until all are done or the time is up; prints the path of the "
                                    "report");
  run->footer(
      "The next night continues one that was stopped or killed. Exit code 3: somebody could not be fitted, or,\n"
      "outside --from and --until, the night of that span failed or never began.\n"
      "Examples:\n"
      "  stratalux-fit batch run --store store --until 07:00\n"
      "  stratalux-fit batch run --store store --workers 4 --memory 12 --order oldest --most 300\n"
      "  stratalux-fit batch run --store store --full-evaluation --json > night.jsonl");
  AddChoice(*run, *ran);
  AddWorkers(*run, *ran);
  auto* until =
      run->add_option("--until", ran->until, "Time of day; no visitor is started who would not be finished by then");
  AddFrom(*run, *ran, *until);
  AddAttempts(*run, *ran);
  OnCall(*run, exit_code, [ran](Logger& logger) { return RunBatch(*ran, logger); });

  AddClusterCommands(*batch, exit_code);

  auto asked = std::make_shared<BatchFlags>();
  auto* status = batch->add_subcommand("status", "Progress of the newest night");
  status->footer("Example:\n  stratalux-fit batch status --store store --json");
  AddStore(*status, *asked);
  status->add_flag("--json", asked->json, "Machine-readable");
  OnCall(*status, exit_code, [asked](Logger&) { return PrintStatus(*asked); });

  auto watched = std::make_shared<BatchFlags>();
  auto* watch = batch->add_subcommand("watch", "Show the same, live, until the night is over");
  watch->footer("Example:\n  stratalux-fit batch watch --store store");
  AddStore(*watch, *watched);
  OnCall(*watch, exit_code, [watched](Logger&) { return WatchNight(*watched); });

  auto reported = std::make_shared<BatchFlags>();
  auto* report = batch->add_subcommand("report", "Make a night's morning report again; prints its path");
  report->footer(
      "Examples:\n  stratalux-fit batch report --store store\n"
      "  stratalux-fit batch report --store store --text | mail -s 'last night' operator");
  AddStore(*report, *reported);
  report->add_option("night", reported->night, "Name of its folder, or latest")->capture_default_str();
  report->add_flag("--text", reported->text, "Print it as text, for a mail");
  OnCall(*report, exit_code, [reported](Logger&) { return PrintReport(*reported); });

  auto retried = std::make_shared<BatchFlags>();
  auto* retry = batch->add_subcommand("retry", "Restart jobs that failed, were set aside or were cancelled");
  retry->footer(
      "Examples:\n  stratalux-fit batch retry 17 18 --store store\n  stratalux-fit batch retry --all --store store");
  AddStore(*retry, *retried);
  retry->add_option("job", retried->jobs, "Numbers of jobs");
  retry->add_flag("--all", retried->all, "All of them");
  OnCall(*retry, exit_code, [retried](Logger& logger) { return Retry(*retried, logger); });

  AddScaleCommand(*batch, exit_code);
}

}  // namespace stratalux::fit
