// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/kiosk.h"

#include <cerrno>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include <malloc.h>
#include <poll.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "db/catalogue/consent.h"
#include "db/privacy/open_visits.h"
#include "firmware-host/kiosk/rig_worker.h"
#include "firmware-host/kiosk/selfcheck_keeper.h"
#include "firmware-host/kiosk/service_notice.h"
#include "firmware-host/kiosk/store_watch.h"
#include "firmware-host/kiosk/visit_machine.h"
#include "firmware-host/session/store_disk.h"

namespace stratalux::rig {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kReopenSeconds = 10;
constexpr int kGraceSeconds = 10;  // for what is over its deadline, and was told to end, to come to its end
constexpr auto kHousekeeping = std::chrono::seconds(10);
constexpr int kLookMs = 500;        // for the watchdog, the clock and an operator whose stop came behind another
constexpr int kStoppedLookMs = 20;  // a token that is stopped stays readable: nothing wakes us for the operator
constexpr auto kClockJump = std::chrono::seconds(5);

int Permille(double share) { return static_cast<int>(std::lround(1000.0 * share)); }

int SecondsOf(Deadline deadline, const KioskConfig& kiosk) {
  switch (deadline) {
    case Deadline::kQuestion:
      return kiosk.question_s;
    case Deadline::kConsent:
      return kiosk.consent_s;
    case Deadline::kPosition:
      return kiosk.position_s;
    case Deadline::kCapture:
      return kiosk.capture_s;
    case Deadline::kGate:
      return kiosk.gate_s;
    case Deadline::kThanks:
      return kiosk.thanks_s;
    case Deadline::kForgetting:
      return kiosk.forgetting_s;
    case Deadline::kSelfcheck:
      return kiosk.selfcheck_s;
    case Deadline::kCountdown:
      return 1;
    case Deadline::kReopen:
      return kReopenSeconds;
    case Deadline::kNone:
      return 0;
  }
  return 0;
}

int MinuteOfDay() {
  const std::time_t now = std::time(nullptr);
  std::tm local{};
  localtime_r(&now, &local);
  return local.tm_hour * 60 + local.tm_min;
}

// What a front may say; of languages and texts those that there are.
bool IsOfFront(const VisitEvent& event, const KioskConfig& kiosk) {
  if (const auto* agreed = std::get_if<event::Agree>(&event))
    return agreed->choice.language < kiosk.languages.size() && agreed->choice.text < kiosk.consent_texts.size();
  return std::holds_alternative<event::Start>(event) || std::holds_alternative<event::NotSensitive>(event) ||
         std::holds_alternative<event::Sensitive>(event) || std::holds_alternative<event::Agree>(event) ||
         std::holds_alternative<event::Refuse>(event) || std::holds_alternative<event::Leave>(event) ||
         std::holds_alternative<event::Operator>(event) || std::holds_alternative<event::PageLost>(event) ||
         std::holds_alternative<event::PageBack>(event) || std::holds_alternative<event::Shutdown>(event);
}

class KioskLoop {
 public:
  KioskLoop(CaptureStation& station, const KioskOptions& options, const VisitRules& rules, KioskFront& front,
            StopToken& stop, Logger& logger)
      : station_(station),
        options_(options),
        kiosk_(options.station.config.kiosk),
        rules_(rules),
        front_(front),
        stop_(stop),
        logger_(logger),
        selfchecks_(options.state.empty() ? options.state
                                          : SelfchecksFile(options.state, options.station.simulated.has_value()),
                    logger),
        worker_(station,
                {options.station, options.timing, options.second / 5,
                 [&front](const Shot& shot) { front.Preview(shot.record, shot.pixels); },
                 [this](Selfcheck check) { return KeepSelfcheck(std::move(check)); }, options.after_forget_step},
                stop, logger),
        store_(options.station, rules, logger),
        timer_(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK)) {}

  Result<KioskReport> Run();

