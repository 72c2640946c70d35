// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/fleet.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <queue>
#include <utility>

#include "shared/base/formatted.h"
#include "shared/base/median.h"
#include "shared/base/random.h"

namespace stratalux::fit {
namespace {

constexpr double kMinute = 60.0, kHour = 3600.0, kDay = 24.0 * kHour;
constexpr double kBytesPerMbit = 1e6 / 8.0;
constexpr double kBackOff = 30.0;  // of the queue (docs/batch.md), doubled with each attempt
constexpr double kNever = std::numeric_limits<double>::infinity();

double SecondsOfNight(const FleetOptions& options) {
  const double hours = options.until_h - options.from_h;
  return (hours <= 0.0 ? hours + 24.0 : hours) * kHour;
}

double Mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

struct Visitor {
  double captured = 0.0;
  double whole_s = 0.0, left_s = 0.0;  // of a core
  int attempts = 0;
  bool hopeless = false;
};

// Bytes that are dropped when their time is over.
class Retained {
 public:
  void Add(double at, double bytes) {
    at_.emplace_back(at, bytes);
    sum_ += bytes;
  }
  double Since(double oldest) {
    for (; !at_.empty() && at_.front().first < oldest; at_.pop_front()) sum_ -= at_.front().second;
    return at_.empty() ? 0.0 : sum_;
  }

 private:
  std::deque<std::pair<double, double>> at_;
  double sum_ = 0.0;
};

struct Kiosk {
  bool busy = false;
  std::queue<double> line;  // when they came
  std::vector<int> held;    // captured and not pulled
  bool away = false;
  double pull_due = 0.0;
  bool pulling = false;
  Retained pulled;
};

struct Pull {
  int kiosk = 0;
  double left_bytes = 0.0;
  std::vector<int> visitors;
};

struct Core {
  int machine = 0;
  int visitor = -1;
  bool dies = false;  // the attempt under way
  double began = 0.0;
  int64_t turn = 0;  // which of its attempts: an end that was foreseen for an earlier one counts no more
};

enum class What {
  kComes,
  kLeaves,
  kPull,
  kPullEnds,
  kAttemptEnds,
  kQueueAgain,
  kNight,
  kMachineFails,
  kMachineBack,
  kMidnight,
  kMorning
};

struct Event {
  double at = 0.0;
  int64_t order = 0;  // of two at the same time the one that was foreseen first
  What what = What::kMidnight;
  int who = 0;
  int64_t turn = 0;
  bool operator>(const Event& other) const { return at != other.at ? at > other.at : order > other.order; }
};

class Fleet {
 public:
  Fleet(const VisitFigures& figures, const FleetOptions& options)
      : figures_(figures),
        options_(options),
        random_(options.seed),
        usual_s_(Median(figures.fit_cpu_s)),
        night_s_(SecondsOfNight(options)),
        kiosks_(static_cast<size_t>(options.kiosks)) {
    for (int machine = 0; machine < options.machines; ++machine)
      for (int core = 0; core < options.cores; ++core) cores_.push_back({.machine = machine});
    for (size_t core = 0; core < cores_.size(); ++core) idle_.push_back(static_cast<int>(core));
  }

  std::vector<FleetDay> Run() {
    for (int day = 0; day <= options_.days; ++day) At(day * kDay, What::kMidnight, day);
    for (int machine = 0; machine < options_.machines; ++machine) FailLater(machine);
    // Rounds of pulls are spread over the hour, as timers with a random delay spread them.
    for (int kiosk = 0; kiosk < options_.kiosks; ++kiosk)
      At(random_.Uniform(0.0, options_.pull_every_h * kHour), What::kPull, kiosk);
    while (!events_.empty() && days_.size() < static_cast<size_t>(options_.days)) {
      const Event event = events_.top();
      events_.pop();
      now_ = event.at;
      Happen(event);
    }
    return std::move(days_);
  }

 private:
  void At(double at, What what, int who, int64_t turn = 0) {
    if (at < kNever) events_.push({at, order_++, what, who, turn});
  }

