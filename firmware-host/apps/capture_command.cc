// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/capture_command.h"

#include <cstdio>

#include <nlohmann/json.hpp>

#include "shared/base/number_ranges.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

class ProgressBar final : public CaptureObserver {
 public:
  ProgressBar(Logger& logger, size_t steps) : progress_(logger, "capture", static_cast<int64_t>(steps)) {}
  void OnStepDone(const PlanStep& /*step*/) override { progress_.Advance(); }

 private:
  Progress progress_;
};

}  // namespace

Result<CaptureOutcome> CaptureWithProgress(CaptureStation& station, const CaptureRequest& request, Logger& logger,
                                           CaptureObserver* watch) {
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(request.plan));
  ProgressBar bar(logger, plan.steps.size());
  std::vector<CaptureObserver*> observers = {&bar};
  if (watch != nullptr) observers.push_back(watch);
  ObserverList all(std::move(observers));
  return station.Capture(request, &all);
}

Result<CaptureRequest> WithChosenExposure(CaptureStation& station, const CaptureJob& job, Logger& logger) {
  CaptureRequest request = job.request;
  const auto longest = FromMilliseconds(1000.0 * job.station.config.max_visit_s);
  SLX_ASSIGN_OR_RETURN(const ExposureChoice choice, station.ChooseExposure(request.plan, job.timing, longest));
  request.plan.exposure_ms = choice.exposure_ms;
  request.prescan = choice.findings;
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(request.plan));
  char line[200];
  std::snprintf(line, sizeof line,
                "exposure %.1f ms: the darkest tenth has a signal-to-noise ratio of %.0f, %.2f %% saturates; the visit "
                "takes %.1f s",
                choice.exposure_ms, choice.snr, 100.0 * choice.saturated,
                1e-9 * static_cast<double>(VisitTime(plan, job.timing).count()));
  logger.Info(line);
  for (const std::string& finding : ToText(choice.findings)) logger.Warning(finding);
  return request;
}

std::string OutcomeAsText(const CaptureOutcome& outcome) {
  const CaptureReport& r = outcome.report;
  char line[160];
  std::snprintf(line, sizeof line, ": %s, %d of %d steps proven, %d frames, %d shot again, %.1f s\n",
                ToString(r.status), r.captured, r.planned, r.frames, r.retried, outcome.seconds);
  std::string text = "session " + outcome.session + line;
  for (const std::string& reason : r.Reasons()) text += "  " + reason + "\n";
  for (const SlowAnswers& slow : r.slow) text += "  " + SlowAnswersAsText(slow) + "\n";
  return text;
}

std::string OutcomeAsJson(const CaptureOutcome& outcome) {
  const CaptureReport& r = outcome.report;
  CaptureFindings found = r.Found();
  found.findings.insert(found.findings.end(), outcome.prescan.begin(), outcome.prescan.end());
  Json injected = Json::array();
  for (const InjectedFault& fault : outcome.injected)
    injected.push_back({{"kind", ToString(fault.kind)}, {"number", fault.number}, {"seconds", fault.seconds}});
  std::vector<NumberRange> missing;
  for (const int step : r.missing_steps) AppendNumber(missing, step);
  Json missing_steps = Json::array();
  for (const NumberRange& range : missing) missing_steps.push_back({range.first, range.last});
  Json slow = Json::array();
  for (const SlowAnswers& one : r.slow)
    slow.push_back({{"projector", one.projector},
                    {"answers", one.answers},
                    {"slow", one.slow},
                    {"late", one.late},
                    {"longest_ms", 1e-6 * static_cast<double>(one.longest.count())},
                    {"usual_ms", 1e-6 * static_cast<double>(one.limit.usual.count())}});
  const Json json = {{"session", outcome.session}, {"status", ToString(r.status)},
                     {"planned", r.planned},       {"captured", r.captured},
                     {"frames", r.frames},         {"retried", r.retried},
                     {"faults", found.faults},     {"missing_steps", missing_steps},
                     {"reasons", r.Reasons()},     {"findings", Json::parse(FindingsToJson(found.findings))},
                     {"slower_than_learnt", slow}, {"injected", injected},
                     {"seconds", outcome.seconds}};
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

int ExitCode(const CaptureOutcome& outcome) {
  switch (outcome.report.status) {
    case SessionStatus::kComplete:
      return static_cast<int>(StatusCode::kOk);
    case SessionStatus::kDegraded:
      return static_cast<int>(StatusCode::kDegraded);
    default:
      return static_cast<int>(StatusCode::kFailed);
  }
}

}  // namespace stratalux::rig
