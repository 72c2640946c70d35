// SPDX-License-Identifier: Apache-2.0
// What the verbs of `stratalux-fit batch` share: options, and how a night's events are told.
#pragma once

#include <chrono>
#include <cstdint>
#include <ctime>
#include <filesystem>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "fitter/apps/fit_flags.h"
#include "fitter/batch/night.h"
#include "fitter/batch/night_status.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

inline constexpr double kGib = 1024.0 * 1024.0 * 1024.0;

struct BatchFlags {
  FitFlags fit;
  std::vector<CLI::Option*> fit_options;
  std::string order = "newest", from, until;
  int most = 0, workers = 0, threads = 0, attempts = 3;
  double memory_gib = 0.0, visit_limit_min = 60.0;
  std::vector<int64_t> jobs;
  std::string night = "latest";
  bool all = false, json = false, text = false;
  std::string out;
};

// `shard`, `submit` and `merge`, into the verb `batch`.
void AddClusterCommands(CLI::App& batch, int& exit_code);

void AddStore(CLI::App& verb, BatchFlags& flags);
void AddWorkers(CLI::App& verb, BatchFlags& flags);
// Store, who is fitted, and how.
void AddChoice(CLI::App& verb, BatchFlags& flags);
void AddAttempts(CLI::App& verb, BatchFlags& flags);
void AddFrom(CLI::App& verb, BatchFlags& flags, CLI::Option& until);
// Program, number, threads, memory and patience of the workers.
Status SetWorkers(const BatchFlags& flags, NightOptions& night);
// The file of this program, which workers and tasks run.
[[nodiscard]] Result<std::filesystem::path> OwnProgram();

[[nodiscard]] Result<ChoiceOptions> ChoiceOf(const BatchFlags& flags);
// A night as all of these options say, begun `now`.
[[nodiscard]] Result<NightOptions> NightOf(const BatchFlags& flags, std::time_t now);
// Whether `now` is between --from and --until, or there is no --from. Where it is not, nobody is begun, and the status
// says how the last night went: kDegraded where none has begun since the last --from, or see CheckNewestNight(). A unit
// that is begun again behind its span, or too late, does not look as if all were well.
[[nodiscard]] Result<bool> IsTimeForANight(const BatchFlags& flags, std::time_t now, Logger& logger);

// A line of JSON an event on stdout, or none; a sentence for people on stderr.
class NightTeller {
 public:
  NightTeller(Logger& logger, const BatchFlags& flags) : logger_(logger), json_(flags.json) {}
  void Hear(const NightEvent& event);
  [[nodiscard]] const Status& written() const { return written_; }

 private:
  Logger& logger_;
  const bool json_;
  std::vector<NightEvent> events_;
  Status written_;
};

template <typename Body>
void OnCall(CLI::App& verb, int& exit_code, Body body) {
  verb.callback([body, &exit_code] {
    Logger logger;
    const Status status = body(logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
