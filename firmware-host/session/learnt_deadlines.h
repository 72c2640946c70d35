// SPDX-License-Identifier: Apache-2.0
// The delays that a selftest saw, kept for the captures that follow (docs/file-formats.md, "Learnt delays").
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/sequence/deadlines.h"
#include "firmware-host/session/state_file.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// `folder`/deadlines.json; of the simulated rig deadlines-simulated.json, so that it never stands for a real one.
[[nodiscard]] std::filesystem::path DelaysFile(const std::filesystem::path& folder,
                                               const std::optional<SimulatedRigOptions>& simulated);

// Replaces what was kept, whole or not at all, with what makes it valid: the camera, its driver, format, size and pace,
// the projectors with their lines or displays; of the simulated rig scene and sizes. Exposure times are none of that:
// delays count from the end of an exposure.
[[nodiscard]] Status KeepDelays(const std::filesystem::path& folder, const RigConfig& config,
                                const std::optional<SimulatedRigOptions>& simulated, const RigDelays& delays);

// What a capture of this rig goes by: `config.deadline_ms` where it is set, else as learnt, else the default. Never
// fails: what cannot be read, or was learnt of another rig, is `refused`.
[[nodiscard]] RigDeadlines ChooseDeadlines(const std::filesystem::path& folder, const RigConfig& config,
                                           const std::optional<SimulatedRigOptions>& simulated);

}  // namespace stratalux::rig
