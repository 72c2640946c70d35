// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/capture_station.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>
#include <utility>

#include "db/catalogue/consent.h"
#include "firmware-host/camera/raw_format.h"
#include "firmware-host/recording/session_archive.h"
#include "firmware-host/sequence/dark_on_exception.h"
#include "firmware-host/sequence/realtime.h"
#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/session/session_calibration.h"
#include "firmware-host/session/store_disk.h"
#include "shared/base/version.h"

namespace stratalux::rig {
namespace {

// Projector columns that a camera pixel may see: at 8 a white target's sessions were degraded without any fault, at 7.1
// they were complete.
constexpr double kMostColumnsAPixel = 6.4;

// Mean light of a sinusoid as the projector gives it.
double SinusoidMean(const ProjectorCalibration& projector) {
  constexpr int kSamples = 256;
  double sum = 0.0;
  for (int k = 0; k < kSamples; ++k)
    sum += projector.Response(0.5 + 0.5 * std::cos(2.0 * std::numbers::pi * k / kSamples)) / kSamples;
  return sum;
}

Status StoreTruth(db::SessionWriter& writer, SimulatedRig& rig, const CapturePlan& plan) {
  const std::string exact = rig.calibration().ToJson();
  if (writer.info().calibration_json != exact) SLX_RETURN_IF_ERROR(writer.KeepTruthCalibration(exact));
  SLX_ASSIGN_OR_RETURN(const std::vector<TruthMap> maps, rig.Truth(plan));
  for (const TruthMap& truth : maps)
    SLX_RETURN_IF_ERROR(writer.AppendTruth(truth.name, truth.map.view()).WithContext("truth map " + truth.name));
  return Status::Ok();
}

// BeginSession asks again.
Status AskConsent(const StationOptions& station, const CaptureRequest& request) {
  if (request.plan.kind != SessionKind::kVisitor) return Status::Ok();
  const bool nobody = request.visitor.empty() || request.visitor == db::kSimulatedVisitor;
  if (nobody && station.simulated) return Status::Ok();
  if (nobody)
    return Status::Usage(
        "a visitor's session needs a pseudonym whose consent is recorded (--visitor; `stratalux-db consent give` "
        "records it); --kind calibration, flat or dark show nobody");
  return request.consent ? Status::Ok() : db::ValidConsent(station.config.store.folder, request.visitor).status();
}

// What no memory holds is refused before anything moves. Displays draw whatever they are asked for.
Status CheckMemories(const StationOptions& station, const CapturePlan& plan) {
  const RigConfig& config = station.config;
  SLX_ASSIGN_OR_RETURN(const MemoryLayout layout, LayOutMemories(config.plan, config.memory));
  const auto memories = MemoryTimingsOf(config);
  for (size_t p = 0; p < memories.size(); ++p)
    if (station.simulated || memories[p]) SLX_RETURN_IF_ERROR(layout.CheckHeld(plan, static_cast<int>(p)));
  return Status::Ok();
}

db::WriterOptions WriterOptionsFor(const StoreConfig& config) {
  db::WriterOptions options;
  options.codec = config.codec;
  options.encryption = config.encrypt.value_or(false) ? db::Encryption::kPerSession : db::Encryption::kNone;
  options.signing = config.sign ? db::Signing::kRigKey : db::Signing::kNone;
  return options;
}

void Object(CaptureReport& report, const CaptureObserver& observer) {
  if (report.status == SessionStatus::kFailed) return;
  for (Finding& objection : observer.Objections()) {
    report.status = SessionStatus::kDegraded;
    report.findings.push_back(std::move(objection));
  }
}

void Fail(CaptureReport& report, const Status& status) {
  if (status.ok()) return;
  report.status = SessionStatus::kFailed;
  // A writer's error ends the capture, too: it need not be told twice.
  for (const Finding& finding : report.findings)
    if (finding.detail.find(status.message()) != std::string::npos) return;
  report.findings.push_back({FindingKind::kDevice, -1, -1, 0.0, 0.0, status.message()});
}

}  // namespace

Status StationOptions::Validate() const {
  if (!simulated && config.projectors.empty())
    return Status::Usage("capture: the configuration wires no [[projector]]; --simulate runs the simulated rig");
  // Below, pixels mix stripes that the witness expects apart: good frames fail its level check.
  const int least = static_cast<int>(std::ceil(config.plan.projector_width / kMostColumnsAPixel));
  if (config.camera.width < least)
    return Status::Usage("a camera of " + std::to_string(config.camera.width) + "x" +
                         std::to_string(config.camera.height) +
                         " px: too few to tell whether a frame shows its pattern; use " + std::to_string(least) +
                         " columns or more (--size, [camera] width)");
  return Status::Ok();
}

Status CaptureRequest::Validate() const {
  if (!visitor.empty()) SLX_RETURN_IF_ERROR(db::CheckPseudonym(visitor));
  if (!visit.empty()) SLX_RETURN_IF_ERROR(db::CheckPseudonym(visit).WithContext("the visit's name"));
  if (attempt < 0) return Status::Usage("attempt " + std::to_string(attempt) + ": attempts count from 1");
  if (consent && visitor.empty()) return Status::Usage("--consent-scope: say who consents with --visitor");
  if (board_pose >= 0 && plan.kind != SessionKind::kCalibration && plan.kind != SessionKind::kFlat)
    return Status::Usage("--pose numbers the board's poses of --kind calibration, or the target's of --kind flat");
  if (consent && !consent->fit) return Status::Usage("--consent-scope: a capture needs the scope fit");
  return Status::Ok();
}

Result<std::unique_ptr<CaptureStation>> CaptureStation::Open(const StationOptions& options, StopToken& stop,
                                                             Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(options.config.plan));
  SLX_RETURN_IF_ERROR(CheckMemories(options, plan));
  SLX_ASSIGN_OR_RETURN(OpenedRig rig,
                       OpenRig(options.config, options.simulated, stop, logger, options.camera_at_start));
  SLX_RETURN_IF_ERROR(CheckFits(plan, rig.devices()));
  auto station = std::unique_ptr<CaptureStation>(new CaptureStation(options, std::move(rig), stop, logger));
  SLX_RETURN_IF_ERROR(CheckResponse(plan, station->SequencerOptionsFor().witness));
  station->Rest();
  return station;
}

