// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/pull.h"

#include <algorithm>
#include <exception>
#include <functional>
#include <iterator>
#include <mutex>
#include <set>
#include <thread>

#include "db/base/durable_file.h"
#include "db/care/incoming.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/fit_store.h"
#include "db/catalogue/session_index.h"
#include "db/keys/sealed_key.h"
#include "db/privacy/forget.h"
#include "db/transfer/adopt.h"
#include "db/transfer/fetched_session.h"
#include "db/transfer/foreign_ledger.h"
#include "db/transfer/source_catalogue.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

// What those who pull at the same time share. Whoever has the turn works on the store and on these; it is given away
// while a source is waited for.
struct SharedTurn {
  std::mutex turn;
  std::set<std::string> here;     // listed
  std::set<std::string> claimed;  // being fetched by one of them
};

std::optional<std::chrono::steady_clock::time_point> DeadlineOf(const PullOptions& options) {
  if (options.limit.count() == 0) return {};
  return std::chrono::steady_clock::now() + options.limit;
}

class Puller {
 public:
  Puller(fs::path store, std::string from, const PullOptions& options, Logger& logger, SharedTurn& shared,
         PullReport& report)
      : store_(std::move(store)),
        from_(std::move(from)),
        options_(options),
        deadline_(DeadlineOf(options)),
        logger_(logger),
        shared_(shared),
        turn_(shared.turn, std::defer_lock),
        report_(report),
        catalogue_(store_, from_, {options.timeout, deadline_}) {}
  Status Run();

 private:
  Status TakeAll();
  [[nodiscard]] bool dry() const { return options_.mode == PullMode::kDryRun; }
  template <typename Wait>
  auto ForTheSource(const Wait& wait);
  [[nodiscard]] bool Claim(const std::string& id);
  Status TakeLedger();
  Status Obey();
  Status Reconcile(const SourceOffers& offers);
  Status Wipe(const fs::path& place, const std::string& why);
  Status TakeSession(const Offer& offer);
  Status FetchSession(const std::string& id);
  Status SayDoubts(const std::string& id);
  Status TakeKeys(const Offer& offer);
  Status TakeFits(const Offer& offer);
  Result<bool> TakeFit(const std::string& session, const std::string& fit);
  [[nodiscard]] bool InTime() const;
  [[nodiscard]] Status OutOfTime(const std::string& how_far) const;

  const fs::path store_;
  const std::string from_;
  const PullOptions& options_;
  const std::optional<std::chrono::steady_clock::time_point> deadline_;
  Logger& logger_;
  SharedTurn& shared_;
  std::unique_lock<std::mutex> turn_;
  PullReport& report_;
  SourceCatalogue catalogue_;
  std::set<std::string> forgotten_;  // by either side
};

// The turn is the others' meanwhile.
template <typename Wait>
auto Puller::ForTheSource(const Wait& wait) {
  turn_.unlock();
  auto result = wait();
  turn_.lock();
  return result;
}

bool Puller::Claim(const std::string& id) {
  if (shared_.claimed.insert(id).second) return true;
  report_.notes.push_back("session " + id +
                          " comes from another source now; the next pull fetches what else this"
                          " one has of it");
  return false;
}

Status Puller::TakeLedger() {
  SLX_ASSIGN_OR_RETURN(const auto ours, ListDeletions(store_));
  for (const Deletion& deletion : ours) forgotten_.insert(deletion.session);
  SLX_RETURN_IF_ERROR(ForTheSource([this] { return catalogue_.Fetch(forgotten_, report_.problems); }));
  SLX_ASSIGN_OR_RETURN(const Ledger theirs, Ledger::Read(catalogue_.folder()));
  for (const auto& [id, certificate] : theirs.forgotten()) forgotten_.insert(id);
  // An older store's tombstones bear the names of sessions: they are taken over, never kept.
  const fs::path tombstones = catalogue_.folder() / "deletions";
  if (dry()) return WipeFolder(tombstones);
  SLX_ASSIGN_OR_RETURN(const LedgerMerge merge, AdoptLedger(store_, catalogue_.folder()));
  SLX_RETURN_IF_ERROR(WipeFolder(tombstones));
  report_.ledger_entries = merge.entries;
  for (const std::string& problem : merge.problems) report_.problems.push_back("ledger of the source: " + problem);
  SLX_ASSIGN_OR_RETURN(report_.withdrawals, ApplyWithdrawals(store_));
  return Status::Ok();
}

