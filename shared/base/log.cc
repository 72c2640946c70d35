// SPDX-License-Identifier: Apache-2.0
#include "shared/base/log.h"

#include <algorithm>

#include <unistd.h>

#include "shared/base/printable.h"

namespace stratalux {

void Logger::Write(LogLevel level, const std::string& message) {
  static constexpr const char* kNames[] = {"debug", "info", "warning", "error"};
  if (!Shows(level)) return;
  const std::lock_guard lock(mutex_);
  std::fprintf(stream_, "%s: %s\n", kNames[static_cast<int>(level)], PrintableLines(message).c_str());
  std::fflush(stream_);
}

Progress::Progress(Logger& logger, std::string label, int64_t total)
    : logger_(logger),
      label_(std::move(label)),
      total_(std::max<int64_t>(total, 1)),
      terminal_(isatty(fileno(logger.stream())) != 0),
      start_(std::chrono::steady_clock::now()) {}

Progress::~Progress() {
  const std::lock_guard lock(mutex_);
  if (terminal_ && done_ > 0) Draw(true);
}

void Progress::Advance(int64_t steps) {
  const std::lock_guard lock(mutex_);
  done_ = std::min(done_ + steps, total_);
  const int64_t percent = done_ * 100 / total_;
  const int64_t step = terminal_ ? 1 : 10;
  if (percent / step == last_drawn_percent_ / step && last_drawn_percent_ >= 0) return;
  last_drawn_percent_ = percent;
  Draw(false);
}

void Progress::Draw(bool final) {
  if (!logger_.Shows(LogLevel::kInfo)) return;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  const int percent = static_cast<int>(done_ * 100 / total_);
  if (!terminal_) {
    std::fprintf(logger_.stream(), "%s: %3d %% (%.1f s)\n", label_.c_str(), percent, seconds);
    return;
  }
  const int filled = percent * 30 / 100;
  std::fprintf(logger_.stream(), "\r%-24s [%.*s%*s] %3d %% %6.1f s%s", label_.c_str(), filled,
               "##############################", 30 - filled, "", percent, seconds, final ? "\n" : "");
  std::fflush(logger_.stream());
}

}  // namespace stratalux
