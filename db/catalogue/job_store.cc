// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/job_store.h"

#include <algorithm>
#include <ctime>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/base/retry.h"
#include "db/catalogue/session_index.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

constexpr std::pair<JobState, const char*> kStates[] = {
    {JobState::kQueued, "queued"}, {JobState::kRunning, "running"},    {JobState::kDone, "done"},
    {JobState::kFailed, "failed"}, {JobState::kSetAside, "set-aside"}, {JobState::kCancelled, "cancelled"}};

constexpr const char* kJobColumns =
    "SELECT j.id, j.key, j.kind, coalesce(s.id, ''), j.options_json, j.priority, j.not_before_wall_ns, j.max_attempts,"
    " j.state, j.attempts, j.owner, j.fence, j.last_error, j.created_wall_ns, coalesce(j.finished_wall_ns, 0)"
    " FROM jobs j LEFT JOIN sessions s ON s.number = j.session ";

Result<Job> ReadJob(const Statement& row) {
  Job job;
  job.id = row.Integer(0);
  job.request = {row.Text(1),
                 row.Text(2),
                 row.Text(3),
                 row.Text(4),
                 static_cast<int>(row.Integer(5)),
                 {row.Integer(6)},
                 static_cast<int>(row.Integer(7))};
  SLX_ASSIGN_OR_RETURN(job.state, ParseJobState(row.Text(8)));
  job.attempts = static_cast<int>(row.Integer(9));
  job.owner = row.Text(10);
  job.token = row.Integer(11);
  job.last_error = row.Text(12);
  job.created.ns = row.Integer(13);
  job.finished.ns = row.Integer(14);
  return job;
}

Result<std::vector<Job>> ReadJobs(Statement& select) {
  std::vector<Job> jobs;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return jobs;
    SLX_ASSIGN_OR_RETURN(jobs.emplace_back(), ReadJob(select));
  }
}

// Rows of state and number.
Result<std::map<JobState, int64_t>> ReadCounts(Statement& select) {
  std::map<JobState, int64_t> counts;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return counts;
    SLX_ASSIGN_OR_RETURN(const JobState state, ParseJobState(select.Text(0)));
    counts[state] = select.Integer(1);
  }
}

Status Check(const JobRequest& request) {
  if (request.key.empty() || request.kind.empty())
    return Status::Usage("a job needs a key and a kind (key '" + request.key + "', kind '" + request.kind + "')");
  if (request.max_attempts < 1)
    return Status::Usage("max_attempts " + std::to_string(request.max_attempts) + " must be at least 1");
  if (nlohmann::json::parse(request.options_json, nullptr, false).is_discarded())
    return Status::Usage("options of job '" + request.key + "' are not JSON: " + request.options_json);
  return Status::Ok();
}

Status CheckDuration(std::chrono::milliseconds duration) {
  constexpr std::chrono::hours kLongest(24 * 365);
  if (duration.count() > 0 && duration <= kLongest) return Status::Ok();
  return Status::Usage("a lease of " + std::to_string(duration.count()) + " ms; allowed: 1 ms .. a year");
}

// Where a job of this token is, it is running under it.
Result<std::optional<int64_t>> HolderOf(Connection& connection, int64_t token) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT id FROM jobs WHERE state = 'running' AND fence = ?1"));
  SLX_ASSIGN_OR_RETURN(const bool held, select.Bind(1, token).Step());
  return held ? std::optional(select.Integer(0)) : std::nullopt;
}

Status Outdated(Connection& connection, int64_t token) {
  std::string why = "its job was leased again, or was deleted with its session";
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT id, state FROM jobs WHERE fence = ?1"));
  SLX_ASSIGN_OR_RETURN(const bool known, select.Bind(1, token).Step());
  if (known) why = "job " + std::to_string(select.Integer(0)) + " is " + select.Text(1);
  return Status::Failed("lease " + std::to_string(token) + " is outdated: " + why + "; its work does not count");
}

Status BeginAnew(Connection& connection, int64_t id) {
  SLX_ASSIGN_OR_RETURN(auto update,
                       connection.Prepare("UPDATE jobs SET state = 'queued', attempts = 0, finished_wall_ns = NULL,"
                                          " boot = '', until_boot_ns = 0, not_before_wall_ns = 0 WHERE id = ?1"));
  return update.Bind(1, id).Run();
}

}  // namespace

const char* ToString(JobState state) {
  for (const auto& [value, name] : kStates)
    if (value == state) return name;
  return "?";
}

Result<JobState> ParseJobState(const std::string& text) {
  for (const auto& [value, name] : kStates)
    if (text == name) return value;
  return Status(StatusCode::kNewerSchema, "state of a job '" + text + "' is not known; use a newer stratalux");
}

