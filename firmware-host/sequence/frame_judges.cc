// SPDX-License-Identifier: Apache-2.0
// What a single group of frames says of its pattern.
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <ranges>

#include "firmware-host/sequence/pattern_witness.h"

namespace stratalux::rig {
namespace {

constexpr int kFewestInBand = 40;  // lit probes; of fewer, no share is taken
constexpr int kFewestMet = 3;      // of them, by the spots
constexpr double kSigmas = 4.0;    // of noise, that a single limit leaves room for

using PerBand = std::array<int, ProbeLattice::kBands>;

// Whether more than `share` of the probes are off in some band; bands of few probes are taken with the next ones, from
// the top and from the bottom.
bool AnyBandOff(const PerBand& off, const PerBand& all, double share) {
  const auto any_from = [&](const auto& order) {
    int off_here = 0, all_here = 0;
    for (const int band : order) {
      off_here += off[band];
      all_here += all[band];
      if (all_here < kFewestInBand) continue;
      if (off_here > share * all_here) return true;
      off_here = all_here = 0;
    }
    return false;
  };
  const auto down = std::views::iota(0, ProbeLattice::kBands);
  return any_from(down) || any_from(down | std::views::reverse);
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

// Of probe i, projector px from the nearest line of a comb or disc of spots; 0: on it; -1: not known.
double DistanceToLight(const Pattern& pattern, const LevelsAt& frame, size_t i) {
  const int period = pattern.period;
  if (pattern.kind == PatternKind::kSpots) {
    if (frame.column[i] < 0 || frame.row[i] < 0) return -1.0;
    const int dx = frame.column[i] % period - period / 2, dy = frame.row[i] % period - period / 2;
    return std::max(0.0, std::hypot(dx, dy) - pattern.width);
  }
  const int at = pattern.axis == PatternAxis::kColumns ? frame.column[i] : frame.row[i];
  if (at < 0) return -1.0;
  const int distance = ((at - pattern.shift) % period + period) % period;
  return distance < pattern.width ? 0 : std::min(distance - pattern.width + 1, period - distance);
}

}  // namespace

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
  white_now_ = white_.probes;
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
    good = excess <= (options_.dark_tolerance + kSigmas * MeanLevelSd()) * contrast;
  }
  if (good && !preroll_white_.empty()) {
    PerBand off{}, all{};
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
  PerBand off{}, all{};
  for (size_t i = 0; i < frame.size(); ++i) {
    const double white = white_now_[i], black = black_.probes[i], level = frame[i];
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
  PerBand off{}, all{};
  for (int i : lit_) {
    double sum = 0.0;
    for (const Probes* frame : frames) sum += (*frame)[i];
    const double white = white_now_[i], black = black_.probes[i];
    const double variance = (1.0 + scale) * (VarianceDn(white) + VarianceDn(black));
    const int band = lattice_.BandOf(i);
    ++all[band];
    if (std::abs(scale * sum - 2.0 * (mean * white + (1.0 - mean) * black)) >
        options_.sum_tolerance * (white - black) + 4.0 * std::sqrt(variance))
      ++off[band];
  }
  if (AnyBandOff(off, all, options_.max_off_fraction)) return false;
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
    const double white = white_now_[i], black = black_.probes[i];
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

bool PatternWitness::OneIsDimmer(std::span<const int> shifts) {
  // Each shift gives the lit probes the same light, where they stand over several periods: the sum of all hides a lamp
  // that blinked in one of few.
  const Pattern& pattern = plan_.steps[shifts[0]].pattern;
  if (ExtentOf(pattern.axis) < 6 * pattern.period || shifts.size() < 3) return false;
  std::vector<double> expected;  // a narrow subject has more of one shift than of another
  for (int step : shifts) expected.push_back(ExpectedLevel(plan_.steps[step].pattern).level);
  const auto [least, most] = std::minmax_element(expected.begin(), expected.end());
  if (*most > (1.0 + options_.steady_tolerance) * *least) return false;
  double all = 0.0;
  for (int step : shifts) all += MeanLevel(frames_.at(step).probes);
  for (int step : shifts) {
    const double level = MeanLevel(frames_.at(step).probes);
    const double others = (all - level) / static_cast<double>(shifts.size() - 1);
    if (std::abs(level - others) > 2.0 * options_.steady_tolerance * others) return true;
  }
  return false;
}

PatternWitness::Testimony PatternWitness::JudgeShifts(const PlanStep& step, std::span<const int> group) {
  const bool whole =
      step.pattern.kind == PatternKind::kSinusoid && static_cast<int>(group.size()) == step.pattern.shifts;
  if (whole && (!AddsUp(group, SinusoidMean(step.projector)) || OneIsDimmer(group))) return Testimony::kRefutes;
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
  const double room = kSigmas * MeanLevelSd() * plan_.options.exposure_ms / step.exposure_ms;
  if (mean > 3.0 * share + 2.0 * options_.dark_tolerance + black + room) return Testimony::kRefutes;
  if (mean < std::max(0.05 * share, 0.25 * share - room) - black) return Testimony::kRefutes;
  if (!BrightAsTheExposure(step) || LightElsewhere(step, frame)) return Testimony::kRefutes;
  const double evidence = EvidenceOf(step, frame);
  if (evidence < -options_.min_evidence || OtherShiftInABand(step, frame, Bands::kOfRows)) return Testimony::kRefutes;
  return evidence < options_.min_evidence ? Testimony::kSilent : Testimony::kConfirms;
}

double PatternWitness::EvidenceOf(const PlanStep& step, const LevelsAt& frame) const {
  if (step.pattern.kind == PatternKind::kComb) return CombEvidence(step.pattern, plan_.options.comb_step, frame);
  return ShiftEvidence(step.pattern, frame);
}

bool PatternWitness::OtherShiftInABand(const PlanStep& step, const LevelsAt& frame, Bands of) const {
  struct Part {
    std::vector<float> level;
    std::vector<int> column, row;
  };
  std::array<Part, ProbeLattice::kBands> bands;
  for (size_t i = 0; i < frame.level.size(); ++i) {
    const int column = lit_[i] % lattice_.columns();
    Part& part =
        bands[of == Bands::kOfRows ? lattice_.BandOf(lit_[i]) : column * ProbeLattice::kBands / lattice_.columns()];
    part.level.push_back(frame.level[i]);
    if (!frame.column.empty()) part.column.push_back(frame.column[i]);
    if (!frame.row.empty()) part.row.push_back(frame.row[i]);
  }
  return std::any_of(bands.begin(), bands.end(), [&](const Part& part) {
    const LevelsAt here{part.level, part.column, part.row, frame.width, frame.height};
    return EvidenceOf(step, here) < -options_.min_evidence;
  });
}

bool PatternWitness::LightElsewhere(const PlanStep& step, const LevelsAt& frame) const {
  // In some band, probes far from the lines or spots that are as bright as those on them.
  const Pattern& pattern = step.pattern;
  double on = 0.0;
  int lit = 0;
  std::vector<double> beyond(frame.level.size());
  for (size_t i = 0; i < frame.level.size(); ++i) {
    beyond[i] = DistanceToLight(pattern, frame, i);
    if (beyond[i] != 0.0) continue;
    on += frame.level[i];
    ++lit;
  }
  if (lit == 0) return false;
  const double bright = 0.6 * on / lit;
  PerBand off{}, all{};
  for (size_t i = 0; i < frame.level.size(); ++i) {
    const int band = lattice_.BandOf(lit_[i]);
    ++all[band];
    if (frame.level[i] <= bright || beyond[i] <= 2 * pattern.width) continue;
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

PatternWitness::Stillness PatternWitness::StillnessOf(const Probes& white, const Probes& of) const {
  const double mean = MeanLevel(white);
  double rest = 0.0, contrast = 0.0, squares = 0.0;
  for (int i : lit_) {
    const double reference = mean * (of[i] - black_.probes[i]);
    const double difference = white[i] - black_.probes[i] - reference;
    const double noise = VarianceDn(white[i]) + mean * mean * VarianceDn(of[i]) +
                         (1.0 - mean) * (1.0 - mean) * VarianceDn(black_.probes[i]);
    rest += difference * difference - noise;
    squares += 2.0 * noise * noise;  // of a normal deviation's square
    contrast += reference * reference;
  }
  if (contrast <= 0.0) return {};
  return {std::sqrt(std::max(0.0, rest) / contrast), std::sqrt(4.0 * std::sqrt(squares) / contrast)};
}

PatternWitness::Testimony PatternWitness::JudgeWhite(const Probes& white) const {
  const double mean = MeanLevel(white);
  if (std::abs(mean - 1.0) > options_.steady_tolerance) return Testimony::kRefutes;
  PerBand off{}, all{};
  for (int i : lit_) {
    const double reference = mean * (white_now_[i] - black_.probes[i]);
    const double limit = options_.sum_tolerance * reference + 4.0 * std::sqrt(2.0 * VarianceDn(white_now_[i]));
    const int band = lattice_.BandOf(i);
    ++all[band];
    off[band] += std::abs(white[i] - black_.probes[i] - reference) > limit;
  }
  return AnyBandOff(off, all, options_.max_off_fraction) ? Testimony::kRefutes : Testimony::kConfirms;
}

bool PatternWitness::FailsAsBefore(const PlanStep& step) const {
  const std::vector<int> group = GroupOf(plan_, step.index);
  return std::ranges::all_of(group, [&](int member) {
    const Frame* frame = Find(member);
    if (frame == nullptr || frame->earlier.empty()) return false;
    PerBand off{}, all{};
    for (int i : lit_) {
      const double now = frame->probes[i], before = frame->earlier[i];
      const double limit = options_.sum_tolerance * (white_now_[i] - black_.probes[i]) +
                           4.0 * std::sqrt(VarianceDn(now) + VarianceDn(before));
      const int band = lattice_.BandOf(i);
      ++all[band];
      off[band] += std::abs(now - before) > limit;
    }
    return !AnyBandOff(off, all, options_.max_off_fraction);
  });
}

double PatternWitness::SinusoidMean(int projector) const {
  const auto& means = options_.sinusoid_mean;
  return projector < static_cast<int>(means.size()) ? means[projector] : 0.5;
}

void PatternWitness::Follow(const PlanStep& step, std::span<const int> group) {
  const Pattern& pattern = step.pattern;
  const bool pair = step.phase == CapturePhase::kCorrespondence && group.size() == 2;
  const bool sinusoids = step.phase == CapturePhase::kSeparation && pattern.kind == PatternKind::kSinusoid &&
                         static_cast<int>(group.size()) == pattern.shifts;
  if (step.phase == CapturePhase::kMotion) white_now_ = Find(step.index)->probes;
  if (!pair && !sinusoids) return;
  // sum / N = mean W + (1 - mean) B.
  const double mean = pair ? 0.5 : SinusoidMean(step.projector);
  for (size_t i = 0; i < white_now_.size(); ++i) {
    double sum = 0.0;
    for (const int member : group) sum += frames_.at(member).probes[i];
    const double white = (sum / static_cast<double>(group.size()) - (1.0 - mean) * black_.probes[i]) / mean;
    white_now_[i] = static_cast<Probes::value_type>(std::clamp(std::round(white), 0.0, 65535.0));
  }
}

double PatternWitness::MeanLevelSd() const {
  double variance = 0.0, contrast = 0.0;
  for (int i : lit_) {
    variance += 2.0 * VarianceDn(black_.probes[i]);
    contrast += white_.probes[i] - black_.probes[i];
  }
  return std::sqrt(variance) / std::max(1e-9, contrast);
}

double PatternWitness::WholeLevel(const Frame& frame) const {
  return (frame.mean_dn - black_.mean_dn) / std::max(1e-9, white_.mean_dn - black_.mean_dn);
}

double PatternWitness::WholeLevelSd() const {
  return std::sqrt(2.0 * VarianceDn(black_.mean_dn) / static_cast<double>(black_.pixels)) /
         std::max(1e-9, white_.mean_dn - black_.mean_dn);
}

PatternWitness::Expected PatternWitness::ExpectedLevel(const Pattern& pattern) {
  const Coordinates& at = Where();
  if (!at.Tell(pattern))
    return {MeanIntensity(pattern, plan_.options.projector_width, plan_.options.projector_height),
            static_cast<int>(lit_.size())};
  double sum = 0.0, white = 0.0;
  Expected expected;
  for (size_t k = 0; k < lit_.size(); ++k) {
    const int column = at.column.empty() ? 0 : at.column[k], row = at.row.empty() ? 0 : at.row[k];
    if (column < 0 || row < 0) continue;
    const double contrast = white_.probes[lit_[k]] - black_.probes[lit_[k]];
    const double intensity = pattern.Intensity(column, row);
    sum += contrast * intensity;
    white += contrast;
    expected.bright += intensity > 0.5;
  }
  expected.level = sum / std::max(1e-9, white);
  return expected;
}

std::optional<PatternWitness::SpotPatterns> PatternWitness::SpotsOf(const CapturePlan& plan) {
  const auto step =
      std::ranges::find(plan.steps, PatternKind::kSpots, [](const PlanStep& s) { return s.pattern.kind; });
  if (step == plan.steps.end()) return {};
  SpotPatterns of{.spots = step->pattern, .wide = step->pattern};
  of.wide.width = std::min(4 * of.spots.width, of.spots.period / 2);
  const int width = plan.options.projector_width, height = plan.options.projector_height;
  of.share = MeanIntensity(of.spots, width, height);
  of.wide_share = MeanIntensity(of.wide, width, height);
  return of;
}

PatternWitness::Spots PatternWitness::ExpectedSpots() {
  if (!spots_) return {};
  const Expected met = ExpectedLevel(spots_->spots);
  if (met.bright >= kFewestInBand) return {met.level, true};
  // By the wider discs, and the share of these that is lit; but some spots must be met.
  const Expected around = ExpectedLevel(spots_->wide);
  if (met.bright < kFewestMet || around.bright < kFewestInBand) return {spots_->share, false};
  return {around.level * spots_->share / spots_->wide_share, true};
}

double PatternWitness::DarkLimit() const {
  const PlanOptions& o = plan_.options;
  const double lines = static_cast<double>(o.comb_width) / o.comb_period;
  return std::max(options_.dark_tolerance, std::min(options_.dark_tolerance + kSigmas * MeanLevelSd(), 0.8 * lines));
}

PatternWitness::Testimony PatternWitness::JudgeLevel(const PlanStep& step) {
  // Spots light so little of the picture that only the mean of all pixels tells them from black, and in faint light not
  // even that.
  const auto [spots, met] = ExpectedSpots();
  const double room = kSigmas * WholeLevelSd();
  spots_show_ = met && 0.3 * spots >= room;
  const Frame& frame = *Find(step.index);
  const double level = WholeLevel(frame);
  if (step.pattern.kind == PatternKind::kSpots) {
    // Beside them in the memory stand white, black, sinusoids and, in some plans, combs: halfway to these, in ratios,
    // of the whole picture's light.
    const PlanOptions& o = plan_.options;
    const double comb = static_cast<double>(o.comb_width) / o.comb_period;
    double highest = 0.25 + 0.5 * spots;
    if (comb >= 4.0 * spots_->share) highest = std::min(highest, std::sqrt(spots_->share * comb));
    if (level >= highest + (spots_show_ ? 0.0 : room)) return Testimony::kRefutes;
    if (spots_show_ && level <= 0.3 * spots) return Testimony::kRefutes;
    std::vector<float> levels;  // rows of another picture can have the mean of spots
    const LevelsAt at = LevelsOf(step, levels);
    if (LightElsewhere(step, at)) return Testimony::kRefutes;
    return spots_show_ ? Testimony::kConfirms : Testimony::kSilent;
  }
  if (std::abs(MeanLevel(frame.probes)) > DarkLimit()) return Testimony::kRefutes;
  if (spots == 0.0) return Testimony::kConfirms;
  if (level >= (spots_show_ ? 0.3 * spots : spots + room)) return Testimony::kRefutes;
  return spots_show_ ? Testimony::kConfirms : Testimony::kSilent;
}

}  // namespace stratalux::rig