// Sessions that are here and that a ledger forgets. Deleting them for another store's word is for people to decide.
Status Puller::Obey() {
  std::vector<std::string> still_here;
  for (const std::string& id : forgotten_)
    if (shared_.here.contains(id)) still_here.push_back(id);
  const bool obeys = options_.forgotten != ForgottenElsewhere::kName && !dry();
  if (!obeys) {
    for (const std::string& id : still_here) {
      // The source's to take back, unlike the session.
      if (!dry()) SLX_RETURN_IF_ERROR(WipeSealedKeys(store_ / "sessions" / id));
      report_.problems.push_back("session " + id + " was forgotten at the source, but is here: `stratalux-db forget " +
                                 id + "`, or `pull --obey` for all of them");
    }
    return Status::Ok();
  }
  // A forgetting that was broken off, by an obeying pull perhaps, is no longer among what is here.
  SLX_ASSIGN_OR_RETURN(const auto begun, UnfinishedForgets(store_));
  if (still_here.empty() && begun.empty()) return Status::Ok();
  ForgetRequest request;
  request.sessions = still_here;
  SLX_ASSIGN_OR_RETURN(const ForgetReport gone, Forget(store_, request, logger_));
  for (const ForgottenSession& session : gone.sessions) report_.obeyed.push_back(session.id);
  for (const std::string& leftover : gone.leftovers)
    report_.problems.push_back("forgotten, but still there: " + leftover);
  for (const std::string& id : still_here) shared_.here.erase(id);
  return Status::Ok();
}

Status Puller::Wipe(const fs::path& place, const std::string& why) {
  SLX_RETURN_IF_ERROR(WipeFolder(place));
  report_.wiped.push_back(place.lexically_relative(store_).string() + ": " + why);
  return Status::Ok();
}

// What broken-off pulls left, held against what both sides say now.
Status Puller::Reconcile(const SourceOffers& offers) {
  for (const IncomingSession& session : ListIncoming(store_)) {
    if (shared_.claimed.contains(session.id)) continue;
    const bool offered = offers.folders.contains(session.id) || catalogue_.OthersHave(session.id);
    for (const fs::path& place : session.places) {
      const bool of_fits = place == IncomingFits(store_, session.id);
      if (forgotten_.contains(session.id)) {
        SLX_RETURN_IF_ERROR(Wipe(place, "the session was forgotten"));
      } else if (!offered) {
        SLX_RETURN_IF_ERROR(Wipe(place, "the source no longer offers the session"));
      } else if (shared_.here.contains(session.id) != of_fits) {
        SLX_RETURN_IF_ERROR(Wipe(place, of_fits ? "its session is not here" : "the session is here already"));
      }
    }
  }
  // Manifests of forgotten sessions in the kept catalogues.
  std::vector<std::string> forgotten;
  std::set_difference(forgotten_.begin(), forgotten_.end(), shared_.claimed.begin(), shared_.claimed.end(),
                      std::back_inserter(forgotten));
  return WipeIncoming(store_, forgotten).status();
}

Status Puller::FetchSession(const std::string& id) {
  std::error_code error;
  if (fs::exists(store_ / "sessions" / id, error))  // moved by a pull that was cut before it could list
    return ListAdopted(store_, id, from_);
  const fs::path incoming = IncomingFolder(store_, id);
  SLX_RETURN_IF_ERROR(ForTheSource([&] { return catalogue_.Copy("sessions/" + id, incoming); }));
  SLX_ASSIGN_OR_RETURN(const LeftOut out, LeaveOutUnproven(incoming));
  SLX_ASSIGN_OR_RETURN(const int64_t frames, ProveFolder(store_, incoming));
  SLX_RETURN_IF_ERROR(AdoptFolder(store_, incoming, from_));
  report_.frames += frames;
  report_.problems.insert(report_.problems.end(), out.problems.begin(), out.problems.end());
  report_.notes.insert(report_.notes.end(), out.notes.begin(), out.notes.end());
  return SayDoubts(id);
}

