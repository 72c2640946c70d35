// SPDX-License-Identifier: Apache-2.0
// Many kiosks and the machines that fit their visitors by night, as a discrete-event simulation: how long the queue
// gets, at which hour a night is done, how full the disks are. What a visitor costs is measured, not assumed.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "fitter/batch/visit_figures.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct FleetOptions {
  int kiosks = 50;
  double visitors = 300.0;  // of a kiosk and day, at random times (Poisson)
  double opens_h = 10.0, closes_h = 18.0;
  double between_s = 30.0;              // of a visit, besides its capture: position, consent, thanks
  double pull_every_h = 1.0;            // each kiosk by a timer of its own
  double link_mbit = 1000.0;            // of a kiosk
  double ingress_mbit = 10000.0;        // of the store; shared by the pulls under way
  double from_h = 20.0, until_h = 7.0;  // of a night; the same: round the clock
  int machines = 1, cores = 2;          // of each; a worker a core
  int attempts = 3;
  double away_share = 0.0;      // of kiosk and days: no pull reaches it all day
  double crash_share = 0.0;     // of attempts: die somewhere on their way
  double hopeless_share = 0.0;  // of visitors: each attempt dies
  double machine_days = 0.0;    // between failures of a machine, on average (exponential); 0: never
  double repair_h = 12.0;
  double frames_days = 30.0, artifacts_days = 2.0, fits_days = 365.0;  // kept in the store
  double kiosk_days = 7.0;                                             // kept on the kiosk, once pulled
  int days = 7;
  uint64_t seed = 1;
  [[nodiscard]] Status Validate() const;
};

// A day from midnight on and the night behind it.
struct FleetDay {
  int day = 0;
  int64_t came = 0, captured = 0;                  // came: the others left when the kiosk closed
  double longest_wait_s = 0.0, mean_wait_s = 0.0;  // before a kiosk
  int64_t pulled = 0, on_kiosks = 0;               // on_kiosks: captured and not pulled, in the morning
  int64_t queue_longest = 0, queue_left = 0;       // of the night; left: in the morning
  int64_t fitted = 0, set_aside = 0, attempts = 0;
  std::optional<double> done_h;  // hours from the day's midnight, 24 and more: the next day; none: not done in time
  double cores_busy = 0.0;       // share of the night's core hours
  double store_bytes = 0.0, fullest_kiosk_bytes = 0.0;  // in the morning
};

// Shares of what there is that the fleet asks for, by arithmetic: above 1 it cannot go on for ever.
struct FleetLoad {
  double kiosk = 0.0, link = 0.0, ingress = 0.0, cores = 0.0;
};
[[nodiscard]] FleetLoad LoadOf(const VisitFigures& figures, const FleetOptions& options);

// The same seed gives the same days.
[[nodiscard]] Result<std::vector<FleetDay>> SimulateFleet(const VisitFigures& figures, const FleetOptions& options);

}  // namespace stratalux::fit