 private:
  [[nodiscard]] bool Ended() const {
    return state_.closed_for.Has(Closure::kShutdown) && state_.work == VisitState::Work::kNone;
  }
  [[nodiscard]] bool Hangs() const;
  void Wait() const;
  void Hear();
  void HearRig();
  void KeepHouse();
  void Feed(const VisitEvent& event);
  // Lines once lost are opened by a start alone: the reset that the operator asks for is one.
  [[nodiscard]] bool NeedsNewStart(const VisitEvent& event) const {
    const auto* ordered = std::get_if<event::Operator>(&event);
    return ordered != nullptr && ordered->command == OperatorCommand::kReset && state_.phase == Phase::kSafe &&
           state_.lost.Has(Device::kLines);
  }

  void Perform(const action::LightOff& /*action*/) { worker_.LightOff(); }
  void Perform(const action::StopCapture& action) {
    logger_.Info(std::string("the capture is stopped: ") + ToString(action.reason));
    worker_.LightOff();
  }
  void Perform(const action::Preview& action) { worker_.Begin(action); }
  void Perform(const action::CheckRig& action) { worker_.Begin(action); }
  void Perform(const action::Recover& action) { worker_.Begin(action); }
  void Perform(const action::StartCapture& action) {
    ++report_.captures;
    worker_.Begin(action);
  }
  void Perform(const action::Discard& action) {
    ++report_.discarded;
    untaken_.reset();
    worker_.Begin(action);
  }
  void Perform(const action::Show& action);
  void Perform(const action::PrintTicket& action) {
    untaken_ = action;
    if (front_.GiveTicket(worker_.names().ticket)) KeepVisit();
  }
  void KeepVisit() {
    ++report_.tickets;
    worker_.Begin(*std::exchange(untaken_, std::nullopt));
  }
  void LookForTicket();
  void Perform(const action::TellOperator& action);
  void Perform(const action::Count& action) { ++report_.ended[static_cast<size_t>(action.end)]; }
  void Perform(const action::Arm& action);

  // Wall clock less monotonic clock: changes when somebody sets the clock.
  [[nodiscard]] std::chrono::nanoseconds ClockOffset() const {
    return std::chrono::nanoseconds(options_.wall().ns - MonotonicNow().ns);
  }
  bool KeepSelfcheck(Selfcheck check);
  [[nodiscard]] event::Hours HoursNow() const { return {!kiosk_.hours || kiosk_.hours->IsOpenAt(MinuteOfDay())}; }

  CaptureStation& station_;
  const KioskOptions& options_;
  const KioskConfig& kiosk_;
  const VisitRules& rules_;
  KioskFront& front_;
  StopToken& stop_;
  Logger& logger_;
  VisitState state_;
  KioskReport report_;
  ServiceNotice notice_;
  SelfcheckKeeper selfchecks_;  // the worker's
  RigWorker worker_;
  StoreWatch store_;
  UniqueFd timer_;
  Clock::time_point next_housekeeping_;
  std::chrono::nanoseconds clock_offset_ = ClockOffset();
  std::optional<action::PrintTicket> untaken_;  // nobody has the ticket yet
  bool new_start_ = false;
};

Result<KioskReport> KioskLoop::Run() {
  if (timer_.get() < 0) return Status::Failed("timerfd_create: out of descriptors");
  for (const RigSignal signal : {RigSignal::kDoor, RigSignal::kEmergencyStop, RigSignal::kCamera, RigSignal::kLines})
    if (!station_.events().IsActive(signal))
      continue;
    else if (signal == RigSignal::kDoor || signal == RigSignal::kEmergencyStop)
      Feed(event::InterlockChanged{signal == RigSignal::kDoor ? Interlock::kDoor : Interlock::kEmergencyStop, true});
    else
      Feed(event::DeviceChanged{signal == RigSignal::kCamera ? Device::kCamera : Device::kLines, false});
  front_.ShowSelfchecks(selfchecks_.trend());
  front_.ServeWithdrawals([this](const std::string& visitor) { return worker_.Withdraw(visitor); });
  KeepHouse();
  notice_.Ready();
  while (!Ended() && !new_start_) {
    Wait();
    Hear();
    LookForTicket();
    if (!Hangs()) notice_.Alive();
  }
  front_.ServeWithdrawals(nullptr);
  notice_.Stopping();
  if (new_start_)
    return Status::Failed("the GPIO lines are gone; the kiosk ends, and opens them when it is started again");
  report_.begun = state_.visit;
  report_.owed = state_.closed_for.Has(Closure::kUnforgotten);
  return report_;
}