// It is here, whatever they are.
Status Puller::SayDoubts(const std::string& id) {
  SLX_ASSIGN_OR_RETURN(const auto doubts, DoubtsAbout(store_, id));
  for (const std::string& doubt : doubts)
    report_.problems.push_back("session " + id + " was fetched, but verify says: " + doubt);
  return Status::Ok();
}

Status Puller::TakeSession(const Offer& offer) {
  if (shared_.here.contains(offer.id)) {
    ++report_.present;
    if (!dry()) SLX_RETURN_IF_ERROR(TakeKeys(offer));
    return TakeFits(offer);
  }
  if (dry()) {
    report_.sessions.push_back(offer.id);
    return Status::Ok();
  }
  const Status taken = FetchSession(offer.id);
  if (IsTroubleOfAll(taken)) return taken;
  if (taken.ok()) {
    report_.sessions.push_back(offer.id);
    shared_.here.insert(offer.id);
    return Status::Ok();
  }
  // A damaged copy would look finished to rsync for good. One of a later version waits for a later program.
  if (taken.code() != StatusCode::kNewerSchema) SLX_RETURN_IF_ERROR(WipeFolder(IncomingFolder(store_, offer.id)));
  report_.problems.push_back("session " + offer.id + " was not fetched: " + taken.message());
  return Status::Ok();
}

// What `key share` sealed at the source after the session had come here.
Status Puller::TakeKeys(const Offer& offer) {
  for (const fs::path& file : ListSealedKeys(catalogue_.folder() / "sessions" / offer.id)) {
    const auto taken = AdoptSealedKey(store_, offer.id, file);
    if (IsTroubleOfAll(taken.status())) return taken.status();
    if (!taken.ok()) {
      report_.problems.push_back("session " + offer.id + ": a sealed key was not fetched: " + taken.status().message());
      std::error_code error;
      fs::remove(file, error);  // fetched again, should the damage be ours
    } else if (*taken) {
      ++report_.keys;
    }
  }
  return Status::Ok();
}

// True where it was not whole here.
Result<bool> Puller::TakeFit(const std::string& session, const std::string& fit) {
  const fs::path incoming = IncomingFits(store_, session) / fit;
  SLX_RETURN_IF_ERROR(ForTheSource([&] { return catalogue_.Copy("sessions/" + session + "/fits/" + fit, incoming); }));
  return AdoptFit(store_, session, incoming);
}

// Fits and calibrations that were made at the source after the session had come here.
Status Puller::TakeFits(const Offer& offer) {
  std::error_code error;
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store_));
  for (const std::string& fit : offer.fits) {
    if (fs::exists(store_ / "sessions" / offer.id / "fits" / fit / "fit.json", error)) continue;
    if (ledger.WithdrawnAt(offer.id)) continue;  // nothing more is made of it
    const std::string name = offer.id + "/" + fit;
    if (dry()) {
      report_.fits.push_back(name);
      continue;
    }
    const auto taken = TakeFit(offer.id, fit);
    if (IsTroubleOfAll(taken.status())) return taken.status();
    if (taken.ok()) {
      if (*taken) report_.fits.push_back(name);
    } else if (taken.status().code() == StatusCode::kUsage) {  // consent
      report_.notes.push_back("fit " + name + " was not fetched: " + taken.status().message());
    } else {
      report_.problems.push_back("fit " + name + " was not fetched: " + taken.status().message());
    }
  }
  return dry() ? Status::Ok() : WipeFolder(IncomingFits(store_, offer.id));
}

bool Puller::InTime() const { return !deadline_ || std::chrono::steady_clock::now() < *deadline_; }

Status Puller::OutOfTime(const std::string& how_far) const {
  return Status(StatusCode::kTryAgain, "the limit of " + std::to_string(options_.limit.count()) +
                                           " s is over: " + how_far + ", the next pull continues");
}

// However it ends: what came is bound by what the ledger withdraws.
Status Puller::Run() {
  turn_.lock();
  const Status taken = TakeAll();
  if (dry()) return taken;
  const auto late = ApplyWithdrawals(store_);
  if (late.ok()) report_.withdrawals += *late;
  return taken.ok() ? late.status() : taken;
}

