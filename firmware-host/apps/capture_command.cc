// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/capture_command.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "firmware-host/apps/open_rig.h"
#include "firmware-host/apps/session_calibration.h"
#include "firmware-host/apps/store_disk.h"
#include "firmware-host/recording/session_archive.h"
#include "firmware-host/sequence/realtime.h"
#include "firmware-host/sequence/sequencer.h"
#include "shared/base/version.h"

namespace stratalux::rig {
namespace {

// Projector columns that a camera pixel may see: at 8 a white target's sessions were degraded without any fault, at 7.1
// they were complete.
constexpr double kMostColumnsAPixel = 6.4;

using Json = nlohmann::ordered_json;

SessionInfo DescribeSession(const CaptureOptions& options, const CapturePlan& plan, const OpenedRig& rig,
                            std::string calibration_json) {
  SessionInfo info;
  info.kind = plan.options.kind;
  info.rig = options.config.store.rig;
  info.visitor = options.visitor;
  info.retention = options.retention;
  info.started_wall = WallNow();
  info.program_version = kVersion;
  info.plan_json = PlanOptionsToJson(plan.options);
  if (rig.simulation) {
    info.simulated = true;
    info.seed = options.simulated->seed;
  }
  info.calibration_json = std::move(calibration_json);
  return info;
}

// Mean light of a sinusoid as the projector gives it.
double SinusoidMean(const ProjectorCalibration& projector) {
  constexpr int kSamples = 256;
  double sum = 0.0;
  for (int k = 0; k < kSamples; ++k)
    sum += projector.Response(0.5 + 0.5 * std::cos(2.0 * std::numbers::pi * k / kSamples)) / kSamples;
  return sum;
}

// The tolerances of a single probe follow the camera at hand.
SequencerOptions OptionsFor(const CaptureOptions& capture, const OpenedRig& rig) {
  const RigConfig& config = capture.config;
  SequencerOptions options;
  options.shooter.settle = FromMilliseconds(config.settle_ms);
  options.shooter.camera = CameraTimingOf(config.camera);
  options.shooter.sync_deadline = options.shooter.frame_deadline = FromMilliseconds(config.deadline_ms);
  options.max_on_time = FromMilliseconds(1000.0 * config.max_on_time_s);
  options.max_retries = config.max_retries;
  options.shooter.wait = rig.wait();
  double saturation_dn = config.camera.saturation_dn, read_noise_dn = config.camera.read_noise_dn;
  options.witness.gain_e_per_dn = config.camera.gain_e_per_dn;
  if (rig.simulation) {
    const RigTiming& timing = rig.simulation->timing();
    options.shooter.camera.read_out = timing.overlapped_readout ? ReadOut::kOverlapped : ReadOut::kSerial;
    options.shooter.camera.min_frame_period = FromMilliseconds(std::max(timing.min_frame_period_ms, timing.readout_ms));
    const CameraCalibration& camera = rig.simulation->calibration().camera;
    options.witness.gain_e_per_dn = camera.gain_e_per_dn;
    read_noise_dn = capture.simulated->noise ? std::max(read_noise_dn, camera.read_noise_dn) : 0.0;
    saturation_dn = camera.saturation_dn;
    for (const ProjectorCalibration& p : rig.simulation->calibration().projectors)
      options.witness.sinusoid_mean.push_back(SinusoidMean(p));
  }
  options.witness.read_noise_dn = read_noise_dn;
  options.witness.saturation_dn = 0.975 * saturation_dn;
  return options;
}

Status StoreTruth(db::SessionWriter& writer, SimulatedRig& rig, const CapturePlan& plan) {
  const std::string exact = rig.calibration().ToJson();
  if (writer.info().calibration_json != exact) SLX_RETURN_IF_ERROR(writer.KeepTruthCalibration(exact));
  SLX_ASSIGN_OR_RETURN(const std::vector<TruthMap> maps, rig.Truth(plan));
  for (const TruthMap& truth : maps)
    SLX_RETURN_IF_ERROR(writer.AppendTruth(truth.name, truth.map.view()).WithContext("truth map " + truth.name));
  return Status::Ok();
}

// Before the rig moves and before a store is made. BeginSession asks again.
Status AskConsent(const CaptureOptions& options) {
  if (options.config.plan.kind != SessionKind::kVisitor) return Status::Ok();
  const bool nobody = options.visitor.empty() || options.visitor == db::kSimulatedVisitor;
  if (nobody && options.simulated) return Status::Ok();
  if (nobody)
    return Status::Usage(
        "a visitor's session needs a pseudonym whose consent is recorded (--visitor; `stratalux-db consent give` "
        "records it); --kind calibration, flat or dark show nobody");
  return options.consent ? Status::Ok() : db::ValidConsent(options.config.store.folder, options.visitor).status();
}

db::WriterOptions WriterOptionsFor(const StoreConfig& config) {
  db::WriterOptions options;
  options.codec = config.codec;
  options.encryption = config.encrypt.value_or(false) ? db::Encryption::kPerSession : db::Encryption::kNone;
  options.signing = config.sign ? db::Signing::kRigKey : db::Signing::kNone;
  return options;
}

// Between the sequencer and the recorder.
class WatchedSink : public FrameSink {
 public:
  WatchedSink(FrameSink& sink, CaptureWatch* watch) : sink_(sink), watch_(watch) {}
  Status Put(FrameRecord record, Image<uint16_t> pixels) override {
    if (watch_ != nullptr) watch_->See(record, pixels);
    return sink_.Put(std::move(record), std::move(pixels));
  }

