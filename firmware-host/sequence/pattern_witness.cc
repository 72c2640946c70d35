// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/pattern_witness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

namespace stratalux::rig {
namespace {

// One pixel in each cell of a lattice of about 160 columns. The step is even, so that all probes see one colour of the
// mosaic; (1, 0) is a green site of RGGB and BGGR.
std::vector<float> SampleProbes(const Image<uint16_t>& pixels) {
  const int step = std::max(2, 2 * (pixels.width() / 320));
  std::vector<float> probes;
  for (int y = 0; y < pixels.height(); y += step)
    for (int x = std::min(1, pixels.width() - 1); x < pixels.width(); x += step) probes.push_back(pixels(x, y));
  return probes;
}

bool SameFamily(const PlanStep& a, const PlanStep& b) {
  if (a.projector != b.projector || a.phase != b.phase || a.bracket != b.bracket) return false;
  const Pattern& p = a.pattern;
  const Pattern& q = b.pattern;
  switch (a.phase) {
    case CapturePhase::kReference:
      return true;
    case CapturePhase::kCorrespondence:
      return p.kind == q.kind && p.axis == q.axis && p.bit == q.bit;
    case CapturePhase::kSeparation:
      return p.kind == PatternKind::kSinusoid && q.kind == p.kind && p.axis == q.axis && p.period == q.period;
    default:
      return a.index == b.index;
  }
}

std::string Percent(double fraction) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f %%", 100.0 * fraction);
  return text;
}

}  // namespace

PatternWitness::PatternWitness(const CapturePlan& plan, WitnessOptions options) : plan_(plan), options_(options) {}

void PatternWitness::StartProjector(int projector) {
  projector_ = projector;
  frames_.clear();
  lit_.clear();
  white_.clear();
  black_.clear();
  coordinates_.clear();
}

std::vector<int> PatternWitness::GroupOf(const CapturePlan& plan, int step) {
  std::vector<int> group;
  int first = step;
  while (first > 0 && SameFamily(plan.steps[first - 1], plan.steps[step])) --first;
  for (int i = first; i < static_cast<int>(plan.steps.size()) && SameFamily(plan.steps[i], plan.steps[step]); ++i)
    group.push_back(i);
  return group;
}

void PatternWitness::Add(const PlanStep& step, const Image<uint16_t>& pixels) {
  frames_[step.index] = SampleProbes(pixels);
  if (step.phase == CapturePhase::kCorrespondence) coordinates_.erase(step.pattern.axis);
}

const PatternWitness::Probes* PatternWitness::Find(int step) const {
  const auto found = frames_.find(step);
  return found == frames_.end() ? nullptr : &found->second;
}

LevelCheck PatternWitness::Check(const PlanStep& step) {
  using Verdict = LevelCheck;
  const std::vector<int> group = GroupOf(plan_, step.index);
  for (int member : group)
    if (Find(member) == nullptr) return Verdict::kNotChecked;
  auto verdict = [](bool good) { return good ? Verdict::kPassed : Verdict::kFailed; };
  if (step.phase == CapturePhase::kReference)
    return group.size() < 2 ? Verdict::kNotChecked : verdict(UpdateReference());
  if (lit_.empty()) return Verdict::kNotChecked;
  switch (step.phase) {
    case CapturePhase::kCorrespondence:
      return group.size() == 2 ? verdict(AddsUp(group)) : Verdict::kNotChecked;
    case CapturePhase::kSeparation: {
      if (step.pattern.kind != PatternKind::kSinusoid) return Verdict::kNotChecked;
      if (static_cast<int>(group.size()) == step.pattern.shifts && !AddsUp(group)) return Verdict::kFailed;
      for (int member : group)
        if (!AgreesBest(plan_.steps[member], step.pattern.shifts, 1).value_or(true)) return Verdict::kFailed;
      return Verdict::kPassed;
    }
    case CapturePhase::kSweep: {
      const int comb_step = plan_.options.comb_step;
      const std::optional<bool> agrees = AgreesBest(step, step.pattern.period / comb_step, comb_step);
      return agrees ? verdict(*agrees) : Verdict::kNotChecked;
    }
    case CapturePhase::kMotion:
      return verdict(std::abs(MeanLevel(*Find(step.index)) - 1.0) <= options_.steady_tolerance);
    case CapturePhase::kGuard:
      return verdict(std::abs(MeanLevel(*Find(step.index))) <= options_.dark_tolerance);
    default:
      return Verdict::kNotChecked;
  }
}

bool PatternWitness::UpdateReference() {
  const Probes* white = nullptr;
  const Probes* black = nullptr;
  for (int i : StepsOf(CapturePhase::kReference)) {
    const PatternKind kind = plan_.steps[i].pattern.kind;
    if (kind == PatternKind::kWhite) white = Find(i);
    if (kind == PatternKind::kBlack) black = Find(i);
  }
  lit_.clear();
  coordinates_.clear();
  if (white == nullptr || black == nullptr) return false;
  white_ = *white;
  black_ = *black;
  for (size_t i = 0; i < white_.size(); ++i)
    if (white_[i] - black_[i] >= options_.min_contrast_dn && white_[i] < options_.saturation_dn)
      lit_.push_back(static_cast<int>(i));
  if (static_cast<int>(lit_.size()) >= options_.min_lit_probes) return true;
  lit_.clear();
  return false;
}

