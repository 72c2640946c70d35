// SPDX-License-Identifier: Apache-2.0
// What a program that works on a session, or hands it out, says first of one that is not whole.
#pragma once

#include <string>

#include "shared/capture/session.h"

namespace stratalux::db {

// "session s000017-0badcafe is degraded: 78 of 492 frames are missing: 414 to 491; ..."; "" for a complete one.
[[nodiscard]] std::string Shortfall(const SessionInfo& info);

}  // namespace stratalux::db
