// SPDX-License-Identifier: Apache-2.0
// How long things take: what the command line says of it, of capture, selftest and plan show alike, and what follows
// from it, the configuration, a selftest and the simulated rig.
#pragma once

#include <optional>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/sequence/deadlines.h"
#include "firmware-host/sequence/visit_time.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct TimingFlags {
  std::optional<double> settle_ms, deadline_ms;  // unset: as the configuration says
};

// --settle and --deadline, of a command of the command line.
template <typename Command>
void AddTimingFlags(Command& command, TimingFlags& flags) {
  command.add_option("--settle", flags.settle_ms, "settling time of each step, ms (default: 2)");
  command.add_option(
      "--deadline", flags.deadline_ms,
      "deadline for a SYNC edge, and for a frame after its exposure, ms (default: learnt by selftest, else 500)");
}
// kUsage for what is out of range; names the flag.
[[nodiscard]] Status ApplyTimingFlags(const TimingFlags& flags, RigConfig& config);

struct TimingInUse {
  VisitTiming visit;  // the simulated rig's own, exactly; of devices as configured, else as learnt
  RigDeadlines deadlines;
};
// Of `config` with `flags` applied; what was learnt lies in StateFolder(). Fails with the simulation's file alone.
[[nodiscard]] Result<TimingInUse> ChooseTiming(const TimingFlags& flags, const RigConfig& config,
                                               const std::optional<SimulatedRigOptions>& simulated);

}  // namespace stratalux::rig
