// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/shard.h"

#include <algorithm>
#include <map>
#include <utility>

#include "db/base/file_lock.h"
#include "fitter/batch/shard_store.h"
#include "fitter/mixture/em_kernel.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

Status CheckMachine(const ShardPlan& plan) {
  if (plan.isa == KernelIsa()) return Status::Ok();
  return Status::Usage("the plan's fits are for the instruction set " + plan.isa +
                       ", this machine would make them for " + KernelIsa() +
                       ": run it on machines like the one that made the plan (Slurm: --constraint)");
}

class ShardRun {
 public:
  ShardRun(const ShardOptions& options, const ShardPlan& plan, const std::function<void(const NightEvent&)>& heard,
           Logger& logger)
      : options_(options), plan_(plan), heard_(heard), logger_(logger), store_(options.night.choice.run.store) {
    for (const size_t place : VisitsOf(plan, options.shard)) visits_.push_back(&plan.visits[place]);
  }
  Result<ShardOutcome> Run(int stop);

 private:
  Status GoOnFromEarlier();
  [[nodiscard]] bool IsDone(const ShardVisit& visit) const;
  Status Say(NightEvent event);
  Status DropWhoMayNot();
  Status Night(const std::vector<std::string>& sessions, int stop);
  [[nodiscard]] Result<NightChoice> Choose(const ShardStore& store, const std::vector<std::string>& sessions);
  [[nodiscard]] Status Allowed(const std::string& session) const;

  const ShardOptions& options_;
  const ShardPlan& plan_;
  const std::function<void(const NightEvent&)>& heard_;
  Logger& logger_;
  const fs::path store_;
  std::vector<const PlannedVisit*> visits_;
  ShardManifest manifest_;
};

// A ledger that cannot be read for the moment forbids nothing: who is forgotten is kept out by the merge.
Status ShardRun::Allowed(const std::string& session) const {
  Status allowed = LedgerAllows(store_, session);
  return allowed.code() == StatusCode::kUsage ? allowed : Status::Ok();
}

bool ShardRun::IsDone(const ShardVisit& visit) const {
  if (visit.end.kind != NightEventKind::kDone) return false;
  return IsMerged(options_.results, visit.end.session) ||
         CheckRecords(ResultsOf(options_.results, visit.end.session), visit.made).ok();
}

Status ShardRun::GoOnFromEarlier() {
  manifest_ = {plan_.id, options_.shard, {}};
  auto earlier = ReadManifest(ManifestFile(options_.results, options_.shard), plan_);
  // Half a manifest, or one of another plan, is none. One that says something, and cannot be read here, stays.
  const StatusCode code = earlier.status().code();
  if (!earlier.ok() && code != StatusCode::kNotFound && code != StatusCode::kIntegrity) return earlier.status();
  if (earlier.ok()) manifest_.visits = std::move(earlier->visits);
  // Who failed begins anew.
  std::erase_if(manifest_.visits, [this](const ShardVisit& visit) {
    return visit.end.kind != NightEventKind::kDropped && !IsDone(visit);
  });
  if (!earlier.ok() && earlier.status().code() != StatusCode::kNotFound) logger_.Warning(earlier.status().message());
  return WriteManifest(options_.results, manifest_);
}

Status ShardRun::Say(NightEvent event) {
  if (event.at.ns == 0) event.at = WallNow();
  if (heard_) heard_(event);
  if (!IsEnd(event.kind)) return Status::Ok();
  ShardVisit visit{std::move(event), {}};
  if (visit.end.kind == NightEventKind::kDone) {
    SLX_ASSIGN_OR_RETURN(visit.made, ListMade(ResultsOf(options_.results, visit.end.session), visit.end.fit));
  }
  // What was made of somebody who may not be fitted any more goes.
  if (visit.end.kind == NightEventKind::kDropped)
    SLX_RETURN_IF_ERROR(RemoveResults(options_.results, visit.end.session));
  manifest_.Say(std::move(visit));
  return WriteManifest(options_.results, manifest_);
}

Status ShardRun::DropWhoMayNot() {
  for (const PlannedVisit* visit : visits_) {
    const Status allowed = Allowed(visit->session);
    const ShardVisit* said = manifest_.Find(visit->session);
    if (allowed.ok() || (said != nullptr && said->end.kind == NightEventKind::kDropped)) continue;
    SLX_RETURN_IF_ERROR(Say(
        {.kind = NightEventKind::kDropped, .session = visit->session, .fit = visit->fit, .reason = allowed.message()}));
  }
  return Status::Ok();
}