CaptureStation::CaptureStation(StationOptions options, OpenedRig rig, StopToken& stop, Logger& logger)
    : options_(std::move(options)),
      rig_(std::move(rig)),
      deadlines_(ChooseDeadlines(StateFolder(), options_.config, options_.simulated)),
      stop_(stop),
      logger_(logger) {
  if (!deadlines_.refused.empty())
    logger_.Warning("learnt deadlines are not used, `stratalux-rig selftest` learns them again: " + deadlines_.refused);
}

CaptureStation::~CaptureStation() {
  if (moved_) Rest();
}

void CaptureStation::Rest() {
  const std::vector<Projector*> projectors = rig_.devices().projectors;
  bool all = true;
  for (size_t p = 0; p < projectors.size(); ++p) {
    const Status rested = projectors[p]->Rest();
    all &= rested.ok();
    // The next capture finds its way, and names what is wrong, from wherever the memory stands.
    if (!rested.ok() && !stop_.stopped())
      logger_.Warning("projector " + std::to_string(p) + " is not at its first pattern: " + rested.message());
  }
  moved_ = !all;  // what a stop forbade is made up for
}

Status CaptureStation::MayBegin(const StationOptions& options, const CaptureRequest& request) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(request.Validate());
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(request.plan));
  SLX_RETURN_IF_ERROR(CheckMemories(options, plan));
  SLX_RETURN_IF_ERROR(AskConsent(options, request));
  return CheckFreeSpace(
      options.config.store.folder,
      SessionBytes(static_cast<int64_t>(plan.steps.size()), options.config.camera.width, options.config.camera.height));
}

