// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/gpio/gpio_adapter.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <map>
#include <utility>

#include <fcntl.h>
#include <gpiod.h>
#include <linux/gpio.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

constexpr const char* kConsumer = "stratalux-rig";
constexpr size_t kMaxLines = GPIO_V2_LINES_MAX;
// Edges that the kernel keeps for us: a second of 1 kHz bounce on one line.
constexpr uint32_t kEventBuffer = 1024;

Status RequestError(const std::string& chip_path, int error) {
  const std::string message = chip_path + ": cannot take the lines: " + std::strerror(error);
  if (error == EBUSY)
    return Status::Busy(
        message + "; `stratalux-rig devices` names their consumer: another stratalux-rig, or a driver of the board");
  if (error == EACCES || error == EPERM)
    return Status::Failed(message + "; this user must be in the group gpio (systemd/README.md)");
  return Status::Failed(message);
}

struct ChipCloser {
  void operator()(gpiod_chip* chip) const { gpiod_chip_close(chip); }
};
using Chip = std::unique_ptr<gpiod_chip, ChipCloser>;

std::string Text(const char* text) { return text != nullptr ? text : ""; }

#if STRATALUX_LIBGPIOD_MAJOR >= 2

GpioChip Describe(gpiod_chip* chip, const std::string& path) {
  GpioChip described{path, "", {}};
  gpiod_chip_info* info = gpiod_chip_get_info(chip);
  if (info == nullptr) return described;
  described.label = Text(gpiod_chip_info_get_label(info));
  const size_t lines = gpiod_chip_info_get_num_lines(info);
  gpiod_chip_info_free(info);
  for (unsigned offset = 0; offset < lines; ++offset) {
    GpioLine& described_line = described.lines.emplace_back();
    gpiod_line_info* line = gpiod_chip_get_line_info(chip, offset);
    if (line == nullptr) continue;
    const bool output = gpiod_line_info_get_direction(line) == GPIOD_LINE_DIRECTION_OUTPUT;
    described_line = {Text(gpiod_line_info_get_name(line)), output ? LineDirection::kOutput : LineDirection::kInput,
                      gpiod_line_info_is_used(line), Text(gpiod_line_info_get_consumer(line))};
    gpiod_line_info_free(line);
  }
  return described;
}

class Outputs final : public OutputRequest {
 public:
  Outputs(Chip chip, gpiod_line_request* request, size_t count)
      : chip_(std::move(chip)), request_(request), count_(count) {}
  ~Outputs() override { gpiod_line_request_release(request_); }
  Outputs(const Outputs&) = delete;
  Outputs& operator=(const Outputs&) = delete;

  static gpiod_line_request* Request(gpiod_chip* chip, const std::vector<unsigned>& offsets, uint64_t levels) {
    const std::unique_ptr<gpiod_line_settings, void (*)(gpiod_line_settings*)> settings(gpiod_line_settings_new(),
                                                                                        gpiod_line_settings_free);
    const std::unique_ptr<gpiod_line_config, void (*)(gpiod_line_config*)> lines(gpiod_line_config_new(),
                                                                                 gpiod_line_config_free);
    const std::unique_ptr<gpiod_request_config, void (*)(gpiod_request_config*)> config(gpiod_request_config_new(),
                                                                                        gpiod_request_config_free);
    if (!settings || !lines || !config) return nullptr;
    gpiod_request_config_set_consumer(config.get(), kConsumer);
    gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_OUTPUT);
    for (size_t i = 0; i < offsets.size(); ++i) {
      gpiod_line_settings_set_output_value(settings.get(), Value(levels, i));
      if (gpiod_line_config_add_line_settings(lines.get(), &offsets[i], 1, settings.get()) != 0) return nullptr;
    }
    return gpiod_chip_request_lines(chip, config.get(), lines.get());
  }

  int Write(uint64_t levels) noexcept override {
    gpiod_line_value values[kMaxLines];
    for (size_t i = 0; i < count_; ++i) values[i] = Value(levels, i);
    return gpiod_line_request_set_values(request_, values) == 0 ? 0 : errno;
  }
  int Read(uint64_t& levels) noexcept override {
    gpiod_line_value values[kMaxLines];
    if (gpiod_line_request_get_values(request_, values) != 0) return errno;
    levels = 0;
    for (size_t i = 0; i < count_; ++i)
      if (values[i] == GPIOD_LINE_VALUE_ACTIVE) levels |= uint64_t{1} << i;
    return 0;
  }

 private:
  static gpiod_line_value Value(uint64_t levels, size_t i) {
    return (levels >> i & 1U) != 0 ? GPIOD_LINE_VALUE_ACTIVE : GPIOD_LINE_VALUE_INACTIVE;
  }
  Chip chip_;
  gpiod_line_request* request_;
  size_t count_;
};

