// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/retention.h"

#include <algorithm>
#include <optional>

#include "db/catalogue/consent.h"
#include "db/catalogue/session_store.h"

namespace stratalux::db {
namespace {

constexpr int64_t kNsPerDay = int64_t{24} * 3600 * 1'000'000'000;

std::optional<int> DaysOf(Retention retention, const RetentionDays& days) {
  switch (retention) {
    case Retention::kShort:
      return days.short_days;
    case Retention::kStandard:
      return days.standard_days;
    case Retention::kLong:
      return days.long_days;
    case Retention::kKeep:
      break;
  }
  return std::nullopt;
}

std::optional<WallNs> WithdrawnOn(const SessionInfo& info, const std::vector<ConsentRow>& consents) {
  const ConsentRow* newest = nullptr;
  for (const ConsentRow& row : consents) {
    if (row.visitor != info.visitor) continue;
    if (row.consent.given_wall == info.consent.given_wall) return row.withdrawn;
    newest = &row;
  }
  return newest == nullptr ? std::nullopt : newest->withdrawn;
}

std::string ReasonOf(const SessionInfo& info, const std::vector<ConsentRow>& consents, const RetentionDays& days,
                     WallNs now) {
  if (const auto withdrawn = WithdrawnOn(info, consents)) return "consent withdrawn on " + ToIso8601(*withdrawn);
  const auto kept = DaysOf(info.retention, days);
  const WallNs end = info.finished_wall.ns > 0 ? info.finished_wall : info.started_wall;
  const int64_t age = now.ns > end.ns ? (now.ns - end.ns) / kNsPerDay : 0;
  if (!kept || age < *kept || now < end) return "";
  return std::string(ToString(info.retention)) + ": " + std::to_string(age) + " days old, kept for " +
         std::to_string(*kept);
}

}  // namespace

Result<std::vector<DueSession>> DueSessions(const std::filesystem::path& store, const RetentionDays& days, WallNs now) {
  SLX_ASSIGN_OR_RETURN(const auto opened, SessionStore::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto rows, opened.ListSessions());
  SLX_ASSIGN_OR_RETURN(const auto consents, ListConsents(store, ""));
  std::vector<DueSession> due;
  for (const SessionRow& row : rows) {
    if (row.info.kind != SessionKind::kVisitor) continue;
    if (std::string reason = ReasonOf(row.info, consents, days, now); !reason.empty())
      due.push_back({row.info.id, std::move(reason)});
  }
  std::reverse(due.begin(), due.end());
  return due;
}

}  // namespace stratalux::db
