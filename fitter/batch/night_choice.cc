// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/night_choice.h"

#include <algorithm>
#include <utility>

#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/job_store.h"
#include "db/catalogue/session_store.h"
#include "db/keys/sealed_key.h"
#include "fitter/pipeline/run.h"

namespace stratalux::fit {
namespace {

constexpr std::pair<LeftOut, const char*> kNames[] = {
    {LeftOut::kComplete, "complete"}, {LeftOut::kCapture, "capture"},   {LeftOut::kConsent, "consent"},
    {LeftOut::kKey, "key"},           {LeftOut::kUnusable, "unusable"}, {LeftOut::kSetAside, "set-aside"},
    {LeftOut::kQuota, "quota"}};

// Why a session that can be opened is left; kOk: it is fitted.
struct Verdict {
  LeftOut why = LeftOut::kUnusable;
  Status reason;
};

// An error: whether it may be fitted could not be asked, of which nobody is told that consent is missing.
Result<Verdict> Judge(const ChoiceOptions& options, const db::SessionSummary& session, ChosenVisit& visit) {
  const RunOptions& run = options.run;
  const SessionStatus status = session.info.status;
  if (status == SessionStatus::kFailed || status == SessionStatus::kRecording)
    return Verdict{LeftOut::kCapture, Status::Failed(std::string("the capture is ") + ToString(status))};
  if (Status may = MayStillBeFitted(run.store, session.info.id, session.info.visitor); !may.ok()) {
    if (may.code() != StatusCode::kUsage) return may;
    return Verdict{LeftOut::kConsent, std::move(may)};
  }
  RunOptions dry = run;
  dry.session = session.info.id;
  dry.dry_run = true;
  Logger quiet(LogLevel::kError);
  const Result<RunOutcome> outcome = RunSession(dry, quiet);
  if (!outcome.ok()) return Verdict{LeftOut::kUnusable, outcome.status()};
  if (options.key == KeyHere::kNeeded && !outcome->readable.ok()) return Verdict{LeftOut::kKey, outcome->readable};
  const auto folder = std::filesystem::path(run.store) / "sessions" / session.info.id;
  if (options.key == KeyHere::kNot && outcome->sealed && db::ListSealedKeys(folder).empty())
    return Verdict{LeftOut::kKey,
                   Status::Failed("encrypted, and its key is not sealed to anybody who could fit it elsewhere "
                                  "(`stratalux-db key share`); `stratalux-fit batch run` fits it here")};
  visit = {outcome->session, outcome->fit, outcome->sites, outcome->sealed};
  if (outcome->was_complete) return Verdict{LeftOut::kComplete, Status::Failed("fit " + outcome->fit + " is complete")};
  return Verdict{};
}

}  // namespace

const char* ToString(LeftOut why) {
  for (const auto& [value, name] : kNames)
    if (value == why) return name;
  return "?";
}

NightEvent EventOf(const LeftOutVisit& visit) {
  return {
      .kind = NightEventKind::kLeftOut, .session = visit.session, .why = ToString(visit.why), .reason = visit.reason};
}

std::string JobKey(const ChosenVisit& visit) { return "fit " + visit.session + " " + visit.fit; }

Status MayStillBeFitted(const std::string& store, const std::string& session, const std::string& visitor) {
  SLX_RETURN_IF_ERROR(db::RefuseForgotten(store, session));
  return visitor.empty() ? Status::Ok() : db::ValidConsent(store, visitor).status();
}

bool Forbids(const Status& may) { return may.code() == StatusCode::kUsage || may.code() == StatusCode::kNotFound; }

Result<NightChoice> ChooseNight(const ChoiceOptions& options, Logger& logger) {
  NightChoice choice;
  std::vector<db::SessionSummary> sessions;
  {
    SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(options.run.store, db::AccessMode::kReadOnly));
    for (const std::string& note : store.notes()) logger.Warning(note);
    SLX_ASSIGN_OR_RETURN(sessions, store.ListSessions());
  }
  std::erase_if(sessions, [](const auto& session) { return session.info.kind != SessionKind::kVisitor; });
  if (options.order == NightOrder::kOldest) std::reverse(sessions.begin(), sessions.end());
  Progress progress(logger, "visitors looked at", static_cast<int64_t>(sessions.size()));
  for (const db::SessionSummary& session : sessions) {
    progress.Advance();
    ChosenVisit visit;
    SLX_ASSIGN_OR_RETURN(const Verdict verdict, Judge(options, session, visit));
    if (!verdict.reason.ok())
      choice.left_out.push_back({session.info.id, verdict.why, verdict.reason.message()});
    else if (options.most > 0 && choice.visits.size() >= static_cast<size_t>(options.most))
      choice.left_out.push_back(
          {session.info.id, LeftOut::kQuota, "the night takes at most " + std::to_string(options.most)});
    else
      choice.visits.push_back(std::move(visit));
  }
  return choice;
}

}  // namespace stratalux::fit
