// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/pattern_memory_projector.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

namespace stratalux::rig {
namespace {

constexpr int kTries = 3;                                                   // on the way to the wanted pattern
constexpr std::chrono::nanoseconds kSlice = std::chrono::milliseconds(20);  // longest wait that looks at no stop

class PatternMemoryProjector final : public Projector {
 public:
  PatternMemoryProjector(LineBank& lines, PatternMemoryLines& memory_lines, PatternMemoryOptions options,
                         const StopToken& stop)
      : lines_(lines),
        memory_lines_(memory_lines),
        options_(std::move(options)),
        stop_(stop),
        first_pattern_count_(memory_lines_.SyncCount(options_.projector)) {}

  [[nodiscard]] int width() const override { return options_.width; }
  [[nodiscard]] int height() const override { return options_.height; }
  Status Load(const std::vector<Pattern>& sequence) override;
  void Doubt() override { place_ = Place::kDoubtful; }
  Status Rest() override;

 private:
  enum class Place : uint8_t { kDoubtful, kCounted };

  [[nodiscard]] bool has_reset() const { return options_.timing.reset.has_value(); }
  // The pattern that the next TRIGGER shows.
  [[nodiscard]] int64_t Next() {
    const int64_t shown = memory_lines_.SyncCount(options_.projector) - first_pattern_count_;
    return shown % static_cast<int64_t>(options_.memory.size());
  }
  Status Rewind();
  // True where SYNC confirmed the step.
  Result<bool> Step();
  Result<bool> StepTo(int64_t target);
  [[nodiscard]] Status Unconfirmed() const;

  LineBank& lines_;
  PatternMemoryLines& memory_lines_;
  PatternMemoryOptions options_;
  const StopToken& stop_;
  int64_t first_pattern_count_;  // SYNC edges before the memory last stood at its first pattern
  Place place_ = Place::kDoubtful;
};

Status PatternMemoryProjector::Rewind() {
  place_ = Place::kDoubtful;  // also where the pulse fails half-way
  SLX_RETURN_IF_ERROR(memory_lines_.ResetMemory(options_.projector));
  first_pattern_count_ = memory_lines_.SyncCount(options_.projector);
  place_ = Place::kCounted;
  return Status::Ok();
}

Result<bool> PatternMemoryProjector::Step() {
  SLX_RETURN_IF_ERROR(stop_.Check());
  SLX_ASSIGN_OR_RETURN(const TriggerReceipt pulse, lines_.TriggerProjector(options_.projector));
  std::chrono::nanoseconds left = options_.sync_deadline;
  while (left.count() > 0) {
    SLX_RETURN_IF_ERROR(stop_.Check());
    const std::chrono::nanoseconds slice = std::min(left, kSlice);
    SLX_ASSIGN_OR_RETURN(const std::optional<SyncEdge> edge, lines_.WaitSync(slice));
    if (!edge) left -= slice;
    if (edge && edge->projector == options_.projector && edge->time >= pulse.time) return true;
  }
  return false;
}

Result<bool> PatternMemoryProjector::StepTo(int64_t target) {
  // A memory that steps twice at a pulse may jump over the target: one more round, then it is broken.
  const auto limit = static_cast<int64_t>(2 * options_.memory.size());
  for (int64_t steps = 0; Next() != target; ++steps) {
    if (steps == limit) return false;
    SLX_ASSIGN_OR_RETURN(const bool confirmed, Step());
    if (!confirmed) return false;
  }
  return true;
}

Status PatternMemoryProjector::Load(const std::vector<Pattern>& sequence) {
  if (sequence.empty()) return Status::Ok();
  // Without RESET there is nothing better than the count.
  const bool known = place_ == Place::kCounted || !has_reset();
  const std::optional<MemoryWay> way =
      FindWay(options_.memory, sequence, known ? std::optional(Next()) : std::nullopt, options_.timing);
  if (!way)
    return Status::Usage("the pattern memory of projector " + std::to_string(options_.projector) + " (" +
                         std::to_string(options_.memory.size()) + " patterns) does not hold this sequence of " +
                         std::to_string(sequence.size()) + "; fill it again with `stratalux-rig plan render`");
  for (int attempt = 0; attempt < (has_reset() ? kTries : 1); ++attempt) {
    if (attempt > 0 || way->start == WayStart::kReset) SLX_RETURN_IF_ERROR(Rewind());
    SLX_ASSIGN_OR_RETURN(const bool there, StepTo(way->target));
    if (there) return Status::Ok();
  }
  Doubt();
  return Unconfirmed();
}

Status PatternMemoryProjector::Rest() {
  if (has_reset()) return Rewind();
  SLX_ASSIGN_OR_RETURN(const bool there, StepTo(0));
  return there ? Status::Ok() : Unconfirmed();
}

Status PatternMemoryProjector::Unconfirmed() const {
  return Status::Failed(
      "projector " + std::to_string(options_.projector) + " does not confirm its steps (no SYNC edge " + "within " +
      std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(options_.sync_deadline).count()) +
      " ms of TRIGGER); check its power, its TRIGGER and SYNC cables and their polarity in rig.toml");
}

}  // namespace

std::unique_ptr<Projector> MakePatternMemoryProjector(LineBank& lines, PatternMemoryLines& memory_lines,
                                                      PatternMemoryOptions options, const StopToken& stop) {
  return std::make_unique<PatternMemoryProjector>(lines, memory_lines, std::move(options), stop);
}

}  // namespace stratalux::rig
