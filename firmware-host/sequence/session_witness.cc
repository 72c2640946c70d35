// SPDX-License-Identifier: Apache-2.0
// What must add up over all projectors.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "firmware-host/sequence/pattern_witness.h"

namespace stratalux::rig {

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
    return {{.kind = FindingKind::kMoved, .value = rest, .limit = options_.still_tolerance}};
  std::vector<Finding> findings;
  bool brighter = false, dimmer = false;
  // Of each gain's own uncertainty: alike pictures of two projectors are told apart badly.
  const Eigen::MatrixXd covariance = solver.solve(Eigen::MatrixXd::Identity(projectors, projectors));
  Eigen::Index p = 0;
  for (const auto& [projector, contrast] : contrast_) {
    const double deviation = std::sqrt(std::max(0.0, covariance(p, p)) * noise / probes);
    const double limit = options_.steady_tolerance + 4.0 * deviation;
    if (std::abs(gain[p] - 1.0) > limit)
      findings.push_back({.kind = FindingKind::kLamp, .projector = projector, .value = gain[p], .limit = limit});
    brighter |= gain[p] > 1.0 + limit;
    dimmer |= gain[p] < 1.0 - limit;
    ++p;
  }
  if (!brighter || !dimmer) return findings;
  // Lamps age and sag; who moves comes nearer to one and leaves another. What else a lamp did stands behind it.
  const Finding& most =
      *std::ranges::max_element(findings, {}, [](const Finding& f) { return std::abs(f.value - 1.0); });
  findings.insert(findings.begin(),
                  {.kind = FindingKind::kMoved, .value = std::abs(most.value - 1.0), .limit = most.limit});
  return findings;
}

}  // namespace stratalux::rig
