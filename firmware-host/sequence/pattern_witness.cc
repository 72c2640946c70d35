// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/pattern_witness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace stratalux::rig {
namespace {

constexpr int kFewestInBand = 40;  // lit probes; of fewer, no share is taken

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

// Share of the picture that the pattern lights.
double MeanIntensity(const Pattern& pattern, int width, int height) {
  if (pattern.IsOneDimensional()) {
    const std::vector<float> profile = pattern.Profile(pattern.axis == PatternAxis::kColumns ? width : height);
    return std::accumulate(profile.begin(), profile.end(), 0.0) / static_cast<double>(profile.size());
  }
  const Image<float> picture = pattern.Render(width, height);
  return std::accumulate(picture.pixels().begin(), picture.pixels().end(), 0.0) / static_cast<double>(picture.size());
}

}  // namespace

PatternWitness::PatternWitness(const CapturePlan& plan, WitnessOptions options) : plan_(plan), options_(options) {}

void PatternWitness::AddPreroll(const PlanStep& step, const Image<uint16_t>& pixels) {
  if (lattice_.size() == 0) lattice_ = ProbeLattice(pixels.width(), pixels.height());
  const bool white = step.pattern.kind == PatternKind::kWhite;
  std::vector<float>& mean = white ? preroll_white_ : preroll_black_;
  int& count = white ? preroll_whites_ : preroll_blacks_;
  const Probes probes = lattice_.Sample(pixels);
  mean.resize(probes.size());
  ++count;
  for (size_t i = 0; i < probes.size(); ++i) mean[i] += (probes[i] - mean[i]) / static_cast<float>(count);
}

void PatternWitness::StartProjector(int projector) {
  projector_ = projector;
  ++load_;
  frames_.clear();
  doubtful_.clear();
  lit_.clear();
  decoded_ = false;
}

std::vector<int> PatternWitness::GroupOf(const CapturePlan& plan, int step) {
  std::vector<int> group;
  int first = step;
  while (first > 0 && SameFamily(plan.steps[first - 1], plan.steps[step])) --first;
  for (int i = first; i < static_cast<int>(plan.steps.size()) && SameFamily(plan.steps[i], plan.steps[step]); ++i)
    group.push_back(i);
  return group;
}

void PatternWitness::Add(const PlanStep& step, const Image<uint16_t>& pixels, double mean_dn) {
  if (lattice_.size() == 0) lattice_ = ProbeLattice(pixels.width(), pixels.height());
  frames_[step.index] = {lattice_.Sample(pixels), mean_dn, load_, shots_++, Testimony::kSilent};
  if (step.phase == CapturePhase::kCorrespondence) decoded_ = false;
}

const PatternWitness::Frame* PatternWitness::Find(int step) const {
  const auto found = frames_.find(step);
  return found == frames_.end() ? nullptr : &found->second;
}

LevelCheck PatternWitness::Check(const PlanStep& step) {
  const std::vector<int> group = GroupOf(plan_, step.index);
  for (int member : group)
    if (Find(member) == nullptr) return LevelCheck::kNotChecked;
  Testimony testimony = Judge(step, group);
  for (int member : group) frames_.at(member).testimony = testimony;
  if (testimony == Testimony::kRefutes) DoubtSilentBefore(group);
  if (step.phase == CapturePhase::kCorrespondence && testimony != Testimony::kRefutes &&
      JudgeOrder(step.pattern.axis, group) == Testimony::kRefutes)
    testimony = Testimony::kRefutes;
  switch (testimony) {
    case Testimony::kConfirms:
      return LevelCheck::kPassed;
    case Testimony::kRefutes:
      return LevelCheck::kFailed;
    case Testimony::kSilent:
      break;
  }
  return LevelCheck::kNotChecked;
}

void PatternWitness::DoubtSilentBefore(std::span<const int> group) {
  const int load = frames_.at(group.front()).load;
  std::map<int64_t, int> before;  // shot -> step, of this load
  for (const auto& [step, frame] : frames_)
    if (frame.load == load && frame.shot < frames_.at(group.front()).shot) before[frame.shot] = step;
  for (auto it = before.rbegin(); it != before.rend(); ++it) {
    const Testimony testimony = frames_.at(it->second).testimony;
    if (testimony == Testimony::kConfirms) return;
    if (testimony == Testimony::kSilent) doubtful_.push_back(it->second);
  }
}