// Whom the shard's store lists, in the plan's order. Who cannot be fitted here, and who is fitted already, is said.
Result<NightChoice> ShardRun::Choose(const ShardStore& store, const std::vector<std::string>& sessions) {
  ChoiceOptions options = options_.night.choice;
  options.run.store = store.folder();
  SLX_ASSIGN_OR_RETURN(const NightChoice found, ChooseNight(options, logger_));
  std::map<std::string, ChosenVisit> chosen;
  std::map<std::string, LeftOutVisit> left_out;
  for (const ChosenVisit& visit : found.visits) chosen[visit.session] = visit;
  for (const LeftOutVisit& visit : found.left_out) left_out[visit.session] = visit;
  NightChoice choice;
  for (const PlannedVisit* visit : visits_) {
    if (std::find(sessions.begin(), sessions.end(), visit->session) == sessions.end()) continue;
    NightEvent event{.kind = NightEventKind::kFailed, .session = visit->session, .fit = visit->fit};
    const auto one = chosen.find(visit->session);
    const auto left = left_out.find(visit->session);
    if (one != chosen.end() && one->second.fit == visit->fit) {
      choice.visits.push_back(one->second);
      continue;
    }
    if (one != chosen.end()) {
      event.reason = "would be fit " + one->second.fit + " here, but is " + visit->fit +
                     " in the plan: its frames, or the program that made the plan (" + plan_.program + "), differ";
    } else if (left == left_out.end()) {
      event.reason = store.Trouble(visit->session).message();
    } else if (left->second.why == LeftOut::kComplete) {
      event.kind = NightEventKind::kDone;  // by a run that was killed before it could say so
    } else {
      event.reason = left->second.reason;
    }
    SLX_RETURN_IF_ERROR(Say(event));
  }
  return choice;
}

Status ShardRun::Night(const std::vector<std::string>& sessions, int stop) {
  SLX_ASSIGN_OR_RETURN(const ShardStore store,
                       ShardStore::Make({store_, options_.results, options_.scratch, sessions}, logger_));
  SLX_ASSIGN_OR_RETURN(const NightChoice choice, Choose(store, sessions));
  if (choice.visits.empty()) return Status::Ok();
  NightOptions night = options_.night;
  night.choice.run.store = store.folder();
  night.arguments = plan_.arguments;
  night.also_asked = [this](const std::string& session) { return Allowed(session); };
  for (const PlannedVisit* visit : visits_)
    if (visit->cost) night.foreseen.emplace_back(*visit->cost, visit->sites);
  Status said;
  const auto hear = [&](const NightEvent& event) {
    if (Status now = Say(event); !now.ok() && said.ok()) said = std::move(now);
  };
  SLX_RETURN_IF_ERROR(RunNight(night, choice, stop, hear, logger_).status());
  return said;
}

Result<ShardOutcome> ShardRun::Run(int stop) {
  SLX_RETURN_IF_ERROR(GoOnFromEarlier());
  SLX_RETURN_IF_ERROR(DropWhoMayNot());
  std::vector<std::string> sessions;
  for (const PlannedVisit* visit : visits_)
    if (manifest_.Find(visit->session) == nullptr && !IsMerged(options_.results, visit->session))
      sessions.push_back(visit->session);
  if (!sessions.empty()) SLX_RETURN_IF_ERROR(Night(sessions, stop));
  ShardOutcome outcome{.manifest = ManifestFile(options_.results, options_.shard)};
  for (const PlannedVisit* visit : visits_) {
    const ShardVisit* said = manifest_.Find(visit->session);
    if (said == nullptr)
      ++(IsMerged(options_.results, visit->session) ? outcome.fitted : outcome.waiting);
    else if (said->end.kind == NightEventKind::kDone)
      ++outcome.fitted;
    else if (said->end.kind == NightEventKind::kDropped)
      ++outcome.dropped;
    else
      ++outcome.failed;
  }
  return outcome;
}

}  // namespace

Result<ShardOutcome> RunShard(const ShardOptions& options, const ShardPlan& plan, int stop,
                              const std::function<void(const NightEvent&)>& heard, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.night.Validate());
  SLX_RETURN_IF_ERROR(CheckMachine(plan));
  const fs::path manifest = ManifestFile(options.results, options.shard);
  const fs::path lock_file = manifest.parent_path() / ("." + manifest.stem().string() + ".lock");
  const auto lock = db::FileLock::TryTake(lock_file, "another process works on " + manifest.string());
  if (lock.status().code() == StatusCode::kBusy) return Status(StatusCode::kTryAgain, lock.status().message());
  SLX_RETURN_IF_ERROR(lock.status());
  return ShardRun(options, plan, heard, logger).Run(stop);
}

}  // namespace stratalux::fit
