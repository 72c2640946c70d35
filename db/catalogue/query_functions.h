// SPDX-License-Identifier: Apache-2.0
// The SQL functions of ReadOnlyIndex, as plain C++. Internal to db/.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "db/base/sqlite.h"

namespace stratalux::db {

// Steps of the plan that PlanOptionsToJson wrote; nullopt where the text is no plan.
[[nodiscard]] std::optional<int64_t> PlannedSteps(const std::string& plan_json);
// "no proven frame for steps 3, 17 and 5 more" -> "no proven frame for steps N, N and N more".
[[nodiscard]] std::string ReasonClass(const std::string& reason);
// {1, 0, 0, 1, 0, 1} -> "1-2, 4".
[[nodiscard]] std::string MissingRuns(const std::vector<bool>& seen);
// Days a session is kept; nullopt: for ever (or no such class).
[[nodiscard]] std::optional<int64_t> DaysKept(const std::string& retention);

Status RegisterQueryFunctions(const Connection& connection);

}  // namespace stratalux::db