Result<std::unique_ptr<OutputRequest>> MakeOutputs(Chip chip, const std::string& chip_path,
                                                   const std::vector<unsigned>& offsets, uint64_t levels) {
  gpiod_line_request* request = Outputs::Request(chip.get(), offsets, levels);
  if (request == nullptr) return RequestError(chip_path, errno);
  return std::unique_ptr<OutputRequest>(std::make_unique<Outputs>(std::move(chip), request, offsets.size()));
}

#else

GpioChip Describe(gpiod_chip* chip, const std::string& path) {
  GpioChip described{path, Text(gpiod_chip_label(chip)), {}};
  for (unsigned offset = 0; offset < gpiod_chip_num_lines(chip); ++offset) {
    GpioLine& described_line = described.lines.emplace_back();
    gpiod_line* line = gpiod_chip_get_line(chip, offset);
    if (line == nullptr) continue;
    const bool output = gpiod_line_direction(line) == GPIOD_LINE_DIRECTION_OUTPUT;
    described_line = {Text(gpiod_line_name(line)), output ? LineDirection::kOutput : LineDirection::kInput,
                      gpiod_line_is_used(line), Text(gpiod_line_consumer(line))};
  }
  return described;
}

class Outputs final : public OutputRequest {
 public:
  Outputs(Chip chip, const gpiod_line_bulk& lines) : chip_(std::move(chip)), lines_(lines) {}
  ~Outputs() override { gpiod_line_release_bulk(&lines_); }
  Outputs(const Outputs&) = delete;
  Outputs& operator=(const Outputs&) = delete;

  int Write(uint64_t levels) noexcept override {
    int values[kMaxLines];
    Split(levels, values);
    return gpiod_line_set_value_bulk(&lines_, values) == 0 ? 0 : errno;
  }
  int Read(uint64_t& levels) noexcept override {
    int values[kMaxLines];
    if (gpiod_line_get_value_bulk(&lines_, values) != 0) return errno;
    levels = 0;
    for (size_t i = 0; i < lines_.num_lines; ++i)
      if (values[i] != 0) levels |= uint64_t{1} << i;
    return 0;
  }
  static void Split(uint64_t levels, int* values) {
    for (size_t i = 0; i < kMaxLines; ++i) values[i] = static_cast<int>(levels >> i & 1U);
  }

 private:
  Chip chip_;
  gpiod_line_bulk lines_;
};

Result<std::unique_ptr<OutputRequest>> MakeOutputs(Chip chip, const std::string& chip_path,
                                                   const std::vector<unsigned>& offsets, uint64_t levels) {
  std::vector<unsigned> wanted = offsets;  // libgpiod takes them as not const
  gpiod_line_bulk lines;
  int values[kMaxLines];
  Outputs::Split(levels, values);
  if (gpiod_chip_get_lines(chip.get(), wanted.data(), static_cast<unsigned>(wanted.size()), &lines) != 0 ||
      gpiod_line_request_bulk_output(&lines, kConsumer, values) != 0)
    return RequestError(chip_path, errno);
  return std::unique_ptr<OutputRequest>(std::make_unique<Outputs>(std::move(chip), lines));
}

#endif

