// SPDX-License-Identifier: Apache-2.0
// Deadlines: how long the answer to a pulse is awaited before it counts as lost. `selftest` measures the delays of a
// healthy rig; what follows from them is shorter by far than what holds for any rig (ShooterOptions), and is used for
// as long as the rig answers as it did then.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace stratalux::rig {

// Delays of one kind, as they were seen.
struct DelayFigures {
  int count = 0;
  double median_ms = 0.0;
  double worst_ms = 0.0;
  double spread_ms = 0.0;  // standard deviation

  friend bool operator==(const DelayFigures&, const DelayFigures&) = default;
};
[[nodiscard]] DelayFigures FiguresOf(std::span<const double> delays_ms);

// What a selftest saw of a rig.
struct RigDelays {
  std::vector<DelayFigures> sync;  // of each projector, from TRIGGER to SYNC
  // Until the frame was in hand. Triggered: from the planned end of its exposure, TRIGGER + exposure. Free running:
  // from two exposures after the start of the exposure before, which is the longest that a step may have to wait.
  DelayFigures frame;
  double transfer_ms = 0.0;      // median, from the end of an exposure by the frame's own time to the frame in hand
  double frame_period_ms = 0.0;  // from frame to frame, one after the other
  double exposure_ms = 0.0;      // of these frames

  friend bool operator==(const RigDelays&, const RigDelays&) = default;
};

struct AnswerLimit {
  std::chrono::nanoseconds usual{};     // what comes later comes later than was learnt
  std::chrono::nanoseconds deadline{};  // what has not come then is lost

  friend bool operator==(const AnswerLimit&, const AnswerLimit&) = default;
};

// Delays counted as in RigDelays.
struct LearntDeadlines {
  std::vector<AnswerLimit> sync;  // of each projector
  AnswerLimit frame;

  friend bool operator==(const LearntDeadlines&, const LearntDeadlines&) = default;
};

// usual    = worst + 6 spread + 1 ms
// deadline = usual + margin, no more than `longest`
//
// Six spreads: of delays with an exponential tail, the heavier of the usual ones, one in 9,000 comes later than the
// worst of 60 and six spreads, and none in 1,000,000 later than the deadline (deadlines_test). A millisecond: what a
// thread is late by on a computer that is not busy. The margin: a frame may have to wait for another one on the link,
// or for a busy computer: one frame period, 10 ms at least. A SYNC edge gets four: a late frame is told by its own
// time, while an edge that comes after its step was given up may be taken for the next one's.
[[nodiscard]] LearntDeadlines DeadlinesFrom(const RigDelays& delays, std::chrono::nanoseconds longest);

// "SYNC 97.4, 97.4 ms after TRIGGER, frames 33.1 ms after their exposure".
[[nodiscard]] std::string DeadlinesAsText(const LearntDeadlines& deadlines);

// What a capture goes by, and why.
enum class DeadlineSource : uint8_t {
  kDefault,     // nothing was learnt of this rig
  kLearnt,      // by a selftest
  kConfigured,  // [capture] deadline_ms
  kFlag,        // --deadline
};
struct RigDeadlines {
  DeadlineSource source = DeadlineSource::kDefault;
  std::chrono::nanoseconds longest{};     // of any answer
  std::optional<LearntDeadlines> learnt;  // kLearnt alone
  std::optional<RigDelays> delays;        // as selftest saw them, where that was kept, whatever deadlines are used
  std::string learnt_at;                  // ISO 8601; empty without `delays`
  std::string refused;                    // why what was kept is not taken; empty where nothing was, and where it is
};

// Answers of a rig that came later than was learnt.
struct SlowAnswers {
  int projector = -1;                  // whose SYNC; -1: the camera's frames
  int64_t answers = 0;                 // in all
  int64_t slow = 0;                    // beyond `usual`
  int64_t late = 0;                    // beyond the learnt deadline
  std::chrono::nanoseconds longest{};  // at least
  AnswerLimit limit;
};
// "SYNC of projector 2 came 8.4 ms or more after TRIGGER, beyond the 1.4 ms that `selftest` learnt (120 of 125
// answers): run `stratalux-rig selftest` again".
[[nodiscard]] std::string SlowAnswersAsText(const SlowAnswers& slow);

enum class Patience : uint8_t {
  kLearnt,      // as learnt, where that holds
  kConfigured,  // as for any rig: what is shot again, what follows another exposure time
};

// The deadlines of one capture. The learnt ones hold for a kind of answer once `kConfirmations` of it have come as
// learnt, and for none of any kind any more once one came beyond its deadline, or one in ten beyond `usual`.
class AnswerWatch {
 public:
  static constexpr int kConfirmations = 5;

  // Without `learnt`, or where it does not tell of `projectors`, the first two hold throughout.
  AnswerWatch(std::chrono::nanoseconds sync_deadline, std::chrono::nanoseconds frame_deadline, int projectors,
              std::optional<LearntDeadlines> learnt);

  // `projector` -1: of all of them together.
  [[nodiscard]] std::chrono::nanoseconds SyncDeadline(int projector, Patience patience) const;
  [[nodiscard]] std::chrono::nanoseconds FrameDeadline(Patience patience) const;
  void SawSync(int projector, std::chrono::nanoseconds delay);
  void SawFrame(std::chrono::nanoseconds delay);
  // A frame was here by then, since when nobody saw: that it was late is not known.
  void HadFrame(std::chrono::nanoseconds by);
  // A frame that had been given up came after all.
  void SawLateFrame();
  // Learnt deadlines are used, or will be.
  [[nodiscard]] bool holds() const { return holds_; }
  // Kinds of which answers came beyond their deadline, or more than one in fifty beyond `usual`.
  [[nodiscard]] std::vector<SlowAnswers> Slow() const;

 private:
  void Saw(SlowAnswers& kind, std::chrono::nanoseconds delay);
  [[nodiscard]] std::chrono::nanoseconds Deadline(const SlowAnswers& kind, std::chrono::nanoseconds configured) const;

  std::chrono::nanoseconds sync_deadline_, frame_deadline_;
  bool holds_ = false;
  std::vector<SlowAnswers> sync_;
  SlowAnswers frame_;
};

}  // namespace stratalux::rig