Status CaptureStation::OpenStore() {
  if (store_) return Status::Ok();
  const std::string& folder = options_.config.store.folder;
  SLX_RETURN_IF_ERROR(db::SessionStore::Create(folder));
  SLX_ASSIGN_OR_RETURN(store_, db::SessionStore::Open(folder, db::AccessMode::kReadWrite));
  for (const std::string& note : store_->notes()) logger_.Warning(note);
  return Status::Ok();
}

// The tolerances of a single probe follow the camera at hand.
SequencerOptions CaptureStation::SequencerOptionsFor() const {
  const RigConfig& config = options_.config;
  SequencerOptions options;
  options.shooter.settle = FromMilliseconds(config.settle_ms);
  options.shooter.camera = CameraTimingOf(config.camera);
  options.shooter.sync_deadline = options.shooter.frame_deadline = deadlines_.longest;
  options.shooter.learnt = deadlines_.learnt;
  options.max_on_time = FromMilliseconds(1000.0 * config.max_on_time_s);
  options.max_retries = config.max_retries;
  options.shooter.wait = rig_.wait();
  double read_noise_dn = config.camera.read_noise_dn;
  options.witness.gain_e_per_dn = config.camera.gain_e_per_dn;
  if (rig_.simulation) {
    options.shooter.camera = CameraTimingOf(rig_.simulation->timing(), options.shooter.camera);
    const CameraCalibration& camera = rig_.simulation->calibration().camera;
    options.witness.gain_e_per_dn = camera.gain_e_per_dn;
    read_noise_dn = options_.simulated->noise ? std::max(read_noise_dn, camera.read_noise_dn) : 0.0;
    for (const ProjectorCalibration& p : rig_.simulation->calibration().projectors)
      options.witness.sinusoid_mean.push_back(SinusoidMean(p));
  }
  options.witness.read_noise_dn = read_noise_dn;
  options.witness.saturation_dn = 0.975 * SaturationDn();
  return options;
}

double CaptureStation::SaturationDn() const {
  if (rig_.simulation) return rig_.simulation->calibration().camera.saturation_dn;
  const CameraWiring& camera = options_.config.camera;
  std::optional<RawFormat> raw = RawFormatOf(camera.format);
  if (const auto stream = StreamFormatOf(camera.format); camera.backend == CameraBackend::kLibcamera && stream)
    raw = stream->raw;
  return raw ? std::min(camera.saturation_dn, raw->FullScaleDn()) : camera.saturation_dn;
}

SessionInfo CaptureStation::Describe(const CaptureRequest& request, std::string calibration_json) const {
  SessionInfo info;
  info.kind = request.plan.kind;
  info.rig = options_.config.store.rig;
  info.visitor = request.visitor;
  info.visit = request.visit;
  info.attempt = request.attempt;
  info.retention = request.retention;
  info.started_wall = WallNow();
  info.program_version = kVersion;
  info.plan_json = PlanOptionsToJson(request.plan);
  info.simulated = rig_.simulation != nullptr;
  if (info.simulated) info.seed = options_.simulated->seed;
  info.calibration_json = std::move(calibration_json);
  info.devices.saturation_dn = SaturationDn();
  return info;
}

