// SPDX-License-Identifier: Apache-2.0
// What every page must keep to.
#pragma once

#include <string>

namespace stratalux::fit {

// The name of the first element that is closed out of order or left open; empty when all nest.
[[nodiscard]] std::string FirstBadlyNested(const std::string& html);
// The first thing that would be fetched from elsewhere, or run; empty for a page that stands alone.
[[nodiscard]] std::string FetchedFromOutside(const std::string& html);

}  // namespace stratalux::fit
