// SPDX-License-Identifier: Apache-2.0
// Data for whoever reads stdout; what people read while work runs goes to stderr (log.h).
#pragma once

#include <string_view>

#include "shared/base/result.h"

namespace stratalux {

// Behind what was logged before. kFailed where the bytes do not arrive: a full disk or a pipe that nobody reads any
// more must not pass for success.
[[nodiscard]] Status WriteStdout(std::string_view bytes);

}  // namespace stratalux