Result<JobClock> JobClock::OfThisMachine() {
  const std::filesystem::path file = "/proc/sys/kernel/random/boot_id";
  SLX_ASSIGN_OR_RETURN(std::string boot_id, ReadFile(file));
  boot_id.erase(std::remove(boot_id.begin(), boot_id.end(), '\n'), boot_id.end());
  if (boot_id.empty()) return Status::Failed(file.string() + " is empty: leases need the boot id");
  const auto boot = [] {
    timespec now{};
    clock_gettime(CLOCK_BOOTTIME, &now);
    return std::chrono::seconds(now.tv_sec) + std::chrono::nanoseconds(now.tv_nsec);
  };
  return JobClock{boot, WallNow, boot_id};
}

struct JobStore::Impl {
  SessionIndex index;
  JobClock clock;
  std::chrono::milliseconds patience;

  [[nodiscard]] int64_t BootNow() const { return static_cast<int64_t>(clock.boot().count()); }
  [[nodiscard]] int64_t In(std::chrono::milliseconds time) const {
    return BootNow() + static_cast<int64_t>(std::chrono::nanoseconds(time).count());
  }

  // All of a call in one transaction, which takes SQLite's write lock first: nobody comes in between.
  template <typename Body>
  Status Change(const Body& body) {
    return RetryWhileBusy(patience, [&]() -> Status {
      SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(index.connection()));
      SLX_RETURN_IF_ERROR(body(index.connection()));
      return transaction.Commit();
    });
  }
  // `body` of the job that runs under this token.
  template <typename Body>
  Status ChangeHeld(int64_t token, const Body& body) {
    return Change([&](Connection& connection) -> Status {
      SLX_ASSIGN_OR_RETURN(const auto id, HolderOf(connection, token));
      if (!id) return Outdated(connection, token);
      return body(connection, *id);
    });
  }
  Status EndLeases(Connection& connection) const;
  Result<std::optional<int64_t>> Next(Connection& connection, const LeaseRequest& request) const;
};

JobStore::JobStore(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
JobStore::JobStore(JobStore&&) noexcept = default;
JobStore& JobStore::operator=(JobStore&&) noexcept = default;
JobStore::~JobStore() = default;

Result<JobStore> JobStore::Open(const std::filesystem::path& store, JobStoreOptions options) {
  if (!options.clock) {
    SLX_ASSIGN_OR_RETURN(options.clock, JobClock::OfThisMachine());
  }
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  return JobStore(std::unique_ptr<Impl>(new Impl{std::move(index), std::move(*options.clock), options.patience}));
}

Result<int64_t> JobStore::Enqueue(const JobRequest& request) {
  SLX_RETURN_IF_ERROR(Check(request));
  int64_t id = 0;
  const auto enqueue = [&](Connection& connection) -> Status {
    // A job of a worker that fell silent waits.
    if (request.anew) SLX_RETURN_IF_ERROR(impl_->EndLeases(connection));
    std::optional<int64_t> session;
    if (!request.session.empty()) {
      SLX_ASSIGN_OR_RETURN(session, impl_->index.NumberOf(request.session));
    }
    SLX_ASSIGN_OR_RETURN(
        auto insert,
        connection.Prepare("INSERT INTO jobs (key, session, kind, state, priority, options_json, created_wall_ns,"
                           " not_before_wall_ns, attempts, max_attempts, owner, fence, boot, until_boot_ns, last_error)"
                           " VALUES (?1, ?2, ?3, 'queued', ?4, ?5, ?6, ?7, 0, ?8, '', 0, '', 0, '')"
                           " ON CONFLICT (key) DO UPDATE SET priority = excluded.priority,"
                           " options_json = excluded.options_json, max_attempts = excluded.max_attempts"
                           " WHERE ?9 AND state IN ('queued', 'done')"));
    insert.Bind(1, request.key).Bind(3, request.kind).Bind(4, int64_t{request.priority}).Bind(5, request.options_json);
    insert.Bind(6, impl_->clock.wall().ns).Bind(7, request.not_before.ns).Bind(8, int64_t{request.max_attempts});
    insert.Bind(9, int64_t{request.anew});
    if (session) insert.Bind(2, *session);
    SLX_RETURN_IF_ERROR(insert.Run());
    SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT id, state FROM jobs WHERE key = ?1"));
    SLX_RETURN_IF_ERROR(select.Bind(1, request.key).Step().status());
    id = select.Integer(0);
    const bool done = select.Text(1) == ToString(JobState::kDone);
    return done && request.anew ? BeginAnew(connection, id) : Status::Ok();
  };
  SLX_RETURN_IF_ERROR(impl_->Change(enqueue));
  return id;
}

// Of workers that fell silent, and of the time before the machine started.
Status JobStore::Impl::EndLeases(Connection& connection) const {
  SLX_ASSIGN_OR_RETURN(
      auto end,
      connection.Prepare("UPDATE jobs SET state = CASE WHEN attempts < max_attempts THEN 'queued' ELSE 'set-aside' END,"
                         " finished_wall_ns = CASE WHEN attempts < max_attempts THEN NULL ELSE ?3 END,"
                         " boot = '', until_boot_ns = 0,"
                         " last_error = 'worker ' || owner || ' fell silent in attempt ' || attempts"
                         " WHERE state = 'running' AND (boot <> ?1 OR until_boot_ns <= ?2)"));
  return end.Bind(1, clock.boot_id).Bind(2, BootNow()).Bind(3, clock.wall().ns).Run();
}

Result<std::optional<int64_t>> JobStore::Impl::Next(Connection& connection, const LeaseRequest& request) const {
  SLX_ASSIGN_OR_RETURN(auto select,
                       connection.Prepare("SELECT id FROM jobs WHERE state = 'queued' AND not_before_wall_ns <= ?1"
                                          " AND (boot <> ?2 OR until_boot_ns <= ?3)"
                                          " AND (?4 = '[]' OR kind IN (SELECT value FROM json_each(?4)))"
                                          " AND (?5 = '[]' OR id IN (SELECT value FROM json_each(?5)))"
                                          " ORDER BY priority DESC, id LIMIT 1"));
  select.Bind(1, clock.wall().ns).Bind(2, clock.boot_id).Bind(3, BootNow());
  const nlohmann::json kinds = request.kinds;
  select.Bind(4, kinds.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace));
  select.Bind(5, nlohmann::json(request.jobs).dump());
  SLX_ASSIGN_OR_RETURN(const bool any, select.Step());
  return any ? std::optional(select.Integer(0)) : std::nullopt;
}

