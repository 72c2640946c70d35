// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/gpio/gpio_lights.h"

#include <atomic>
#include <string>
#include <utility>
#include <vector>

#include "firmware-host/gpio/gpio_adapter.h"

namespace stratalux::rig {
namespace {

class EnableLine final : public LightSwitch {
 public:
  EnableLine(std::unique_ptr<OutputRequest> line, ActiveLevel active, std::string name)
      : line_(std::move(line)), inactive_(InactiveLevel(active)), name_(std::move(name)) {}

  // The level of a line alone in its request.
  static uint64_t InactiveLevel(ActiveLevel active) { return active == ActiveLevel::kLow ? 1 : 0; }

  int Set(bool on) noexcept override { return line_->Write(on ? inactive_ ^ 1U : inactive_); }
  int Read(bool& on) noexcept override {
    uint64_t level = 0;
    const int error = line_->Read(level);
    on = level != inactive_;
    return error;
  }
  [[nodiscard]] const char* name() const noexcept override { return name_.c_str(); }

 private:
  const std::unique_ptr<OutputRequest> line_;
  const uint64_t inactive_;
  const std::string name_;
};

Result<std::unique_ptr<EnableLine>> TakeEnable(const std::vector<GpioChip>& chips, const OutputWiring& wiring,
                                               const std::string& name) {
  SLX_ASSIGN_OR_RETURN(const FoundLine line, FindLine(chips, wiring.at));
  SLX_ASSIGN_OR_RETURN(auto request,
                       RequestOutputs(line.chip_path, {line.offset}, EnableLine::InactiveLevel(wiring.active)));
  return std::make_unique<EnableLine>(
      std::move(request), wiring.active,
      name + " (" + wiring.at.ToString() + ", " + line.chip_path + ":" + std::to_string(line.offset) + ")");
}

class InterlockLines final : public InterlockInput {
 public:
  // Bit 0 is E-STOP, where it is wired; DOOR is `door`.
  InterlockLines(std::unique_ptr<InputRequest> lines, uint64_t emergency_stop, uint64_t door, RigEvents* events)
      : lines_(std::move(lines)), emergency_stop_(emergency_stop), door_(door), events_(events) {}

  [[nodiscard]] int fd() const noexcept override { return lines_->fd(); }
  StopReason Take() noexcept override {
    uint64_t seen = 0, active = 0;
    const int error = lines_->Take(seen, active);
    if (events_ != nullptr) {
      const MonotonicNs now = MonotonicNow();
      // Others may have lost theirs for good.
      const bool gone = error != 0;
      if (gone_.exchange(gone) != gone)
        events_->Tell(RigSignal::kLines, gone ? SignalLevel::kActive : SignalLevel::kRest, now);
      if (error == 0) TellLine(RigSignal::kEmergencyStop, seen & emergency_stop_, active & emergency_stop_, now);
      if (error == 0) TellLine(RigSignal::kDoor, seen & door_, active & door_, now);
    }
    if (error != 0) return StopReason::kLinesGone;
    seen |= active;
    if ((seen & emergency_stop_) != 0) return StopReason::kEmergencyStop;
    return (seen & door_) != 0 ? StopReason::kDoorOpen : StopReason::kNone;
  }

 private:
  // Two threads that look at once may tell in the other order: the next look, which is never far, sets it right.
  void TellLine(RigSignal signal, uint64_t seen, uint64_t active, MonotonicNs now) noexcept {
    if (seen != 0 || active != 0) events_->Tell(signal, SignalLevel::kActive, now);
    if (active == 0) events_->Tell(signal, SignalLevel::kRest, now);
  }
  const std::unique_ptr<InputRequest> lines_;
  const uint64_t emergency_stop_, door_;
  RigEvents* const events_;
  std::atomic<bool> gone_ = false;
};

Result<std::unique_ptr<InterlockInput>> TakeInterlock(const std::vector<GpioChip>& chips, const GpioWiring& wiring,
                                                      RigEvents* events) {
  std::vector<InputLine> lines;
  std::string chip_path;
  uint64_t bits[2] = {0, 0};
  const std::optional<InputWiring>* inputs[2] = {&wiring.emergency_stop, &wiring.door};
  for (int i = 0; i < 2; ++i) {
    if (!*inputs[i]) continue;
    const InputWiring& input = **inputs[i];
    SLX_ASSIGN_OR_RETURN(const FoundLine line, FindLine(chips, input.at));
    if (!chip_path.empty() && chip_path != line.chip_path)
      return Status::Usage("E-STOP is on " + chip_path + ", DOOR on " + line.chip_path + "; wire both to one chip");
    chip_path = line.chip_path;
    bits[i] = uint64_t{1} << lines.size();
    lines.push_back({line.offset, input.active, input.bias, input.debounce});
  }
  if (lines.empty()) return std::unique_ptr<InterlockInput>();
  SLX_ASSIGN_OR_RETURN(auto request, RequestInputs(chip_path, lines));
  return std::unique_ptr<InterlockInput>(
      std::make_unique<InterlockLines>(std::move(request), bits[0], bits[1], events));
}

class Lights final : public GpioLights {
 public:
  Lights(std::vector<std::unique_ptr<EnableLine>> enables, std::unique_ptr<InterlockInput> interlock)
      : enables_(std::move(enables)), interlock_(std::move(interlock)) {}
  [[nodiscard]] LightSwitch* enable(int projector) const noexcept override { return enables_[projector].get(); }
  [[nodiscard]] InterlockInput* interlock() const noexcept override { return interlock_.get(); }

 private:
  const std::vector<std::unique_ptr<EnableLine>> enables_;  // by projector; null: it has none
  const std::unique_ptr<InterlockInput> interlock_;
};

}  // namespace

Result<std::unique_ptr<GpioLights>> GpioLights::Open(const GpioWiring& wiring, RigEvents* events) {
  const std::vector<GpioChip> chips = ListChips();
  std::vector<std::unique_ptr<EnableLine>> enables;
  for (size_t p = 0; p < wiring.projectors.size(); ++p) {
    auto& enable = enables.emplace_back();
    if (!wiring.projectors[p].enable) continue;
    SLX_ASSIGN_OR_RETURN(enable,
                         TakeEnable(chips, *wiring.projectors[p].enable, "ENABLE of projector " + std::to_string(p)));
  }
  SLX_ASSIGN_OR_RETURN(auto interlock, TakeInterlock(chips, wiring, events));
  return std::unique_ptr<GpioLights>(std::make_unique<Lights>(std::move(enables), std::move(interlock)));
}

Status DriveEnablesOff(const std::vector<OutputWiring>& enables) {
  const std::vector<GpioChip> chips = ListChips();
  Status first_error;
  // One by one: a line that cannot be had must not keep another one on.
  for (size_t i = 0; i < enables.size(); ++i) {
    const std::string name = "ENABLE of projector " + std::to_string(i);
    const auto taken = TakeEnable(chips, enables[i], name);
    Status status = taken.status().WithContext(name);
    bool on = true;
    if (taken.ok() && ((*taken)->Read(on) != 0 || on))
      status = Status::Failed(std::string((*taken)->name()) + " stays on although it was switched off");
    if (first_error.ok()) first_error = status;
  }
  return first_error;
}

}  // namespace stratalux::rig