Result<CaptureOutcome> CaptureStation::Capture(const CaptureRequest& request, CaptureObserver* observer) {
  const auto start = std::chrono::steady_clock::now();
  SLX_RETURN_IF_ERROR(MayBegin(options_, request));
  SLX_RETURN_IF_ERROR(stop_.Check());
  if (events().IsActive(RigSignal::kCamera))
    return Status::Failed("the camera is unplugged; plug it in, it is then opened again");
  const RigEvents::Occupied occupied(events());
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(request.plan));
  SLX_RETURN_IF_ERROR(CheckFits(plan, rig_.devices()));
  SimulatedRig* simulation = rig_.simulation.get();
  SLX_ASSIGN_OR_RETURN(std::string calibration,
                       ChooseCalibration(request.calibration, options_.config,
                                         simulation != nullptr ? &simulation->calibration() : nullptr, logger_));
  SLX_RETURN_IF_ERROR(OpenStore());
  if (request.consent)
    SLX_RETURN_IF_ERROR(db::GiveConsent(options_.config.store.folder, request.visitor, *request.consent));
  SLX_ASSIGN_OR_RETURN(db::SessionWriter writer, store_->BeginSession(Describe(request, std::move(calibration)),
                                                                      WriterOptionsFor(options_.config.store)));
  CaptureOutcome outcome;
  outcome.session = writer.info().id;
  logger_.Write(LogLevel::kInfo, "session " + outcome.session + ": " + std::to_string(plan.steps.size()) + " frames",
                {{"SESSION", outcome.session}});
  const size_t injected_before = simulation != nullptr ? simulation->injected().size() : 0;
  CaptureObserver silent;
  moved_ = true;
  outcome.report = Record(plan, std::move(writer), request, observer != nullptr ? *observer : silent);
  outcome.prescan = request.prescan;
  if (occupied.dropped() > 0)
    logger_.Warning("START was pressed during the capture (" + std::to_string(occupied.dropped()) +
                    " times): it has no effect");
  // The next captures need not find out again.
  for (const SlowAnswers& slow : outcome.report.slow)
    if (slow.late > 0 && deadlines_.learnt) {
      deadlines_.learnt.reset();
      deadlines_.source = DeadlineSource::kDefault;
      deadlines_.refused = "the rig is slower than what was learnt; run `stratalux-rig selftest` again";
    }
  // The next opening ends what a writer could not even mark as failed.
  if (outcome.report.status == SessionStatus::kFailed) store_.reset();
  if (simulation != nullptr) {
    outcome.injected = simulation->injected();
    outcome.injected.erase(outcome.injected.begin(),
                           outcome.injected.begin() + static_cast<std::ptrdiff_t>(injected_before));
  }
  outcome.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  Rest();
  return outcome;
}

CaptureReport CaptureStation::Record(const CapturePlan& plan, db::SessionWriter writer, const CaptureRequest& request,
                                     CaptureObserver& observer) {
  CaptureReport report;
  SessionArchive archive(std::move(writer), request.board_pose);
  {
    Recorder recorder(archive, options_.config.queue_frames, stop_);
    Sequencer sequencer(rig_.devices(), SequencerOptionsFor(), logger_, &observer);
    std::unique_ptr<RealtimeThread> realtime;
    if (const int priority = options_.config.realtime_priority; priority > 0) {
      Result<std::unique_ptr<RealtimeThread>> entered = RealtimeThread::Enter(priority);
      // A capture at the mercy of other programs is slower at worst: late frames are shot again.
      if (!entered.ok()) logger_.Warning(entered.status().message());
      if (entered.ok()) realtime = std::move(entered).value();
    }
    Result<CaptureReport> ran = sequencer.Run(plan, recorder);
    if (ran.ok()) report = std::move(ran).value();
    Fail(report, ran.status());
    Fail(report, recorder.Close());
  }
  Object(report, observer);
  if (rig_.simulation && report.status != SessionStatus::kFailed)
    Fail(report, StoreTruth(archive.writer(), *rig_.simulation, plan));
  CaptureFindings found = report.Found();
  found.findings.insert(found.findings.end(), request.prescan.begin(), request.prescan.end());
  Fail(report, archive.writer().Finish(report.status, report.Reasons(), std::move(found)));
  return report;
}

Status CaptureStation::ReopenCamera() {
  const int64_t losses = events().camera_losses();  // it may go again while it is opened
  SLX_RETURN_IF_ERROR(rig_.ReopenCamera(options_.config.camera, logger_));
  losses_mended_ = losses;
  return stop_.reason() == StopReason::kCameraGone ? light().Reset() : Status::Ok();
}