Result<std::optional<Job>> JobStore::Lease(const LeaseRequest& request) {
  SLX_RETURN_IF_ERROR(CheckDuration(request.duration));
  if (request.owner.empty()) return Status::Usage("a lease needs an owner");
  std::optional<Job> job;
  const auto lease = [&](Connection& connection) -> Status {
    SLX_RETURN_IF_ERROR(impl_->EndLeases(connection));
    SLX_ASSIGN_OR_RETURN(const auto id, impl_->Next(connection, request));
    if (!id) return Status::Ok();
    SLX_RETURN_IF_ERROR(connection.Execute("UPDATE job_fence SET last = last + 1"));
    SLX_ASSIGN_OR_RETURN(auto take,
                         connection.Prepare("UPDATE jobs SET state = 'running', attempts = attempts + 1, owner = ?2,"
                                            " boot = ?3, until_boot_ns = ?4, fence = (SELECT last FROM job_fence)"
                                            " WHERE id = ?1"));
    take.Bind(1, *id).Bind(2, request.owner).Bind(3, impl_->clock.boot_id).Bind(4, impl_->In(request.duration));
    SLX_RETURN_IF_ERROR(take.Run());
    SLX_ASSIGN_OR_RETURN(job, Find(*id));
    return Status::Ok();
  };
  SLX_RETURN_IF_ERROR(impl_->Change(lease));
  return job;
}

Status JobStore::Heartbeat(int64_t token, std::chrono::milliseconds duration) {
  SLX_RETURN_IF_ERROR(CheckDuration(duration));
  return impl_->ChangeHeld(token, [&](Connection& connection, int64_t id) -> Status {
    SLX_ASSIGN_OR_RETURN(auto update,
                         connection.Prepare("UPDATE jobs SET boot = ?2, until_boot_ns = ?3 WHERE id = ?1"));
    return update.Bind(1, id).Bind(2, impl_->clock.boot_id).Bind(3, impl_->In(duration)).Run();
  });
}

Status JobStore::Complete(int64_t token) {
  return impl_->ChangeHeld(token, [&](Connection& connection, int64_t id) -> Status {
    SLX_ASSIGN_OR_RETURN(auto update,
                         connection.Prepare("UPDATE jobs SET state = 'done', finished_wall_ns = ?2, boot = '',"
                                            " until_boot_ns = 0, last_error = '' WHERE id = ?1"));
    return update.Bind(1, id).Bind(2, impl_->clock.wall().ns).Run();
  });
}

