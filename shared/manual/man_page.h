// SPDX-License-Identifier: Apache-2.0
// A program's manual page, section 1, in the language of mdoc(7).
#pragma once

#include <string>

#include "shared/manual/command_table.h"

namespace stratalux {

// `date`: of the page, as "November 3, 2026". The page ends with a newline.
[[nodiscard]] std::string ManPage(const CommandEntry& program, const std::string& version, const std::string& date);

}  // namespace stratalux
