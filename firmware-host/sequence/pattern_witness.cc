// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/pattern_witness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "shared/pattern/micro_phase.h"

namespace stratalux::rig {
namespace {

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

// What only the light of the whole picture tells from each other (JudgeLevel).
bool IsSpotOrBlack(const PlanStep& step) {
  return step.phase == CapturePhase::kSpot || step.phase == CapturePhase::kGuard ||
         (step.phase == CapturePhase::kRepeat && step.pattern.kind != PatternKind::kComb);
}

}  // namespace

PatternWitness::PatternWitness(const CapturePlan& plan, WitnessOptions options)
    : plan_(plan), options_(std::move(options)), spots_(SpotsOf(plan)) {}

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
  contradicted_.clear();
  lit_.clear();
  decoded_ = false;
  spots_show_ = true;
}

std::vector<int> PatternWitness::GroupOf(const CapturePlan& plan, int step) {
  std::vector<int> group;
  int first = step;
  while (first > 0 && SameFamily(plan.steps[first - 1], plan.steps[step])) --first;
  for (int i = first; i < static_cast<int>(plan.steps.size()) && SameFamily(plan.steps[i], plan.steps[step]); ++i)
    group.push_back(i);
  return group;
}

std::vector<int> PatternWitness::OneLoadOf(const CapturePlan& plan, int step) {
  if (plan.steps[step].phase != CapturePhase::kCorrespondence) return {step};
  return GroupOf(plan, step);
}

