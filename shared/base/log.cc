// SPDX-License-Identifier: Apache-2.0
#include "shared/base/log.h"

#include <algorithm>

#include "shared/base/log_queue.h"
#include "shared/base/log_sink.h"
#include "shared/base/printable.h"

namespace stratalux {
namespace {

// With the fields, less than a datagram of the journal holds.
constexpr size_t kMaxMessage = 64 << 10;

std::string CutOff(std::string text) {
  if (text.size() <= kMaxMessage) return text;
  size_t kept = kMaxMessage;
  while ((static_cast<unsigned char>(text[kept]) & 0xc0U) == 0x80U) --kept;  // within a character of UTF-8
  const std::string rest = "... (" + std::to_string(text.size() - kept) + " bytes cut off)";
  text.resize(kept);
  return text + rest;
}

}  // namespace

Logger::Logger(LogLevel threshold, std::FILE* stream) : Logger(threshold, SinkFor(stream)) {}
Logger::Logger(LogLevel threshold, std::shared_ptr<LogSink> sink)
    : threshold_(threshold), queue_(std::make_unique<LogQueue>(std::move(sink))) {}
Logger::~Logger() = default;

void Logger::Write(LogLevel level, const std::string& message, std::initializer_list<LogField> fields) {
  if (!Shows(level)) return;
  queue_->Push(queue_->sink().Format(level, CutOff(PrintableLines(message)), fields), LogQueue::Kind::kLine);
}

bool Logger::Flush() { return queue_->Flush(std::chrono::steady_clock::now() + LogQueue::kPatience); }
int64_t Logger::dropped() const { return queue_->dropped(); }

void Say(LogLevel level, const std::string& text) {
  FlushLoggers();
  LogQueue queue(SinkFor(stderr));
  queue.Push(queue.sink().Plain(level, CutOff(PrintableLines(text))), LogQueue::Kind::kLine);
}

Progress::Progress(Logger& logger, std::string label, int64_t total)
    : logger_(logger),
      label_(std::move(label)),
      total_(std::max<int64_t>(total, 1)),
      terminal_(logger.queue_->sink().IsTerminal()),
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
  const int filled = percent * 30 / 100;
  char text[160];
  if (terminal_)
    std::snprintf(text, sizeof text, "\r%-24.60s [%.*s%*s] %3d %% %6.1f s%s", label_.c_str(), filled,
                  "##############################", 30 - filled, "", percent, seconds, final ? "\n" : "");
  else
    std::snprintf(text, sizeof text, "%.60s: %3d %% (%.1f s)\n", label_.c_str(), percent, seconds);
  LogQueue& queue = *logger_.queue_;
  queue.Push(queue.sink().Plain(LogLevel::kInfo, text), LogQueue::Kind::kProgress);
}

}  // namespace stratalux