uint64_t FlagsOf(const InputLine& line) {
  uint64_t flags = GPIO_V2_LINE_FLAG_INPUT | GPIO_V2_LINE_FLAG_EDGE_RISING;  // rising: inactive to active
  if (line.active == ActiveLevel::kLow) flags |= GPIO_V2_LINE_FLAG_ACTIVE_LOW;
  if (line.bias == LineBias::kDisabled) flags |= GPIO_V2_LINE_FLAG_BIAS_DISABLED;
  if (line.bias == LineBias::kPullUp) flags |= GPIO_V2_LINE_FLAG_BIAS_PULL_UP;
  if (line.bias == LineBias::kPullDown) flags |= GPIO_V2_LINE_FLAG_BIAS_PULL_DOWN;
  return flags;
}

class Inputs final : public InputRequest {
 public:
  Inputs(UniqueFd fd, std::string chip_path, std::vector<unsigned> offsets)
      : fd_(std::move(fd)), chip_path_(std::move(chip_path)), offsets_(std::move(offsets)) {}

  [[nodiscard]] int fd() const override { return fd_.get(); }
  Result<std::vector<LineEvent>> Read() override {
    std::vector<LineEvent> events;
    gpio_v2_line_event raw[64];
    while (true) {
      const ssize_t bytes = read(fd_.get(), raw, sizeof raw);
      if (bytes < 0 && errno == EINTR) continue;
      if (bytes < 0 && errno == EAGAIN) return events;
      if (bytes <= 0) return Gone(bytes < 0 ? errno : ENODEV);
      for (size_t i = 0; i < static_cast<size_t>(bytes) / sizeof raw[0]; ++i) events.push_back(From(raw[i]));
      if (static_cast<size_t>(bytes) < sizeof raw) return events;
    }
  }
  Result<uint64_t> ReadActive() override {
    uint64_t active = 0;
    if (const int error = Levels(active); error != 0) return Gone(error);
    return active;
  }
  int Take(uint64_t& seen, uint64_t& active) noexcept override {
    seen = active = 0;
    gpio_v2_line_event raw[16];
    while (true) {
      const ssize_t bytes = read(fd_.get(), raw, sizeof raw);
      if (bytes < 0 && errno == EINTR) continue;
      if (bytes < 0 && errno == EAGAIN) return Levels(active);
      if (bytes <= 0) return bytes < 0 ? errno : ENODEV;
      for (size_t i = 0; i < static_cast<size_t>(bytes) / sizeof raw[0]; ++i) seen |= uint64_t{1} << LineOf(raw[i]);
    }
  }

 private:
  [[nodiscard]] Status Gone(int error) const { return Status::Failed(chip_path_ + ": " + std::strerror(error)); }
  [[nodiscard]] size_t LineOf(const gpio_v2_line_event& raw) const noexcept {
    return static_cast<size_t>(std::find(offsets_.begin(), offsets_.end(), raw.offset) - offsets_.begin());
  }
  [[nodiscard]] LineEvent From(const gpio_v2_line_event& raw) const {
    return {LineOf(raw), raw.line_seqno, MonotonicNs{static_cast<int64_t>(raw.timestamp_ns)}};
  }
  int Levels(uint64_t& active) const noexcept {
    gpio_v2_line_values values{};
    values.mask = offsets_.size() == kMaxLines ? ~uint64_t{0} : (uint64_t{1} << offsets_.size()) - 1;
    if (ioctl(fd_.get(), GPIO_V2_LINE_GET_VALUES_IOCTL, &values) != 0) return errno;
    active = values.bits & values.mask;
    return 0;
  }
  UniqueFd fd_;
  std::string chip_path_;
  std::vector<unsigned> offsets_;
};

}  // namespace

std::vector<std::string> ChipPaths() {
  std::vector<std::string> paths;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", ignored))
    if (entry.path().filename().string().starts_with("gpiochip") && !entry.is_symlink(ignored))
      paths.push_back(entry.path().string());
  std::sort(paths.begin(), paths.end());
  return paths;
}

