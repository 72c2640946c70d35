// SPDX-License-Identifier: Apache-2.0
// A night: the store's queue of fits worked off by processes, each visitor in one of its own.
//
// The queue outlives everything (db/catalogue/job_store.h): a night that was killed, or that ended by its deadline, is
// gone on with by the next one, and a visitor's stages that were finished are not computed again. Two nights at once
// share the queue. A worker that crashes, hangs or eats memory costs its visitor an attempt, and nobody else anything.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "fitter/batch/night_choice.h"
#include "fitter/batch/night_log.h"
#include "fitter/batch/visit_cost.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct NightOptions {
  ChoiceOptions choice;
  // Of `stratalux-fit run`, by which choice.run was read: workers are given the same.
  std::vector<std::string> arguments;
  std::filesystem::path program;  // of the workers
  int workers = 1, threads = 1;   // threads: of each worker
  int nice = 10;
  int64_t memory_bytes = 0;  // for all workers together
  // Starts nobody who would not be finished by then.
  std::optional<std::chrono::steady_clock::time_point> deadline;
  std::chrono::seconds visit_limit{3600};  // of one attempt
  int attempts = 3;
  std::chrono::seconds back_off{30};        // before the second attempt; doubled before each that follows
  std::chrono::milliseconds lease{20'000};  // how long others wait for a night that was killed
  // Asked beside the store's own word, before a visitor begins and while it is fitted; not kOk: not any more.
  std::function<Status(const std::string& session)> also_asked = {};
  // What visitors took of whom the store itself does not know: cost, and sites of the camera.
  std::vector<std::pair<VisitCost, int64_t>> foreseen = {};

  [[nodiscard]] Status Validate() const;
};

struct NightOutcome {
  std::filesystem::path folder;
  int fitted = 0, failed = 0, dropped = 0;  // failed: for good, or set aside
  int64_t waiting = 0;                      // of the choice, who are left
  bool stopped = false, out_of_time = false;
};

// Puts who was chosen into the queue and works until it is empty, the deadline is near, or `stop` becomes readable
// (-1: never): then workers end and give their visitors back. `heard`: each event, once it is on the disk.
[[nodiscard]] Result<NightOutcome> RunNight(const NightOptions& options, const NightChoice& choice, int stop,
                                            const std::function<void(const NightEvent&)>& heard, Logger& logger);

}  // namespace stratalux::fit
