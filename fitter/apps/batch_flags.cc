// SPDX-License-Identifier: Apache-2.0
#include "fitter/apps/batch_flags.h"

#include <algorithm>
#include <cstdlib>
#include <ctime>
#include <thread>

#include <CLI/CLI.hpp>

#include "fitter/batch/time_of_day.h"
#include "shared/base/formatted.h"
#include "shared/base/read_file.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

int64_t AvailableBytes() {
  const auto text = ReadFile("/proc/meminfo");
  constexpr std::string_view kKey = "MemAvailable:";
  const size_t at = text.ok() ? text->find(kKey) : std::string::npos;
  return at == std::string::npos ? 0 : std::atoll(text->c_str() + at + kKey.size()) * 1024;
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
      return place + who + " is dropped: " + event.reason;
    case NightEventKind::kReleased:
      return who + " goes back to the queue: " + event.reason;
    case NightEventKind::kEnded:
      return "the night is over" + (event.reason.empty() ? "" : ": " + event.reason);
  }
  return "";
}

}  // namespace

void AddStore(CLI::App& verb, BatchFlags& flags) {
  verb.add_option("--store", flags.fit.run.store, "Store folder")->envname("STRATALUX_STORE")->required();
}

void AddWorkers(CLI::App& verb, BatchFlags& flags) {
  verb.add_option("--workers", flags.workers, "Visitors fitted at a time, each in its own process; 0: one per core")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  verb.add_option("--threads", flags.threads, "Threads of each worker; 0: the cores, divided among the workers")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  verb.add_option("--memory", flags.memory_gib, "Memory of all workers together, GiB; 0: four fifths of what is free")
      ->check(CLI::Range(0.0, 1e6))
      ->capture_default_str();
}

void AddChoice(CLI::App& verb, BatchFlags& flags) {
  AddStore(verb, flags);
  verb.add_option("--order", flags.order, "Who is fitted first: newest or oldest visitors")
      ->check(CLI::IsMember({"newest", "oldest"}))
      ->capture_default_str();
  verb.add_option("--most", flags.most, "Fit at most this many visitors; 0: all")
      ->check(CLI::Range(0, 1000000))
      ->capture_default_str();
  flags.fit_options = AddFitOptions(verb, flags.fit);
  verb.add_flag("--json", flags.json, "Machine-readable; `run` writes one line per event, as it happens");
}

void AddAttempts(CLI::App& verb, BatchFlags& flags) {
  verb.add_option("--attempts", flags.attempts, "Attempts per visitor before it is set aside")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  verb.add_option("--visit-limit", flags.visit_limit_min, "Minutes after which an attempt is given up")
      ->check(CLI::Range(0.01, 1e5))
      ->capture_default_str();
}

void AddFrom(CLI::App& verb, BatchFlags& flags, CLI::Option& until) {
  verb.add_option("--from", flags.from,
                  "Time of day, with --until: outside that span nobody is fitted; exit code 0 if the last night went "
                  "well, else 3")
      ->needs(&until);
}

Result<fs::path> OwnProgram() {
  std::error_code error;
  fs::path program = fs::read_symlink("/proc/self/exe", error);
  if (error) return Status::Failed("/proc/self/exe: " + error.message());
  return program;
}

Status SetWorkers(const BatchFlags& flags, NightOptions& night) {
  SLX_ASSIGN_OR_RETURN(night.program, OwnProgram());
  const int cores = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  night.workers = flags.workers > 0 ? flags.workers : cores;
  night.threads = flags.threads > 0 ? flags.threads : std::max(1, cores / night.workers);
  // A fifth is left to everybody else.
  night.memory_bytes =
      flags.memory_gib > 0.0 ? static_cast<int64_t>(flags.memory_gib * kGib) : AvailableBytes() / 5 * 4;
  night.attempts = flags.attempts;
  night.visit_limit = std::chrono::seconds(static_cast<int64_t>(60.0 * flags.visit_limit_min));
  return Status::Ok();
}

Result<ChoiceOptions> ChoiceOf(const BatchFlags& flags) {
  ChoiceOptions choice;
  SLX_ASSIGN_OR_RETURN(choice.run, RunOptionsOf(flags.fit));
  choice.order = flags.order == "oldest" ? NightOrder::kOldest : NightOrder::kNewest;
  choice.most = flags.most;
  return choice;
}

Result<NightOptions> NightOf(const BatchFlags& flags, std::time_t now) {
  NightOptions night;
  SLX_ASSIGN_OR_RETURN(night.choice, ChoiceOf(flags));
  night.arguments = GivenArguments(flags.fit_options);
  SLX_RETURN_IF_ERROR(SetWorkers(flags, night));
  if (!flags.until.empty()) {
    SLX_ASSIGN_OR_RETURN(const auto left, TimeUntil(flags.until, now));
    night.deadline = std::chrono::steady_clock::now() + left;
  }
  return night;
}

Result<bool> IsTimeForANight(const BatchFlags& flags, std::time_t now, Logger& logger) {
  if (flags.from.empty()) return true;
  SLX_ASSIGN_OR_RETURN(const bool between, IsBetween(flags.from, flags.until, now));
  if (between) return true;
  logger.Info("nobody is fitted: it is not between " + flags.from + " and " + flags.until + " (--from, --until)");
  SLX_ASSIGN_OR_RETURN(const std::chrono::seconds since, TimeSince(flags.from, now, "--from"));
  SLX_RETURN_IF_ERROR(CheckNewestNight(flags.fit.run.store, {(int64_t{now} - since.count()) * kSecondNs}));
  return false;
}

void NightTeller::Hear(const NightEvent& event) {
  events_.push_back(event);
  if (json_ && written_.ok()) written_ = WriteStdout(ToJson(event) + "\n");
  const NightStatus status = StatusOf(events_);
  const std::string sentence = Sentence(event, status.Over(), status.chosen);
  if (sentence.empty()) return;
  const bool bad = event.kind == NightEventKind::kFailed || event.kind == NightEventKind::kSetAside;
  bad                                    ? logger_.Error(sentence)
  : event.kind == NightEventKind::kRetry ? logger_.Warning(sentence)
                                         : logger_.Info(sentence);
}

}  // namespace stratalux::fit
