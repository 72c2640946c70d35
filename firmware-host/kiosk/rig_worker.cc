// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/rig_worker.h"

#include <cmath>
#include <cstdio>
#include <exception>
#include <optional>
#include <random>
#include <utility>

#include <sys/eventfd.h>
#include <unistd.h>

#include "db/privacy/ticket.h"
#include "firmware-host/kiosk/capture_watch.h"
#include "firmware-host/kiosk/selfcheck_keeper.h"
#include "firmware-host/sequence/rig_check.h"
#include "shared/base/check.h"

namespace stratalux::rig {
namespace {

constexpr int kDistanceBits = 5;  // 32 stripes

bool MakesLight(const VisitAction& job) {
  return std::holds_alternative<action::Preview>(job) || std::holds_alternative<action::CheckRig>(job) ||
         std::holds_alternative<action::StartCapture>(job);
}

Deadline DeadlineOf(const VisitAction& job) {
  if (std::holds_alternative<action::Preview>(job)) return Deadline::kPosition;
  if (std::holds_alternative<action::StartCapture>(job)) return Deadline::kCapture;
  if (std::holds_alternative<action::CheckRig>(job)) return Deadline::kSelfcheck;
  return std::holds_alternative<action::Recover>(job) ? Deadline::kReopen : Deadline::kForgetting;
}

// What the machine hears of a job that came to nothing.
std::optional<VisitEvent> FailureOf(const VisitAction& job) {
  if (std::holds_alternative<action::StartCapture>(job) || std::holds_alternative<action::Preview>(job))
    return event::Failed{};
  if (std::holds_alternative<action::CheckRig>(job)) return event::Checked{};
  if (std::holds_alternative<action::Recover>(job)) return event::Recovered{};
  if (std::holds_alternative<action::Discard>(job)) return event::DiscardFailed{};
  return std::nullopt;
}

}  // namespace

RigWorker::RigWorker(CaptureStation& station, WorkerOptions options, StopToken& stop, Logger& logger)
    : station_(station),
      options_(std::move(options)),
      stop_(stop),
      logger_(logger),
      wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
      search_([this] { Tell(event::Leftover{}); }, logger),
      forgetting_(options_.station.config.store.folder, options_.after_forget_step, search_, logger) {
  SLX_CHECK(wake_.get() >= 0);
  thread_ = std::thread([this] { Work(); });
}

RigWorker::~RigWorker() {
  LightOff();
  {
    const std::scoped_lock lock(mutex_);
    ending_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void RigWorker::Begin(const VisitAction& job) {
  {
    const std::scoped_lock lock(mutex_);
    jobs_.push_back(job);
  }
  changed_.notify_all();
}

void RigWorker::LightOff() {
  {
    const std::scoped_lock lock(mutex_);
    // What was not begun is answered, too.
    for (const VisitAction& job : jobs_)
      if (MakesLight(job) && !std::holds_alternative<action::Preview>(job)) told_.push_back(*FailureOf(job));
    std::erase_if(jobs_, MakesLight);
    cancelled_ = lighting_;
    if (lighting_) stop_.Request(StopReason::kVisitorLeft);
  }
  changed_.notify_all();
  Wake();
}

void RigWorker::Wake() {
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(wake_.get(), &one, sizeof one);
}

std::vector<VisitEvent> RigWorker::Take() {
  uint64_t count = 0;
  [[maybe_unused]] const ssize_t read_bytes = read(wake_.get(), &count, sizeof count);
  const std::scoped_lock lock(mutex_);
  return std::exchange(told_, {});
}

std::optional<WorkInHand> RigWorker::in_hand() const {
  const std::scoped_lock lock(mutex_);
  return in_hand_;
}

VisitNames RigWorker::names() const {
  const std::scoped_lock lock(mutex_);
  return names_;
}

void RigWorker::Tell(const VisitEvent& event) {
  {
    const std::scoped_lock lock(mutex_);
    told_.push_back(event);
  }
  Wake();
}

bool RigWorker::cancelled() const {
  const std::scoped_lock lock(mutex_);
  return cancelled_ || ending_;
}

bool RigWorker::LightTaken() const {
  const StopReason reason = stop_.reason();
  return reason == StopReason::kLeaseExpired || reason == StopReason::kOnTimeLimit || reason == StopReason::kLinesGone;
}

void RigWorker::Work() {
  ForgetWhatWasLeft();
  while (true) {
    VisitAction job;
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return ending_ || !jobs_.empty(); });
      if (jobs_.empty()) return;
      job = jobs_.front();
      jobs_.pop_front();
      lighting_ = MakesLight(job);
      cancelled_ = false;
      in_hand_ = {DeadlineOf(job), std::chrono::steady_clock::now()};
    }
    // Of the libraries' own: no job may take the program with it, which would find the same again at its next start.
    try {
      std::visit([this](const auto& one) { Do(one); }, job);
    } catch (const std::exception& error) {
      logger_.Error(ToString(job) + ": " + error.what());
      if (const auto failed = FailureOf(job)) Tell(*failed);
    }
    {
      const std::scoped_lock lock(mutex_);
      lighting_ = cancelled_ = false;
      in_hand_.reset();
    }
    SettleStop();
  }
}