 private:
  FrameSink& sink_;
  CaptureWatch* watch_;
};

void Object(CaptureReport& report, const CaptureWatch* watch) {
  if (watch == nullptr || report.status == SessionStatus::kFailed) return;
  for (const CaptureFault& fault : watch->Faults()) {
    report.status = SessionStatus::kDegraded;
    report.reasons.push_back(fault.what + ": " + fault.remedy);
  }
}

void Fail(CaptureReport& report, const Status& status) {
  if (status.ok()) return;
  report.status = SessionStatus::kFailed;
  // A writer's error ends the capture, too: it need not be told twice.
  for (const std::string& reason : report.reasons)
    if (reason.find(status.message()) != std::string::npos) return;
  report.reasons.push_back(status.message());
}

}  // namespace

Status CaptureOptions::Validate() const {
  // Told before the visitor is asked for anything.
  if (!simulated && config.projectors.empty())
    return Status::Usage("capture: the configuration wires no [[projector]]; --simulate runs the simulated rig");
  // Below, pixels mix stripes that the witness expects apart: good frames fail its level check.
  const int least = static_cast<int>(std::ceil(config.plan.projector_width / kMostColumnsAPixel));
  if (config.camera.width < least)
    return Status::Usage("a camera of " + std::to_string(config.camera.width) + "x" +
                         std::to_string(config.camera.height) +
                         " px: too few to tell whether a frame shows its pattern; use " + std::to_string(least) +
                         " columns or more (--size, [camera] width)");
  if (!visitor.empty()) SLX_RETURN_IF_ERROR(db::CheckPseudonym(visitor));
  if (consent && visitor.empty()) return Status::Usage("--consent-scope: say who consents with --visitor");
  if (board_pose >= 0 && config.plan.kind != SessionKind::kCalibration && config.plan.kind != SessionKind::kFlat)
    return Status::Usage("--pose numbers the board's poses of --kind calibration, or the target's of --kind flat");
  if (consent && !consent->fit) return Status::Usage("--consent-scope: a capture needs the scope fit");
  return Status::Ok();
}

Result<CaptureOutcome> Capture(const CaptureOptions& options, StopToken& stop, Logger& logger, CaptureWatch* watch) {
  const auto start = std::chrono::steady_clock::now();
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(options.config.plan));
  SLX_RETURN_IF_ERROR(AskConsent(options));
  SLX_RETURN_IF_ERROR(CheckFreeSpace(options.config.store.folder,
                                     SessionBytes(static_cast<int64_t>(plan.steps.size()), options.config.camera.width,
                                                  options.config.camera.height)));
  SLX_ASSIGN_OR_RETURN(const OpenedRig rig, OpenRig(options.config, plan, options.simulated, stop, logger));
  SLX_RETURN_IF_ERROR(CheckFits(plan, rig.devices()));
  SLX_ASSIGN_OR_RETURN(std::string calibration,
                       ChooseCalibration(options.config.calibration, options.config,
                                         rig.simulation ? &rig.simulation->calibration() : nullptr, logger));
  const std::string& folder = options.config.store.folder;
  SLX_RETURN_IF_ERROR(db::SessionStore::Create(folder));
  SLX_ASSIGN_OR_RETURN(db::SessionStore store, db::SessionStore::Open(folder, db::AccessMode::kReadWrite));
  for (const std::string& note : store.notes()) logger.Warning(note);
  if (options.consent) SLX_RETURN_IF_ERROR(db::GiveConsent(folder, options.visitor, *options.consent));
  SLX_ASSIGN_OR_RETURN(db::SessionWriter writer,
                       store.BeginSession(DescribeSession(options, plan, rig, std::move(calibration)),
                                          WriterOptionsFor(options.config.store)));
  CaptureOutcome outcome;
  outcome.session = writer.info().id;
  logger.Write(LogLevel::kInfo, "session " + outcome.session + ": " + std::to_string(plan.steps.size()) + " frames",
               {{"SESSION", outcome.session}});

