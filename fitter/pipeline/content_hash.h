// SPDX-License-Identifier: Apache-2.0
// XXH3-128 of a text as 32 hex digits: identity of inputs, options and program version.
#pragma once

#include <string>

namespace stratalux::fit {

[[nodiscard]] std::string ContentHashOf(const std::string& text);

}  // namespace stratalux::fit
