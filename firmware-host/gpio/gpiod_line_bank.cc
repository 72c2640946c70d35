// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/gpio/gpiod_line_bank.h"

#include <algorithm>
#include <array>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "firmware-host/events/start_button.h"
#include "firmware-host/gpio/gpio_adapter.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

// How long an unplugged chip stays unnoticed at most.
constexpr int kCheckPeriodMs = 50;
constexpr size_t kMaxEdges = 4096;  // that nobody waited for

enum class InputRole : uint8_t { kSync, kStrobe, kStart };

struct Input {
  InputRole role = InputRole::kSync;
  int projector = -1;
  int64_t count = 0;  // edges, by the kernel's numbers
};

// The outputs of one request: which bit is which signal.
struct OutputPlan {
  std::string chip_path;
  std::vector<unsigned> offsets;
  uint64_t active_low = 0;
  std::vector<uint64_t> trigger, reset;  // by projector; 0: not wired
  uint64_t camera_trigger = 0;
};

struct InputPlan {
  std::string chip_path;
  std::vector<InputLine> lines;
  std::vector<Input> inputs;
};

Status OneChip(const char* what, const LineAddress& at, const FoundLine& line, std::string& chip_path) {
  if (chip_path.empty()) chip_path = line.chip_path;
  if (chip_path == line.chip_path) return Status::Ok();
  return Status::Usage(std::string(what) + " line " + at.ToString() + " is on " + line.chip_path + ", others on " +
                       chip_path + "; lines that switch together must be on one chip");
}

Result<uint64_t> AddOutput(std::span<const GpioChip> chips, const std::optional<OutputWiring>& wiring,
                           OutputPlan& plan) {
  if (!wiring) return uint64_t{0};
  SLX_ASSIGN_OR_RETURN(const FoundLine line, FindLine(chips, wiring->at));
  SLX_RETURN_IF_ERROR(OneChip("output", wiring->at, line, plan.chip_path));
  if (plan.offsets.size() == 64) return Status::Usage("more than 64 output lines");
  const uint64_t bit = uint64_t{1} << plan.offsets.size();
  plan.offsets.push_back(line.offset);
  if (wiring->active == ActiveLevel::kLow) plan.active_low |= bit;
  return bit;
}

Result<OutputPlan> PlanOutputs(std::span<const GpioChip> chips, const GpioWiring& wiring) {
  OutputPlan plan;
  for (const ProjectorLines& p : wiring.projectors) {
    SLX_ASSIGN_OR_RETURN(plan.trigger.emplace_back(), AddOutput(chips, p.trigger, plan));
    SLX_ASSIGN_OR_RETURN(plan.reset.emplace_back(), AddOutput(chips, p.reset, plan));
  }
  SLX_ASSIGN_OR_RETURN(plan.camera_trigger, AddOutput(chips, wiring.camera_trigger, plan));
  return plan;
}

Status AddInput(std::span<const GpioChip> chips, const std::optional<InputWiring>& wiring, Input input,
                InputPlan& plan) {
  if (!wiring) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const FoundLine line, FindLine(chips, wiring->at));
  SLX_RETURN_IF_ERROR(OneChip("input", wiring->at, line, plan.chip_path));
  plan.lines.push_back({line.offset, wiring->active, wiring->bias, wiring->debounce});
  plan.inputs.push_back(input);
  return Status::Ok();
}

Result<InputPlan> PlanInputs(std::span<const GpioChip> chips, const GpioWiring& wiring) {
  InputPlan plan;
  for (size_t p = 0; p < wiring.projectors.size(); ++p)
    SLX_RETURN_IF_ERROR(AddInput(chips, wiring.projectors[p].sync, {InputRole::kSync, static_cast<int>(p)}, plan));
  SLX_RETURN_IF_ERROR(AddInput(chips, wiring.strobe, {InputRole::kStrobe}, plan));
  SLX_RETURN_IF_ERROR(AddInput(chips, wiring.start, {InputRole::kStart}, plan));
  return plan;
}

