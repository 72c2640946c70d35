// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/night.h"

#include <algorithm>
#include <csignal>
#include <memory>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include <nlohmann/json.hpp>
#include <poll.h>
#include <unistd.h>

#include "db/catalogue/deletions.h"
#include "db/catalogue/job_store.h"
#include "db/catalogue/session_store.h"
#include "db/keys/rig_key.h"
#include "db/keys/session_key.h"
#include "fitter/batch/worker.h"
#include "shared/base/formatted.h"
#include "shared/base/read_file.h"

namespace stratalux::fit {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;
using std::chrono::seconds;
namespace fs = std::filesystem;

constexpr const char* kKind = "fit";
constexpr milliseconds kLook{1000};  // at memory, time limits and jobs that come due
constexpr seconds kGrace{10};        // from SIGTERM to SIGKILL
// Exit codes of `stratalux-fit run` (shared/base/result.h).
bool WorthTryingAgain(int exit_code) {
  const auto code = static_cast<StatusCode>(exit_code);
  return code == StatusCode::kFailed || code == StatusCode::kBusy || code == StatusCode::kTryAgain;
}

double InSeconds(Clock::duration time) { return std::chrono::duration<double>(time).count(); }
std::string InGib(int64_t bytes) { return Formatted("%.2f GiB", static_cast<double>(bytes) / (int64_t{1} << 30)); }

// What the worker said last of its failure.
std::string LastError(const fs::path& log) {
  constexpr std::string_view kMark = "error: ";
  const auto text = ReadFile(log);
  if (!text.ok()) return "";
  const size_t at = text->rfind(kMark);
  if (at == std::string::npos) return "";
  return text->substr(at + kMark.size(), text->find('\n', at) - at - kMark.size());
}

std::string FitOf(const db::Job& job) {
  const auto what = nlohmann::json::parse(job.request.options_json, nullptr, false);
  const auto fit = what.is_object() ? what.find("fit") : what.end();
  return fit != what.end() && fit->is_string() ? fit->get<std::string>() : "";
}

struct Attempt {
  db::Job job;
  int64_t sites = 0;
  fs::path log;
  Worker worker;
  Clock::time_point next_heartbeat;
  std::string killed = {};     // why we ended it; its attempt counts
  std::string no_longer = {};  // why it may not be fitted any more
  std::string lost = {};       // why the job is not ours any more
  std::optional<Clock::time_point> asked_to_end = {};
};

class Night {
 public:
  Night(const NightOptions& options, int stop, const std::function<void(const NightEvent&)>& heard, db::JobStore jobs,
        db::SessionStore store, NightLog log, CostHistory history, Logger& logger)
      : options_(options),
        stop_(stop),
        heard_(heard),
        jobs_(std::move(jobs)),
        store_(std::move(store)),
        log_(std::move(log)),
        history_(std::move(history)),
        logger_(logger) {
    outcome_.folder = log_.folder();
  }

  Result<NightOutcome> Run(const NightChoice& choice);

 private:
  Status Tell(NightEvent event);
  Status Enqueue(const NightChoice& choice);
  Status CloseWhoIsFitted();
  [[nodiscard]] Result<std::optional<db::Job>> Lease(std::vector<int64_t> ids);
  // Until nobody is left, the time is up or it is told to stop.
  Status Work();
  // False: nothing can be started now.
  Result<bool> StartOne();
  [[nodiscard]] bool Fits() const;
  [[nodiscard]] bool InTime() const;
  // The session's row. kUsage: consent was withdrawn or it was forgotten; kNotFound: it is not listed any more; others:
  // not known.
  [[nodiscard]] Result<db::SessionRow> MayGoOn(const std::string& session) const;
  Status Launch(const db::Job& job);
  Status Watch();
  Status LookAt(Attempt& attempt);
  Status Reap();
  Status NotBegun(const db::Job& job, NightEvent event, const Status& why);
  Status Fail(const db::Job& job, NightEvent event, const std::string& reason, bool again);
  Status TellWhoWasSetAside();
  Status Drop(const db::Job& job, NightEvent event, const std::string& reason);
  Status Finish(Attempt& attempt, const WorkerEnd& end);
  void Wait() const;
  Status GiveBack();
  [[nodiscard]] std::optional<VisitCost> Foresee(int64_t sites) const { return history_.Foresee(sites); }

