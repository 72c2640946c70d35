// SPDX-License-Identifier: Apache-2.0
// Scripts by which shells complete a program's commands, options and, where --help names them all, values.
#pragma once

#include <string>

#include "shared/manual/command_table.h"

namespace stratalux {

// For /usr/share/bash-completion/completions/PROGRAM; what has no list is left to the shell, which offers files.
[[nodiscard]] std::string BashCompletion(const CommandEntry& program);
// For a folder of zsh's $fpath, as _PROGRAM.
[[nodiscard]] std::string ZshCompletion(const CommandEntry& program);
// For /usr/share/fish/vendor_completions.d/PROGRAM.fish.
[[nodiscard]] std::string FishCompletion(const CommandEntry& program);

}  // namespace stratalux