class Bank final : public GpiodLineBank {
 public:
  // `outputs` and `inputs` may be null: nothing of the kind is wired.
  Bank(OutputPlan plan, std::unique_ptr<OutputRequest> outputs, std::vector<Input> inputs,
       std::unique_ptr<InputRequest> input_request, UniqueFd stop, Logger& logger, RigEvents* events)
      : plan_(std::move(plan)),
        outputs_(std::move(outputs)),
        inputs_(std::move(inputs)),
        input_request_(std::move(input_request)),
        stop_(std::move(stop)),
        logger_(logger),
        events_(events) {}
  ~Bank() override;
  Bank(const Bank&) = delete;
  Bank& operator=(const Bank&) = delete;

  // After construction, before anything else.
  Status Begin();

  Result<TriggerReceipt> TriggerProjector(int projector) override;
  Result<TriggerReceipt> TriggerCamera() override;
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds timeout) override;
  [[nodiscard]] std::optional<MonotonicNs> LastStrobe() override;
  Status ResetMemory(int projector) override;
  [[nodiscard]] int64_t SyncCount(int projector) override;

  std::chrono::microseconds projector_pulse_{0}, camera_pulse_{0}, reset_pulse_{0};

 private:
  Status CheckProjector(int projector, const std::vector<uint64_t>& bits, const char* signal) const;
  Result<TriggerReceipt> Pulse(uint64_t bits, std::chrono::microseconds width);
  // With mutex_ held.
  Status Write(uint64_t active);
  [[nodiscard]] Status GoneStatus() const { return Status::Failed("GPIO lines are gone: " + gone_reason_); }

  void Watch();
  // False when the lines are gone.
  bool ProbeLines();
  bool TakeEvents();
  void Take(const LineEvent& event);
  void LinesGone(const std::string& reason);

  const OutputPlan plan_;
  const std::unique_ptr<OutputRequest> outputs_;
  std::vector<Input> inputs_;
  const std::unique_ptr<InputRequest> input_request_;
  const UniqueFd stop_;  // eventfd: the watcher shall end
  Logger& logger_;
  RigEvents* const events_;
  StartButton start_;  // the watcher's
  std::thread watcher_;

  std::mutex pulse_mutex_;  // one pulse after the other
  std::mutex mutex_;        // guards what follows, and the counts of inputs_
  std::condition_variable changed_;
  uint64_t active_ = 0;  // outputs
  int64_t pulses_ = 0;
  std::string gone_reason_;  // not empty: the lines are gone
  std::deque<SyncEdge> edges_;
  std::optional<MonotonicNs> strobe_;
};

Status Bank::Begin() {
  if (!ProbeLines()) return GoneStatus();
  watcher_ = std::thread([this] { Watch(); });
  return Status::Ok();
}

Bank::~Bank() {
  if (watcher_.joinable()) {
    const uint64_t one = 1;
    if (write(stop_.get(), &one, sizeof one) != sizeof one) logger_.Error("GPIO: the watcher cannot be told to stop");
    watcher_.join();
  }
  const std::lock_guard lock(mutex_);
  static_cast<void>(Write(0));
}

Status Bank::Write(uint64_t active) {
  active_ = active;
  if (!outputs_) return Status::Ok();
  const int error = outputs_->Write(active ^ plan_.active_low);
  return error == 0 ? Status::Ok() : Status::Failed(plan_.chip_path + ": " + std::strerror(error));
}

Status Bank::CheckProjector(int projector, const std::vector<uint64_t>& bits, const char* signal) const {
  if (projector < 0 || projector >= static_cast<int>(bits.size()))
    return Status::Usage("projector " + std::to_string(projector) + " does not exist");
  if (bits[projector] == 0)
    return Status::Usage("projector " + std::to_string(projector) + " has no " + signal + " line");
  return Status::Ok();
}