PatternWitness::Testimony PatternWitness::JudgeOrder(PatternAxis axis, std::span<const int> group) {
  const std::vector<int> at = Decode(axis);
  if (at.empty()) return Testimony::kSilent;
  // Pairs of lit probes that stand side by side along the axis.
  const int stride = axis == PatternAxis::kColumns ? 1 : lattice_.columns();
  std::vector<std::pair<int, int>> pairs;
  std::vector<int> index(lattice_.size(), -1);
  for (size_t k = 0; k < lit_.size(); ++k) index[lit_[k]] = static_cast<int>(k);
  for (size_t k = 0; k < lit_.size(); ++k) {
    const size_t beside = static_cast<size_t>(lit_[k]) + stride;
    if (beside >= index.size() || (stride == 1 && beside % lattice_.columns() == 0)) continue;
    if (const int other = index[beside]; other >= 0 && at[k] >= 0 && at[other] >= 0)
      pairs.emplace_back(at[k], at[other]);
  }
  if (static_cast<int>(pairs.size()) < options_.min_lit_probes) return Testimony::kSilent;
  // Of the picture with the lowest bits of each position inverted, which is what one exchanged bit of the Gray code
  // does.
  auto roughness = [&](int mask) {
    int64_t sum = 0;
    for (const auto& [a, b] : pairs) sum += std::abs((a ^ mask) - (b ^ mask));
    return sum;
  };
  const int64_t as_decoded = roughness(0);
  const int extent = axis == PatternAxis::kColumns ? plan_.options.projector_width : plan_.options.projector_height;
  const int bits = GrayBits(extent);
  for (int significance = 0; significance < bits - 1; ++significance) {
    const int block = 2 << significance;
    if (roughness(block - 1) * 10 > as_decoded * 6) continue;
    Testimony judged = Testimony::kSilent;
    for (int i : StepsOf(CapturePhase::kCorrespondence)) {
      const Pattern& p = plan_.steps[i].pattern;
      if (p.kind != PatternKind::kGray || p.axis != axis || p.bit != bits - 1 - significance) continue;
      frames_.at(i).testimony = Testimony::kRefutes;
      if (std::find(group.begin(), group.end(), i) != group.end()) {
        judged = Testimony::kRefutes;
      } else {
        doubtful_.push_back(i);
      }
      decoded_ = false;
    }
    return judged;
  }
  return Testimony::kConfirms;
}

bool PatternWitness::ReferenceStandsAlone() const {
  return std::none_of(frames_.begin(), frames_.end(), [&](const auto& entry) {
    return plan_.steps[entry.first].phase != CapturePhase::kReference && entry.second.testimony == Testimony::kConfirms;
  });
}

std::vector<int> PatternWitness::TakeDoubtful() {
  std::vector<int> steps;
  for (int step : doubtful_)
    for (int member : GroupOf(plan_, step)) steps.push_back(member);
  doubtful_.clear();
  std::sort(steps.begin(), steps.end());
  steps.erase(std::unique(steps.begin(), steps.end()), steps.end());
  return steps;
}

bool PatternWitness::CanSpeak(const PlanStep& step) const {
  // Brackets of other phases than the sweep have no white of their exposure to be held against.
  if (step.bracket > 0 && step.phase != CapturePhase::kSweep) return false;
  if (step.phase == CapturePhase::kPreroll || step.phase == CapturePhase::kRadiometry) return false;
  return step.phase == CapturePhase::kReference || !lit_.empty();
}

PatternWitness::Testimony PatternWitness::Judge(const PlanStep& step, std::span<const int> group) {
  if (!CanSpeak(step)) return Testimony::kSilent;
  if (step.phase == CapturePhase::kReference) return group.size() < 2 ? Testimony::kSilent : JudgeReference();
  for (int member : group)
    if (!WithinReference(plan_.steps[member])) return Testimony::kRefutes;
  switch (step.phase) {
    case CapturePhase::kCorrespondence:
      return group.size() == 2 ? JudgeGray(group) : Testimony::kSilent;
    case CapturePhase::kSeparation:
      return JudgeShifts(step, group);
    case CapturePhase::kSweep:
      return JudgeComb(step);
    case CapturePhase::kMotion:
      return JudgeWhite(step);
    case CapturePhase::kSpot:
    case CapturePhase::kGuard:
      return JudgeLevel(step);
    default:
      return Testimony::kSilent;
  }
}

