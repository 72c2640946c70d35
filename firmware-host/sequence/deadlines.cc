// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/deadlines.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "shared/base/median.h"
#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

using std::chrono::nanoseconds;

constexpr double kSpreads = 6.0, kUnrestMs = 1.0, kLeastMarginMs = 10.0;
constexpr double kFramePeriods = 1.0, kSyncPeriods = 4.0;
constexpr int64_t kOneSlowInSaid = 50, kOneSlowInEnds = 10;

AnswerLimit LimitOf(const DelayFigures& delay, double margin_ms, nanoseconds longest) {
  const double usual_ms = delay.worst_ms + kSpreads * delay.spread_ms + kUnrestMs;
  return {std::min(longest, FromMilliseconds(usual_ms)), std::min(longest, FromMilliseconds(usual_ms + margin_ms))};
}

}  // namespace

DelayFigures FiguresOf(std::span<const double> delays_ms) {
  DelayFigures figures;
  if (delays_ms.empty()) return figures;
  figures.count = static_cast<int>(delays_ms.size());
  figures.median_ms = Median({delays_ms.begin(), delays_ms.end()});
  figures.worst_ms = *std::max_element(delays_ms.begin(), delays_ms.end());
  double mean = 0.0, squares = 0.0;
  for (const double ms : delays_ms) mean += ms / figures.count;
  for (const double ms : delays_ms) squares += (ms - mean) * (ms - mean);
  if (figures.count > 1) figures.spread_ms = std::sqrt(squares / (figures.count - 1));
  return figures;
}

LearntDeadlines DeadlinesFrom(const RigDelays& delays, nanoseconds longest) {
  LearntDeadlines learnt;
  const double period_ms = std::max(delays.frame_period_ms, kLeastMarginMs);
  for (const DelayFigures& sync : delays.sync) learnt.sync.push_back(LimitOf(sync, kSyncPeriods * period_ms, longest));
  learnt.frame = LimitOf(delays.frame, kFramePeriods * period_ms, longest);
  return learnt;
}

std::string DeadlinesAsText(const LearntDeadlines& deadlines) {
  std::string text = "SYNC ";
  char ms[32];
  for (const AnswerLimit& sync : deadlines.sync) {
    std::snprintf(ms, sizeof ms, "%s%.1f", &sync == deadlines.sync.data() ? "" : ", ", ToMilliseconds(sync.deadline));
    text += ms;
  }
  std::snprintf(ms, sizeof ms, "%.1f", ToMilliseconds(deadlines.frame.deadline));
  return text + " ms after TRIGGER, frames " + ms + " ms after their exposure";
}

std::string SlowAnswersAsText(const SlowAnswers& slow) {
  const bool frames = slow.projector < 0;
  const std::string what = frames ? "frames" : "SYNC of projector " + std::to_string(slow.projector);
  char text[256];
  std::snprintf(text, sizeof text,
                "%s came %.1f ms or more after %s, beyond the %.1f ms that `selftest` learnt (%lld of %lld answers): "
                "run `stratalux-rig selftest` again%s",
                what.c_str(), ToMilliseconds(slow.longest), frames ? "the exposure" : "TRIGGER",
                ToMilliseconds(slow.limit.usual), static_cast<long long>(slow.slow),
                static_cast<long long>(slow.answers),
                slow.late > 0 ? "; until then the configured deadlines hold" : "");
  return text;
}

AnswerWatch::AnswerWatch(nanoseconds sync_deadline, nanoseconds frame_deadline, int projectors,
                         std::optional<LearntDeadlines> learnt)
    : sync_deadline_(sync_deadline),
      frame_deadline_(frame_deadline),
      holds_(learnt && static_cast<int>(learnt->sync.size()) == projectors) {
  if (!holds_) return;
  for (int p = 0; p < projectors; ++p) sync_.push_back({.projector = p, .limit = learnt->sync[p]});
  frame_.limit = learnt->frame;
}

nanoseconds AnswerWatch::Deadline(const SlowAnswers& kind, nanoseconds configured) const {
  return kind.answers < kConfirmations ? configured : std::min(configured, kind.limit.deadline);
}

nanoseconds AnswerWatch::SyncDeadline(int projector, Patience patience) const {
  if (!holds_ || patience == Patience::kConfigured) return sync_deadline_;
  if (projector >= 0) return Deadline(sync_[projector], sync_deadline_);
  nanoseconds longest(0);
  for (const SlowAnswers& one : sync_) longest = std::max(longest, Deadline(one, sync_deadline_));
  return longest;
}

nanoseconds AnswerWatch::FrameDeadline(Patience patience) const {
  return holds_ && patience == Patience::kLearnt ? Deadline(frame_, frame_deadline_) : frame_deadline_;
}

void AnswerWatch::Saw(SlowAnswers& kind, nanoseconds delay) {
  ++kind.answers;
  if (delay <= kind.limit.usual) return;
  ++kind.slow;
  kind.late += delay > kind.limit.deadline;
  kind.longest = std::max(kind.longest, delay);
  if (kind.late > 0 || (kind.slow > 1 && kind.slow * kOneSlowInEnds > kind.answers)) holds_ = false;
}

void AnswerWatch::SawSync(int projector, nanoseconds delay) {
  if (projector >= 0 && projector < static_cast<int>(sync_.size())) Saw(sync_[projector], delay);
}

void AnswerWatch::SawFrame(nanoseconds delay) {
  if (!sync_.empty()) Saw(frame_, delay);
}

void AnswerWatch::HadFrame(nanoseconds by) {
  if (by <= frame_.limit.usual) SawFrame(by);
}

void AnswerWatch::SawLateFrame() { SawFrame(frame_.limit.deadline + nanoseconds(1)); }

std::vector<SlowAnswers> AnswerWatch::Slow() const {
  std::vector<SlowAnswers> slow;
  const auto look = [&slow](const SlowAnswers& kind) {
    if (kind.late > 0 || (kind.slow > 1 && kind.slow * kOneSlowInSaid > kind.answers)) slow.push_back(kind);
  };
  for (const SlowAnswers& one : sync_) look(one);
  look(frame_);
  return slow;
}

}  // namespace stratalux::rig