void RigWorker::SettleStop() {
  if (stop_.reason() != StopReason::kVisitorLeft) {
    if (LightTaken()) Tell(event::Failed{true});
    return;
  }
  // What we asked for is done.
  const Status reset = station_.light().Reset();
  if (reset.ok()) return;
  // While door or E-STOP are open this fails: their own way out resets it then. Else a lamp may shine on nobody.
  const RigEvents& events = station_.events();
  const bool open = events.IsActive(RigSignal::kDoor) || events.IsActive(RigSignal::kEmergencyStop) ||
                    events.IsActive(RigSignal::kLines);
  if (open) return logger_.Debug("not reset yet: " + reset.message());
  logger_.Error(reset.message());
  Tell(event::Failed{true});
}

void RigWorker::Do(const action::Preview& /*job*/) {
  foreground_ = {};
  while (!cancelled()) {
    const std::optional<VisitEvent> seen = Look();
    {
      std::unique_lock lock(mutex_);
      if (cancelled_ || ending_) return;
      if (seen) told_.push_back(*seen);
    }
    Wake();
    if (seen && std::holds_alternative<event::Failed>(*seen)) return;
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, options_.look_pause, [this] { return cancelled_ || ending_; });
    in_hand_->since = std::chrono::steady_clock::now();
  }
}

std::optional<VisitEvent> RigWorker::Look() {
  const RigConfig& config = options_.station.config;
  const auto longest = FromMilliseconds(1000.0 * config.max_visit_s);
  const Result<PreScanTaken> taken = station_.TakePreScan(config.plan, options_.timing, longest);
  if (!taken.ok()) {
    // Door, E-STOP and cable speak for themselves.
    if (stop_.stopped() && !LightTaken()) return std::nullopt;
    logger_.Warning("pre-scan: " + taken.status().message());
    return event::Failed{LightTaken()};
  }
  if (options_.preview) options_.preview(taken->shots.front());
  std::vector<PreScan> scans;
  for (size_t i = 0; i < taken->shots.size(); i += 2)
    scans.push_back({taken->shots[i].pixels, taken->shots[i + 1].pixels});
  const ExposureRule rule = station_.RuleOfCamera();
  std::optional<Foreground> foreground = ForegroundOf(scans, rule.read_noise_dn);
  if (!foreground || !taken->choice) return event::NoFace{};
  event::Face face;
  face.box = BoxOf(*foreground);
  face.level_permille = static_cast<int>(std::lround(1000.0 * std::min(10.0, taken->choice->snr / rule.wanted_snr)));
  face.exposure_us = static_cast<int>(std::lround(1000.0 * taken->choice->exposure_ms));
  if (const auto distance = Distance(*foreground)) face.distance_mm = static_cast<int>(std::lround(*distance));
  foreground_ = std::move(*foreground);
  prescan_ = taken->choice->findings;
  return face;
}

