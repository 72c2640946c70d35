// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/retention.h"

#include <limits>
#include <map>

#include "db/catalogue/session_index.h"

namespace stratalux::db {
namespace {

constexpr int64_t kNsPerDay = int64_t{24} * 3600 * 1'000'000'000;
// As the index sessions_by_end has it.
constexpr const char* kEnd = "CASE WHEN finished_wall_ns > 0 THEN finished_wall_ns ELSE started_wall_ns END";

constexpr const char* kWhatIsThere =
    "s.number, s.id, s.frame_count, (SELECT count(*) FROM fits f WHERE f.session = s.number), s.stored_bytes,"
    " s.key_id IS NOT NULL";
constexpr int kMoment = 6;  // behind them: of the end, of the withdrawal

using DueByNumber = std::map<int64_t, DueSession>;

void Add(const Statement& select, std::string reason, DueByNumber& due) {
  DueSession& session = due[select.Integer(0)];
  session.id = select.Text(1);
  session.reason = std::move(reason);
  session.frames = select.Integer(2);
  session.fits = select.Integer(3);
  session.bytes = select.Integer(4);
  session.encrypted = select.Integer(5) != 0;
}

// The newest end that is due: so many days back, and never of the future.
int64_t DueUntil(int days, WallNs now) {
  int64_t kept = 0, until = 0;
  if (__builtin_mul_overflow(static_cast<int64_t>(days), kNsPerDay, &kept) ||
      __builtin_sub_overflow(now.ns, kept, &until))
    return std::numeric_limits<int64_t>::min();
  return std::min(until, now.ns);
}

Status AddPastTheirDays(Connection& connection, Retention retention, int days, WallNs now, DueByNumber& due) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT " + std::string(kWhatIsThere) + ", " + kEnd +
                                                       " FROM sessions s WHERE kind = 'visitor' AND retention = ?1"
                                                       " AND " +
                                                       kEnd + " <= ?2"));
  select.Bind(1, std::string(ToString(retention))).Bind(2, DueUntil(days, now));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    const int64_t age = (now.ns - select.Integer(kMoment)) / kNsPerDay;
    Add(select,
        std::string(ToString(retention)) + ": " + std::to_string(age) + " days old, kept for " + std::to_string(days),
        due);
  }
}

// Of the visitors who withdrew one; what they gave anew holds for new sessions.
Status AddWithdrawn(Connection& connection, DueByNumber& due) {
  SLX_ASSIGN_OR_RETURN(
      auto select, connection.Prepare(
                       "SELECT " + std::string(kWhatIsThere) +
                       ", (SELECT c.withdrawn_wall_ns FROM session_consents c WHERE c.session = s.number) AS withdrawn"
                       " FROM (SELECT DISTINCT visitor FROM consents WHERE withdrawn_wall_ns IS NOT NULL) w"
                       " CROSS JOIN sessions s ON s.visitor = w.visitor"
                       " WHERE s.kind = 'visitor' AND withdrawn IS NOT NULL"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    Add(select, "consent withdrawn on " + ToIso8601(WallNs{select.Integer(kMoment)}), due);
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
  sessions.reserve(due.size());
  while (!due.empty()) sessions.push_back(std::move(due.extract(due.begin()).mapped()));
  return sessions;
}

}  // namespace stratalux::db
