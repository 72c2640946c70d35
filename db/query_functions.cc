// SPDX-License-Identifier: Apache-2.0
#include "db/query_functions.h"

#include <cctype>
#include <map>

#include <sqlite3.h>

#include "shared/capture/plan.h"

namespace stratalux::db {
namespace {

std::string TextOf(sqlite3_value* value) {
  const auto* text = reinterpret_cast<const char*>(sqlite3_value_text(value));
  return text == nullptr ? std::string() : std::string(text, static_cast<size_t>(sqlite3_value_bytes(value)));
}

void ReturnInteger(sqlite3_context* context, const std::optional<int64_t>& value) {
  value ? sqlite3_result_int64(context, *value) : sqlite3_result_null(context);
}

using PlanCache = std::map<std::string, std::optional<int64_t>>;

// The sessions of a rig share a few plans: each is built once a connection.
void PlannedStepsFunction(sqlite3_context* context, int, sqlite3_value** arguments) {
  auto& cache = *static_cast<PlanCache*>(sqlite3_user_data(context));
  const std::string text = TextOf(arguments[0]);
  auto known = cache.find(text);
  if (known == cache.end()) known = cache.emplace(text, PlannedSteps(text)).first;
  ReturnInteger(context, known->second);
}

void ReasonClassFunction(sqlite3_context* context, int, sqlite3_value** arguments) {
  const std::string text = ReasonClass(TextOf(arguments[0]));
  sqlite3_result_text(context, text.data(), static_cast<int>(text.size()), SQLITE_TRANSIENT);
}

void RetentionDaysFunction(sqlite3_context* context, int, sqlite3_value** arguments) {
  ReturnInteger(context, RetentionDays(TextOf(arguments[0])));
}

using Function = void (*)(sqlite3_context*, int, sqlite3_value**);

int Register(sqlite3* handle, const char* name, Function function, void* data = nullptr,
             void (*destroy)(void*) = nullptr) {
  // Innocuous: views of an untrusted schema may call it.
  constexpr int kFlags = SQLITE_UTF8 | SQLITE_DETERMINISTIC | SQLITE_INNOCUOUS;
  return sqlite3_create_function_v2(handle, name, 1, kFlags, data, function, nullptr, nullptr, destroy);
}

}  // namespace

std::optional<int64_t> PlannedSteps(const std::string& plan_json) {
  const auto options = PlanOptionsFromJson(plan_json);
  if (!options.ok()) return std::nullopt;
  const auto plan = BuildPlan(*options);
  if (!plan.ok()) return std::nullopt;
  return static_cast<int64_t>(plan->steps.size());
}

std::string ReasonClass(const std::string& reason) {
  std::string text;
  bool in_number = false;
  for (size_t i = 0; i < reason.size(); ++i) {
    const bool digit = std::isdigit(static_cast<unsigned char>(reason[i])) != 0;
    // "12.5" and "1/2" are one number each.
    const bool joint = in_number && (reason[i] == '.' || reason[i] == '/') && i + 1 < reason.size() &&
                       std::isdigit(static_cast<unsigned char>(reason[i + 1])) != 0;
    if (digit && !in_number) text += 'N';
    in_number = digit || joint;
    if (!in_number) text += reason[i];
  }
  return text;
}

std::optional<int64_t> RetentionDays(const std::string& retention) {
  if (retention == "short") return 30;
  if (retention == "standard") return 365;
  if (retention == "long") return 3650;
  return std::nullopt;
}

Status RegisterQueryFunctions(const Connection& connection) {
  const auto drop = [](void* cache) { delete static_cast<PlanCache*>(cache); };
  if (Register(connection.handle(), "planned_steps", PlannedStepsFunction, new PlanCache, drop) != SQLITE_OK ||
      Register(connection.handle(), "reason_class", ReasonClassFunction) != SQLITE_OK ||
      Register(connection.handle(), "retention_days", RetentionDaysFunction) != SQLITE_OK)
    return connection.Error("register functions");
  return Status::Ok();
}

}  // namespace stratalux::db