PatternWitness::Testimony PatternWitness::JudgeReference() {
  const Frame* white = nullptr;
  const Frame* black = nullptr;
  for (int i : StepsOf(CapturePhase::kReference)) {
    const PatternKind kind = plan_.steps[i].pattern.kind;
    if (kind == PatternKind::kWhite) white = Find(i);
    if (kind == PatternKind::kBlack) black = Find(i);
  }
  lit_.clear();
  decoded_ = false;
  if (white == nullptr || black == nullptr) return Testimony::kRefutes;
  white_ = *white;
  black_ = *black;
  for (size_t i = 0; i < white_.probes.size(); ++i)
    if (white_.probes[i] - black_.probes[i] >= options_.min_contrast_dn && white_.probes[i] < options_.saturation_dn)
      lit_.push_back(static_cast<int>(i));
  bool good = static_cast<int>(lit_.size()) >= options_.min_lit_probes;
  // All projectors' white is at least this one's, their black too.
  if (good && !preroll_black_.empty()) {
    double excess = 0.0, contrast = 0.0;
    for (int i : lit_) {
      excess += black_.probes[i] - preroll_black_[i];
      contrast += white_.probes[i] - black_.probes[i];
    }
    good = excess <= options_.dark_tolerance * contrast;
  }
  if (good && !preroll_white_.empty()) {
    std::array<int, ProbeLattice::kBands> off{}, all{};
    for (size_t i = 0; i < white_.probes.size(); ++i) {
      const double limit =
          preroll_white_[i] * (1.0 + options_.sum_tolerance) + 4.0 * std::sqrt(2.0 * VarianceDn(white_.probes[i]));
      const int band = lattice_.BandOf(static_cast<int>(i));
      ++all[band];
      off[band] += preroll_white_[i] < options_.saturation_dn && white_.probes[i] > limit;
    }
    for (int b = 0; b < ProbeLattice::kBands; ++b) good = good && off[b] <= options_.max_off_fraction * all[b];
  }
  if (good) return Testimony::kConfirms;
  lit_.clear();
  return Testimony::kRefutes;
}

bool PatternWitness::WithinReference(const PlanStep& step) const {
  if (step.exposure_ms != plan_.options.exposure_ms) return true;
  const Probes& frame = Find(step.index)->probes;
  // Bands of few probes are no evidence; elsewhere light where white gives none is a picture out of place.
  std::array<int, ProbeLattice::kBands> off{}, all{};
  for (size_t i = 0; i < frame.size(); ++i) {
    const double white = white_.probes[i], black = black_.probes[i], level = frame[i];
    const int band = lattice_.BandOf(static_cast<int>(i));
    ++all[band];
    if (white >= options_.saturation_dn || (level <= white && level >= black)) continue;
    const double beyond = std::max(level - white, black - level);
    const double share = options_.steady_tolerance * std::max(0.0, white - black);
    if (beyond > share + 4.0 * std::sqrt(2.0 * VarianceDn(std::max(level, white)))) ++off[band];
  }
  for (int b = 0; b < ProbeLattice::kBands; ++b)
    if (off[b] > 0.2 * options_.max_off_fraction * all[b] + 3.0) return false;
  return true;
}

bool PatternWitness::AddsUp(std::span<const int> steps, double mean) const {
  // 2/N sum I - 2 (mean W + (1 - mean) B) vanishes; its variance is about that of W and B plus (2/N)^2 of each frame.
  const double scale = 2.0 / static_cast<double>(steps.size());
  std::vector<const Probes*> frames;
  for (int step : steps) frames.push_back(&frames_.at(step).probes);
  std::array<int, ProbeLattice::kBands> off{}, all{};
  for (int i : lit_) {
    double sum = 0.0;
    for (const Probes* frame : frames) sum += (*frame)[i];
    const double white = white_.probes[i], black = black_.probes[i];
    const double variance = (1.0 + scale) * (VarianceDn(white) + VarianceDn(black));
    const int band = lattice_.BandOf(i);
    ++all[band];
    if (std::abs(scale * sum - 2.0 * (mean * white + (1.0 - mean) * black)) >
        options_.sum_tolerance * (white - black) + 4.0 * std::sqrt(variance))
      ++off[band];
  }
  for (int b = 0; b < ProbeLattice::kBands; ++b)
    if (all[b] >= kFewestInBand && off[b] > options_.max_off_fraction * all[b]) return false;
  return std::accumulate(off.begin(), off.end(), 0) <= options_.max_off_fraction * static_cast<double>(lit_.size());
}

