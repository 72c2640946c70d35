// SPDX-License-Identifier: Apache-2.0
// `PROGRAM manual man|bash|zsh|fish`: what the build installs as manual page and completions. For packagers, so --help
// does not list it.
#pragma once

#include <optional>
#include <string>

#include <CLI/CLI.hpp>

namespace stratalux {

// The page or script that the command line asks for; nullopt: it asks for something else. Dated by $SOURCE_DATE_EPOCH,
// else today (UTC).
[[nodiscard]] std::optional<std::string> AskedManual(const CLI::App& app, const std::string& program, int argc,
                                                     const char* const* argv);

}  // namespace stratalux