std::optional<double> RigWorker::Distance(const Foreground& foreground) {
  const RigConfig& config = options_.station.config;
  if (config.kiosk.nearest_mm <= 0.0 && config.kiosk.furthest_mm <= 0.0) return std::nullopt;
  const Result<CapturePlan> plan = BuildPlan(config.plan);
  const Result<RigCalibration> calibration = station_.Calibration(config.calibration);
  if (!plan.ok() || !calibration.ok()) return std::nullopt;
  std::vector<Shot> shots;
  const auto code = CoarseCode(*plan, 0, kDistanceBits);
  for (const auto& [bit, inverse] : code)
    for (const Pattern& pattern : {bit, inverse}) {
      Result<Shot> shot = station_.SnapPattern(0, pattern, config.plan.exposure_ms);
      if (!shot.ok()) return std::nullopt;
      shots.push_back(std::move(shot).value());
    }
  if (shots.empty()) return std::nullopt;
  std::vector<CodeBit> bits;
  for (size_t i = 0; i < shots.size(); i += 2) bits.push_back({shots[i].pixels, shots[i + 1].pixels});
  return MedianDistanceMm(foreground, bits, code.front().first.bits, *calibration, 0);
}

void RigWorker::Do(const action::CheckRig& /*job*/) {
  const RigConfig& config = options_.station.config;
  RigCheckOptions check;
  if (const Result<CapturePlan> plan = BuildPlan(config.plan); plan.ok())
    for (const PlanStep& step : plan->steps)
      if (step.phase == CapturePhase::kPreroll) check.markers.push_back(step.pattern);
  check.exposure_ms = config.plan.exposure_ms;
  check.settle = FromMilliseconds(config.settle_ms);
  check.deadline = config.LongestDeadline();
  check.max_on_time = FromMilliseconds(1e3 * config.max_on_time_s);
  check.wait = station_.rig().wait();
  const Result<RigCheckReport> report = CheckRig(station_.rig().devices(), check);
  bool passed = report.ok();
  if (!report.ok()) logger_.Warning("self-check: " + report.status().message());
  if (report.ok())
    for (const CheckItem& item : report->items) {
      passed &= item.state != CheckState::kFailed;
      if (item.state == CheckState::kFailed)
        logger_.Warning("self-check: " + item.name + ": " + item.found + "; " + item.remedy);
    }
  station_.Rest();
  std::optional<Selfcheck> figures;
  if (report.ok() && options_.checked) figures = SelfcheckOf(*report, check.exposure_ms);
  const bool drifted = figures && options_.checked(std::move(*figures));
  Tell(event::Checked{passed, drifted, LightTaken()});
}

void RigWorker::Do(const action::Recover& /*job*/) {
  Status recovered;
  if (station_.CameraWent()) recovered = station_.ReopenCamera();
  if (recovered.ok() && stop_.stopped()) recovered = station_.light().Reset();
  if (!recovered.ok()) logger_.Warning(recovered.message());
  Tell(event::Recovered{recovered.ok()});
}

void RigWorker::NameVisit(uint32_t visit) {
  VisitNames names;
  names.visit = visit;
  names.ticket = db::DrawTicket();
  const Result<std::string> visitor = db::VisitorOfTicket(names.ticket);
  SLX_CHECK(visitor.ok());
  names.visitor = *visitor;
  std::random_device random;
  char name[32];
  std::snprintf(name, sizeof name, "visit-%08x", random());
  names.name = name;
  const std::scoped_lock lock(mutex_);
  names_ = names;
}

