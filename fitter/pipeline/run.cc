// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/run.h"

#include "db/catalogue/deletions.h"
#include "db/catalogue/fit_store.h"
#include "db/catalogue/shortfall.h"
#include "db/privacy/access_log.h"
#include "fitter/pipeline/fittable.h"
#include "fitter/session/choose_session.h"
#include "fitter/stages/stage_json.h"

namespace stratalux::fit {
namespace {

Evaluation EvaluationOf(const RunOptions& options) {
  return options.full_evaluation ? Evaluation::kFull : Evaluation::kHeldOut;
}

// Evaluations that a fit is published with, one after the other. The report first: who waits for it need not wait for
// its evaluation. Nobody waits for a job of a queue.
std::vector<Evaluation> StepsOf(const RunOptions& options) {
  if (options.job_token) return {EvaluationOf(options)};
  return {Evaluation::kFirst, EvaluationOf(options)};
}

std::string KeyOf(SessionGraph& graph, const RunOptions& options) {
  switch (options.until) {
    case Stage::kReconstruct:
      return graph.Shape(options.geometry);
    case Stage::kSeparate:
      return graph.Separate();
    case Stage::kNormals:
      return graph.Normals();
    case Stage::kSkin:
      return graph.Skin();
    case Stage::kSrd:
      return graph.Srd(options.geometry);
    case Stage::kMaps:
      return graph.Maps();
    default:
      return graph.Fit(options.geometry, options.heldout, FitKind::kJudged);
  }
}

// Keys of all that a run asks for, in their order.
std::vector<std::string> WantedKeys(SessionGraph& graph, const RunOptions& options) {
  if (options.until != Stage::kReport) return {KeyOf(graph, options)};
  std::vector<std::string> keys;
  for (const Evaluation evaluation : StepsOf(options))
    for (std::string& key : KeysOf(graph, options, evaluation)) keys.push_back(std::move(key));
  return keys;
}

// Each time, not only when the shape is made.
Status SayDrift(SessionGraph& graph, const RunOptions& options, Logger& logger) {
  if (options.until == Stage::kSeparate) return Status::Ok();
  const auto load = [](const std::filesystem::path& folder) -> Result<std::string> {
    std::string warning;
    SLX_RETURN_IF_ERROR(ReadJson(folder / "shape.json",
                                 [&](const nlohmann::json& json) { json.at("drift").at("warning").get_to(warning); }));
    return warning;
  };
  SLX_ASSIGN_OR_RETURN(const auto warning, graph.stages().Load(graph.Shape(graph.SkinSource()), load));
  if (!warning.empty()) logger.Warning(warning);
  return Status::Ok();
}

Status RunStages(SessionGraph& graph, const RunOptions& options, SessionFrames& frames, Logger& logger,
                 RunOutcome& outcome) {
  if (options.until != Stage::kReport) {
    SLX_RETURN_IF_ERROR(SayDrift(graph, options, logger));
    SLX_ASSIGN_OR_RETURN(outcome.folder, graph.stages().StoredFolder(KeyOf(graph, options)));
    return Status::Ok();
  }
  const Evaluation wanted = EvaluationOf(options);
  // Figures list the stages in this order, whichever of them this run makes.
  for (const Evaluation evaluation : {Evaluation::kFirst, Evaluation::kHeldOut, wanted})
    (void)KeysOf(graph, options, evaluation);
  SLX_RETURN_IF_ERROR(SettleFits(graph, frames, outcome.fit));
  SLX_ASSIGN_OR_RETURN(const auto held, EvaluationHeld(graph, options, frames, outcome.fit));
  outcome.folder = frames.store().FitFolder(outcome.session, outcome.fit);
  outcome.was_complete = held && *held >= wanted;
  if (outcome.was_complete) return Status::Ok();
  SLX_RETURN_IF_ERROR(SayDrift(graph, options, logger));
  KnownPictures pictures;
  // Stages run before what a report shows is read: both at once would be most of the memory.
  for (const Evaluation evaluation : StepsOf(options)) {
    if (held && *held >= evaluation) continue;
    for (const std::string& key : KeysOf(graph, options, evaluation))
      SLX_RETURN_IF_ERROR(graph.stages().Need(key).status());
    SLX_ASSIGN_OR_RETURN(outcome.folder, Publish(graph, options, frames, evaluation, pictures));
  }
  return Status::Ok();
}

// Nothing stays of work on a session that was forgotten meanwhile. That it was is then what is said.
Status AfterRun(const Status& finished, const RunOptions& options, const RunOutcome& outcome) {
  SLX_ASSIGN_OR_RETURN(const bool forgotten, db::IsForgotten(options.store, outcome.session));
  const std::string session = "session " + outcome.session;
  if (!forgotten)
    return finished.ok() || finished.message().starts_with(session) ? finished : finished.WithContext(session);
  const auto fits = std::filesystem::path(options.store) / "sessions" / outcome.session / "fits";
  return db::DiscardFit(options.store, outcome.session, fits / (outcome.fit + ".partial"));
}

}  // namespace

Result<RunOutcome> RunSession(const RunOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(options.store, options.session, SessionUse::kVisitor, logger));
  SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(options.store, chosen));
  for (const std::string& note : frames.store().notes()) logger.Warning(note);
  if (const std::string text = db::Shortfall(frames.info()); !text.empty()) logger.Warning(text);
  SLX_RETURN_IF_ERROR(RequireFittable(frames, options));
  RunOutcome outcome;
  outcome.session = frames.info().id;
  SLX_ASSIGN_OR_RETURN(const auto graph, SessionGraph::Open(options, frames, logger));
  db::FileSeal seal = graph->stages().store().files().seal();
  outcome.sealed = seal.active();
  if (options.geometry == GeometrySource::kTruth && !graph->has_truth())
    return Status::Usage("session " + outcome.session +
                         " has no truth: --geometry truth works only on simulated sessions that have their truth.seg");
  if (frames.info().simulated && !graph->has_truth())
    logger.Warning("session " + outcome.session +
                   " is simulated but has no truth.seg: nothing is compared with the truth");
  outcome.thin = graph->thin();
  if (outcome.thin) logger.Info(Describe(*outcome.thin));
  outcome.fit = FitIdOf(*graph, options);
  if (options.dry_run) {
    outcome.plan = graph->stages().Plan(WantedKeys(*graph, options));
    SLX_ASSIGN_OR_RETURN(const auto held, EvaluationHeld(*graph, options, frames, outcome.fit));
    outcome.was_complete = options.until == Stage::kReport && held && *held >= EvaluationOf(options);
    const FrameRecord& first = frames.rows().front().record;  // of a session that is fittable there is one
    outcome.readable = seal.RequireKey();
    outcome.sites = int64_t{first.width} * first.height;
    return outcome;
  }
  SLX_RETURN_IF_ERROR(seal.RequireKey());
  SLX_ASSIGN_OR_RETURN(const UniqueFd in_use, graph->stages().store().Use());
  SLX_RETURN_IF_ERROR(AfterRun(RunStages(*graph, options, frames, logger, outcome), options, outcome));
  if (outcome.was_complete) {
    logger.Info("fit " + outcome.fit + " is complete already");
    return outcome;
  }
  SLX_RETURN_IF_ERROR(db::LogAccess(options.store, "fit", outcome.session, "fit " + outcome.fit));
  return outcome;
}

}  // namespace stratalux::fit
