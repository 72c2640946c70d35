// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/pattern_score.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace stratalux::rig {
namespace {

constexpr size_t kFewestOfBin = 8;  // of a bin that counts

// Mean level in bins of the distance from the comb's lines, and the variance of that mean.
struct Profile {
  std::vector<double> mean, variance;
  std::vector<size_t> count;
};

Profile ProfileOf(const Pattern& comb, int step, const LevelsAt& frame) {
  const std::span<const int> at = comb.axis == PatternAxis::kColumns ? frame.column : frame.row;
  const int bins = comb.period / step;
  Profile p{std::vector<double>(bins), std::vector<double>(bins), std::vector<size_t>(bins)};
  std::vector<int> bin_of;  // by position
  for (int position = 0; position < (comb.axis == PatternAxis::kColumns ? frame.width : frame.height); ++position)
    bin_of.push_back(((position - comb.shift) % comb.period + comb.period) % comb.period / step);
  for (size_t i = 0; i < at.size(); ++i) {
    if (at[i] < 0) continue;
    const int bin = bin_of[at[i]];
    ++p.count[bin];
    p.mean[bin] += frame.level[i];
    p.variance[bin] += double(frame.level[i]) * frame.level[i];
  }
  for (int b = 0; b < bins; ++b) {
    if (p.count[b] < 2) continue;
    const auto n = static_cast<double>(p.count[b]);
    p.mean[b] /= n;
    p.variance[b] = std::max(0.0, p.variance[b] / n - p.mean[b] * p.mean[b]) / (n - 1.0);
  }
  return p;
}

// Light near the lines, by bin: 1 on a line, falling off to both sides over the width of a line.
std::vector<double> Neighbourhood(int bins, int line_bins) {
  std::vector<double> weight(bins);
  for (int b = 0; b < bins; ++b) {
    const int beyond = b < line_bins ? 0 : std::min(b - line_bins + 1, bins - b);
    weight[b] = std::exp(-1.2 * beyond);
  }
  return weight;
}

}  // namespace

double CombEvidence(const Pattern& comb, int step, const LevelsAt& frame) {
  const Profile p = ProfileOf(comb, step, frame);
  const int bins = static_cast<int>(p.mean.size());
  const std::vector<double> weight = Neighbourhood(bins, std::max(1, comb.width / step));
  // Bins with too few probes speak for no shift: they are taken as the mean of the others, with its scatter.
  double mean = 0.0, scatter = 0.0;
  int known = 0;
  for (int b = 0; b < bins; ++b) {
    if (p.count[b] < kFewestOfBin) continue;
    mean += p.mean[b];
    ++known;
  }
  if (known < 3 || p.count[0] < kFewestOfBin) return 0.0;
  mean /= known;
  for (int b = 0; b < bins; ++b)
    if (p.count[b] >= kFewestOfBin) scatter += (p.mean[b] - mean) * (p.mean[b] - mean) / known;
  std::vector<double> value(bins), variance(bins), moved_weight = weight;
  for (int b = 0; b < bins; ++b) {
    const bool counts = p.count[b] >= kFewestOfBin;
    value[b] = counts ? p.mean[b] - mean : 0.0;
    variance[b] = counts ? p.variance[b] : scatter;
  }
  double weakest = std::numeric_limits<double>::infinity();
  for (int moved = 1; moved < bins; ++moved) {
    std::rotate(moved_weight.begin(), moved_weight.end() - 1, moved_weight.end());
    double difference = 0.0, total_variance = 0.0;
    for (int b = 0; b < bins; ++b) {
      const double w = weight[b] - moved_weight[b];
      difference += w * value[b];
      total_variance += w * w * variance[b];
    }
    weakest = std::min(weakest, difference / std::sqrt(total_variance + 1e-12));
  }
  return weakest;
}

double ShiftEvidence(const Pattern& pattern, const LevelsAt& frame) {
  const bool plane = pattern.kind == PatternKind::kCheckerboard;
  const bool columns = plane || pattern.axis == PatternAxis::kColumns, rows = plane || !columns;
  std::vector<size_t> known;
  double mean = 0.0;
  for (size_t i = 0; i < frame.level.size(); ++i) {
    if ((columns && frame.column[i] < 0) || (rows && frame.row[i] < 0)) continue;
    known.push_back(i);
    mean += frame.level[i];
  }
  if (known.size() < kFewestOfBin) return 0.0;
  mean /= static_cast<double>(known.size());
  double weakest = std::numeric_limits<double>::infinity();
  for (int shift = 0; shift < (plane ? pattern.shifts * pattern.shifts : pattern.shifts); ++shift) {
    if (shift == pattern.shift) continue;
    Pattern other = pattern;
    other.shift = shift;
    std::vector<float> contrast;  // of the two patterns, along the axis
    if (!plane) {
      contrast = pattern.Profile(columns ? frame.width : frame.height);
      const std::vector<float> theirs = other.Profile(static_cast<int>(contrast.size()));
      for (size_t c = 0; c < contrast.size(); ++c) contrast[c] -= theirs[c];
    }
    double sum = 0.0, squares = 0.0;
    bool differs = false;  // moved by half a period along either axis, a checkerboard is the same
    for (const size_t i : known) {
      const double w =
          plane ? pattern.Intensity(frame.column[i], frame.row[i]) - other.Intensity(frame.column[i], frame.row[i])
                : contrast[columns ? frame.column[i] : frame.row[i]];
      const double x = w * (frame.level[i] - mean);
      sum += x;
      squares += x * x;
      differs = differs || w != 0.0;
    }
    if (!differs) continue;
    weakest = std::min(weakest, sum / std::sqrt(squares + 1e-12));
  }
  return std::isfinite(weakest) ? weakest : 0.0;
}

}  // namespace stratalux::rig
