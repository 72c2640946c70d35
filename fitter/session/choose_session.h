// SPDX-License-Identifier: Apache-2.0
// Which session a verb works on.
#pragma once

#include <string>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// What a verb needs of the newest session.
enum class SessionUse {
  kFrames,       // any frame
  kVisitor,      // a visitor's capture that is complete or degraded
  kCalibration,  // a capture of boards or a target that did not fail
  kFit           // a visitor's capture with a fit
};

// `selector` as it is, unless it is "latest": then the newest session that serves the use, which is said. kNotFound
// says what the store lacks, and the command that makes it.
[[nodiscard]] Result<std::string> ChooseSession(const std::string& store_folder, const std::string& selector,
                                                SessionUse use, Logger& logger);

}  // namespace stratalux::fit