  void Happen(const Event& event) {
    switch (event.what) {
      case What::kMidnight:
        return Midnight(event.who);
      case What::kComes:
        return Comes(event.who);
      case What::kLeaves:
        return Leaves(event.who);
      case What::kPull:
        return BeginPull(event.who);
      case What::kPullEnds:
        return EndPulls(event.turn);
      case What::kNight:
        return BeginNight();
      case What::kAttemptEnds:
        return EndAttempt(event.who, event.turn);
      case What::kQueueAgain:
        --waiting_;
        return Enqueue(event.who);
      case What::kMachineFails:
        return MachineFails(event.who);
      case What::kMachineBack:
        return MachineBack(event.who);
      case What::kMorning:
        return Morning(event.who);
    }
  }

  double Gap(double mean) { return -mean * std::log(1.0 - random_.Uniform()); }

  // ---- Kiosks ----

  void Midnight(int day) {
    const double opens = day * kDay + options_.opens_h * kHour;
    for (int kiosk = 0; kiosk < options_.kiosks; ++kiosk) {
      kiosks_[static_cast<size_t>(kiosk)].away = random_.Uniform() < options_.away_share;
      At(NextVisitor(opens), What::kComes, kiosk);
    }
    if (day < options_.days) {
      const double from = day * kDay + options_.from_h * kHour;
      At(from, What::kNight, day);
      At(from + night_s_, What::kMorning, day);
    }
  }

  double Closes(double day_of) const { return std::floor(day_of / kDay) * kDay + options_.closes_h * kHour; }
  double OpenSeconds() const { return (options_.closes_h - options_.opens_h) * kHour; }
  // Of a kiosk; kNever behind the hour at which it closes.
  double NextVisitor(double after) {
    const double at = after + Gap(OpenSeconds() / options_.visitors);
    return at < Closes(after) ? at : kNever;
  }

  void Comes(int who) {
    Kiosk& kiosk = kiosks_[static_cast<size_t>(who)];
    ++day_.came;
    At(NextVisitor(now_), What::kComes, who);
    kiosk.line.push(now_);
    if (!kiosk.busy) BeginVisit(who);
  }

  void BeginVisit(int who) {
    Kiosk& kiosk = kiosks_[static_cast<size_t>(who)];
    if (now_ >= Closes(now_)) kiosk.line = {};
    kiosk.busy = !kiosk.line.empty();
    if (!kiosk.busy) return;
    const double waited = now_ - kiosk.line.front();
    kiosk.line.pop();
    day_.longest_wait_s = std::max(day_.longest_wait_s, waited);
    waited_s_ += waited;
    ++began_;
    At(now_ + figures_.capture_s + options_.between_s, What::kLeaves, who);
  }

  void Leaves(int who) {
    const double whole =
        figures_.fit_cpu_s[static_cast<size_t>(random_.Uniform() * static_cast<double>(figures_.fit_cpu_s.size()))];
    kiosks_[static_cast<size_t>(who)].held.push_back(static_cast<int>(visitors_.size()));
    visitors_.push_back(
        {.captured = now_, .whole_s = whole, .left_s = whole, .hopeless = random_.Uniform() < options_.hopeless_share});
    ++day_.captured;
    BeginVisit(who);
  }

  // ---- Pulls: those under way share the store's ingress, none is faster than its own link ----

  double PullRate() const {
    return kBytesPerMbit * std::min(options_.link_mbit,
                                    options_.ingress_mbit / static_cast<double>(std::max<size_t>(pulls_.size(), 1)));
  }

  void BeginPull(int who) {
    Kiosk& kiosk = kiosks_[static_cast<size_t>(who)];
    At(now_ + options_.pull_every_h * kHour, What::kPull, who);
    if (kiosk.away || kiosk.pulling || kiosk.held.empty()) return;
    AdvancePulls();
    kiosk.pulling = true;
    pulls_.push_back({who, static_cast<double>(kiosk.held.size()) * figures_.frames_bytes, std::move(kiosk.held)});
    kiosk.held.clear();
    ForeseePullEnd();
  }

