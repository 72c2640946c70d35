// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/timing_flags.h"

#include <sstream>

#include "firmware-host/apps/plan_command.h"
#include "firmware-host/session/learnt_deadlines.h"
#include "firmware-host/simulated/simulation_file.h"

namespace stratalux::rig {
namespace {

Status CheckRange(const char* flag, double ms, double low, double high) {
  if (ms >= low && ms <= high) return Status::Ok();  // nan is not
  std::ostringstream message;
  message << flag << " " << ms << " is out of range, allowed: " << low << " .. " << high << " ms";
  return Status::Usage(message.str());
}

}  // namespace

Status ApplyTimingFlags(const TimingFlags& flags, RigConfig& config) {
  config.settle_ms = flags.settle_ms.value_or(config.settle_ms);
  SLX_RETURN_IF_ERROR(CheckRange("--settle", config.settle_ms, 0.0, kLongestSettleMs));
  if (!flags.deadline_ms) return Status::Ok();
  config.deadline_ms = flags.deadline_ms;
  return CheckRange("--deadline", *flags.deadline_ms, kShortestDeadlineMs, kLongestDeadlineMs);
}

Result<TimingInUse> ChooseTiming(const TimingFlags& flags, const RigConfig& config,
                                 const std::optional<SimulatedRigOptions>& simulated) {
  TimingInUse timing;
  timing.deadlines = ChooseDeadlines(StateFolder(), config, simulated);
  if (flags.deadline_ms) timing.deadlines.source = DeadlineSource::kFlag;
  if (simulated) {
    SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(simulated->scene));
    timing.visit = TimingOf(config, simulation.devices.timing);
  } else {
    timing.visit = TimingOf(config, timing.deadlines.delays ? &*timing.deadlines.delays : nullptr);
  }
  return timing;
}

}  // namespace stratalux::rig