Status CaptureStation::SetSubject(const SubjectOptions& subject) {
  if (!rig_.simulation) return Status::Usage("only a simulated rig can be told who sits in front of it");
  SLX_RETURN_IF_ERROR(rig_.simulation->SetSubject(subject));
  options_.simulated->scene = subject.scene;
  options_.simulated->seed = subject.seed;
  return Status::Ok();
}

Result<RigCalibration> CaptureStation::Calibration(const std::string& asked) const {
  const RigCalibration* exact = rig_.simulation ? &rig_.simulation->calibration() : nullptr;
  SLX_ASSIGN_OR_RETURN(const std::string json, ChooseCalibration(asked, options_.config, exact, logger_));
  if (json.empty()) return Status::NotFound("there is no calibration of this rig");
  return RigCalibration::FromJson(json);
}

ExposureRule CaptureStation::RuleOfCamera() const {
  const WitnessOptions witness = SequencerOptionsFor().witness;
  ExposureRule rule;
  rule.saturation_dn = witness.saturation_dn;
  // A rig's is not known before it is calibrated; 0 sees saturation rather too early.
  if (rig_.simulation) rule.black_level_dn = rig_.simulation->calibration().camera.black_level_dn;
  rule.gain_e_per_dn = witness.gain_e_per_dn;
  rule.read_noise_dn = witness.read_noise_dn;
  // A camera whose exposure cannot be set leaves nothing to choose.
  const CameraWiring& camera = options_.config.camera;
  if (camera.exposure_control == ExposureControl::kNone && camera.fixed_exposure_ms > 0.0)
    rule.shortest_ms = rule.longest_ms = camera.fixed_exposure_ms;
  return rule;
}

Result<ExposureChoice> CaptureStation::ChooseExposure(const PlanOptions& plan, const VisitTiming& timing,
                                                      std::chrono::nanoseconds longest_visit) {
  SLX_ASSIGN_OR_RETURN(PreScanTaken taken, TakePreScan(plan, timing, longest_visit));
  if (!taken.choice) return Status::Failed("pre-scan: no projector lights anything; is somebody there?");
  return std::move(*taken.choice);
}

Result<PreScanTaken> CaptureStation::TakePreScan(const PlanOptions& plan, const VisitTiming& timing,
                                                 std::chrono::nanoseconds longest_visit) {
  ExposureRule rule = RuleOfCamera();
  rule.nominal_ms = plan.exposure_ms;
  SLX_ASSIGN_OR_RETURN(const double longest_ms, LongestExposureMs(plan, timing, longest_visit));
  rule.longest_ms = std::min(rule.longest_ms, longest_ms);
  if (rule.longest_ms < rule.shortest_ms)
    return Status::Usage(
        "a visit of " + std::to_string(std::chrono::duration_cast<std::chrono::seconds>(longest_visit).count()) +
        " s has room only for an exposure of up to " + std::to_string(longest_ms) + " ms, the least is " +
        std::to_string(rule.shortest_ms) + " ms; raise [capture] max_visit_s or plan fewer steps");
  // A pre-scan has no pre-roll that would tell a memory out of step.
  Rest();
  constexpr int kHalvings = 5;
  double scan_ms = std::min(plan.exposure_ms, rule.longest_ms);
  for (int halving = 0;; ++halving) {
    PreScanTaken taken;
    taken.exposure_ms = scan_ms;
    for (int p = 0; p < plan.projectors; ++p)
      for (const PatternKind kind : {PatternKind::kWhite, PatternKind::kBlack}) {
        SLX_ASSIGN_OR_RETURN(Shot shot, SnapPattern(p, {.kind = kind}, scan_ms));
        taken.shots.push_back(std::move(shot));
      }
    std::vector<PreScan> scans;
    for (size_t i = 0; i < taken.shots.size(); i += 2)
      scans.push_back({taken.shots[i].pixels, taken.shots[i + 1].pixels});
    Result<ExposureChoice> choice = stratalux::rig::ChooseExposure(scans, scan_ms, rule);
    const bool shorter = choice.ok() && choice->prescan_saturated && 0.5 * scan_ms >= rule.shortest_ms;
    if (!shorter || halving == kHalvings) {
      Rest();
      if (choice.ok()) taken.choice = std::move(choice).value();
      return taken;
    }
    scan_ms *= 0.5;
  }
}