  void AdvancePulls() {
    for (Pull& pull : pulls_) pull.left_bytes -= (now_ - pulls_at_) * PullRate();
    pulls_at_ = now_;
  }

  void ForeseePullEnd() {
    if (pulls_.empty()) return;
    const auto next = std::min_element(pulls_.begin(), pulls_.end(),
                                       [](const Pull& a, const Pull& b) { return a.left_bytes < b.left_bytes; });
    At(now_ + std::max(0.0, next->left_bytes) / PullRate(), What::kPullEnds, 0, ++pull_turn_);
  }

  void EndPulls(int64_t turn) {
    if (turn != pull_turn_) return;
    AdvancePulls();
    std::vector<Pull> still;
    for (Pull& pull : pulls_) {
      if (pull.left_bytes > 1.0) {
        still.push_back(std::move(pull));
        continue;
      }
      Kiosk& kiosk = kiosks_[static_cast<size_t>(pull.kiosk)];
      kiosk.pulling = false;
      const double bytes = static_cast<double>(pull.visitors.size()) * figures_.frames_bytes;
      kiosk.pulled.Add(now_, bytes);
      frames_.Add(now_, bytes);
      day_.pulled += static_cast<int64_t>(pull.visitors.size());
      for (const int visitor : pull.visitors) Enqueue(visitor);
    }
    pulls_ = std::move(still);
    ForeseePullEnd();
  }

  // ---- The queue and its workers ----

  bool Night() const { return now_ < night_ends_; }

  void Enqueue(int visitor) {
    queue_.emplace(visitors_[static_cast<size_t>(visitor)].captured, visitor);
    Dispatch();
    if (Night()) day_.queue_longest = std::max(day_.queue_longest, static_cast<int64_t>(queue_.size()));
  }

  void BeginNight() {
    night_ends_ = now_ + night_s_;
    day_.queue_longest = static_cast<int64_t>(queue_.size());
    Dispatch();
  }

  // As the night does it: newest first; nobody who, by what is usual, would not be finished.
  void Dispatch() {
    while (Night() && !idle_.empty() && !queue_.empty() &&
           now_ + std::min(usual_s_, visitors_[static_cast<size_t>(queue_.top().second)].left_s) <= night_ends_) {
      const int core = idle_.back();
      idle_.pop_back();
      BeginAttempt(core, queue_.top().second);
      queue_.pop();
    }
  }

  void BeginAttempt(int who, int visitor) {
    Core& core = cores_[static_cast<size_t>(who)];
    Visitor& job = visitors_[static_cast<size_t>(visitor)];
    core.visitor = visitor;
    core.began = now_;
    ++core.turn;
    ++job.attempts;
    ++day_.attempts;
    core.dies = job.hopeless || random_.Uniform() < options_.crash_share;
    At(now_ + (core.dies ? random_.Uniform() : 1.0) * job.left_s, What::kAttemptEnds, who, core.turn);
  }

  void EndAttempt(int who, int64_t turn) {
    Core& core = cores_[static_cast<size_t>(who)];
    if (turn != core.turn || core.visitor < 0) return;
    const int visitor = core.visitor;
    LeaveCore(who);
    idle_.push_back(who);
    if (core.dies) {
      Die(visitor, now_ - core.began);
    } else {
      ++day_.fitted;
      fits_.Add(now_, figures_.fit_bytes);
      artifacts_.Add(now_, figures_.artifact_bytes);
    }
    Dispatch();
    if (queue_.empty() && waiting_ == 0 && Working() == 0) last_end_ = now_;
  }

  // What stages had finished is there for the next attempt.
  void Die(int visitor, double after_s) {
    Visitor& job = visitors_[static_cast<size_t>(visitor)];
    const double lost = random_.Uniform() * figures_.longest_stage_share * job.whole_s;
    job.left_s -= std::max(0.0, after_s - lost);
    if (job.attempts >= options_.attempts) {
      ++day_.set_aside;
      return;
    }
    ++waiting_;
    At(now_ + kBackOff * std::exp2(job.attempts - 1), What::kQueueAgain, visitor);
  }

