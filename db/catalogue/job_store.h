// SPDX-License-Identifier: Apache-2.0
// Work that is to be done once: enqueued under a key, leased by one worker at a time, taken over where a worker fell
// silent, set aside with its last error where it fails again and again (docs/file-formats.md, "Jobs").
//
// Every lease has a token, larger than all before it in this store. Whoever lost its lease (another worker took over,
// the job was cancelled or forgotten with its session) is refused from then on: kFailed, saying who has it. Leases and
// back-offs are measured on CLOCK_BOOTTIME and the boot id: setting the clock changes none, and a restart of the
// machine ends all. Therefore all workers of one store run on one machine. Thread-bound: one JobStore a thread.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::db {

class Connection;

enum class JobState {
  kQueued,
  kRunning,
  kDone,
  kFailed,    // its worker said that trying again is no use
  kSetAside,  // used up its attempts
  kCancelled
};
[[nodiscard]] const char* ToString(JobState state);
[[nodiscard]] Result<JobState> ParseJobState(const std::string& text);

struct JobRequest {
  std::string key;  // unique in the store, such as "fit s000012-0badcafe 7f3a"
  std::string kind;
  std::string session = {};  // id; empty: a job of no session alone. With its session the job goes, too
  std::string options_json = "{}";
  int priority = 0;  // higher first; among equals the oldest first
  WallNs not_before = {};
  int max_attempts = 3;
  // A job of this key that waits is from now on as this request says (priority, options, attempts); one that is done
  // begins so anew: what it had made is gone.
  bool anew = false;
};

struct Job {
  int64_t id = 0;
  JobRequest request;
  JobState state = JobState::kQueued;
  int attempts = 0;
  std::string owner;  // that has it, or had it last
  int64_t token = 0;  // of its newest lease
  std::string last_error;
  WallNs created, finished;  // finished: 0 until it is
};

struct JobClock {
  std::function<std::chrono::nanoseconds()> boot;  // since the machine started, also while it sleeps
  std::function<WallNs()> wall;
  std::string boot_id;
  [[nodiscard]] static Result<JobClock> OfThisMachine();
};

struct JobStoreOptions {
  std::optional<JobClock> clock;               // this machine's
  std::chrono::milliseconds patience{60'000};  // while other programs write the index
};

struct LeaseRequest {
  std::string owner;               // for people: host, process
  std::vector<std::string> kinds;  // empty: any
  std::chrono::milliseconds duration{60'000};
  std::vector<int64_t> jobs = {};  // their ids; empty: any
};

class JobStore {
 public:
  [[nodiscard]] static Result<JobStore> Open(const std::filesystem::path& store, JobStoreOptions options = {});
  ~JobStore();
  JobStore(JobStore&&) noexcept;
  JobStore& operator=(JobStore&&) noexcept;

  // The job's id: of a new one, or of the one that has this key, whatever became of it. kNotFound for a session that is
  // not there; kUsage for what no job can be.
  [[nodiscard]] Result<int64_t> Enqueue(const JobRequest& request);
  // The job with the highest priority, the oldest of those, that is due; nullopt where none is.
  [[nodiscard]] Result<std::optional<Job>> Lease(const LeaseRequest& request);
  // From now on for `duration`. Good also for a lease that has run out as long as nobody else was looking for work.
  Status Heartbeat(int64_t token, std::chrono::milliseconds duration);
  Status Complete(int64_t token);
  // Queued again after `back_off`, or set aside where this was its last attempt; nullopt: failed for good.
  Status Fail(int64_t token, const std::string& error, std::optional<std::chrono::milliseconds> back_off);
  // Queued again at once, the attempt not counted: for a worker that is told to stop.
  Status Release(int64_t token);

  // Whoever runs it hears so at its next call. kUsage for a job that has ended.
  Status Cancel(int64_t id);
  // A job that has ended, however, begins anew, its attempts forgotten. kUsage for one that waits or runs.
  Status Requeue(int64_t id);

  [[nodiscard]] Result<Job> Find(int64_t id);
  // Oldest first.
  [[nodiscard]] Result<std::vector<Job>> List(std::optional<JobState> state = {});
  [[nodiscard]] Result<std::map<JobState, int64_t>> Count(const std::string& kind = {});  // empty: of any
  // Of these; who is gone with its session is left out.
  [[nodiscard]] Result<std::map<JobState, int64_t>> CountOf(const std::vector<int64_t>& ids);

 private:
  struct Impl;
  explicit JobStore(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// kOk while `token` is that of a job's current lease; a part of the caller's transaction. Internal to db/.
Status CheckLease(Connection& connection, int64_t token);

}  // namespace stratalux::db