PatternWitness::Testimony PatternWitness::JudgeGray(std::span<const int> pair) const {
  if (!AddsUp(pair, 0.5)) return Testimony::kRefutes;
  // What is left of the sum against the contrast of the two, both less their noise: a bit beside another bit's inverse
  // leaves as much as it differs by.
  const Probes& bit = frames_.at(pair[0]).probes;
  const Probes& inverse = frames_.at(pair[1]).probes;
  double rest = 0.0, contrast = 0.0, noise = 0.0;
  for (int i : lit_) {
    const double white = white_.probes[i], black = black_.probes[i];
    const double sum = double(bit[i]) + inverse[i] - white - black, difference = double(bit[i]) - inverse[i];
    const double two = VarianceDn(bit[i]) + VarianceDn(inverse[i]);
    const double four = two + VarianceDn(white) + VarianceDn(black);
    rest += sum * sum - four;
    contrast += difference * difference - two;
    noise += 2.0 * four * four;
  }
  noise = std::sqrt(noise);
  if (rest > 0.4 * std::max(0.0, contrast) + 10.0 * noise) return Testimony::kRefutes;
  return contrast > 10.0 * noise && rest < 0.2 * contrast ? Testimony::kConfirms : Testimony::kSilent;
}

PatternWitness::Testimony PatternWitness::JudgeShifts(const PlanStep& step, std::span<const int> group) {
  const bool whole =
      step.pattern.kind == PatternKind::kSinusoid && static_cast<int>(group.size()) == step.pattern.shifts;
  const auto& means = options_.sinusoid_mean;
  const double mean = step.projector < static_cast<int>(means.size()) ? means[step.projector] : 0.5;
  if (whole && !AddsUp(group, mean)) return Testimony::kRefutes;
  Testimony testimony = Testimony::kConfirms;
  std::vector<float> level;
  for (int member : group) {
    const LevelsAt frame = LevelsOf(plan_.steps[member], level);
    const double evidence = ShiftEvidence(plan_.steps[member].pattern, frame);
    if (evidence < -options_.min_evidence) return Testimony::kRefutes;
    if (evidence < options_.min_evidence) testimony = Testimony::kSilent;
  }
  return testimony;
}

PatternWitness::Testimony PatternWitness::JudgeComb(const PlanStep& step) {
  std::vector<float> level;
  const LevelsAt frame = LevelsOf(step, level);
  if (frame.level.empty()) return Testimony::kSilent;
  // A comb spreads the light it has: more would be another pattern, none would be black.
  const double share = static_cast<double>(step.pattern.width) / step.pattern.period;
  const double mean = MeanLevel(Find(step.index)->probes) * plan_.options.exposure_ms / step.exposure_ms;
  // The black that MeanLevel takes off is that of the nominal exposure.
  const double black = options_.dark_tolerance * std::abs(plan_.options.exposure_ms / step.exposure_ms - 1.0);
  if (mean > 3.0 * share + 2.0 * options_.dark_tolerance + black || mean < 0.25 * share - black)
    return Testimony::kRefutes;
  if (!BrightAsTheExposure(step) || LinesElsewhere(step, frame)) return Testimony::kRefutes;
  const double evidence = CombEvidence(step.pattern, plan_.options.comb_step, frame);
  if (std::abs(evidence) < options_.min_evidence) return Testimony::kSilent;
  return evidence > 0.0 ? Testimony::kConfirms : Testimony::kRefutes;
}

bool PatternWitness::LinesElsewhere(const PlanStep& step, const LevelsAt& frame) const {
  // In some band, probes far from the lines that are as bright as those on them.
  const Pattern& comb = step.pattern;
  const std::span<const int> at = comb.axis == PatternAxis::kColumns ? frame.column : frame.row;
  std::vector<int> beyond;  // px from the nearest line, by position
  for (int position = 0; position < (comb.axis == PatternAxis::kColumns ? frame.width : frame.height); ++position) {
    const int distance = ((position - comb.shift) % comb.period + comb.period) % comb.period;
    beyond.push_back(distance < comb.width ? 0 : std::min(distance - comb.width + 1, comb.period - distance));
  }
  double on = 0.0;
  int lines = 0;
  for (size_t i = 0; i < at.size(); ++i)
    if (at[i] >= 0 && beyond[at[i]] == 0) {
      on += frame.level[i];
      ++lines;
    }
  if (lines == 0) return false;
  const double bright = 0.6 * on / lines;
  std::array<int, ProbeLattice::kBands> off{}, all{};
  for (size_t i = 0; i < at.size(); ++i) {
    const int band = lattice_.BandOf(lit_[i]);
    ++all[band];
    if (at[i] < 0 || frame.level[i] <= bright || beyond[at[i]] <= 2 * comb.width) continue;
    const double contrast = white_.probes[lit_[i]] - black_.probes[lit_[i]];
    off[band] += frame.level[i] > bright + 4.0 * std::sqrt(2.0 * VarianceDn(white_.probes[lit_[i]])) / contrast;
  }
  for (int b = 0; b < ProbeLattice::kBands; ++b)
    if (off[b] > 0.2 * options_.max_off_fraction * all[b] + 2.0) return true;
  return false;
}