  SessionArchive archive(std::move(writer), options.board_pose);
  {
    Recorder recorder(archive, options.config.queue_frames, stop);
    Progress progress(logger, "capture", static_cast<int64_t>(plan.steps.size()));
    Sequencer sequencer(rig.devices(), OptionsFor(options, rig), logger, [&progress] { progress.Advance(); });
    std::unique_ptr<RealtimeThread> realtime;
    if (const int priority = options.config.realtime_priority; priority > 0) {
      Result<std::unique_ptr<RealtimeThread>> entered = RealtimeThread::Enter(priority);
      // A capture at the mercy of other programs is slower at worst: late frames are shot again.
      if (!entered.ok()) logger.Warning(entered.status().message());
      if (entered.ok()) realtime = std::move(entered).value();
    }
    WatchedSink sink(recorder, watch);
    Result<CaptureReport> report = sequencer.Run(plan, sink);
    if (report.ok()) outcome.report = std::move(report).value();
    Fail(outcome.report, report.status());
    Fail(outcome.report, recorder.Close());
  }
  Object(outcome.report, watch);
  if (rig.simulation && outcome.report.status != SessionStatus::kFailed)
    Fail(outcome.report, StoreTruth(archive.writer(), *rig.simulation, plan));
  Fail(outcome.report, archive.writer().Finish(outcome.report.status, outcome.report.reasons));
  if (rig.simulation) outcome.injected = rig.simulation->injected();
  outcome.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return outcome;
}

std::string OutcomeAsText(const CaptureOutcome& outcome) {
  const CaptureReport& r = outcome.report;
  char line[160];
  std::snprintf(line, sizeof line, ": %s, %d of %d steps proven, %d frames, %d shot again, %.1f s\n",
                ToString(r.status), r.captured, r.planned, r.frames, r.retried, outcome.seconds);
  std::string text = "session " + outcome.session + line;
  for (const std::string& reason : r.reasons) text += "  " + reason + "\n";
  return text;
}

std::string OutcomeAsJson(const CaptureOutcome& outcome) {
  const CaptureReport& r = outcome.report;
  Json faults = Json::object();
  for (int i = 1; i < kShotFaultCount; ++i)
    if (r.faults[i] > 0) faults[ToString(static_cast<ShotFault>(i))] = r.faults[i];
  Json injected = Json::array();
  for (const InjectedFault& fault : outcome.injected)
    injected.push_back({{"kind", ToString(fault.kind)}, {"number", fault.number}, {"seconds", fault.seconds}});
  const Json json = {{"session", outcome.session}, {"status", ToString(r.status)},
                     {"planned", r.planned},       {"captured", r.captured},
                     {"frames", r.frames},         {"retried", r.retried},
                     {"faults", faults},           {"missing_steps", r.missing_steps},
                     {"reasons", r.reasons},       {"injected", injected},
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
