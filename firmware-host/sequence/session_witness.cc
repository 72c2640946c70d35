// SPDX-License-Identifier: Apache-2.0
// What must add up over all frames of a projector, and over all projectors.
#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "firmware-host/sequence/pattern_witness.h"

namespace stratalux::rig {

std::vector<Finding> PatternWitness::CheckProjector() {
  std::vector<Finding> findings;
  if (lit_.empty()) return findings;
  std::vector<float>& contrast = contrast_[projector_];
  contrast.assign(white_.probes.size(), std::numeric_limits<float>::quiet_NaN());
  for (size_t i = 0; i < contrast.size(); ++i)
    if (white_.probes[i] < options_.saturation_dn)
      contrast[i] = static_cast<float>(white_.probes[i]) - static_cast<float>(black_.probes[i]);
  for (int i : StepsOf(CapturePhase::kMotion)) {
    const Frame* white = Find(i);
    if (white == nullptr || white->testimony != Testimony::kRefutes) continue;
    const double mean = MeanLevel(white->probes);
    if (std::abs(mean - 1.0) > options_.steady_tolerance)
      findings.push_back({FindingKind::kLamp, projector_, i, mean, options_.steady_tolerance});
    else
      findings.push_back({FindingKind::kMoved, projector_, i, StillnessOf(white->probes), options_.still_tolerance});
    break;
  }
  // The mean black over reference and guards: a whole cycle takes it off period / step times.
  double black = 0.0;
  int blacks = 0;
  for (CapturePhase phase : {CapturePhase::kReference, CapturePhase::kGuard})
    for (int i : StepsOf(phase))
      if (plan_.steps[i].pattern.kind == PatternKind::kBlack && Find(i) != nullptr) {
        black += MeanLevel(Find(i)->probes);
        ++blacks;
      }
  if (blacks > 0) black /= blacks;
  const PlanOptions& o = plan_.options;
  for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    double sum = 0.0;
    int count = 0;
    for (int i : StepsOf(CapturePhase::kSweep)) {
      const PlanStep& step = plan_.steps[i];
      if (step.pattern.axis != axis || step.bracket != 0 || step.exposure_ms != o.exposure_ms) continue;
      if (Find(i) == nullptr) continue;
      sum += MeanLevel(Find(i)->probes) - black;
      ++count;
    }
    if (count == 0 || count != o.comb_period / o.comb_step) continue;
    const double whites = sum * o.comb_step / o.comb_width / (1.0 - black);
    if (std::abs(whites - 1.0) > options_.steady_tolerance)
      findings.push_back({FindingKind::kMixedUp, projector_, -1, whites, options_.steady_tolerance});
  }
  return findings;
}

std::vector<Finding> PatternWitness::CheckSession() const {
  // P_W - P_B = sum_p g_p (W_p - B_p): the pre-roll shows all projectors at once. Least squares over the probes gives
  // g_p, which is 1 where lamp p is as it was, and a rest that vanishes where the visitor is.
  const auto projectors = static_cast<Eigen::Index>(contrast_.size());
  if (projectors == 0 || projectors != plan_.options.projectors || preroll_white_.empty() || preroll_black_.empty())
    return {};
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(projectors, projectors);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(projectors), row(projectors);
  double all = 0.0, noise = 0.0;
  int probes = 0, saturated = 0;
  for (size_t i = 0; i < preroll_white_.size(); ++i) {
    Eigen::Index p = 0;
    for (const auto& [projector, contrast] : contrast_) row[p++] = contrast[i];
    const double sum = preroll_white_[i] - preroll_black_[i];
    saturated += preroll_white_[i] >= options_.saturation_dn;
    if (preroll_white_[i] >= options_.saturation_dn || !row.allFinite() || sum < options_.min_contrast_dn) continue;
    normal += row * row.transpose();
    right += row * sum;
    all += sum * sum;
    noise += VarianceDn(preroll_white_[i]) * (1.0 + 1.0 / preroll_whites_) +
             static_cast<double>(projectors + 1) * VarianceDn(preroll_black_[i]);
    ++probes;
  }
  // Under all projectors a white target saturates; the rim that is left says little.
  if (probes < options_.min_lit_probes || probes < saturated) return {};
  const Eigen::LDLT<Eigen::MatrixXd> solver(normal);
  const Eigen::VectorXd gain = solver.solve(right);
  const double rest = std::sqrt(std::max(0.0, all - right.dot(gain) - noise) / all);
  if (rest > options_.still_tolerance)  // no gain means anything then
    return {{FindingKind::kMoved, -1, -1, rest, options_.still_tolerance}};
  std::vector<Finding> findings;
  // Of each gain's own uncertainty: alike pictures of two projectors are told apart badly.
  const Eigen::MatrixXd covariance = solver.solve(Eigen::MatrixXd::Identity(projectors, projectors));
  Eigen::Index p = 0;
  for (const auto& [projector, contrast] : contrast_) {
    const double deviation = std::sqrt(std::max(0.0, covariance(p, p)) * noise / probes);
    if (std::abs(gain[p] - 1.0) > options_.steady_tolerance + 4.0 * deviation)
      findings.push_back({FindingKind::kLamp, projector, -1, gain[p], options_.steady_tolerance});
    ++p;
  }
  return findings;
}

}  // namespace stratalux::rig