  void LeaveCore(int who) {
    Core& core = cores_[static_cast<size_t>(who)];
    // What lies behind the morning is the next day's.
    busy_s_ += now_ - std::max(core.began, counted_from_);
    core.visitor = -1;
  }

  int64_t Working() const {
    return std::count_if(cores_.begin(), cores_.end(), [](const Core& core) { return core.visitor >= 0; });
  }

  void FailLater(int machine) {
    if (options_.machine_days > 0.0) At(now_ + Gap(options_.machine_days * kDay), What::kMachineFails, machine);
  }

  void MachineFails(int machine) {
    std::erase_if(idle_, [&](int core) { return cores_[static_cast<size_t>(core)].machine == machine; });
    for (size_t who = 0; who < cores_.size(); ++who) {
      Core& core = cores_[who];
      if (core.machine != machine || core.visitor < 0) continue;
      const int visitor = core.visitor;
      LeaveCore(static_cast<int>(who));
      Die(visitor, now_ - core.began);
    }
    At(now_ + options_.repair_h * kHour, What::kMachineBack, machine);
  }

  void MachineBack(int machine) {
    for (size_t core = 0; core < cores_.size(); ++core)
      if (cores_[core].machine == machine) idle_.push_back(static_cast<int>(core));
    FailLater(machine);
    Dispatch();
  }

  // ---- The morning ----

  void Morning(int day) {
    for (Core& core : cores_)
      if (core.visitor >= 0) busy_s_ += now_ - std::max(core.began, counted_from_);
    day_.day = day;
    day_.mean_wait_s = began_ > 0 ? waited_s_ / static_cast<double>(began_) : 0.0;
    day_.queue_left = static_cast<int64_t>(queue_.size()) + waiting_;
    if (day_.queue_left == 0 && Working() == 0 && day_.fitted + day_.set_aside > 0)
      day_.done_h = (last_end_ - day * kDay) / kHour;
    day_.cores_busy = busy_s_ / (night_s_ * static_cast<double>(cores_.size()));
    day_.store_bytes = frames_.Since(now_ - options_.frames_days * kDay) +
                       artifacts_.Since(now_ - options_.artifacts_days * kDay) +
                       fits_.Since(now_ - options_.fits_days * kDay);
    for (Kiosk& kiosk : kiosks_) {
      day_.on_kiosks += static_cast<int64_t>(kiosk.held.size());
      const double held = static_cast<double>(kiosk.held.size()) * figures_.frames_bytes;
      day_.fullest_kiosk_bytes =
          std::max(day_.fullest_kiosk_bytes, held + kiosk.pulled.Since(now_ - options_.kiosk_days * kDay));
    }
    for (const Pull& pull : pulls_) day_.on_kiosks += static_cast<int64_t>(pull.visitors.size());
    days_.push_back(day_);
    day_ = {};
    waited_s_ = busy_s_ = 0.0;
    began_ = 0;
    counted_from_ = now_;
  }

  const VisitFigures& figures_;
  const FleetOptions& options_;
  Random random_;
  double usual_s_, night_s_;
  double now_ = 0.0, night_ends_ = -1.0, counted_from_ = 0.0;
  std::priority_queue<Event, std::vector<Event>, std::greater<>> events_;
  int64_t order_ = 0;

  std::vector<Kiosk> kiosks_;
  std::vector<Visitor> visitors_;
  std::vector<Pull> pulls_;
  double pulls_at_ = 0.0;
  int64_t pull_turn_ = 0;

  std::priority_queue<std::pair<double, int>> queue_;  // by when they were captured
  std::vector<Core> cores_;
  std::vector<int> idle_;
  int64_t waiting_ = 0;  // for their next attempt

