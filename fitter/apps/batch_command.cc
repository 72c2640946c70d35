// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit batch`: the visitors of a store, fitted in a night.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <memory>
#include <thread>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <unistd.h>

#include "db/catalogue/job_store.h"
#include "fitter/apps/fit_flags.h"
#include "fitter/apps/run_command.h"
#include "fitter/apps/scale_command.h"
#include "fitter/batch/morning_report.h"
#include "fitter/batch/night.h"
#include "fitter/batch/night_status.h"
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

constexpr double kGib = 1024.0 * 1024.0 * 1024.0;

struct BatchFlags {
  FitFlags fit;
  std::vector<CLI::Option*> fit_options;
  std::string order = "newest", until;
  int most = 0, workers = 0, threads = 0, attempts = 3;
  double memory_gib = 0.0, visit_limit_min = 60.0;
  std::vector<int64_t> jobs;
  std::string night = "latest";
  bool all = false, json = false, text = false;
};

std::string Text(const Json& json) { return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n"; }

// The next time that a clock of this machine says so.
Result<std::chrono::seconds> TimeUntil(const std::string& text) {
  int hour = -1, minute = -1, length = 0;
  const int read = std::sscanf(text.c_str(), "%2d:%2d%n", &hour, &minute, &length);
  if (read != 2 || static_cast<size_t>(length) != text.size() || hour < 0 || hour > 23 || minute < 0 || minute > 59)
    return Status::Usage("--until " + text + ": a time of day, such as 07:00");
  const std::time_t now = std::time(nullptr);
  std::tm then{};
  localtime_r(&now, &then);
  then.tm_hour = hour;
  then.tm_min = minute;
  then.tm_sec = 0;
  then.tm_isdst = -1;
  std::time_t at = std::mktime(&then);
  if (at <= now) {
    ++then.tm_mday;
    then.tm_isdst = -1;
    at = std::mktime(&then);
  }
  return std::chrono::seconds(at - now);
}

int64_t AvailableBytes() {
  const auto text = ReadFile("/proc/meminfo");
  constexpr std::string_view kKey = "MemAvailable:";
  const size_t at = text.ok() ? text->find(kKey) : std::string::npos;
  return at == std::string::npos ? 0 : std::atoll(text->c_str() + at + kKey.size()) * 1024;
}

Result<ChoiceOptions> ChoiceOf(const BatchFlags& flags) {
  ChoiceOptions choice;
  SLX_ASSIGN_OR_RETURN(choice.run, RunOptionsOf(flags.fit));
  choice.order = flags.order == "oldest" ? NightOrder::kOldest : NightOrder::kNewest;
  choice.most = flags.most;
  return choice;
}

Result<NightOptions> NightOf(const BatchFlags& flags) {
  NightOptions night;
  SLX_ASSIGN_OR_RETURN(night.choice, ChoiceOf(flags));
  night.arguments = GivenArguments(flags.fit_options);
  std::error_code error;
  night.program = fs::read_symlink("/proc/self/exe", error);
  if (error) return Status::Failed("/proc/self/exe: " + error.message());
  const int cores = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  night.workers = flags.workers > 0 ? flags.workers : cores;
  night.threads = flags.threads > 0 ? flags.threads : std::max(1, cores / night.workers);
  // A fifth is left to everybody else.
  night.memory_bytes =
      flags.memory_gib > 0.0 ? static_cast<int64_t>(flags.memory_gib * kGib) : AvailableBytes() / 5 * 4;
  night.attempts = flags.attempts;
  night.visit_limit = std::chrono::seconds(static_cast<int64_t>(60.0 * flags.visit_limit_min));
  if (!flags.until.empty()) {
    SLX_ASSIGN_OR_RETURN(const auto left, TimeUntil(flags.until));
    night.deadline = std::chrono::steady_clock::now() + left;
  }
  return night;
}

Status PrintPlan(const BatchFlags& flags, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const NightOptions night, NightOf(flags));
  SLX_ASSIGN_OR_RETURN(const NightChoice choice, ChooseNight(night.choice, logger));
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(night.choice.run.store, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const CostHistory history, CostHistory::Read(store));
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
    text += known ? Formatted(", %.1f hours at least\n", hours) : ", how long is known after the first\n";
  else
    text += "\n";
  return WriteStdout(PrintableLines(text));
}

