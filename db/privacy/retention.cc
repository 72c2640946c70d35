// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/retention.h"

#include <limits>
#include <map>

#include "db/catalogue/consent_rows.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/session_index.h"

namespace stratalux::db {
namespace {

constexpr int64_t kNsPerDay = int64_t{24} * 3600 * 1'000'000'000;
// As the index sessions_by_end has it.
constexpr const char* kEnd = "CASE WHEN finished_wall_ns > 0 THEN finished_wall_ns ELSE started_wall_ns END";

using DueByNumber = std::map<int64_t, DueSession>;

// The newest end that is due: so many days back, and never of the future.
int64_t DueUntil(int days, WallNs now) {
  int64_t kept = 0, until = 0;
  if (__builtin_mul_overflow(static_cast<int64_t>(days), kNsPerDay, &kept) ||
      __builtin_sub_overflow(now.ns, kept, &until))
    return std::numeric_limits<int64_t>::min();
  return std::min(until, now.ns);
}

Status AddPastTheirDays(Connection& connection, Retention retention, int days, WallNs now, DueByNumber& due) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT number, id, " + std::string(kEnd) +
                                                       " FROM sessions WHERE kind = 'visitor' AND retention = ?1 AND " +
                                                       kEnd + " <= ?2"));
  select.Bind(1, std::string(ToString(retention))).Bind(2, DueUntil(days, now));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    const int64_t age = (now.ns - select.Integer(2)) / kNsPerDay;
    due[select.Integer(0)] = {select.Text(1), std::string(ToString(retention)) + ": " + std::to_string(age) +
                                                  " days old, kept for " + std::to_string(days)};
  }
}

// Of the visitors who withdrew one; what they gave anew holds for new sessions.
Status AddWithdrawn(Connection& connection, DueByNumber& due) {
  SLX_ASSIGN_OR_RETURN(
      auto select,
      connection.Prepare("SELECT s.number, s.id, s.visitor, s.consent_json FROM (SELECT DISTINCT visitor FROM consents"
                         " WHERE withdrawn_wall_ns IS NOT NULL) w CROSS JOIN sessions s ON s.visitor = w.visitor"
                         " WHERE s.kind = 'visitor'"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    SLX_ASSIGN_OR_RETURN(const auto withdrawn,
                         WithdrawnOn(connection, select.Text(2), ConsentFromJson(select.Text(3)).given_wall));
    if (withdrawn) due[select.Integer(0)] = {select.Text(1), "consent withdrawn on " + ToIso8601(*withdrawn)};
  }
}

}  // namespace

Result<std::vector<DueSession>> DueSessions(const std::filesystem::path& store, const RetentionDays& days, WallNs now) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  Connection& connection = index.connection();
  DueByNumber due;
  for (const auto& [retention, kept] :
       {std::pair(Retention::kShort, days.short_days), std::pair(Retention::kStandard, days.standard_days),
        std::pair(Retention::kLong, days.long_days)})
    SLX_RETURN_IF_ERROR(AddPastTheirDays(connection, retention, kept, now, due));
  SLX_RETURN_IF_ERROR(AddWithdrawn(connection, due));
  std::vector<DueSession> sessions;
  for (auto& [number, session] : due) sessions.push_back(std::move(session));
  return sessions;
}

}  // namespace stratalux::db
