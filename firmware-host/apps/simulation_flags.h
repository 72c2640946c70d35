// SPDX-License-Identifier: Apache-2.0
// The simulated rig on the command line: --simulate and what only it knows.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/simulated/scene/description.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/result.h"

namespace stratalux::rig {

struct SimulationFlags {
  std::string scene;                // empty: the devices
  std::optional<std::string> size;  // WIDTHxHEIGHT
  std::string events;               // the FIFO; empty: none
  uint64_t seed = 1;
  std::vector<std::string> faults;
  double fault_rate = 0.0;
  uint64_t fault_seed = 1;
  bool no_scattering = false;
  bool no_noise = false;
};

// kUsage names --size and what it expects.
[[nodiscard]] Status ApplySize(const SimulationFlags& flags, RigConfig& config);
// The rig that --simulate asks for, of `config` with its flags applied; nullopt: the devices. kUsage names the flag.
[[nodiscard]] Result<std::optional<SimulatedRigOptions>> SimulationFrom(const SimulationFlags& flags, int board_pose,
                                                                        const RigConfig& config);
// What is wrong with the flag's text; empty: nothing. CLI::Range lets nan pass, and CLI11 would wrap a negative seed
// and cut a long one.
[[nodiscard]] std::string ComplaintOfChance(const std::string& text);
[[nodiscard]] std::string ComplaintOfSeed(const std::string& text);

// --simulate alone.
template <typename Command>
void AddSimulate(Command& command, SimulationFlags& flags, const std::string& what) {
  command
      .add_option("--simulate", flags.scene,
                  what + "; a scene file (docs/simulated-rig.md) or one of these: " + PlainSceneNames())
      ->expected(0, 1)
      ->default_str("head");
}

// All of them, of a command of the command line.
template <typename Command>
void AddSimulationFlags(Command& command, SimulationFlags& flags) {
  AddSimulate(command, flags, "use the simulated rig");
  command.add_option("--fault", flags.faults,
                     "simulation: KIND@NUMBER[xCOUNT][=VALUE], repeatable; such as frame_lost@17, lamp_drift@40=0.95");
  command
      .add_option("--fault-rate", flags.fault_rate, "simulation: chance of a random fault at each exposure and pulse")
      ->check(ComplaintOfChance);
  command.add_option("--fault-seed", flags.fault_seed, "simulation: another seed, other random faults")
      ->capture_default_str();
  command.add_option("--seed", flags.seed, "simulation: another seed, another face, skin and noise")
      ->check(ComplaintOfSeed)
      ->capture_default_str();
  command.add_option("--size", flags.size, "simulation: size of the camera mosaic, WIDTHxHEIGHT (default: 1392x1042)");
  command.add_flag("--no-scattering", flags.no_scattering, "simulation: opaque matt skin (ablation)");
  command.add_flag("--no-noise", flags.no_noise, "simulation: a camera without noise");
  command.add_option("--simulate-events", flags.events,
                     "simulation: a FIFO, created if missing, that takes events: start, door open, door closed, "
                     "estop press, estop release, unplug camera, plug camera, unplug lines, plug lines");
}

// What only the simulated rig knows is not left unheard by a real one.
template <typename Command>
[[nodiscard]] Status CheckSimulationFlags(const Command& command) {
  if (command.count("--simulate") > 0) return Status::Ok();
  for (const char* name : {"--fault", "--fault-rate", "--fault-seed", "--seed", "--size", "--no-scattering",
                           "--no-noise", "--simulate-events"}) {
    const auto* given = command.get_option(name);
    if (given->count() == 0) continue;
    const std::string value = given->get_expected_max() > 0 ? " " + given->results().front() : "";
    return Status::Usage(name + value + ": only the simulated rig has it; add --simulate, or leave it out");
  }
  return Status::Ok();
}

}  // namespace stratalux::rig