// A job that never ends is the watchdog's, whatever is shown meanwhile: what comes behind it is never begun.
bool KioskLoop::Hangs() const {
  const std::optional<WorkInHand> work = worker_.in_hand();
  return work && Clock::now() - work->since > (SecondsOf(work->deadline, kiosk_) + kGraceSeconds) * options_.second;
}

// Of a ticket that nobody took the note stays, so that the next forgetting or the next start takes what nobody could
// ever take back.
void KioskLoop::LookForTicket() {
  if (!untaken_) return;
  if (front_.TicketTaken()) return KeepVisit();
  if (state_.phase == Phase::kThanks) return;
  untaken_.reset();
  logger_.Error("a ticket could not be handed out: the visit has none and is not kept");
}

void KioskLoop::Wait() const {
  const bool stopped = stop_.stopped();
  std::array<pollfd, 5> fds = {pollfd{station_.events().fd(), POLLIN, 0}, pollfd{worker_.fd(), POLLIN, 0},
                               pollfd{timer_.get(), POLLIN, 0}, pollfd{front_.fd(), POLLIN, 0},
                               pollfd{stopped ? -1 : stop_.fd(), POLLIN, 0}};
  poll(fds.data(), fds.size(), stopped ? kStoppedLookMs : kLookMs);
}

// What takes the light away first: who fails because of it is not asked why.
void KioskLoop::Hear() {
  HearRig();
  if (stop_.operator_asked() && !state_.closed_for.Has(Closure::kShutdown)) Feed(event::Shutdown{});
  for (const VisitEvent& event : front_.Take())
    if (IsOfFront(event, kiosk_)) {
      new_start_ = new_start_ || NeedsNewStart(event);
      Feed(event);
    }
  for (const VisitEvent& event : worker_.Take()) {
    HearRig();
    Feed(event);
  }
  uint64_t expirations = 0;
  if (read(timer_.get(), &expirations, sizeof expirations) == sizeof expirations) Feed(event::Tick{state_.armed});
  if (Clock::now() >= next_housekeeping_) KeepHouse();
  if (std::chrono::abs(ClockOffset() - clock_offset_) < kClockJump) return;
  clock_offset_ = ClockOffset();
  Feed(event::ClockJumped{});
  Feed(HoursNow());
}

void KioskLoop::HearRig() {
  for (const RigEvent& event : station_.events().Take()) {
    const bool active = event.level == SignalLevel::kActive;
    switch (event.signal) {
      case RigSignal::kStart:
        Feed(event::Start{});
        break;
      case RigSignal::kDoor:
        Feed(event::InterlockChanged{Interlock::kDoor, active});
        break;
      case RigSignal::kEmergencyStop:
        Feed(event::InterlockChanged{Interlock::kEmergencyStop, active});
        break;
      case RigSignal::kCamera:
        Feed(event::DeviceChanged{Device::kCamera, !active});
        break;
      case RigSignal::kLines:
        Feed(event::DeviceChanged{Device::kLines, !active});
        break;
    }
  }
}

void KioskLoop::KeepHouse() {
  next_housekeeping_ = Clock::now() + kHousekeeping;
  Feed(store_.Space());
  Feed(store_.Calibration());
  Feed(HoursNow());
}

void KioskLoop::Feed(const VisitEvent& event) {
  VisitStep step = Step(rules_, state_, event);
  if (logger_.Shows(LogLevel::kDebug) && !(step.state == state_))
    logger_.Debug(ToString(event) + " -> " + ToString(step.state));
  state_ = step.state;
  const bool nobody = state_.phase == Phase::kIdle || state_.phase == Phase::kClosed || state_.phase == Phase::kSafe;
  worker_.SetRest(nobody && state_.work == VisitState::Work::kNone);
  for (const VisitAction& action : step.actions) std::visit([this](const auto& one) { Perform(one); }, action);
  if (options_.after_step) options_.after_step(state_, event);
}

void KioskLoop::Perform(const action::Show& action) {
  front_.Show(action);
  notice_.State(std::string(ToString(action.screen)) + ", " + std::to_string(report_.tickets) + " visits kept");
}