Result<TriggerReceipt> Bank::Pulse(uint64_t bits, std::chrono::microseconds width) {
  const std::lock_guard one_at_a_time(pulse_mutex_);
  TriggerReceipt receipt;
  {
    const std::lock_guard lock(mutex_);
    receipt = {pulses_, MonotonicNow()};
    if (const Status up = Write(active_ | bits); !up.ok()) {
      active_ &= ~bits;  // of a pulse that may not have begun: the next one has its own
      return up;
    }
    ++pulses_;
  }
  std::this_thread::sleep_for(width);
  const std::lock_guard lock(mutex_);
  SLX_RETURN_IF_ERROR(Write(active_ & ~bits));
  return receipt;
}

Result<TriggerReceipt> Bank::TriggerProjector(int projector) {
  uint64_t bits = 0;
  for (int p = 0; p < static_cast<int>(plan_.trigger.size()); ++p) {
    if (projector >= 0 && p != projector) continue;
    SLX_RETURN_IF_ERROR(CheckProjector(p, plan_.trigger, "TRIGGER"));
    bits |= plan_.trigger[p];
  }
  if (bits == 0) return Status::Usage("projector " + std::to_string(projector) + " does not exist");
  return Pulse(bits, projector_pulse_);
}

Result<TriggerReceipt> Bank::TriggerCamera() {
  if (plan_.camera_trigger == 0) return Status::Usage("no camera TRIGGER line is wired ([gpio] camera_trigger)");
  return Pulse(plan_.camera_trigger, camera_pulse_);
}

Status Bank::ResetMemory(int projector) {
  SLX_RETURN_IF_ERROR(CheckProjector(projector, plan_.reset, "RESET"));
  return Pulse(plan_.reset[projector], reset_pulse_).status();
}

Result<std::optional<SyncEdge>> Bank::WaitSync(std::chrono::nanoseconds timeout) {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, timeout, [this] { return !edges_.empty() || !gone_reason_.empty(); });
  if (edges_.empty()) {
    if (!gone_reason_.empty()) return GoneStatus();
    return std::optional<SyncEdge>();
  }
  const SyncEdge edge = edges_.front();
  edges_.pop_front();
  return std::optional(edge);
}

std::optional<MonotonicNs> Bank::LastStrobe() {
  const std::lock_guard lock(mutex_);
  return strobe_;
}

int64_t Bank::SyncCount(int projector) {
  const std::lock_guard lock(mutex_);
  for (const Input& input : inputs_)
    if (input.role == InputRole::kSync && input.projector == projector) return input.count;
  return 0;
}

void Bank::Watch() {
  std::array<pollfd, 2> fds = {pollfd{stop_.get(), POLLIN, 0},
                               pollfd{input_request_ ? input_request_->fd() : -1, POLLIN, 0}};
  auto next_check = std::chrono::steady_clock::now();
  while (true) {
    poll(fds.data(), fds.size(), kCheckPeriodMs);
    if (fds[0].revents != 0) return;
    if ((fds[1].revents & POLLIN) != 0 && !TakeEvents()) return;
    if ((fds[1].revents & (POLLERR | POLLHUP | POLLNVAL)) != 0) return LinesGone("the kernel hung up");
    // Under steady edges poll never times out.
    if (std::chrono::steady_clock::now() < next_check) continue;
    next_check = std::chrono::steady_clock::now() + std::chrono::milliseconds(kCheckPeriodMs);
    if (!ProbeLines()) return;
  }
}

