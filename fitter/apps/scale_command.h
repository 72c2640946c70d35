// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit batch scale`: a fleet's nights, simulated on the measured cost of a visitor.
#pragma once

#include <CLI/CLI.hpp>

namespace stratalux::fit {

void AddScaleCommand(CLI::App& batch, int& exit_code);

}  // namespace stratalux::fit