Status JobStore::Fail(int64_t token, const std::string& error, std::optional<std::chrono::milliseconds> back_off) {
  return impl_->ChangeHeld(token, [&](Connection& connection, int64_t id) -> Status {
    SLX_ASSIGN_OR_RETURN(
        auto update,
        connection.Prepare("UPDATE jobs SET last_error = ?2, boot = ?5, until_boot_ns = ?6, finished_wall_ns ="
                           " CASE WHEN ?3 AND attempts < max_attempts THEN NULL ELSE ?4 END,"
                           " state = CASE WHEN NOT ?3 THEN 'failed' WHEN attempts < max_attempts THEN 'queued'"
                           " ELSE 'set-aside' END WHERE id = ?1"));
    update.Bind(1, id).Bind(2, error).Bind(3, int64_t{back_off.has_value()}).Bind(4, impl_->clock.wall().ns);
    update.Bind(5, impl_->clock.boot_id).Bind(6, impl_->In(back_off.value_or(std::chrono::milliseconds(0))));
    return update.Run();
  });
}

Status JobStore::Release(int64_t token) {
  return impl_->ChangeHeld(token, [&](Connection& connection, int64_t id) -> Status {
    SLX_ASSIGN_OR_RETURN(auto update,
                         connection.Prepare("UPDATE jobs SET state = 'queued', attempts = attempts - 1, boot = '',"
                                            " until_boot_ns = 0 WHERE id = ?1"));
    return update.Bind(1, id).Run();
  });
}

Status JobStore::Cancel(int64_t id) {
  return impl_->Change([&](Connection& connection) -> Status {
    SLX_ASSIGN_OR_RETURN(const Job job, Find(id));
    if (job.state != JobState::kQueued && job.state != JobState::kRunning)
      return Status::Usage("job " + std::to_string(id) + " is " + ToString(job.state) + " already");
    SLX_ASSIGN_OR_RETURN(auto update,
                         connection.Prepare("UPDATE jobs SET state = 'cancelled', finished_wall_ns = ?2, boot = '',"
                                            " until_boot_ns = 0 WHERE id = ?1"));
    return update.Bind(1, id).Bind(2, impl_->clock.wall().ns).Run();
  });
}

Status JobStore::Requeue(int64_t id) {
  return impl_->Change([&](Connection& connection) -> Status {
    SLX_ASSIGN_OR_RETURN(const Job job, Find(id));
    if (job.state == JobState::kQueued || job.state == JobState::kRunning)
      return Status::Usage("job " + std::to_string(id) + " is " + ToString(job.state) +
                           "; only a job that has ended can start again");
    return BeginAnew(connection, id);
  });
}

Result<Job> JobStore::Find(int64_t id) {
  SLX_ASSIGN_OR_RETURN(auto select, impl_->index.connection().Prepare(std::string(kJobColumns) + "WHERE j.id = ?1"));
  select.Bind(1, id);
  SLX_ASSIGN_OR_RETURN(auto jobs, ReadJobs(select));
  if (jobs.empty()) return Status::NotFound("no job " + std::to_string(id));
  return std::move(jobs.front());
}

Result<std::vector<Job>> JobStore::List(std::optional<JobState> state) {
  SLX_ASSIGN_OR_RETURN(auto select, impl_->index.connection().Prepare(std::string(kJobColumns) +
                                                                      "WHERE ?1 = '' OR j.state = ?1 ORDER BY j.id"));
  select.Bind(1, std::string(state ? ToString(*state) : ""));
  return ReadJobs(select);
}

Result<std::map<JobState, int64_t>> JobStore::Count(const std::string& kind) {
  SLX_ASSIGN_OR_RETURN(auto select,
                       impl_->index.connection().Prepare("SELECT state, sum(jobs) FROM job_counts WHERE jobs > 0"
                                                         " AND (?1 = '' OR kind = ?1) GROUP BY state"));
  select.Bind(1, kind);
  return ReadCounts(select);
}

Result<std::map<JobState, int64_t>> JobStore::CountOf(const std::vector<int64_t>& ids) {
  SLX_ASSIGN_OR_RETURN(auto select,
                       impl_->index.connection().Prepare("SELECT state, count(*) FROM jobs WHERE id IN"
                                                         " (SELECT value FROM json_each(?1)) GROUP BY state"));
  select.Bind(1, nlohmann::json(ids).dump());
  return ReadCounts(select);
}

Status CheckLease(Connection& connection, int64_t token) {
  SLX_ASSIGN_OR_RETURN(const auto id, HolderOf(connection, token));
  return id ? Status::Ok() : Outdated(connection, token);
}

}  // namespace stratalux::db
