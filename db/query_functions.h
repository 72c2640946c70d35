// SPDX-License-Identifier: Apache-2.0
// The SQL functions of ReadOnlyIndex, as plain C++. Internal to db/.
#pragma once

#include <optional>
#include <string>

#include "db/sqlite.h"

namespace stratalux::db {

// Steps of the plan that PlanOptionsToJson wrote; nullopt where the text is no plan.
[[nodiscard]] std::optional<int64_t> PlannedSteps(const std::string& plan_json);
// "no proven frame for steps 3, 17 and 5 more" -> "no proven frame for steps N, N and N more".
[[nodiscard]] std::string ReasonClass(const std::string& reason);
// Days a session is kept; nullopt: for ever (or no such class).
[[nodiscard]] std::optional<int64_t> RetentionDays(const std::string& retention);

Status RegisterQueryFunctions(const Connection& connection);

}  // namespace stratalux::db