CaptureRequest RigWorker::RequestFor(const action::StartCapture& job) const {
  const RigConfig& config = options_.station.config;
  const VisitNames named = names();
  CaptureRequest request;
  request.plan = config.plan;
  request.plan.exposure_ms = 1e-3 * job.exposure_us;
  request.visitor = named.visitor;
  request.visit = named.name;
  request.attempt = job.attempt;
  request.calibration = config.calibration;
  request.prescan = prescan_;
  if (const auto retention = ParseRetention(config.kiosk.retention); retention.ok()) request.retention = *retention;
  // That of the first attempt holds for all.
  if (job.attempt > 1) return request;
  Consent& consent = request.consent.emplace();
  consent.fit = job.consent.fit;
  consent.research = job.consent.research;
  consent.publication = job.consent.publication;
  consent.language = config.kiosk.languages.at(job.consent.language);
  consent.text_version = config.kiosk.consent_texts.at(job.consent.text);
  return request;
}

void RigWorker::Do(const action::StartCapture& job) {
  if (job.attempt == 1) NameVisit(job.visit);
  const VisitNames named = names();
  if (const Status noted = forgetting_.Begin(named.name, named.visitor); !noted.ok()) {
    logger_.Error("no capture of a visitor whom a power cut would leave without a ticket: " + noted.message());
    return Tell(event::Failed{});
  }
  const auto turn = search_.Turn();
  const CaptureRequest request = RequestFor(job);
  const Result<CapturePlan> plan = BuildPlan(request.plan);
  const int steps = plan.ok() ? static_cast<int>(plan->steps.size()) : 1;
  CaptureWatch watch(foreground_, station_.RuleOfCamera(), steps, [this](int done, int of) {
    Tell(event::Progress{done, of});
  });
  const Result<CaptureOutcome> outcome = station_.Capture(request, &watch);
  if (!outcome.ok()) {
    logger_.Warning("no capture: " + outcome.status().message());
    return Tell(event::Failed{LightTaken()});
  }
  const CaptureReport& report = outcome->report;
  logger_.Write(
      LogLevel::kInfo,
      "session " + outcome->session + ": " + ToString(report.status) + ", attempt " + std::to_string(job.attempt),
      {{"SESSION", outcome->session}});
  for (const std::string& reason : report.Reasons()) logger_.Warning(reason);
  Tell(event::Captured{watch.Facts(report, LightTaken())});
}

void RigWorker::Do(const action::PrintTicket& job) {
  const VisitNames named = names();
  if (named.visit != job.visit) return;
  if (const Status kept = forgetting_.Keep(named.name); !kept.ok())
    logger_.Error(
        "a visit that has its ticket will be forgotten at the next start unless its note is removed before: " +
        kept.message());
}

void RigWorker::Do(const action::Discard& job) {
  const VisitNames named = names();
  Status noted, forgotten;
  if (named.visit == job.visit) noted = forgetting_.Begin(named.name, named.visitor);
  if (noted.ok()) {
    forgotten = forgetting_.ForgetUnkept();
  } else {
    // A disk that is full or read-only takes no note; what is there may go all the same.
    logger_.Warning("a visit to be forgotten could not be noted: " + noted.message());
    forgotten = forgetting_.Withdraw(named.visitor);
    if (forgotten.code() == StatusCode::kNotFound) forgotten = Status::Ok();
  }
  if (!forgotten.ok()) logger_.Error("a visit could not be forgotten: " + forgotten.message());
  forgotten.ok() ? Tell(event::Discarded{}) : Tell(event::DiscardFailed{});
}

void RigWorker::ForgetWhatWasLeft() {
  Status forgotten;
  try {
    forgotten = forgetting_.ForgetUnkept();
  } catch (const std::exception& error) {
    forgotten = Status::Failed(error.what());
  }
  if (forgotten.ok()) return;
  logger_.Error("what was left without a ticket could not be forgotten: " + forgotten.message() +
                "; the next discard or start tries again");
  Tell(event::Leftover{});
}

}  // namespace stratalux::rig
