// SPDX-License-Identifier: Apache-2.0
// What leaves the index with a forgotten session: its row and all that hangs on it, what the log of accesses says of
// its visitor, and visitors of whom no session is left. Internal to db/; one transaction of the caller's.
#pragma once

#include <string>
#include <vector>

#include "db/catalogue/session_index.h"

namespace stratalux::db {

struct VisitorSession {
  std::string session, visitor;  // visitor: empty where there is none
};
// `visitors`: further ones, who go if they have no session left.
Status RemoveForgottenRows(SessionIndex& index, const std::vector<VisitorSession>& forgotten,
                           const std::vector<std::string>& visitors = {});

}  // namespace stratalux::db