bool Bank::ProbeLines() {
  int error = 0;
  if (outputs_) {
    const std::lock_guard lock(mutex_);  // libgpiod: one thread at a time in a request
    uint64_t levels = 0;
    error = outputs_->Read(levels);
  }
  if (error != 0) {
    LinesGone(plan_.chip_path + ": " + std::strerror(error));
    return false;
  }
  if (!input_request_) return true;
  const Result<uint64_t> active = input_request_->ReadActive();
  if (!active.ok()) {
    LinesGone(active.status().message());
    return false;
  }
  for (size_t i = 0; i < inputs_.size(); ++i) {
    if (inputs_[i].role != InputRole::kStart) continue;
    if ((*active >> i & 1U) != 0)
      start_.OnHeld();
    else
      start_.OnRest(MonotonicNow());
  }
  return true;
}

bool Bank::TakeEvents() {
  const Result<std::vector<LineEvent>> events = input_request_->Read();
  if (!events.ok()) {
    LinesGone(events.status().message());
    return false;
  }
  for (const LineEvent& event : *events) Take(event);
  changed_.notify_all();
  return true;
}

void Bank::Take(const LineEvent& event) {
  int64_t lost = 0;
  Input& input = inputs_[event.line];
  {
    const std::lock_guard lock(mutex_);
    const uint32_t step = event.line_number - static_cast<uint32_t>(input.count);  // over the kernel's wrap, too
    lost = static_cast<int64_t>(step) - 1;
    input.count += step;
    if (input.role == InputRole::kSync) edges_.push_back({input.projector, input.count - 1, event.time});
    if (edges_.size() > kMaxEdges) edges_.pop_front();  // its number is missing now
    if (input.role == InputRole::kStrobe) strobe_ = event.time;
  }
  if (input.role == InputRole::kStart && start_.OnEdge() && events_ != nullptr) events_->PressStart(event.time);
  if (lost > 0 && input.role == InputRole::kSync)
    logger_.Warning("SYNC of projector " + std::to_string(input.projector) + ": " + std::to_string(lost) +
                    " edges lost before edge " + std::to_string(input.count - 1));
}

void Bank::LinesGone(const std::string& reason) {
  logger_.Error("GPIO lines are gone: " + reason);
  {
    const std::lock_guard lock(mutex_);
    if (gone_reason_.empty()) gone_reason_ = reason;
  }
  if (events_ != nullptr) events_->Tell(RigSignal::kLines, SignalLevel::kActive, MonotonicNow());
  changed_.notify_all();
}

}  // namespace

Result<std::unique_ptr<GpiodLineBank>> GpiodLineBank::Open(const GpioWiring& wiring, Logger& logger,
                                                           RigEvents* events) {
  const std::vector<GpioChip> chips = ListChips();
  SLX_ASSIGN_OR_RETURN(OutputPlan outputs, PlanOutputs(chips, wiring));
  SLX_ASSIGN_OR_RETURN(InputPlan inputs, PlanInputs(chips, wiring));
  std::unique_ptr<OutputRequest> output_request;
  if (!outputs.offsets.empty()) {
    SLX_ASSIGN_OR_RETURN(output_request, RequestOutputs(outputs.chip_path, outputs.offsets, outputs.active_low));
  }
  std::unique_ptr<InputRequest> input_request;
  if (!inputs.lines.empty()) {
    SLX_ASSIGN_OR_RETURN(input_request, RequestInputs(inputs.chip_path, inputs.lines));
  }
  UniqueFd stop(eventfd(0, EFD_CLOEXEC));
  if (!stop.ok()) return Status::Failed(std::string("eventfd: ") + std::strerror(errno));
  auto bank = std::make_unique<Bank>(std::move(outputs), std::move(output_request), std::move(inputs.inputs),
                                     std::move(input_request), std::move(stop), logger, events);
  bank->projector_pulse_ = wiring.projector_pulse;
  bank->camera_pulse_ = wiring.camera_pulse;
  bank->reset_pulse_ = wiring.reset_pulse;
  SLX_RETURN_IF_ERROR(bank->Begin());
  return std::unique_ptr<GpiodLineBank>(std::move(bank));
}

}  // namespace stratalux::rig
