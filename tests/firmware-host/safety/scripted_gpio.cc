// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/safety/scripted_gpio.h"

#include <cerrno>
#include <new>

#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include "firmware-host/gpio/gpio_adapter.h"
#include "shared/base/check.h"
#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

constexpr const char* kPath = "/dev/gpiochip9";

// True: this one fails.
bool Refused(std::atomic<int>& refusals) {
  int left = refusals.load();
  while (left > 0 && !refusals.compare_exchange_weak(left, left - 1)) {
  }
  return left != 0;
}

class Outputs final : public OutputRequest {
 public:
  explicit Outputs(std::vector<unsigned> offsets) : offsets_(std::move(offsets)) {}
  ~Outputs() override {
    for (const unsigned offset : offsets_) TheGpio().lines[offset].taken.store(0);
  }
  int Write(uint64_t levels) noexcept override {
    for (size_t i = 0; i < offsets_.size(); ++i) {
      ScriptedGpio::Line& line = TheGpio().lines[offsets_[i]];
      if (Refused(line.refuse_writes)) return EIO;
      const int level = static_cast<int>(levels >> i & 1U);
      if (line.level.exchange(level) != level) line.changed_ns.store(MonotonicNow().ns);
      ++line.writes;
    }
    return 0;
  }
  int Read(uint64_t& levels) noexcept override {
    levels = 0;
    for (size_t i = 0; i < offsets_.size(); ++i) {
      ScriptedGpio::Line& line = TheGpio().lines[offsets_[i]];
      if (Refused(line.refuse_reads)) return EIO;
      const int level = line.level.load();
      line.last_read.store(level);
      if (level != 0) levels |= uint64_t{1} << i;
    }
    return 0;
  }

 private:
  const std::vector<unsigned> offsets_;
};

class Inputs final : public InputRequest {
 public:
  explicit Inputs(std::vector<InputLine> lines)
      : lines_(std::move(lines)), fd_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    for (const InputLine& line : lines_) TheGpio().lines[line.offset].event_fd.store(fd_);
  }
  ~Inputs() override {
    for (const InputLine& line : lines_) {
      TheGpio().lines[line.offset].event_fd.store(-1);
      TheGpio().lines[line.offset].taken.store(0);
    }
    close(fd_);
  }
  [[nodiscard]] int fd() const override { return fd_; }
  Result<std::vector<LineEvent>> Read() override {
    std::vector<LineEvent> events;
    uint64_t seen = 0, active = 0;
    if (const int error = Take(seen, active); error != 0) return Status::Failed(std::string(kPath) + ": gone");
    for (size_t i = 0; i < lines_.size(); ++i)
      if ((seen >> i & 1U) != 0) events.push_back({i, ++numbers_[i], MonotonicNow()});
    return events;
  }
  Result<uint64_t> ReadActive() override {
    uint64_t active = 0;
    if (Levels(active) != 0) return Status::Failed(std::string(kPath) + ": gone");
    return active;
  }
  int Take(uint64_t& seen, uint64_t& active) noexcept override {
    uint64_t count = 0;
    if (read(fd_, &count, sizeof count) < 0 && errno != EAGAIN) return errno;
    seen = 0;
    for (size_t i = 0; i < lines_.size(); ++i)
      if (TheGpio().lines[lines_[i].offset].edges.exchange(0) != 0) seen |= uint64_t{1} << i;
    return Levels(active);
  }

 private:
  int Levels(uint64_t& active) const noexcept {
    active = 0;
    for (size_t i = 0; i < lines_.size(); ++i) {
      ScriptedGpio::Line& line = TheGpio().lines[lines_[i].offset];
      if (Refused(line.refuse_reads)) return EIO;
      const bool high = line.level.load() != 0;
      if (high == (lines_[i].active == ActiveLevel::kHigh)) active |= uint64_t{1} << i;
    }
    return 0;
  }
  const std::vector<InputLine> lines_;
  const int fd_;
  std::array<uint32_t, ScriptedGpio::kLines> numbers_{};
};

Status TakeLines(const std::vector<unsigned>& offsets) {
  for (const unsigned offset : offsets)
    if (TheGpio().lines[offset].taken.exchange(1) != 0) return Status::Busy(std::string(kPath) + ": a line in use");
  return Status::Ok();
}

}  // namespace

void ScriptedGpio::Raise(int line, bool held) {
  lines[line].level.store(held ? 1 : 0);
  ++lines[line].edges;
  const uint64_t one = 1;
  const int fd = lines[line].event_fd.load();
  if (fd >= 0) SLX_CHECK(write(fd, &one, sizeof one) == sizeof one);
}

ScriptedGpio& TheGpio() {
  static ScriptedGpio* const shared = [] {
    void* memory = mmap(nullptr, sizeof(ScriptedGpio), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    SLX_CHECK(memory != MAP_FAILED);
    return new (memory) ScriptedGpio;
  }();
  return *shared;
}

std::vector<GpioChip> ListChips() {
  GpioChip chip{kPath, "scripted", {}};
  for (int i = 0; i < ScriptedGpio::kLines; ++i) chip.lines.push_back({.name = "LINE" + std::to_string(i)});
  return {chip};
}

Result<std::unique_ptr<OutputRequest>> RequestOutputs(const std::string&, const std::vector<unsigned>& offsets,
                                                      uint64_t levels) {
  SLX_RETURN_IF_ERROR(TakeLines(offsets));
  auto outputs = std::make_unique<Outputs>(offsets);
  if (const int error = outputs->Write(levels); error != 0) return Status::Failed(std::string(kPath) + ": EIO");
  return std::unique_ptr<OutputRequest>(std::move(outputs));
}

Result<std::unique_ptr<InputRequest>> RequestInputs(const std::string&, const std::vector<InputLine>& lines) {
  std::vector<unsigned> offsets;
  for (const InputLine& line : lines) offsets.push_back(line.offset);
  SLX_RETURN_IF_ERROR(TakeLines(offsets));
  return std::unique_ptr<InputRequest>(std::make_unique<Inputs>(lines));
}

}  // namespace stratalux::rig