std::string Sentence(const NightEvent& event, int over, int64_t chosen) {
  const std::string who = event.session;
  const std::string place = Formatted("[%d/%lld] ", over, static_cast<long long>(chosen));
  switch (event.kind) {
    case NightEventKind::kBegan:
      return Formatted("%lld visitors to fit", static_cast<long long>(event.count));
    case NightEventKind::kLeftOut:
      return event.why == ToString(LeftOut::kComplete) ? "" : who + " is left out (" + event.why + "): " + event.reason;
    case NightEventKind::kStarted:
      return event.attempt > 1 ? Formatted("%s: attempt %d", who.c_str(), event.attempt) : "";
    case NightEventKind::kDone:
      return place + who +
             Formatted(" fitted in %.0f s (%.0f s of processor, %.2f GiB)", event.seconds, event.cpu_seconds,
                       static_cast<double>(event.peak_bytes) / kGib);
    case NightEventKind::kRetry:
      return who + " failed and is tried again: " + event.reason;
    case NightEventKind::kFailed:
      return place + who + " failed: " + event.reason;
    case NightEventKind::kSetAside:
      return place + who + Formatted(" is set aside after %d attempts: ", event.attempt) + event.reason;
    case NightEventKind::kDropped:
      return place + who + " is not fitted any more: " + event.reason;
    case NightEventKind::kReleased:
      return who + " is given back: " + event.reason;
    case NightEventKind::kEnded:
      return "the night is over" + (event.reason.empty() ? "" : ": " + event.reason);
  }
  return "";
}

Status RunBatch(const BatchFlags& flags, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const NightOptions night, NightOf(flags));
  const InterruptionAsks asks;
  NightStatus status;
  std::vector<NightEvent> events;
  Status written;
  const auto heard = [&](const NightEvent& event) {
    events.push_back(event);
    if (flags.json && written.ok()) written = WriteStdout(ToJson(event) + "\n");
    status = StatusOf(events);
    const std::string sentence = Sentence(event, status.Over(), status.chosen);
    if (sentence.empty()) return;
    const bool bad = event.kind == NightEventKind::kFailed || event.kind == NightEventKind::kSetAside;
    bad                                    ? logger.Error(sentence)
    : event.kind == NightEventKind::kRetry ? logger.Warning(sentence)
                                           : logger.Info(sentence);
  };
  SLX_ASSIGN_OR_RETURN(const NightChoice choice, ChooseNight(night.choice, logger));
  SLX_ASSIGN_OR_RETURN(const NightOutcome outcome, RunNight(night, choice, asks.fd(), heard, logger));
  SLX_RETURN_IF_ERROR(written);
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
  text += Formatted("%d of %lld fitted, %d failed, %d not any more, %zu left out\n", night.Count(NightEventKind::kDone),
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
  logger.Info(Formatted("%zu jobs begin anew with the next `batch run`", ids.size()));
  return Status::Ok();
}

void AddStore(CLI::App& verb, BatchFlags& flags) {
  verb.add_option("--store", flags.fit.run.store, "Store folder")->envname("STRATALUX_STORE")->required();
}

void AddChoice(CLI::App& verb, BatchFlags& flags) {
  AddStore(verb, flags);
  verb.add_option("--order", flags.order, "Who is fitted first: newest or oldest visitors")
      ->check(CLI::IsMember({"newest", "oldest"}))
      ->capture_default_str();
  verb.add_option("--most", flags.most, "So many visitors at most; 0: all")
      ->check(CLI::Range(0, 1000000))
      ->capture_default_str();
  verb.add_option("--workers", flags.workers, "Visitors at a time, each in a process of its own; 0: one a core")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  verb.add_option("--threads", flags.threads, "Threads of each worker; 0: the cores, shared out")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  verb.add_option("--memory", flags.memory_gib, "Memory of all workers together, GiB; 0: four fifths of what is free")
      ->check(CLI::Range(0.0, 1e6))
      ->capture_default_str();
  flags.fit_options = AddFitOptions(verb, flags.fit);
  verb.add_flag("--json", flags.json, "Machine-readable; of `run` a line an event, as it happens");
}