bool PatternWitness::AddsUp(std::span<const int> steps) const {
  // 2/N sum I - (W + B) vanishes; its variance is that of W and B (weight 1) plus (2/N)^2 of each frame.
  const double scale = 2.0 / static_cast<double>(steps.size());
  const double read_variance = options_.read_noise_dn * options_.read_noise_dn;
  int off = 0;
  for (int i : lit_) {
    double sum = 0.0;
    for (int step : steps) sum += frames_.at(step)[i];
    const double residual = scale * sum - white_[i] - black_[i];
    const double shot_variance = (white_[i] + black_[i]) / options_.gain_e_per_dn;
    const double variance = (1.0 + scale) * shot_variance + (2.0 + 2.0 * scale) * read_variance;
    if (std::abs(residual) > options_.sum_tolerance * (white_[i] - black_[i]) + 4.0 * std::sqrt(variance)) ++off;
  }
  return off <= options_.max_off_fraction * static_cast<double>(lit_.size());
}

double PatternWitness::MeanLevel(const Probes& frame) const {
  double above = 0.0, white = 0.0;
  for (int i : lit_) {
    above += frame[i] - black_[i];
    white += white_[i] - black_[i];
  }
  return above / white;
}

std::vector<int> PatternWitness::StepsOf(CapturePhase phase) const {
  std::vector<int> steps;
  for (const PlanStep& step : plan_.steps)
    if (step.projector == projector_ && step.phase == phase) steps.push_back(step.index);
  return steps;
}

const std::vector<int>& PatternWitness::Coordinates(PatternAxis axis) {
  std::vector<int>& known = coordinates_[axis];
  if (!known.empty()) return known;
  std::map<int, std::array<int, 2>> bits;  // bit -> steps of the bit and of its inverse
  int bit_count = 0;
  for (int i : StepsOf(CapturePhase::kCorrespondence)) {
    const Pattern& p = plan_.steps[i].pattern;
    if (p.kind != PatternKind::kGray || p.axis != axis || Find(i) == nullptr) continue;
    bits.try_emplace(p.bit, std::array{-1, -1}).first->second[p.inverse ? 1 : 0] = i;
    bit_count = p.bits;
  }
  if (bit_count == 0 || static_cast<int>(bits.size()) != bit_count) return known;
  // One wrong bit mirrors or moves every coordinate, so a code that did not pass judges nothing.
  for (const auto& [bit, steps] : bits)
    if (steps[0] < 0 || steps[1] < 0 || !AddsUp(steps)) return known;
  known.reserve(lit_.size());
  for (int i : lit_) {
    unsigned gray = 0;
    for (const auto& [bit, steps] : bits)
      gray = gray << 1 | (frames_.at(steps[0])[i] > frames_.at(steps[1])[i] ? 1U : 0U);
    known.push_back(static_cast<int>(BinaryFromGray(gray)));
  }
  return known;
}

std::optional<bool> PatternWitness::AgreesBest(const PlanStep& step, int shift_count, int shift_step) {
  const std::vector<int>& at = Coordinates(step.pattern.axis);
  if (at.empty() || shift_count < 3) return std::nullopt;
  const int extent =
      step.pattern.axis == PatternAxis::kColumns ? plan_.options.projector_width : plan_.options.projector_height;
  const Probes& frame = *Find(step.index);
  std::vector<double> level(lit_.size());
  for (size_t i = 0; i < lit_.size(); ++i)
    level[i] = (frame[lit_[i]] - black_[lit_[i]]) / (white_[lit_[i]] - black_[lit_[i]]);
  int best = -1;
  double best_score = 0.0, own_weight = 0.0;
  const int own = step.pattern.shift / shift_step;
  for (int k = 0; k < shift_count; ++k) {
    Pattern candidate = step.pattern;
    candidate.shift = k * shift_step;
    const std::vector<float> profile = candidate.Profile(extent);
    double weight = 0.0, weighted = 0.0;
    for (size_t i = 0; i < at.size(); ++i) {
      if (at[i] < 0 || at[i] >= extent) continue;
      weight += profile[at[i]];
      weighted += profile[at[i]] * level[i];
    }
    if (k == own) own_weight = weight;
    const double score = weight > 0.0 ? weighted / weight : 0.0;
    if (best < 0 || score > best_score) {
      best = k;
      best_score = score;
    }
  }
  // Too few probes on the pattern's own lines say nothing.
  if (own_weight < 8.0) return std::nullopt;
  const int distance = std::abs(best - own);
  return std::min(distance, shift_count - distance) <= 1;
}

std::vector<std::string> PatternWitness::CheckProjector() const {
  std::vector<std::string> reasons;
  if (lit_.empty()) return reasons;
  const double white_exposure_ms = plan_.options.exposure_ms;
  // The mean black over reference and guards: a whole cycle takes it off period / step times.
  double black = 0.0;
  int blacks = 0;
  for (CapturePhase phase : {CapturePhase::kReference, CapturePhase::kGuard})
    for (int i : StepsOf(phase))
      if (plan_.steps[i].pattern.kind == PatternKind::kBlack && Find(i) != nullptr) {
        black += MeanLevel(*Find(i));
        ++blacks;
      }
  if (blacks > 0) black /= blacks;
  for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    double sum = 0.0;
    int count = 0;
    for (int i : StepsOf(CapturePhase::kSweep)) {
      const PlanStep& step = plan_.steps[i];
      if (step.pattern.axis != axis || step.bracket != 0 || step.exposure_ms != white_exposure_ms) continue;
      if (Find(i) == nullptr) continue;
      sum += MeanLevel(*Find(i)) - black;
      ++count;
    }
    const PlanOptions& o = plan_.options;
    if (count == 0 || count != o.comb_period / o.comb_step) continue;
    const double whites = sum * o.comb_step / o.comb_width / (1.0 - black);
    if (std::abs(whites - 1.0) > options_.steady_tolerance)
      reasons.push_back("projector " + std::to_string(projector_) + ": the comb cycle adds up to " + Percent(whites) +
                        " of white; the visitor moved, the light drifted or frames are mixed up");
  }
  return reasons;
}

}  // namespace stratalux::rig
