// SPDX-License-Identifier: Apache-2.0
// SQLite's VACUUM as something that can be ended. Internal to db/.
#pragma once

#include <functional>

#include "shared/base/result.h"

namespace stratalux::db {

class Connection;

// `goes_on`, asked every few microseconds, may end it: kTryAgain, and the database is as it was.
Status Vacuum(Connection& connection, const std::function<bool()>& goes_on = {});

}  // namespace stratalux::db