void KioskLoop::Perform(const action::TellOperator& action) {
  logger_.Write(LogLevel::kWarning, std::string("operator: ") + ToString(action.word),
                {{"STRATALUX_KIOSK", ToString(action.word)}});
  front_.TellOperator(action.word);
}

// Anew, also for the same one; what had run out before is gone with it.
void KioskLoop::Perform(const action::Arm& action) {
  itimerspec spec{};
  const std::chrono::nanoseconds after = SecondsOf(action.deadline, kiosk_) * options_.second;
  spec.it_value = {static_cast<time_t>(after.count() / 1'000'000'000),
                   static_cast<long>(after.count() % 1'000'000'000)};
  timerfd_settime(timer_.get(), 0, &spec, nullptr);
}

// On the worker's thread.
bool KioskLoop::KeepSelfcheck(Selfcheck check) {
  check.at = options_.wall();
  selfchecks_.Add(std::move(check));
  const SelfcheckTrend trend = selfchecks_.trend();
  for (const FigureDrift& drift : trend.drifts)
    logger_.Write(LogLevel::kWarning, "self-check: " + ToText(drift, trend.days), {{"STRATALUX_KIOSK", "drift"}});
  front_.ShowSelfchecks(trend);
  return !trend.drifts.empty();
}

}  // namespace

Result<VisitRules> RulesOf(const StationOptions& station) {
  const KioskConfig& kiosk = station.config.kiosk;
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(station.config.plan));
  VisitRules rules;
  rules.attempts = kiosk.attempts;
  rules.countdown = kiosk.countdown_s;
  rules.steady_looks = kiosk.steady_looks;
  rules.space_bytes = kiosk.attempts * SessionBytes(static_cast<int64_t>(plan.steps.size()),
                                                    station.config.camera.width, station.config.camera.height);
  rules.calibration_days = kiosk.calibration_days;
  rules.margin_permille = Permille(kiosk.margin);
  rules.height_permille = Permille(kiosk.height);
  rules.off_centre_permille = Permille(kiosk.off_centre);
  rules.nearest_mm = static_cast<int>(kiosk.nearest_mm);
  rules.furthest_mm = static_cast<int>(kiosk.furthest_mm);
  rules.level_permille = Permille(kiosk.snr);
  // A camera whose exposure cannot be set has no shorter one.
  const bool fixed = !station.simulated && station.config.camera.exposure_control == ExposureControl::kNone;
  if (fixed) rules.shortest_exposure_us = std::numeric_limits<int>::max();
  rules.most_saturated_permille = Permille(kiosk.most_saturated);
  rules.least_coverage_permille = Permille(kiosk.least_coverage);
  rules.paper_consent = !kiosk.paper_scope.empty();
  if (rules.paper_consent) {
    Consent paper;
    SLX_RETURN_IF_ERROR(db::SetScope(kiosk.paper_scope, paper).WithContext("kiosk.paper_scope"));
    rules.paper = {paper.fit, paper.research, paper.publication, 0, 0};
  }
  SLX_RETURN_IF_ERROR(rules.Validate());
  return rules;
}

Status KioskOptions::Validate() const {
  if (station.config.plan.kind != SessionKind::kVisitor)
    return Status::Usage(std::string("the kiosk captures visitors; plan.kind is ") +
                         ToString(station.config.plan.kind));
  if (station.config.store.folder.empty())
    return Status::Usage(
        "no store given; use --store DIR, set STRATALUX_STORE or write [rig] store in the configuration");
  SLX_RETURN_IF_ERROR(station.Validate());
  return RulesOf(station).status();
}

Result<KioskReport> RunKiosk(CaptureStation& station, const KioskOptions& options, KioskFront& front, StopToken& stop,
                             Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(const VisitRules rules, RulesOf(options.station));
  SLX_RETURN_IF_ERROR(db::CheckVisitsAreFree(options.station.config.store.folder));
  // Threads come and go with each visit, and each arena keeps what the last one left in it: 8 MB more after a thousand.
  mallopt(M_ARENA_MAX, 1);
  KioskLoop loop(station, options, rules, front, stop, logger);
  return loop.Run();
}

}  // namespace stratalux::rig