  const NightOptions& options_;
  const int stop_;
  const std::function<void(const NightEvent&)>& heard_;
  db::JobStore jobs_;
  db::SessionStore store_;
  NightLog log_;
  CostHistory history_;
  Logger& logger_;
  NightOutcome outcome_;
  std::vector<std::unique_ptr<Attempt>> running_;
  std::vector<int64_t> chosen_;    // jobs of tonight
  std::set<int64_t> told_failed_;  // of these
  int64_t largest_sites_ = 0;      // of whom the queue may give us next
  Clock::time_point began_ = Clock::now();
};

Status Night::Tell(NightEvent event) {
  event.at = WallNow();
  SLX_RETURN_IF_ERROR(log_.Add(event));
  if (heard_) heard_(event);
  return Status::Ok();
}

// Whoever failed in each attempt waits for `batch retry`.
Status Night::Enqueue(const NightChoice& choice) {
  std::vector<LeftOutVisit> left_out = choice.left_out;
  std::vector<ChosenVisit> chosen;
  for (size_t i = 0; i < choice.visits.size(); ++i) {
    const ChosenVisit& visit = choice.visits[i];
    const nlohmann::json what = {{"arguments", options_.arguments}, {"fit", visit.fit}, {"sites", visit.sites}};
    db::JobRequest request{JobKey(visit), kKind, visit.session, what.dump()};
    request.priority = static_cast<int>(choice.visits.size() - i);
    request.max_attempts = options_.attempts;
    // Done, and yet not there: its fit was removed, or its artifacts are of an older version.
    request.anew = true;
    const Result<int64_t> id = jobs_.Enqueue(request);
    if (id.status().code() == StatusCode::kNotFound) continue;  // forgotten since
    SLX_RETURN_IF_ERROR(id.status());
    SLX_ASSIGN_OR_RETURN(const db::Job job, jobs_.Find(*id));
    if (job.state == db::JobState::kFailed || job.state == db::JobState::kSetAside ||
        job.state == db::JobState::kCancelled) {
      left_out.push_back({visit.session, LeftOut::kSetAside,
                          "job " + std::to_string(*id) + " is " + ToString(job.state) + ": " + job.last_error +
                              "; `stratalux-fit batch retry " + std::to_string(*id) + "` starts it again"});
      continue;
    }
    largest_sites_ = std::max(largest_sites_, visit.sites);
    chosen.push_back(visit);
    chosen_.push_back(*id);
  }
  NightEvent began{.kind = NightEventKind::kBegan, .count = static_cast<int64_t>(chosen.size())};
  SLX_RETURN_IF_ERROR(Tell(began));
  for (const LeftOutVisit& visit : left_out) SLX_RETURN_IF_ERROR(Tell(EventOf(visit)));
  // Theirs alone: they wait on, and the next night closes them.
  if (const Status closed = CloseWhoIsFitted(); !closed.ok()) logger_.Warning(closed.message());
  return Status::Ok();
}

// A night that was killed behind the entry of a fit left its job waiting, and nobody chooses who is fitted.
Status Night::CloseWhoIsFitted() {
  const std::set<int64_t> chosen(chosen_.begin(), chosen_.end());
  SLX_ASSIGN_OR_RETURN(const auto waiting, jobs_.List(db::JobState::kQueued));
  for (const db::Job& job : waiting) {
    if (job.request.kind != kKind || chosen.contains(job.id)) continue;
    const std::string fit = FitOf(job);
    const auto fits = store_.ListFits(job.request.session);
    if (fits.status().code() == StatusCode::kNotFound) continue;  // forgotten
    SLX_RETURN_IF_ERROR(fits.status());
    if (std::none_of(fits->begin(), fits->end(), [&](const db::FitRow& row) { return row.id == fit; })) continue;
    SLX_ASSIGN_OR_RETURN(const auto held, Lease({job.id}));
    if (held) SLX_RETURN_IF_ERROR(jobs_.Complete(held->token));
  }
  return Status::Ok();
}

// Only of tonight's: others wait for a night that chooses them, by the options that they wait with.
Result<std::optional<db::Job>> Night::Lease(std::vector<int64_t> ids) {
  if (ids.empty()) return std::optional<db::Job>();
  return jobs_.Lease({Formatted("night %d", static_cast<int>(getpid())), {kKind}, options_.lease, std::move(ids)});
}

// Beside those who run; alone anybody may try.
bool Night::Fits() const {
  if (running_.empty()) return true;
  const auto next = Foresee(largest_sites_);
  if (!next) return false;
  int64_t used = next->peak_bytes;
  for (const auto& attempt : running_) {
    const auto foreseen = Foresee(attempt->sites);
    used += std::max(attempt->worker.ResidentBytes(), foreseen ? foreseen->peak_bytes : 0);
  }
  return used <= options_.memory_bytes;
}

bool Night::InTime() const {
  if (!options_.deadline) return true;
  const auto foreseen = Foresee(largest_sites_);
  const seconds takes(static_cast<int64_t>(foreseen ? foreseen->cpu_seconds / options_.threads : 0.0));
  return Clock::now() + takes < *options_.deadline;
}

Result<bool> Night::StartOne() {
  if (static_cast<int>(running_.size()) >= options_.workers || !Fits()) return false;
  if (!InTime()) {
    outcome_.out_of_time = true;
    return false;
  }
  SLX_ASSIGN_OR_RETURN(const auto job, Lease(chosen_));
  if (!job) return false;
  if (Status launched = Launch(*job); !launched.ok()) {
    // Refused where that attempt has failed already.
    if (const Status released = jobs_.Release(job->token); !released.ok()) logger_.Debug(released.message());
    return launched;
  }
  return true;
}

Result<db::SessionRow> Night::MayGoOn(const std::string& session) const {
  if (options_.also_asked) SLX_RETURN_IF_ERROR(options_.also_asked(session));
  SLX_RETURN_IF_ERROR(db::RefuseForgotten(options_.choice.run.store, session));
  SLX_ASSIGN_OR_RETURN(auto row, store_.FindSession(session));
  SLX_RETURN_IF_ERROR(MayStillBeFitted(options_.choice.run.store, session, row.info.visitor));
  return row;
}

Status Night::Launch(const db::Job& job) {
  const std::string& session = job.request.session;
  const auto what = nlohmann::json::parse(job.request.options_json, nullptr, false);
  auto attempt = std::make_unique<Attempt>();
  attempt->job = job;
  NightEvent event{.kind = NightEventKind::kStarted, .session = session, .attempt = job.attempts};
  std::vector<std::string> command = {
      options_.program.string(), "run", session, "--store", options_.choice.run.store, "--job",
      std::to_string(job.token)};
  try {
    event.fit = what.at("fit").get<std::string>();
    attempt->sites = what.at("sites").get<int64_t>();
    for (const auto& argument : what.at("arguments")) command.push_back(argument.get<std::string>());
  } catch (const nlohmann::json::exception& error) {
    return Fail(job, event, std::string("its options are not those of a night: ") + error.what(), false);
  }
  const auto row = MayGoOn(session);
  if (!row.ok()) return NotBegun(job, event, row.status());
  attempt->log = log_.WorkerLog(session, job.attempts);
  WorkerOptions start{command, attempt->log, options_.threads, options_.nice};
  if (db::KeyId key_id{}; db::FromHex(row->key_id, key_id).ok()) {
    auto key = db::FindKeyOf(options_.choice.run.store, session, key_id);
    if (!key.ok()) return NotBegun(job, event, key.status());
    start.keys.push_back(*key);
  }
  attempt->next_heartbeat = Clock::now() + options_.lease / 4;
  SLX_RETURN_IF_ERROR(Tell(event));
  Result<Worker> worker = Worker::Start(start);
  if (!worker.ok()) return Fail(job, event, worker.status().message(), true);
  attempt->worker = std::move(*worker);
  running_.push_back(std::move(attempt));
  return Status::Ok();
}

// Dropped where it may not be fitted any more; else tried again where another time may help.
Status Night::NotBegun(const db::Job& job, NightEvent event, const Status& why) {
  if (const Status may = MayGoOn(job.request.session).status(); Forbids(may)) return Drop(job, event, may.message());
  // A key that is missing stays missing: it was chosen by who had it, or another night asked for it.
  return Fail(job, event, why.message(), !Forbids(why));
}

// This attempt; the next one waits longer each time.
Status Night::Fail(const db::Job& job, NightEvent event, const std::string& reason, bool again) {
  const bool last = job.attempts >= job.request.max_attempts;
  const auto back_off = options_.back_off * (1 << std::min(job.attempts - 1, 10));
  const Status failed = jobs_.Fail(job.token, reason, again ? std::optional<milliseconds>(back_off) : std::nullopt);
  // Refused: its session went, or another worker has it.
  if (!failed.ok() && failed.code() != StatusCode::kFailed) return failed;
  event.kind = !again ? NightEventKind::kFailed : last ? NightEventKind::kSetAside : NightEventKind::kRetry;
  event.reason = reason;
  if (event.kind == NightEventKind::kRetry) return Tell(event);
  ++outcome_.failed;
  told_failed_.insert(job.id);
  return Tell(event);
}

// The lease of a night that was killed in somebody's last attempt ran out tonight: nobody else says so.
Status Night::TellWhoWasSetAside() {
  for (const int64_t id : chosen_) {
    if (told_failed_.contains(id)) continue;
    const auto job = jobs_.Find(id);
    if (job.status().code() == StatusCode::kNotFound) continue;  // forgotten
    SLX_RETURN_IF_ERROR(job.status());
    if (job->state != db::JobState::kSetAside && job->state != db::JobState::kFailed) continue;
    ++outcome_.failed;
    const bool set_aside = job->state == db::JobState::kSetAside;
    SLX_RETURN_IF_ERROR(Tell({.kind = set_aside ? NightEventKind::kSetAside : NightEventKind::kFailed,
                              .session = job->request.session,
                              .fit = FitOf(*job),
                              .attempt = job->attempts,
                              .reason = job->last_error}));
  }
  return Status::Ok();
}

// A worker that was begun in the moment of a forgetting may have written since.
Status Night::Drop(const db::Job& job, NightEvent event, const std::string& reason) {
  ++outcome_.dropped;
  if (const Status cancelled = jobs_.Cancel(job.id); !cancelled.ok()) logger_.Debug(cancelled.message());
  const auto forgotten = db::IsForgotten(options_.choice.run.store, job.request.session);
  if (forgotten.ok() && *forgotten) SLX_RETURN_IF_ERROR(log_.Remove(job.request.session));
  event.kind = NightEventKind::kDropped;
  event.reason = reason;
  return Tell(event);
}

Status Night::LookAt(Attempt& attempt) {
  if (attempt.worker.Age() > options_.visit_limit && attempt.killed.empty()) {
    attempt.killed = Formatted("not finished after %.0f min", InSeconds(options_.visit_limit) / 60.0);
    attempt.worker.Signal(SIGKILL);
  }
  if (attempt.asked_to_end && Clock::now() > *attempt.asked_to_end + kGrace) attempt.worker.Signal(SIGKILL);
  if (Clock::now() < attempt.next_heartbeat) return Status::Ok();
  attempt.next_heartbeat = Clock::now() + options_.lease / 4;
  if (!attempt.no_longer.empty() || !attempt.lost.empty()) return Status::Ok();
  const Status ours = jobs_.Heartbeat(attempt.job.token, options_.lease);
  const Status may = MayGoOn(attempt.job.request.session).status();
  if (Forbids(may)) attempt.no_longer = may.message();
  // A night that was held up for longer than a lease: somebody else has the visitor, and goes on.
  if (!Forbids(may) && !ours.ok() && ours.code() != StatusCode::kBusy) attempt.lost = ours.message();
  if (attempt.no_longer.empty() && attempt.lost.empty()) return Status::Ok();
  attempt.worker.Signal(SIGTERM);
  attempt.asked_to_end = Clock::now();
  return Status::Ok();
}

// Together they keep to the memory: whoever is furthest beyond what was foreseen goes.
Status Night::Watch() {
  int64_t used = 0, most_beyond = 0;
  Attempt* worst = nullptr;
  for (const auto& attempt : running_) {
    SLX_RETURN_IF_ERROR(LookAt(*attempt));
    const int64_t resident = attempt->worker.ResidentBytes();
    const auto foreseen = Foresee(attempt->sites);
    const int64_t beyond = resident - (foreseen ? foreseen->peak_bytes : 0);
    used += resident;
    if (worst == nullptr || beyond > most_beyond) {
      worst = attempt.get();
      most_beyond = beyond;
    }
  }
  if (worst == nullptr || used <= options_.memory_bytes || !worst->killed.empty()) return Status::Ok();
  worst->killed = "took " + InGib(worst->worker.ResidentBytes()) + " of memory; all workers together may use " +
                  InGib(options_.memory_bytes) + " (--memory)";
  worst->worker.Signal(SIGKILL);
  return Status::Ok();
}

Status Night::Finish(Attempt& attempt, const WorkerEnd& end) {
  NightEvent event{.kind = NightEventKind::kDone,
                   .session = attempt.job.request.session,
                   .attempt = attempt.job.attempts,
                   .seconds = InSeconds(attempt.worker.Age()),
                   .cpu_seconds = end.cpu_seconds,
                   .peak_bytes = end.peak_bytes};
  event.fit = FitOf(attempt.job);
  if (end.exit_code == 0) {
    const Status completed = jobs_.Complete(attempt.job.token);
    if (!completed.ok() && completed.code() != StatusCode::kFailed) return completed;
    // Refused: another worker has the job, or its session went. What it entered before that stands.
    if (!completed.ok()) logger_.Warning(completed.message());
    history_.AddMeasured({end.cpu_seconds, end.peak_bytes}, attempt.sites);
    ++outcome_.fitted;
    return Tell(event);
  }
  if (!attempt.lost.empty()) {
    event.kind = NightEventKind::kReleased;
    event.reason = attempt.lost;
    return Tell(event);
  }
  // A worker that does not find its session says no more than that something is not there: it may be a frame.
  if (attempt.no_longer.empty() && end.exit_code == static_cast<int>(StatusCode::kNotFound))
    if (const Status may = MayGoOn(event.session).status(); Forbids(may)) attempt.no_longer = may.message();
  if (!attempt.no_longer.empty()) return Drop(attempt.job, event, attempt.no_longer);
  event.reason = !attempt.killed.empty() ? attempt.killed
                 : end.signal != 0       ? Formatted("ended by signal %d (%s)", end.signal, strsignal(end.signal))
                                         : LastError(attempt.log);
  if (event.reason.empty())
    event.reason = "ended with exit code " + std::to_string(end.exit_code) + " and gave no reason";
  // In the same words twice: it is no accident.
  const bool repeats = end.exit_code >= 0 && event.reason == attempt.job.last_error;
  const bool again = end.exit_code < 0 || (WorthTryingAgain(end.exit_code) && !repeats);
  return Fail(attempt.job, event, event.reason, again);
}

Status Night::Reap() {
  for (size_t i = 0; i < running_.size();) {
    const auto end = running_[i]->worker.Ended();
    if (!end) {
      ++i;
      continue;
    }
    const auto attempt = std::move(running_[i]);
    running_.erase(running_.begin() + static_cast<std::ptrdiff_t>(i));
    SLX_RETURN_IF_ERROR(Finish(*attempt, *end));
  }
  return Status::Ok();
}

void Night::Wait() const {
  std::vector<pollfd> fds = {{stop_, POLLIN, 0}};
  for (const auto& attempt : running_) fds.push_back({attempt->worker.fd(), POLLIN, 0});
  poll(fds.data(), fds.size(), static_cast<int>(kLook.count()));
}

// What their stages have finished stays. Each is given back, whatever cannot be told of it.
Status Night::GiveBack() {
  Status told;
  for (const auto& attempt : running_) attempt->worker.Signal(SIGTERM);
  const auto end = Clock::now() + kGrace;
  for (const auto& attempt : running_) {
    while (!attempt->worker.Ended() && Clock::now() < end) std::this_thread::sleep_for(milliseconds(20));
    if (const Status released = jobs_.Release(attempt->job.token); !released.ok()) logger_.Debug(released.message());
    Status now = Tell({.kind = NightEventKind::kReleased,
                       .session = attempt->job.request.session,
                       .attempt = attempt->job.attempts,
                       .reason = "the night was stopped"});
    if (told.ok()) told = std::move(now);
  }
  running_.clear();
  return told;
}

Status Night::Work() {
  while (true) {
    pollfd stop{stop_, POLLIN, 0};
    outcome_.stopped = stop_ >= 0 && poll(&stop, 1, 0) > 0;
    if (outcome_.stopped) break;
    while (true) {
      SLX_ASSIGN_OR_RETURN(const bool started, StartOne());
      if (!started) break;
    }
    // Whoever waits for another attempt is waited for, and whom another night has: it may have been killed, and its
    // lease must run out.
    SLX_ASSIGN_OR_RETURN(auto counts, jobs_.CountOf(chosen_));
    outcome_.waiting =
        counts[db::JobState::kQueued] + counts[db::JobState::kRunning] - static_cast<int64_t>(running_.size());
    if (running_.empty() && (outcome_.waiting == 0 || outcome_.out_of_time)) break;
    Wait();
    SLX_RETURN_IF_ERROR(Reap());
    SLX_RETURN_IF_ERROR(Watch());
  }
  return Status::Ok();
}

Result<NightOutcome> Night::Run(const NightChoice& choice) {
  Status worked = Enqueue(choice);
  if (worked.ok()) worked = Work();
  // What ends the night, such as a full disk, costs nobody an attempt.
  const Status given_back = GiveBack();
  const Status told = TellWhoWasSetAside();
  NightEvent ended{
      .kind = NightEventKind::kEnded, .seconds = InSeconds(Clock::now() - began_), .count = outcome_.fitted};
  ended.reason = outcome_.stopped ? "stopped" : outcome_.out_of_time ? "no time for another visitor" : "";
  for (const Status& failed : {worked, given_back, told}) {
    if (failed.ok()) continue;
    ended.reason = failed.message();
    ended.by_error = true;
    if (const Status last = Tell(ended); !last.ok()) logger_.Debug(last.message());
    return failed;
  }
  SLX_RETURN_IF_ERROR(Tell(ended));
  return outcome_;
}

}  // namespace

Status NightOptions::Validate() const {
  if (workers < 1 || threads < 1) return Status::Usage("a night needs at least one worker with one thread");
  if (attempts < 1) return Status::Usage("attempts " + std::to_string(attempts) + ": at least 1");
  if (memory_bytes <= 0) return Status::Usage("no memory for the workers");
  if (visit_limit.count() <= 0 || lease.count() <= 0 || back_off.count() < 0)
    return Status::Usage("times must be positive");
  return choice.run.Validate();
}

Result<NightOutcome> RunNight(const NightOptions& options, const NightChoice& choice, int stop,
                              const std::function<void(const NightEvent&)>& heard, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const fs::path folder = options.choice.run.store;
  SLX_ASSIGN_OR_RETURN(auto store, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto history, CostHistory::Read(store));
  for (const auto& [cost, sites] : options.foreseen) history.AddMeasured(cost, sites);
  SLX_ASSIGN_OR_RETURN(auto jobs, db::JobStore::Open(folder));
  SLX_ASSIGN_OR_RETURN(auto log, NightLog::Begin(folder));
  Night night(options, stop, heard, std::move(jobs), std::move(store), std::move(log), std::move(history), logger);
  return night.Run(choice);
}

}  // namespace stratalux::fit