Result<Shot> CaptureStation::Snap(double exposure_ms) {
  PlanStep step;
  step.exposure_ms = exposure_ms;
  return Shoot(step, [&](Shooter& shooter) { return shooter.Snap(step); });
}

Result<Shot> CaptureStation::SnapPattern(int projector, const Pattern& pattern, double exposure_ms) {
  return ShootPattern(projector, pattern, exposure_ms, {}, Afterwards::kDark);
}

Result<Shot> CaptureStation::ShowPattern(int projector, const Pattern& pattern, double exposure_ms,
                                         std::chrono::nanoseconds hold) {
  Result<Shot> shot = ShootPattern(projector, pattern, exposure_ms, hold, Afterwards::kLit);
  if (!shot.ok()) static_cast<void>(rig_.light->AllOff());  // the guard goes on trying
  return shot;
}

Result<Shot> CaptureStation::ShootPattern(int projector, const Pattern& pattern, double exposure_ms,
                                          std::chrono::nanoseconds hold, Afterwards afterwards) {
  PlanStep step;
  step.projector = projector;
  step.pattern = pattern;
  step.exposure_ms = exposure_ms;
  const SequencerOptions options = SequencerOptionsFor();
  if (projector < 0) return Status::Usage("projector " + std::to_string(projector) + ": they count from 0");
  moved_ = true;
  return Shoot(step, [&](Shooter& shooter) -> Result<Shot> {
    Projector& shows = *rig_.devices().projectors[static_cast<size_t>(projector)];
    SLX_RETURN_IF_ERROR(shows.Load({pattern}));
    SLX_RETURN_IF_ERROR(rig_.light->On(projector, {options.LongestStep(exposure_ms) + hold, options.max_on_time}));
    Result<Shot> shot = shooter.Take(step, 0);
    const Status off = afterwards == Afterwards::kDark ? rig_.light->Off(projector) : Status::Ok();
    if (shot.ok() && shot->fault == ShotFault::kNone) {
      SLX_ASSIGN_OR_RETURN(shot->fault, shooter.DrainEdges());
    }
    if (!shot.ok() || shot->fault != ShotFault::kNone) shows.Doubt();
    return shot.ok() && !off.ok() ? off : std::move(shot);
  });
}

Result<Shot> CaptureStation::Shoot(const PlanStep& step, const std::function<Result<Shot>(Shooter&)>& take) {
  const RigDevices devices = rig_.devices();
  if (step.projector < -1 || step.projector >= static_cast<int>(devices.projectors.size()))
    return Status::Usage("no projector " + std::to_string(step.projector) + ": the rig has " +
                         std::to_string(devices.projectors.size()));
  const SequencerOptions options = SequencerOptionsFor();
  const DarkOnException guard(devices);
  SLX_RETURN_IF_ERROR(devices.camera.Start().WithContext("camera"));
  Shooter shooter(devices, options.shooter, options_.config.plan.sync_mode, [&] { return devices.light.Check(); });
  Result<Shot> shot = take(shooter);
  for (int retry = 0; retry < options.max_retries && shot.ok() && shot->fault != ShotFault::kNone; ++retry)
    shot = take(shooter);
  const Status stopped = devices.camera.Stop().WithContext("camera");
  if (!shot.ok()) return shot;
  if (shot->fault != ShotFault::kNone)
    return Status::Failed(std::string("no frame: ") + ToString(shot->fault) + " in " +
                          std::to_string(options.max_retries + 1) + " tries");
  return stopped.ok() ? std::move(shot) : stopped;
}

}  // namespace stratalux::rig
