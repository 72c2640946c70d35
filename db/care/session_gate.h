// SPDX-License-Identifier: Apache-2.0
// The one gate into the index: what a session's files say is looked at wholly before any of it becomes a row.
#pragma once

#include "db/care/session_rebuild.h"
#include "shared/base/result.h"

namespace stratalux::db {

// Its frames (CheckHeader, db/segment/header_check.h), its manifest's values, its plan, its fits. kNewerSchema for what
// a later version may have written, kIntegrity for what none writes; names session and frame or value.
// RebuildSession asks; who has a RebuiltSession from elsewhere asks again.
[[nodiscard]] Status CheckSession(const RebuiltSession& session);

}  // namespace stratalux::db
