// SPDX-License-Identifier: Apache-2.0
// How deep the keys of a TOML text nest, before anything is made of it. Internal to shared/config.
#pragma once

#include <string_view>

#include "shared/base/result.h"

namespace stratalux {

// kUsage "line: ..." for a key of more than 16 parts, such as a.b.c. toml++ counts the levels of arrays and inline
// tables, but not those that the dots of a key make, and a table of some ten thousand levels cannot be destroyed:
// its destructor recurses. Text that is no TOML may pass: the parser refuses it.
[[nodiscard]] Status CheckKeyParts(std::string_view text);

}  // namespace stratalux