template <typename Body>
void OnCall(CLI::App& verb, int& exit_code, Body body) {
  verb.callback([body, &exit_code] {
    Logger logger;
    const Status status = body(logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace

void AddBatchCommands(CLI::App& app, int& exit_code) {
  auto* batch = app.add_subcommand("batch", "The visitors of a store, fitted in a night");
  batch->require_subcommand(1);
  batch->footer(
      "Examples:\n"
      "  stratalux-fit batch plan --store store\n"
      "  stratalux-fit batch run --store store --until 07:00\n"
      "  stratalux-fit batch status --store store");
  auto planned = std::make_shared<BatchFlags>();
  auto* plan =
      batch->add_subcommand("plan", "Who would be fitted, who not and why, and how long it takes; changes nothing");
  plan->footer("Example:\n  stratalux-fit batch plan --store store --json");
  AddChoice(*plan, *planned);
  OnCall(*plan, exit_code, [planned](Logger& logger) { return PrintPlan(*planned, logger); });

  auto ran = std::make_shared<BatchFlags>();
  auto* run = batch->add_subcommand("run", "Fit them: until all are, or the time is up; prints where the report is");
  run->footer(
      "A night that was stopped or killed is gone on with by the next one. Exit code 3: somebody could not be fitted.\n"
      "Examples:\n"
      "  stratalux-fit batch run --store store --until 07:00\n"
      "  stratalux-fit batch run --store store --workers 4 --memory 12 --order oldest --most 300\n"
      "  stratalux-fit batch run --store store --full-evaluation --json > night.jsonl");
  AddChoice(*run, *ran);
  run->add_option("--until", ran->until, "Time of day: nobody is begun who would not be finished by then");
  run->add_option("--attempts", ran->attempts, "Attempts a visitor, then it is set aside")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  run->add_option("--visit-limit", ran->visit_limit_min, "Minutes after which an attempt is given up")
      ->check(CLI::Range(0.01, 1e5))
      ->capture_default_str();
  OnCall(*run, exit_code, [ran](Logger& logger) { return RunBatch(*ran, logger); });

  auto asked = std::make_shared<BatchFlags>();
  auto* status = batch->add_subcommand("status", "How far the newest night is");
  status->footer("Example:\n  stratalux-fit batch status --store store --json");
  AddStore(*status, *asked);
  status->add_flag("--json", asked->json, "Machine-readable");
  OnCall(*status, exit_code, [asked](Logger&) { return PrintStatus(*asked); });

  auto watched = std::make_shared<BatchFlags>();
  auto* watch = batch->add_subcommand("watch", "The same, live, until the night is over");
  watch->footer("Example:\n  stratalux-fit batch watch --store store");
  AddStore(*watch, *watched);
  OnCall(*watch, exit_code, [watched](Logger&) { return WatchNight(*watched); });

  auto reported = std::make_shared<BatchFlags>();
  auto* report = batch->add_subcommand("report", "The morning's report of a night, made anew; prints where it is");
  report->footer(
      "Examples:\n  stratalux-fit batch report --store store\n"
      "  stratalux-fit batch report --store store --text | mail -s 'last night' operator");
  AddStore(*report, *reported);
  report->add_option("night", reported->night, "Name of its folder, or latest")->capture_default_str();
  report->add_flag("--text", reported->text, "Print it as text, for a mail");
  OnCall(*report, exit_code, [reported](Logger&) { return PrintReport(*reported); });

  auto retried = std::make_shared<BatchFlags>();
  auto* retry = batch->add_subcommand("retry", "Jobs that failed, were set aside or cancelled begin anew");
  retry->footer(
      "Examples:\n  stratalux-fit batch retry 17 18 --store store\n  stratalux-fit batch retry --all --store store");
  AddStore(*retry, *retried);
  retry->add_option("job", retried->jobs, "Numbers of jobs");
  retry->add_flag("--all", retried->all, "All of them");
  OnCall(*retry, exit_code, [retried](Logger& logger) { return Retry(*retried, logger); });

  AddScaleCommand(*batch, exit_code);
}

}  // namespace stratalux::fit