int DescribeChip(const std::string& path, GpioChip& chip) {
  const Chip opened(gpiod_chip_open(path.c_str()));
  if (!opened) return errno;
  chip = Describe(opened.get(), path);
  return 0;
}

std::vector<GpioChip> ListChips() {
  std::vector<GpioChip> chips;
  for (const std::string& path : ChipPaths())
    if (GpioChip chip; DescribeChip(path, chip) == 0) chips.push_back(std::move(chip));
  return chips;
}

Result<std::unique_ptr<OutputRequest>> RequestOutputs(const std::string& chip_path,
                                                      const std::vector<unsigned>& offsets, uint64_t levels) {
  if (offsets.empty() || offsets.size() > kMaxLines)
    return Status::Usage(chip_path + ": " + std::to_string(offsets.size()) + " output lines, allowed: 1 .. 64");
  Chip chip(gpiod_chip_open(chip_path.c_str()));
  if (!chip) return RequestError(chip_path, errno);
  return MakeOutputs(std::move(chip), chip_path, offsets, levels);
}

Result<std::unique_ptr<InputRequest>> RequestInputs(const std::string& chip_path, const std::vector<InputLine>& lines) {
  if (lines.empty() || lines.size() > kMaxLines)
    return Status::Usage(chip_path + ": " + std::to_string(lines.size()) + " input lines, allowed: 1 .. 64");
  gpio_v2_line_request request{};
  std::vector<unsigned> offsets;
  std::map<uint64_t, uint64_t> lines_with_flags, lines_with_debounce;
  for (size_t i = 0; i < lines.size(); ++i) {
    request.offsets[i] = lines[i].offset;
    offsets.push_back(lines[i].offset);
    lines_with_flags[FlagsOf(lines[i])] |= uint64_t{1} << i;
    if (lines[i].debounce.count() > 0)
      lines_with_debounce[static_cast<uint64_t>(lines[i].debounce.count())] |= uint64_t{1} << i;
  }
  // The kernel takes so many exceptions from the common flags.
  if (lines_with_flags.size() - 1 + lines_with_debounce.size() > GPIO_V2_LINE_NUM_ATTRS_MAX)
    return Status::Usage(chip_path + ": the input lines have too many different polarities, biases and debounce times");
  std::strncpy(request.consumer, kConsumer, sizeof request.consumer - 1);
  request.num_lines = static_cast<uint32_t>(lines.size());
  request.event_buffer_size = kEventBuffer;
  request.config.flags = lines_with_flags.begin()->first;
  lines_with_flags.erase(lines_with_flags.begin());
  for (const auto& [flags, mask] : lines_with_flags) {
    gpio_v2_line_config_attribute& attribute = request.config.attrs[request.config.num_attrs++];
    attribute.attr.id = GPIO_V2_LINE_ATTR_ID_FLAGS;
    attribute.attr.flags = flags;
    attribute.mask = mask;
  }
  for (const auto& [debounce_us, mask] : lines_with_debounce) {
    gpio_v2_line_config_attribute& attribute = request.config.attrs[request.config.num_attrs++];
    attribute.attr.id = GPIO_V2_LINE_ATTR_ID_DEBOUNCE;
    attribute.attr.debounce_period_us = static_cast<uint32_t>(debounce_us);
    attribute.mask = mask;
  }
  const UniqueFd chip(open(chip_path.c_str(), O_RDWR | O_CLOEXEC));
  if (!chip.ok() || ioctl(chip.get(), GPIO_V2_GET_LINE_IOCTL, &request) != 0) return RequestError(chip_path, errno);
  UniqueFd fd(request.fd);
  if (fcntl(fd.get(), F_SETFL, fcntl(fd.get(), F_GETFL) | O_NONBLOCK) != 0 || fcntl(fd.get(), F_SETFD, FD_CLOEXEC) != 0)
    return RequestError(chip_path, errno);
  return std::unique_ptr<InputRequest>(std::make_unique<Inputs>(std::move(fd), chip_path, std::move(offsets)));
}

}  // namespace stratalux::rig