Status Puller::TakeAll() {
  if (const Status told = TakeLedger(); !told.ok())
    return told.code() == StatusCode::kTryAgain && !InTime() ? OutOfTime("the source did not say what it has") : told;
  SLX_RETURN_IF_ERROR(Obey());
  SourceOffers offers = catalogue_.Read();
  report_.problems.insert(report_.problems.end(), offers.problems.begin(), offers.problems.end());
  if (!dry()) SLX_RETURN_IF_ERROR(Reconcile(offers));
  for (const std::string& id : offers.folders) {
    if (forgotten_.contains(id))
      ++report_.forgotten;
    else if (offers.unfinished.contains(id))
      ++report_.unfinished;
  }
  Progress progress(logger_, "pull", static_cast<int64_t>(offers.sessions.size()));
  for (const Offer& offer : offers.sessions) {
    if (!forgotten_.contains(offer.id) && Claim(offer.id)) {
      const Status taken = InTime() ? TakeSession(offer) : Status(StatusCode::kTryAgain, "");
      shared_.claimed.erase(offer.id);
      if (taken.code() == StatusCode::kTryAgain && !InTime()) {
        const auto done = static_cast<int64_t>(report_.sessions.size()) + report_.present;
        return OutOfTime(std::to_string(done) + " of " + std::to_string(offers.sessions.size()) + " sessions are here");
      }
      SLX_RETURN_IF_ERROR(taken);
    }
    progress.Advance();
  }
  return Status::Ok();
}

constexpr size_t kMostSources = 256;  // a thread and an rsync each

Status CheckSource(const std::string& from) {
  if (from.empty()) return Status::Usage("--from is empty; give user@host:/path/of/the/store or a local folder");
  if (from.starts_with('-')) return Status::Usage("--from " + from + ": a source must not begin with a dash");
  return Status::Ok();
}

}  // namespace

Result<std::vector<SourcePull>> PullAll(const fs::path& store, const std::vector<std::string>& from,
                                        const PullOptions& options, Logger& logger) {
  std::vector<SourcePull> pulls;
  if (from.empty() || from.size() > kMostSources)
    return Status::Usage(std::to_string(from.size()) + " sources: 1 to " + std::to_string(kMostSources));
  for (std::string source : from) {
    while (source.size() > 1 && source.ends_with('/')) source.pop_back();
    SLX_RETURN_IF_ERROR(CheckSource(source));
    if (std::any_of(pulls.begin(), pulls.end(), [&](const SourcePull& pull) { return pull.from == source; }))
      return Status::Usage("--from " + source + " is given twice");
    pulls.push_back({source, {}, {}});
  }
  SLX_RETURN_IF_ERROR(SessionIndex::Open(store, AccessMode::kReadWrite).status());
  SLX_ASSIGN_OR_RETURN(const auto lock, IncomingLock::Take(store));
  SLX_RETURN_IF_ERROR(WipeFolder(store / "incoming" / ".catalogue"));  // of an older program
  SharedTurn shared;
  SLX_ASSIGN_OR_RETURN(shared.here, ListedSessions(store));
  Logger quiet(LogLevel::kError);  // several bars on one line tell nobody anything
  const auto pull = [&](SourcePull& one) {
    try {
      one.status = Puller(store, one.from, options, pulls.size() > 1 ? quiet : logger, shared, one.report).Run();
    } catch (const std::exception& error) {
      one.status = Status::Failed(error.what());
    }
    if (pulls.size() > 1) logger.Info(one.from + (one.status.ok() ? ": done" : ": " + one.status.message()));
  };
  std::vector<std::jthread> others;
  for (size_t i = 1; i < pulls.size(); ++i) others.emplace_back(pull, std::ref(pulls[i]));
  pull(pulls[0]);
  others.clear();  // waits for them
  return pulls;
}

Result<PullReport> Pull(const fs::path& store, const std::string& source, const PullOptions& options, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(auto pulls, PullAll(store, {source}, options, logger));
  SLX_RETURN_IF_ERROR(pulls[0].status);
  return std::move(pulls[0].report);
}

}  // namespace stratalux::db