  Retained frames_, artifacts_, fits_;  // in the store
  FleetDay day_;
  double waited_s_ = 0.0, busy_s_ = 0.0, last_end_ = 0.0;
  int64_t began_ = 0;
  std::vector<FleetDay> days_;
};

Status Within(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return Status::Ok();  // nan is not
  return Status::Usage(Formatted("%s %g: allowed are %g to %g", name, value, low, high));
}

}  // namespace

Status FleetOptions::Validate() const {
  SLX_RETURN_IF_ERROR(Within("kiosks", kiosks, 1, 100'000));
  SLX_RETURN_IF_ERROR(Within("visitors", visitors, 1e-3, 1e5));
  SLX_RETURN_IF_ERROR(Within("opens", opens_h, 0.0, 24.0));
  SLX_RETURN_IF_ERROR(Within("closes", closes_h, opens_h, 24.0));
  if (closes_h <= opens_h) return Status::Usage("a kiosk must close after it opens");
  SLX_RETURN_IF_ERROR(Within("between", between_s, 0.0, kHour));
  SLX_RETURN_IF_ERROR(Within("pull-every", pull_every_h, 1.0 / kMinute, 24.0));
  SLX_RETURN_IF_ERROR(Within("link", link_mbit, 1e-3, 1e9));
  SLX_RETURN_IF_ERROR(Within("ingress", ingress_mbit, 1e-3, 1e9));
  SLX_RETURN_IF_ERROR(Within("from", from_h, 0.0, 24.0));
  SLX_RETURN_IF_ERROR(Within("until", until_h, 0.0, 24.0));
  SLX_RETURN_IF_ERROR(Within("machines", machines, 1, 100'000));
  SLX_RETURN_IF_ERROR(Within("cores", cores, 1, 10'000));
  SLX_RETURN_IF_ERROR(Within("attempts", attempts, 1, 100));
  SLX_RETURN_IF_ERROR(Within("away", away_share, 0.0, 1.0));
  SLX_RETURN_IF_ERROR(Within("crashes", crash_share, 0.0, 1.0));
  SLX_RETURN_IF_ERROR(Within("hopeless", hopeless_share, 0.0, 1.0));
  SLX_RETURN_IF_ERROR(Within("machine-days", machine_days, 0.0, 1e6));
  SLX_RETURN_IF_ERROR(Within("repair", repair_h, 0.0, 1e4));
  SLX_RETURN_IF_ERROR(Within("frames-days", frames_days, 0.0, 1e5));
  SLX_RETURN_IF_ERROR(Within("artifacts-days", artifacts_days, 0.0, 1e5));
  SLX_RETURN_IF_ERROR(Within("fits-days", fits_days, 0.0, 1e5));
  SLX_RETURN_IF_ERROR(Within("kiosk-days", kiosk_days, 0.0, 1e5));
  SLX_RETURN_IF_ERROR(Within("days", days, 1, 3650));
  constexpr double kMostVisitors = 5e7;  // some GiB of memory
  return Within("kiosks x visitors x days", kiosks * visitors * days, 0.0, kMostVisitors);
}

FleetLoad LoadOf(const VisitFigures& figures, const FleetOptions& options) {
  const double all = options.kiosks * options.visitors;
  return {.kiosk = options.visitors * (figures.capture_s + options.between_s) /
                   ((options.closes_h - options.opens_h) * kHour),
          .link = options.visitors * figures.frames_bytes / (options.link_mbit * kBytesPerMbit * kDay),
          .ingress = all * figures.frames_bytes / (options.ingress_mbit * kBytesPerMbit * kDay),
          .cores = all * Mean(figures.fit_cpu_s) / (SecondsOfNight(options) * options.machines * options.cores)};
}

Result<std::vector<FleetDay>> SimulateFleet(const VisitFigures& figures, const FleetOptions& options) {
  SLX_RETURN_IF_ERROR(figures.Validate());
  SLX_RETURN_IF_ERROR(options.Validate());
  return Fleet(figures, options).Run();
}

}  // namespace stratalux::fit
