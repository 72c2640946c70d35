// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/retention.h"

#include <algorithm>
#include <limits>
#include <map>
#include <optional>
#include <unordered_set>

#include <sys/stat.h>

#include "db/care/incoming.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/session_index.h"
#include "db/ledger/ledger.h"

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

std::string AgeText(const std::string& what, int64_t end, int days, WallNs now) {
  return what + ": " + std::to_string((now.ns - end) / kNsPerDay) + " days old, kept for " + std::to_string(days);
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
    Add(select, AgeText(ToString(retention), select.Integer(kMoment), days, now), due);
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

// What stands in the ledger alone: of a withdrawal that was broken off, of a transfer.
Status AddWithdrawnByLedger(Connection& connection, const std::filesystem::path& store, DueByNumber& due) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT " + std::string(kWhatIsThere) +
                                                       " FROM sessions s WHERE s.kind = 'visitor' AND s.id = ?1"));
  for (const auto& [id, at] : ledger.withdrawn()) {
    SLX_ASSIGN_OR_RETURN(const bool here, select.Bind(1, id).Step());
    if (here) Add(select, "consent withdrawn on " + ToIso8601(at), due);
    select.Reset();
  }
  return Status::Ok();
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
  SLX_RETURN_IF_ERROR(AddWithdrawnByLedger(connection, store, due));
  SLX_RETURN_IF_ERROR(AddWithdrawn(connection, due));
  std::vector<DueSession> sessions;
  sessions.reserve(due.size());
  while (!due.empty()) sessions.push_back(std::move(due.extract(due.begin()).mapped()));
  return sessions;
}

namespace {

namespace fs = std::filesystem;

// "" while it is not due.
std::string WhyDue(const SessionInfo& info, const RetentionDays& days, WallNs now) {
  const std::optional<int> kept = info.retention == Retention::kShort      ? std::optional(days.short_days)
                                  : info.retention == Retention::kStandard ? std::optional(days.standard_days)
                                  : info.retention == Retention::kLong     ? std::optional(days.long_days)
                                                                           : std::nullopt;
  const int64_t end = info.finished_wall.ns > 0 ? info.finished_wall.ns : info.started_wall.ns;
  if (info.kind != SessionKind::kVisitor || !kept || end > DueUntil(*kept, now)) return "";
  return AgeText(ToString(info.retention), end, *kept, now);
}

// When the newest of its files was written; as rsync keeps times, that is when the source wrote it.
int64_t NewestWrite(const std::vector<fs::path>& places) {
  int64_t newest = 0;
  const auto look = [&newest](const fs::path& path) {
    struct stat status {};
    if (lstat(path.c_str(), &status) == 0)
      newest = std::max(newest, int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec);
  };
  for (const fs::path& place : places) {
    std::error_code error;
    bool any = false;
    for (auto entry = fs::recursive_directory_iterator(place, error);
         !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
      if (entry->is_directory(error)) continue;
      look(entry->path());
      any = true;
    }
    if (!any) look(place);
  }
  return newest;
}

// The first manifest that can be read; kNewerSchema where there are such of a later version alone, kNotFound where
// there is none.
Result<SessionInfo> InfoIn(const std::vector<fs::path>& places) {
  Status newer = Status::NotFound("no manifest");
  for (const fs::path& place : places) {
    auto info = ReadManifest(place);
    if (info.ok()) return info;
    if (info.status().code() == StatusCode::kNewerSchema) newer = info.status();
  }
  return newer;
}

Result<std::unordered_set<std::string>> ListedIds(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT id FROM sessions"));
  std::unordered_set<std::string> ids;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return ids;
    ids.insert(select.Text(0));
  }
}

// What a later program's manifest says of class and end cannot be read: never due here, and named in `newer`.
std::string WhyLeftoverIsDue(const IncomingSession& leftover, const Ledger& ledger, const RetentionDays& days,
                             WallNs now, std::vector<std::string>& newer) {
  if (const auto withdrawn = ledger.WithdrawnAt(leftover.id)) return "consent withdrawn on " + ToIso8601(*withdrawn);
  const auto info = InfoIn(leftover.places);
  if (info.ok()) return WhyDue(*info, days, now);
  if (info.status().code() == StatusCode::kNewerSchema) {
    newer.push_back(info.status().message());
    return "";
  }
  const int shortest = std::min({days.short_days, days.standard_days, days.long_days});
  const int64_t newest = NewestWrite(leftover.places);
  return newest <= DueUntil(shortest, now) ? AgeText("no manifest", newest, shortest, now) : "";
}

}  // namespace

Result<IncomingDue> DueIncoming(const fs::path& store, const RetentionDays& days, WallNs now) {
  const auto found = {ListIncoming(store), ListKeptManifests(store)};
  if (std::all_of(found.begin(), found.end(), [](const auto& list) { return list.empty(); })) return IncomingDue();
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  SLX_ASSIGN_OR_RETURN(const auto listed, ListedIds(store));
  std::map<std::string, IncomingSession> leftovers;
  for (const auto& list : found)
    for (const IncomingSession& session : list) {
      if (listed.contains(session.id)) continue;  // goes with its session
      IncomingSession& known = leftovers[session.id];
      known.id = session.id;
      known.places.insert(known.places.end(), session.places.begin(), session.places.end());
    }
  IncomingDue found_due;
  for (const auto& [id, leftover] : leftovers)
    if (std::string why = WhyLeftoverIsDue(leftover, ledger, days, now, found_due.newer); !why.empty())
      found_due.sessions.push_back({.id = id, .reason = std::move(why)});
  return found_due;
}

}  // namespace stratalux::db
