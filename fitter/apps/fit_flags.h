// SPDX-License-Identifier: Apache-2.0
// How visitors are fitted, as options of a command line: of `run`, of the stages by name and of `batch`.
#pragma once

#include <string>
#include <vector>

#include "fitter/pipeline/run_options.h"
#include "shared/base/result.h"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace stratalux::fit {

struct FitFlags {
  RunOptions run;
  std::string shift = "refracted", geometry = "reconstructed", gain = "model", mode = "tied", reading = "gather",
              distance = "tangent", directional = "off", surface = "model", background = "off", prior = "auto",
              neighbours = "on", offset = "on", motion = "on", maps = "on";
};

// The options that were added; `flags` outlives the parsing.
std::vector<CLI::Option*> AddFitOptions(CLI::App& verb, FitFlags& flags);
// What they say; kUsage names option and value.
[[nodiscard]] Result<RunOptions> RunOptionsOf(const FitFlags& flags);
// Those that were given, as another program is given the same.
[[nodiscard]] std::vector<std::string> GivenArguments(const std::vector<CLI::Option*>& options);

// What such arguments say; kUsage for what is none of them.
[[nodiscard]] Result<RunOptions> RunOptionsOf(const std::vector<std::string>& given);

}  // namespace stratalux::fit