bool PatternWitness::BrightAsTheExposure(const PlanStep& step) const {
  // A change of exposure that came late shows the exposure before. The comb before of the same bracket, or the share of
  // the picture that a comb lights, says how bright the frame should be.
  const double before_ms = step.index > 0 ? plan_.steps[step.index - 1].exposure_ms : step.exposure_ms;
  if (before_ms == step.exposure_ms) return true;
  const double share =
      static_cast<double>(step.pattern.width) / step.pattern.period * step.exposure_ms / plan_.options.exposure_ms;
  double expected = share;
  for (const auto& [index, frame] : frames_) {
    const PlanStep& other = plan_.steps[index];
    if (index < step.index && other.phase == step.phase && other.bracket == step.bracket &&
        frame.testimony == Testimony::kConfirms)
      expected = MeanLevel(frame.probes);
  }
  // Nearer to it than to the level of the exposure before: in differences, since a black of another exposure is taken
  // off, or in ratios, since scenes spread the comb's light unlike each other.
  const double level = MeanLevel(Find(step.index)->probes), ratio = before_ms / step.exposure_ms;
  return std::abs(level - expected) < 0.5 * std::max(expected, share) * std::abs(ratio - 1.0) ||
         (level > 0.0 && expected > 0.0 && std::abs(std::log(level / expected)) < 0.5 * std::abs(std::log(ratio)));
}

double PatternWitness::StillnessOf(const Probes& white) const {
  const double mean = MeanLevel(white);
  double rest = 0.0, contrast = 0.0;
  for (int i : lit_) {
    const double reference = mean * (white_.probes[i] - black_.probes[i]);
    const double difference = white[i] - black_.probes[i] - reference;
    rest += difference * difference - VarianceDn(white[i]) - mean * mean * VarianceDn(white_.probes[i]) -
            (1.0 - mean) * (1.0 - mean) * VarianceDn(black_.probes[i]);
    contrast += reference * reference;
  }
  return contrast > 0.0 ? std::sqrt(std::max(0.0, rest) / contrast) : 0.0;
}

PatternWitness::Testimony PatternWitness::JudgeWhite(const PlanStep& step) const {
  const Probes& white = Find(step.index)->probes;
  const double mean = MeanLevel(white);
  if (std::abs(mean - 1.0) > options_.steady_tolerance) return Testimony::kRefutes;
  std::array<int, ProbeLattice::kBands> off{}, all{};
  for (int i : lit_) {
    const double reference = mean * (white_.probes[i] - black_.probes[i]);
    const double limit = options_.sum_tolerance * reference + 4.0 * std::sqrt(2.0 * VarianceDn(white_.probes[i]));
    const int band = lattice_.BandOf(i);
    ++all[band];
    off[band] += std::abs(white[i] - black_.probes[i] - reference) > limit;
  }
  for (int b = 0; b < ProbeLattice::kBands; ++b)
    if (all[b] >= kFewestInBand && off[b] > options_.max_off_fraction * all[b]) return Testimony::kRefutes;
  return StillnessOf(white) > options_.still_tolerance ? Testimony::kRefutes : Testimony::kConfirms;
}

double PatternWitness::WholeLevel(const Frame& frame) const {
  return (frame.mean_dn - black_.mean_dn) / std::max(1e-9, white_.mean_dn - black_.mean_dn);
}

double PatternWitness::ExpectedLevel(const Pattern& pattern) {
  const Coordinates& at = Where();
  if (at.column.empty() || at.row.empty())
    return MeanIntensity(pattern, plan_.options.projector_width, plan_.options.projector_height);
  double sum = 0.0, white = 0.0;
  for (size_t k = 0; k < lit_.size(); ++k) {
    if (at.column[k] < 0 || at.row[k] < 0) continue;
    const double contrast = white_.probes[lit_[k]] - black_.probes[lit_[k]];
    sum += contrast * pattern.Intensity(at.column[k], at.row[k]);
    white += contrast;
  }
  return sum / std::max(1e-9, white);
}

