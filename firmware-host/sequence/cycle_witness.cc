// SPDX-License-Identifier: Apache-2.0
// What must hold over all frames of a projector: whites as the reference, combs that add up to white probe by probe.
#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "firmware-host/sequence/pattern_witness.h"

namespace stratalux::rig {
namespace {

// Standard deviation of all frames' light over all probes' contrast. One black is taken off every frame: in dim light
// its noise, as many times over, is what the sum is uncertain by.
double NoiseOfSum(const CombCycle& cycle) {
  double variance = 0.0, contrast = 0.0;
  for (size_t i = 0; i < cycle.contrast.size(); ++i) {
    double of_probe = static_cast<double>(cycle.frames) * cycle.frames * cycle.black_variance[i];
    for (const std::vector<float>& frame : cycle.variance) of_probe += frame[i];
    variance += of_probe * cycle.contrast[i] * cycle.contrast[i];
    contrast += cycle.contrast[i];
  }
  return std::sqrt(variance) / contrast;
}

bool Has(const std::vector<Finding>& findings, FindingKind kind) {
  return std::any_of(findings.begin(), findings.end(), [kind](const Finding& f) { return f.kind == kind; });
}

}  // namespace

std::optional<Finding> PatternWitness::CheckWhite(const PlanStep& step) const {
  const Frame* white = Find(step.index);
  if (lit_.empty() || white == nullptr || step.phase != CapturePhase::kMotion) return std::nullopt;
  Finding finding{.kind = FindingKind::kLamp, .projector = projector_, .step = step.index};
  finding.value = MeanLevel(white->probes);
  finding.limit = options_.steady_tolerance;
  if (std::abs(finding.value - 1.0) > finding.limit) return finding;
  const Stillness stillness = StillnessOf(white->probes, white_.probes);
  finding.kind = FindingKind::kMoved;
  finding.value = stillness.rms;
  finding.limit = std::hypot(options_.moved_tolerance, stillness.noise);
  return finding.value > finding.limit ? std::optional(finding) : std::nullopt;
}

std::optional<Finding> PatternWitness::FindJump(const PlanStep& white, const Image<uint16_t>& white_pixels,
                                                const PlanStep& black, const Image<uint16_t>& black_pixels) const {
  // By a witness that knows of this projector what was known before its first frame.
  PatternWitness again = *this;
  again.StartProjector(projector_);
  again.Add(white, white_pixels, MeanDn(white_pixels));
  again.Add(black, black_pixels, MeanDn(black_pixels));
  if (again.Check(black) != LevelCheck::kPassed || lit_.empty()) return std::nullopt;
  const Probes& now = again.white_.probes;
  // A lamp that changed is none of the subject's doing.
  if (std::abs(MeanLevel(now) - 1.0) > options_.steady_tolerance || JudgeWhite(now) != Testimony::kRefutes)
    return std::nullopt;
  const Stillness stillness = StillnessOf(now, white_now_);
  Finding jump{.kind = FindingKind::kMoved, .projector = projector_};
  jump.value = stillness.rms;
  jump.limit = std::hypot(options_.moved_tolerance, stillness.noise);
  return jump;
}

void PatternWitness::CheckWhites(std::vector<Finding>& findings) const {
  std::vector<Finding> lamp;
  std::optional<Finding> moved;
  const std::vector<int> whites = StepsOf(CapturePhase::kMotion);
  for (int i : whites) {
    const std::optional<Finding> finding = CheckWhite(plan_.steps[i]);
    if (!finding) continue;
    if (finding->kind == FindingKind::kLamp) lamp.push_back(*finding);
    if (finding->kind == FindingKind::kMoved && !moved) moved = finding;
  }
  if (moved) findings.push_back(*moved);
  if (lamp.empty()) return;
  // A lamp that is itself again in the next white has blinked.
  if (lamp.size() == 1 && lamp[0].step != whites.back()) lamp[0].kind = FindingKind::kBlink;
  findings.push_back(lamp[0]);
}

std::vector<int> PatternWitness::StepsOfCycle(PatternAxis axis) const {
  const PlanOptions& o = plan_.options;
  std::vector<int> steps;
  std::set<int> shifts;  // of the nominal exposure, whichever bracket that is; the first of each
  for (int i : StepsOf(CapturePhase::kSweep)) {
    const PlanStep& step = plan_.steps[i];
    if (step.pattern.axis != axis || step.exposure_ms != o.exposure_ms || Find(i) == nullptr) continue;
    if (shifts.insert(step.pattern.shift).second) steps.push_back(i);
  }
  if (static_cast<int>(steps.size()) != o.comb_period / o.comb_step) return {};
  std::sort(steps.begin(), steps.end(),
            [this](int a, int b) { return plan_.steps[a].pattern.shift < plan_.steps[b].pattern.shift; });
  return steps;
}

PatternWitness::Black PatternWitness::MeanBlack() const {
  // A whole cycle takes the black off period / step times, so its noise counts.
  Black black{std::vector<double>(black_.probes.size()), 0};
  for (CapturePhase phase : {CapturePhase::kReference, CapturePhase::kGuard})
    for (int i : StepsOf(phase)) {
      if (plan_.steps[i].pattern.kind != PatternKind::kBlack || Find(i) == nullptr) continue;
      ++black.frames;
      for (size_t k = 0; k < black.dn.size(); ++k) black.dn[k] += (Find(i)->probes[k] - black.dn[k]) / black.frames;
    }
  return black;
}

CombCycle PatternWitness::CycleOf(PatternAxis axis, const std::vector<int>& steps) {
  const PlanOptions& o = plan_.options;
  const Coordinates& at = Where();
  const std::vector<int>& position = axis == PatternAxis::kColumns ? at.column : at.row;
  const Black black = MeanBlack();
  CombCycle cycle;
  cycle.pitch = lattice_.pitch();
  cycle.frames = static_cast<int>(steps.size());
  cycle.level.resize(steps.size());
  cycle.variance.resize(steps.size());
  for (size_t j = 0; j < lit_.size(); ++j) {
    const int i = lit_[j];
    const double contrast = std::max(1.0, white_.probes[i] - black.dn[i]);
    cycle.contrast.push_back(static_cast<float>(contrast));
    cycle.black_variance.push_back(
        static_cast<float>(VarianceDn(black.dn[i]) / std::max(1, black.frames) / (contrast * contrast)));
    cycle.x.push_back(i % lattice_.columns());
    cycle.y.push_back(i / lattice_.columns());
    cycle.position.push_back(position.empty() ? -1 : position[j]);
    // Line k covers the columns [k q, k q + w).
    const double line = (cycle.position.back() + 0.5 - 0.5 * o.comb_width) / o.comb_step;
    const int nearest = static_cast<int>(std::lround(line));
    cycle.passed_in.push_back(cycle.position.back() < 0 ? -1 : (nearest % cycle.frames + cycle.frames) % cycle.frames);
    for (size_t k = 0; k < steps.size(); ++k) {
      const double dn = Find(steps[k])->probes[i];
      cycle.level[k].push_back(static_cast<float>((dn - black.dn[i]) / contrast));
      cycle.variance[k].push_back(static_cast<float>(VarianceDn(dn) / (contrast * contrast)));
    }
  }
  return cycle;
}

void PatternWitness::CheckCycle(PatternAxis axis, std::vector<Finding>& findings) {
  const std::vector<int> steps = StepsOfCycle(axis);
  if (steps.empty()) return;
  const CombCycle cycle = CycleOf(axis, steps);
  double sum = 0.0, contrast = 0.0;
  for (size_t j = 0; j < lit_.size(); ++j) {
    contrast += cycle.contrast[j];
    for (const std::vector<float>& level : cycle.level) sum += static_cast<double>(cycle.contrast[j]) * level[j];
  }
  const double per_white = static_cast<double>(plan_.options.comb_step) / plan_.options.comb_width;
  const double whites = sum / contrast * per_white;
  auto found = [&](FindingKind kind, int frame, double value, double limit) {
    findings.push_back(
        {.kind = kind, .projector = projector_, .step = frame < 0 ? -1 : steps[frame], .value = value, .limit = limit});
  };
  const double steady = options_.steady_tolerance + 4.0 * per_white * NoiseOfSum(cycle);
  if (std::abs(whites - 1.0) > steady && !Has(findings, FindingKind::kLamp))
    found(FindingKind::kLamp, -1, whites, steady);
  const std::vector<double> gain = FrameGains(cycle);
  if (gain.empty()) return;
  // A comb in another's place lights other probes, so its light says nothing of the lamp.
  const auto missing = FindMissingComb(cycle);
  if (missing) found(FindingKind::kMixedUp, missing->frame, missing->sum, missing->limit);
  std::vector<bool> spoilt(gain.size());
  // A logical code leaves a coarse camera few probes of known position: the fewer, the more the light of a comb's few
  // scatters.
  double scatter = 1.0;
  if (BasePlane(plan_.options.ShownCode(), GrayBits(plan_.options.projector_width))) {
    const auto known = std::ranges::count_if(cycle.passed_in, [](int frame) { return frame >= 0; });
    scatter = std::sqrt(static_cast<double>(lit_.size()) / static_cast<double>(known));
  }
  for (const Blink& blink : FindBlinks(gain, scatter * options_.blink_tolerance)) {
    if (missing && missing->frame == blink.frame) continue;
    spoilt[blink.frame] = true;
    found(FindingKind::kBlink, blink.frame, blink.light, blink.limit);
  }
  if (missing) return;
  // Under a lamp that changed meanwhile, neighbours differ by when their line passed.
  if (Has(findings, FindingKind::kLamp)) return;
  const auto motion = FindMotion(cycle, spoilt, options_.motion);
  if (motion && motion->score > motion->limit)
    found(FindingKind::kMoved, motion->frame, motion->change,
          motion->change * std::sqrt(motion->limit / motion->score));
}

std::vector<Finding> PatternWitness::CheckProjector() {
  std::vector<Finding> findings;
  if (lit_.empty()) return findings;
  std::vector<float>& contrast = contrast_[projector_];
  contrast.assign(white_.probes.size(), std::numeric_limits<float>::quiet_NaN());
  for (size_t i = 0; i < contrast.size(); ++i)
    if (white_.probes[i] < options_.saturation_dn)
      contrast[i] = static_cast<float>(white_.probes[i]) - static_cast<float>(black_.probes[i]);
  CheckWhites(findings);
  for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) CheckCycle(axis, findings);
  std::stable_sort(findings.begin(), findings.end(),
                   [](const Finding& a, const Finding& b) { return a.step < b.step; });
  // One finding of a kind is enough for people; the first tells when it began.
  std::vector<Finding> first;
  for (const Finding& f : findings)
    if (!Has(first, f.kind)) first.push_back(f);
  return first;
}

}  // namespace stratalux::rig
