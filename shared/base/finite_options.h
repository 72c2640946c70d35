// SPDX-License-Identifier: Apache-2.0
// Numbers on the command line that are none: no comparison with nan is true, so that CLI11's ranges let it pass.
#pragma once

#include <cmath>
#include <cstdlib>
#include <string>

namespace stratalux {

// What is wrong with the text of an option; empty: nothing, or it is no number at all, of which the parser complains.
[[nodiscard]] inline std::string ComplaintOfNonFinite(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  const bool whole = !text.empty() && end == text.c_str() + text.size();
  return whole && !std::isfinite(value) ? "'" + text + "' is not a finite number" : "";
}

// Every real-valued option of `app` and of the commands below it that has a range takes finite numbers only. Those
// without one are judged where they are used. Call it once all are there; --help stays as it is. `App` is CLI::App,
// which this library does not link.
template <typename App>
void RangesTakeFiniteNumbers(App& app) {
  for (auto* option : app.get_options())
    if (option->get_type_name().rfind("FLOAT:", 0) == 0) option->check(ComplaintOfNonFinite);
  for (App* command : app.get_subcommands([](App*) { return true; })) RangesTakeFiniteNumbers(*command);
}

}  // namespace stratalux