PatternWitness::Testimony PatternWitness::JudgeLevel(const PlanStep& step) {
  // Spots light so little of the picture that only the mean of all pixels tells them from black.
  double spots = 0.0;
  for (int i : StepsOf(CapturePhase::kSpot)) spots = ExpectedLevel(plan_.steps[i].pattern);
  const Frame& frame = *Find(step.index);
  const double level = WholeLevel(frame);
  if (step.phase == CapturePhase::kSpot)
    return level > 0.3 * spots && level < 0.5 ? Testimony::kConfirms : Testimony::kRefutes;
  if (std::abs(MeanLevel(frame.probes)) > options_.dark_tolerance) return Testimony::kRefutes;
  return spots == 0.0 || level < 0.3 * spots ? Testimony::kConfirms : Testimony::kRefutes;
}

double PatternWitness::MeanLevel(const Probes& frame) const {
  double above = 0.0, white = 0.0;
  for (int i : lit_) {
    above += frame[i] - black_.probes[i];
    white += white_.probes[i] - black_.probes[i];
  }
  return above / white;
}

std::vector<int> PatternWitness::StepsOf(CapturePhase phase) const {
  std::vector<int> steps;
  for (const PlanStep& step : plan_.steps)
    if (step.projector == projector_ && step.phase == phase && (step.bracket == 0 || phase == CapturePhase::kSweep))
      steps.push_back(step.index);
  return steps;
}

std::vector<int> PatternWitness::Decode(PatternAxis axis) const {
  std::map<int, std::array<int, 2>> bits;  // bit -> steps of the bit and of its inverse
  int bit_count = 0;
  for (int i : StepsOf(CapturePhase::kCorrespondence)) {
    const Pattern& p = plan_.steps[i].pattern;
    if (p.kind != PatternKind::kGray || p.axis != axis || Find(i) == nullptr) continue;
    // One wrong bit mirrors or moves every coordinate, so a code that did not pass judges nothing.
    if (Find(i)->testimony == Testimony::kRefutes) return {};
    bits.try_emplace(p.bit, std::array{-1, -1}).first->second[p.inverse ? 1 : 0] = i;
    bit_count = p.bits;
  }
  if (bit_count == 0 || static_cast<int>(bits.size()) != bit_count) return {};
  std::vector<unsigned> gray(lit_.size(), 0);
  for (const auto& [bit, steps] : bits) {
    if (steps[0] < 0 || steps[1] < 0) return {};
    const Probes& shown = frames_.at(steps[0]).probes;
    const Probes& inverse = frames_.at(steps[1]).probes;
    for (size_t k = 0; k < lit_.size(); ++k) gray[k] = gray[k] << 1 | (shown[lit_[k]] > inverse[lit_[k]] ? 1U : 0U);
  }
  const int extent = axis == PatternAxis::kColumns ? plan_.options.projector_width : plan_.options.projector_height;
  std::vector<int> at;
  at.reserve(gray.size());
  for (const unsigned code : gray) {
    const int position = static_cast<int>(BinaryFromGray(code));
    at.push_back(position < extent ? position : -1);
  }
  return at;
}

const PatternWitness::Coordinates& PatternWitness::Where() {
  if (!decoded_) where_ = {Decode(PatternAxis::kColumns), Decode(PatternAxis::kRows)};
  decoded_ = true;
  return where_;
}

LevelsAt PatternWitness::LevelsOf(const PlanStep& step, std::vector<float>& level) {
  const Coordinates& at = Where();
  const bool columns = !at.column.empty(), rows = !at.row.empty();
  const bool known = step.pattern.kind == PatternKind::kCheckerboard ? columns && rows
                     : step.pattern.axis == PatternAxis::kColumns    ? columns
                                                                     : rows;
  level.clear();
  if (!known) return {};
  const Probes& frame = Find(step.index)->probes;
  for (int i : lit_)
    level.push_back(static_cast<float>(frame[i] - black_.probes[i]) /
                    static_cast<float>(white_.probes[i] - black_.probes[i]));
  return {level, at.column, at.row, plan_.options.projector_width, plan_.options.projector_height};
}

}  // namespace stratalux::rig
