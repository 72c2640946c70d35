// SPDX-License-Identifier: Apache-2.0
// What the fitter leaves of an encrypted visit: an artifact and a fit, sealed.
#pragma once

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// An artifact of two files, one of them of two pieces; a fit of the other one, under the artifact's place as a hard
// link has it, and of a page of its own; metrics.json, plain.
[[nodiscard]] Status FitSealed(SessionStore& store, const std::string& session);

}  // namespace stratalux::db
