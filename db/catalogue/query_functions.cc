// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/query_functions.h"

#include <cctype>
#include <map>
#include <memory>

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
  if (sqlite3_value_type(arguments[0]) == SQLITE_NULL) return sqlite3_result_null(context);
  const std::string text = ReasonClass(TextOf(arguments[0]));
  sqlite3_result_text(context, text.data(), static_cast<int>(text.size()), SQLITE_TRANSIENT);
}

void RetentionDaysFunction(sqlite3_context* context, int, sqlite3_value** arguments) {
  ReturnInteger(context, DaysKept(TextOf(arguments[0])));
}

// The steps one group has seen; SQLite keeps the pointer for it.
using Seen = std::vector<bool>;

void MissingStepsStep(sqlite3_context* context, int, sqlite3_value** arguments) {
  auto** seen = static_cast<Seen**>(sqlite3_aggregate_context(context, sizeof(Seen*)));
  const int64_t step = sqlite3_value_int64(arguments[0]);
  constexpr int64_t kMostSteps = 1'000'000;  // a hundred times the longest plan
  if (seen == nullptr || step < 0 || step > kMostSteps) return;
  if (*seen == nullptr) *seen = new Seen;
  if (static_cast<size_t>(step) >= (*seen)->size()) (*seen)->resize(static_cast<size_t>(step) + 1);
  (**seen)[static_cast<size_t>(step)] = true;
}

void MissingStepsFinal(sqlite3_context* context) {
  auto** seen = static_cast<Seen**>(sqlite3_aggregate_context(context, 0));
  if (seen == nullptr || *seen == nullptr) return sqlite3_result_null(context);
  const std::unique_ptr<Seen> owned(*seen);
  const std::string text = MissingRuns(*owned);
  sqlite3_result_text(context, text.data(), static_cast<int>(text.size()), SQLITE_TRANSIENT);
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

std::string MissingRuns(const std::vector<bool>& seen) {
  std::string text;
  for (size_t first = 0; first < seen.size(); ++first) {
    if (seen[first]) continue;
    size_t last = first;
    while (last + 1 < seen.size() && !seen[last + 1]) ++last;
    text += (text.empty() ? "" : ", ") + std::to_string(first) + (last > first ? "-" + std::to_string(last) : "");
    first = last;
  }
  return text;
}

std::optional<int64_t> DaysKept(const std::string& retention) {
  if (retention == "short") return 30;
  if (retention == "standard") return 365;
  if (retention == "long") return 3650;
  return std::nullopt;
}

Status RegisterQueryFunctions(const Connection& connection) {
  const auto drop = [](void* cache) { delete static_cast<PlanCache*>(cache); };
  if (Register(connection.handle(), "planned_steps", PlannedStepsFunction, new PlanCache, drop) != SQLITE_OK ||
      sqlite3_create_function_v2(connection.handle(), "missing_steps", 1, SQLITE_UTF8 | SQLITE_INNOCUOUS, nullptr,
                                 nullptr, MissingStepsStep, MissingStepsFinal, nullptr) != SQLITE_OK ||
      Register(connection.handle(), "reason_class", ReasonClassFunction) != SQLITE_OK ||
      Register(connection.handle(), "retention_days", RetentionDaysFunction) != SQLITE_OK)
    return connection.Error("register functions");
  return Status::Ok();
}

}  // namespace stratalux::db
