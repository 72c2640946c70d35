// SPDX-License-Identifier: Apache-2.0
// What somebody who mistyped a command of one of the programs may have meant.
#pragma once

#include <string>
#include <vector>

#include "shared/base/nearest.h"

namespace stratalux {

// "no command 'shwo'; did you mean 'show'?", also behind a command with words of its own ("no consent command 'giv';
// ..."); empty where no command is mistyped. `App` is CLI::App, which this library does not link.
template <typename App>
[[nodiscard]] std::string MistypedCommand(const App& top, int argc, const char* const* argv) {
  const App* app = &top;
  std::string what = "command";
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    std::vector<std::string> names;
    for (const App* command : app->get_subcommands([](const App*) { return true; }))
      names.push_back(command->get_name());
    if (names.empty() || word.empty() || word.front() == '-') return {};
    if (std::string text = UnknownName(what, word, names); !text.empty()) return text;
    for (const App* command : app->get_subcommands([](const App*) { return true; }))
      if (command->get_name() == word) app = command;
    what = word + " command";
  }
  return {};
}

}  // namespace stratalux