void PatternWitness::Add(const PlanStep& step, const Image<uint16_t>& pixels, double mean_dn) {
  if (lattice_.size() == 0) lattice_ = ProbeLattice(pixels.width(), pixels.height());
  Frame& frame = frames_[step.index];
  Probes earlier = std::move(frame.probes);
  frame = {lattice_.Sample(pixels), mean_dn, pixels.size(), load_, shots_++, std::move(earlier), Testimony::kSilent};
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
  for (int member : group) {
    frames_.at(member).testimony = testimony;
    if (testimony == Testimony::kRefutes) contradicted_.insert(frames_.at(member).load);
  }
  if (step.phase == CapturePhase::kCorrespondence && step.bracket == 0 && testimony != Testimony::kRefutes &&
      JudgeOrder(step.pattern.axis, group) == Testimony::kRefutes)
    testimony = Testimony::kRefutes;
  if (testimony != Testimony::kRefutes && CanSpeak(step)) Follow(step, group);
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

struct PatternWitness::Waves {
  struct AtProbe {
    std::vector<double> difference, weight;  // by plane
  };
  MicroPhaseSearch search;
  std::vector<AtProbe> probes;  // of lit_, every so many
};

PatternWitness::Testimony PatternWitness::JudgeOrder(PatternAxis axis, std::span<const int> group) {
  const std::optional<std::vector<int>> wrong =
      IsOfStripes(plan_.options.ShownCode()) ? ExchangedStripes(axis) : OtherWaves(axis);
  if (!wrong) return Testimony::kSilent;
  if (wrong->empty()) return Testimony::kConfirms;
  Testimony judged = Testimony::kSilent;
  for (int i : StepsOf(CapturePhase::kCorrespondence)) {
    const Pattern& p = plan_.steps[i].pattern;
    if (p.kind != PatternKind::kGray || p.axis != axis || std::ranges::find(*wrong, p.bit) == wrong->end()) continue;
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

std::optional<std::vector<int>> PatternWitness::ExchangedStripes(PatternAxis axis) const {
  const std::vector<int> at = Decode(axis);
  if (at.empty()) return std::nullopt;
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
  if (static_cast<int>(pairs.size()) < options_.min_lit_probes) return std::nullopt;
  const int bits = GrayBits(ExtentOf(axis));
  const ColumnCode code = plan_.options.ShownCode();
  // Of the picture as it is with some planes of the code exchanged.
  auto roughness = [&](unsigned exchanged) {
    std::vector<int> place(size_t{1} << bits);
    for (unsigned column = 0; column < place.size(); ++column)
      place[column] = static_cast<int>(ColumnOf(code, WordOf(code, column, bits) ^ exchanged, bits));
    int64_t sum = 0;
    for (const auto& [a, b] : pairs) sum += std::abs(place[a] - place[b]);
    return sum;
  };
  // The plane whose exchange makes the picture the smoothest, if by so much.
  int64_t least = roughness(0) * 6 / 10;
  std::vector<int> exchanged;
  for (int significance = 0; significance < bits; ++significance)
    if (const int64_t rough = roughness(1U << significance); rough <= least) {
      least = rough;
      exchanged = {bits - 1 - significance};
    }
  return exchanged;
}

std::optional<std::vector<int>> PatternWitness::OtherWaves(PatternAxis axis) const {
  constexpr size_t kEnough = 400;      // probes: whichever they are, all of a wrong plane disagree
  constexpr double kConsistent = 3.0;  // chi^2 a degree of freedom of planes that agree: the lamp's few per cent
  const PairsOfBits bits = PairsOf(axis);
  if (static_cast<int>(lit_.size()) < options_.min_lit_probes || bits.size() < 4) return std::nullopt;
  const Waves waves = WavesOf(axis, bits, 1 + lit_.size() / kEnough);
  // What all planes but these leave, a degree of freedom.
  const auto rest = [&](const std::vector<int>& without) {
    double sum = 0.0;
    for (Waves::AtProbe at : waves.probes) {
      for (const int plane : without) at.weight[static_cast<size_t>(plane)] = 0.0;
      sum += waves.search.Find(at.difference, at.weight).chi2;
    }
    const double freedom = static_cast<double>(bits.size()) - 2.0 - static_cast<double>(without.size());
    return sum / (freedom * static_cast<double>(waves.probes.size()));
  };
  const double all = rest({});
  if (all < kConsistent) return std::vector<int>{};
  double least = all;
  std::vector<int> other;
  const auto suspect = [&](const std::vector<int>& without, double most) {
    const double left = rest(without);
    if (left > most) return;
    least = left;
    other = without;
  };
  const int planes = static_cast<int>(bits.size());
  for (int plane = 0; plane < planes; ++plane) suspect({plane}, std::min(least, 0.6 * all));
  // Both of a period, which no other plane is of, where one of them is not enough.
  const double one = 0.6 * least;
  for (int plane = 0; plane + 1 < planes && planes > 4; plane += 2) suspect({plane, plane + 1}, std::min(least, one));
  return other;
}

bool PatternWitness::ReferenceStandsAlone() const {
  return std::none_of(frames_.begin(), frames_.end(), [&](const auto& entry) {
    return plan_.steps[entry.first].phase != CapturePhase::kReference && entry.second.testimony == Testimony::kConfirms;
  });
}

void PatternWitness::DoubtUnspokenFor() {
  std::map<int64_t, int> by_shot;  // shot -> step
  for (const auto& [step, frame] : frames_) by_shot[frame.shot] = step;
  int spoken_for = load_;  // of this load, all earlier frames
  for (auto it = by_shot.rbegin(); it != by_shot.rend(); ++it) {
    const Frame& frame = frames_.at(it->second);
    if (frame.testimony == Testimony::kConfirms) spoken_for = frame.load;
    const bool unspoken_for = frame.testimony == Testimony::kSilent && frame.load != spoken_for;
    const PlanStep& step = plan_.steps[it->second];
    const bool contradicted = IsSpotOrBlack(step) && contradicted_.contains(frame.load);
    if (unspoken_for && (IsSpokenFor(step) || contradicted)) doubtful_.push_back(it->second);
  }
}

std::vector<int> PatternWitness::TakeDoubtful() {
  DoubtUnspokenFor();
  std::vector<int> steps;
  for (int step : doubtful_)
    for (int member : GroupOf(plan_, step)) steps.push_back(member);
  doubtful_.clear();
  std::sort(steps.begin(), steps.end());
  steps.erase(std::unique(steps.begin(), steps.end()), steps.end());
  return steps;
}

bool PatternWitness::AgreesWithOthers(PatternAxis axis) {
  bool agrees = false;
  std::vector<float> level;
  for (const auto& [index, shot] : frames_) {
    const PlanStep& step = plan_.steps[index];
    const bool sinusoid = step.phase == CapturePhase::kSeparation && step.pattern.kind == PatternKind::kSinusoid;
    if (step.pattern.axis != axis || !(sinusoid || step.phase == CapturePhase::kSweep)) continue;
    if (shot.testimony == Testimony::kRefutes) continue;
    const LevelsAt frame = LevelsOf(step, level);
    agrees = agrees || EvidenceOf(step, frame) >= options_.min_evidence;
    if (OtherShiftInABand(step, frame, Bands::kOfRows) || OtherShiftInABand(step, frame, Bands::kOfColumns))
      return false;
  }
  return agrees;
}

std::vector<int> PatternWitness::UnborneCodes(const std::set<int>& unproven) {
  if (lit_.empty()) return {};
  std::map<int, int64_t> last_word;  // load -> its last shot that confirms what is no code
  for (const auto& [step, frame] : frames_)
    if (plan_.steps[step].phase != CapturePhase::kCorrespondence && frame.testimony == Testimony::kConfirms) {
      int64_t& last = last_word[frame.load];
      last = std::max(last, frame.shot);
    }
  std::vector<int> unborne;
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    std::vector<int> code;
    for (const int step : StepsOf(CapturePhase::kCorrespondence))
      if (plan_.steps[step].pattern.axis == axis) code.push_back(step);
    const bool whole = std::none_of(code.begin(), code.end(), [&](int step) { return unproven.contains(step); });
    if (whole && AgreesWithOthers(axis)) continue;
    for (const int step : code) {
      const Frame* frame = Find(step);
      if (frame == nullptr) continue;
      const auto word = last_word.find(frame->load);
      if (word == last_word.end() || word->second < frame->shot) unborne.push_back(step);
    }
  }
  return unborne;
}

bool PatternWitness::CanSpeak(const PlanStep& step) const {
  // Brackets of other phases than the sweep have no white of their exposure to be held against.
  if (step.bracket > 0 && step.phase != CapturePhase::kSweep) return false;
  if (step.phase == CapturePhase::kPreroll || step.phase == CapturePhase::kRadiometry) return false;
  return step.phase == CapturePhase::kReference || !lit_.empty();
}

bool PatternWitness::IsSpokenFor(const PlanStep& step) const {
  if (!spots_show_ && IsSpotOrBlack(step)) return false;
  return step.phase != CapturePhase::kPreroll && step.phase != CapturePhase::kRadiometry && !lit_.empty();
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
      return JudgeWhite(Find(step.index)->probes);
    case CapturePhase::kSpot:
    case CapturePhase::kGuard:
      return JudgeLevel(step);
    case CapturePhase::kRepeat:
      return step.pattern.kind == PatternKind::kComb ? JudgeComb(step) : JudgeLevel(step);
    default:
      return Testimony::kSilent;
  }
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

PatternWitness::PairsOfBits PatternWitness::PairsOf(PatternAxis axis) const {
  PairsOfBits bits;
  int bit_count = 0;
  for (int i : StepsOf(CapturePhase::kCorrespondence)) {
    const Pattern& p = plan_.steps[i].pattern;
    if (p.kind != PatternKind::kGray || p.axis != axis || Find(i) == nullptr) continue;
    // One wrong bit mirrors or moves every coordinate, so a code that did not pass judges nothing.
    if (Find(i)->testimony == Testimony::kRefutes) return {};
    bits.try_emplace(p.bit, std::array{-1, -1}).first->second[p.inverse ? 1 : 0] = i;
    bit_count = p.bits;
  }
  const bool whole = std::ranges::all_of(bits, [](const auto& b) { return b.second[0] >= 0 && b.second[1] >= 0; });
  return whole && static_cast<int>(bits.size()) == bit_count ? bits : PairsOfBits{};
}

std::vector<int> PatternWitness::Decode(PatternAxis axis) const {
  const PairsOfBits bits = PairsOf(axis);
  if (bits.empty()) return {};
  const int bit_count = static_cast<int>(bits.size());
  const ColumnCode code = plan_.options.ShownCode();
  if (!IsOfStripes(code)) return DecodeWaves(axis, bits);
  std::vector<unsigned> words(lit_.size(), 0);
  for (const auto& [bit, steps] : bits) {
    const Probes& shown = frames_.at(steps[0]).probes;
    const Probes& inverse = frames_.at(steps[1]).probes;
    for (size_t k = 0; k < lit_.size(); ++k) words[k] = words[k] << 1 | (shown[lit_[k]] > inverse[lit_[k]] ? 1U : 0U);
  }
  const int extent = ExtentOf(axis);
  const std::optional<int> base = BasePlane(code, bit_count);
  std::vector<int> at;
  at.reserve(words.size());
  for (size_t k = 0; k < words.size(); ++k) {
    const int position = static_cast<int>(ColumnOf(code, words[k], bit_count));
    const bool known = !base || IsPlain(bits.at(*base), lit_[k]);  // else all coarser planes are read wrong at once
    at.push_back(known && position < extent ? position : -1);
  }
  if (base) ForgetStrays(at);
  return at;
}

PatternWitness::Waves PatternWitness::WavesOf(PatternAxis axis, const PairsOfBits& bits, size_t every) const {
  constexpr double kUnlikeness = 0.015;  // of W - B, that a pair's difference errs by beside its noise: the fitter's
  Waves waves{{ExtentOf(axis), static_cast<int>(bits.size()), plan_.options.separation_period}, {}};
  std::vector<double> squares(bits.size());
  for (size_t k = 0; k < lit_.size(); k += every) {
    const int i = lit_[k];
    Waves::AtProbe& at = waves.probes.emplace_back();
    const double unlike = kUnlikeness * (double(white_.probes[i]) - black_.probes[i]);
    for (const auto& [bit, steps] : bits) {
      const double shown = frames_.at(steps[0]).probes[i], inverse = frames_.at(steps[1]).probes[i];
      const double noise = VarianceDn(shown) + VarianceDn(inverse);
      at.difference.push_back(shown - inverse);
      at.weight.push_back(1.0 / (noise + unlike * unlike));
      squares[static_cast<size_t>(bit)] += (shown - inverse) * (shown - inverse) - noise;
    }
  }
  waves.search.LearnContrast(squares);
  return waves;
}

std::vector<int> PatternWitness::DecodeWaves(PatternAxis axis, const PairsOfBits& bits) const {
  constexpr double kMostAstray = 0.01;
  const Waves waves = WavesOf(axis, bits, 1);
  std::vector<int> at;
  at.reserve(waves.probes.size());
  for (const Waves::AtProbe& probe : waves.probes) {
    const MicroPhaseSearch::Found found = waves.search.Find(probe.difference, probe.weight);
    const auto position = std::lround(found.column);
    const bool known = found.astray < kMostAstray && position >= 0 && position < ExtentOf(axis);
    at.push_back(known ? static_cast<int>(position) : -1);
  }
  ForgetStrays(at);
  return at;
}

void PatternWitness::ForgetStrays(std::vector<int>& at) const {
  std::vector<int> index(lattice_.size(), -1);
  for (size_t k = 0; k < lit_.size(); ++k) index[lit_[k]] = at[k] < 0 ? -1 : static_cast<int>(k);
  const int columns = lattice_.columns();
  // How far the known probes around it lie from a probe's position.
  auto distances = [&](size_t k) {
    std::vector<int> found;
    const int x = lit_[k] % columns;
    for (const int dy : {-1, 0, 1})
      for (const int dx : {-1, 0, 1}) {
        const int beside = lit_[k] + dy * columns + dx;
        if ((dx == 0 && dy == 0) || x + dx < 0 || x + dx >= columns) continue;
        if (beside < 0 || beside >= static_cast<int>(index.size()) || index[beside] < 0) continue;
        found.push_back(std::abs(at[index[beside]] - at[k]));
      }
    return found;
  };
  std::vector<std::vector<int>> around(at.size());
  std::vector<int> all;
  for (size_t k = 0; k < at.size(); ++k) {
    if (at[k] < 0) continue;
    around[k] = distances(k);
    all.insert(all.end(), around[k].begin(), around[k].end());
  }
  if (all.empty()) return;
  std::nth_element(all.begin(), all.begin() + static_cast<int64_t>(all.size() / 2), all.end());
  const int near = 4 * all[all.size() / 2] + 4;  // what lies so near is one surface
  for (size_t k = 0; k < at.size(); ++k) {
    const auto together = std::ranges::count_if(around[k], [&](int distance) { return distance <= near; });
    if (2 * together < static_cast<int64_t>(around[k].size())) at[k] = -1;
  }
}

bool PatternWitness::IsPlain(std::span<const int> pair, int probe) const {
  constexpr double kLeastContrast = 0.06;  // of W - B, as for the fitter
  const double bit = frames_.at(pair[0]).probes[probe], inverse = frames_.at(pair[1]).probes[probe];
  const double least = kLeastContrast * (double(white_.probes[probe]) - black_.probes[probe]);
  return std::abs(bit - inverse) > std::hypot(least, 4.0 * std::sqrt(VarianceDn(bit) + VarianceDn(inverse)));
}

const PatternWitness::Coordinates& PatternWitness::Where() {
  if (!decoded_) where_ = {Decode(PatternAxis::kColumns), Decode(PatternAxis::kRows)};
  decoded_ = true;
  return where_;
}

bool PatternWitness::Coordinates::Tell(const Pattern& pattern) const {
  if (!pattern.IsOneDimensional()) return !column.empty() && !row.empty();
  return pattern.axis == PatternAxis::kColumns ? !column.empty() : !row.empty();
}

LevelsAt PatternWitness::LevelsOf(const PlanStep& step, std::vector<float>& level) {
  const Coordinates& at = Where();
  level.clear();
  if (!at.Tell(step.pattern)) return {};
  const Probes& frame = Find(step.index)->probes;
  for (int i : lit_)
    level.push_back(static_cast<float>(frame[i] - black_.probes[i]) /
                    static_cast<float>(white_.probes[i] - black_.probes[i]));
  return {level, at.column, at.row, plan_.options.projector_width, plan_.options.projector_height};
}

}  // namespace stratalux::rig
