// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/exposure_choice.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace stratalux::rig {
namespace {

// Reorders.
double Percentile(std::vector<float>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

struct Lit {
  std::vector<float> quads;    // mean signal of each block's quads, DN at the pre-scan's exposure
  std::vector<float> samples;  // all light of each sample of these blocks, the room's too: what saturates
  bool saturated = false;      // more samples than allowed at the pre-scan already
};

Lit LitOf(const PreScan& scan, const ExposureRule& rule) {
  Lit lit;
  size_t saturated = 0;
  for (const LitBlock& block : LitBlocks(scan, rule.read_noise_dn)) {
    lit.quads.push_back(block.signal);
    for (int j = 0; j < kLitBlock; ++j)
      for (int i = 0; i < kLitBlock; ++i) {
        const uint16_t white = scan.white(block.x + i, block.y + j);
        lit.samples.push_back(static_cast<float>(white - rule.black_level_dn));
        saturated += white >= rule.saturation_dn;
      }
  }
  lit.saturated = static_cast<double>(saturated) > rule.max_saturated * static_cast<double>(lit.samples.size());
  return lit;
}

// Electrons^2 of read noise in a quad's difference of two frames.
double ReadVariance(const ExposureRule& rule) {
  const double read = rule.read_noise_dn * rule.gain_e_per_dn;
  return 2.0 * kQuadSamples * read * read;
}

// Ratio of a quad's signal, the difference of two frames, the light itself in one of them.
double SnrOf(double signal_dn, const ExposureRule& rule) {
  const double electrons = signal_dn * rule.gain_e_per_dn;
  return electrons / std::sqrt(std::max(1e-9, electrons + ReadVariance(rule)));
}

// The signal that has it: SnrOf solved for its argument.
double SignalFor(double snr, const ExposureRule& rule) {
  const double square = snr * snr;
  return 0.5 * (square + std::sqrt(square * square + 4.0 * square * ReadVariance(rule))) / rule.gain_e_per_dn;
}

}  // namespace

Result<ExposureChoice> ChooseExposure(const std::vector<PreScan>& scans, double scan_ms, const ExposureRule& rule) {
  const double range_dn = rule.saturation_dn - rule.black_level_dn;
  double wanted_ms = 0.0, allowed_ms = std::numeric_limits<double>::infinity();
  ExposureChoice choice;
  std::vector<Lit> lit;
  std::vector<double> darkest;  // signal of the darkest tenth a ms
  for (const PreScan& scan : scans) {
    Lit& one = lit.emplace_back(LitOf(scan, rule));
    darkest.push_back(0.0);
    if (one.quads.empty()) {
      choice.findings.push_back({FindingKind::kDim, static_cast<int>(darkest.size()) - 1, -1, 0.0, rule.wanted_snr});
      continue;
    }
    choice.prescan_saturated = choice.prescan_saturated || one.saturated;
    darkest.back() = Percentile(one.quads, 0.1) / scan_ms;
    wanted_ms = std::max(wanted_ms, SignalFor(rule.wanted_snr, rule) / darkest.back());
    // Samples of the same number saturate together.
    allowed_ms = std::min(allowed_ms, range_dn / (Percentile(one.samples, 1.0 - rule.max_saturated) + 1.0) * scan_ms);
  }
  if (wanted_ms == 0.0) return Status::Failed("pre-scan: no projector lights anything; is somebody there?");
  wanted_ms = std::max(wanted_ms, rule.nominal_ms);
  choice.exposure_ms = std::min(std::max(std::min(wanted_ms, allowed_ms), rule.shortest_ms), rule.longest_ms);
  choice.snr = std::numeric_limits<double>::infinity();
  for (size_t p = 0; p < scans.size(); ++p) {
    if (darkest[p] == 0.0) continue;
    const int projector = static_cast<int>(p);
    const double snr = SnrOf(darkest[p] * choice.exposure_ms, rule);
    const auto saturated =
        static_cast<double>(std::count_if(lit[p].samples.begin(), lit[p].samples.end(), [&](float light) {
          return light / scan_ms * choice.exposure_ms >= range_dn;
        }));
    const double share = saturated / static_cast<double>(lit[p].samples.size());
    choice.snr = std::min(choice.snr, snr);
    choice.saturated = std::max(choice.saturated, share);
    if (snr < 0.999 * rule.wanted_snr)
      choice.findings.push_back({FindingKind::kDim, projector, -1, snr, rule.wanted_snr});
    if (share > 1.05 * rule.max_saturated)
      choice.findings.push_back({FindingKind::kSaturated, projector, -1, share, rule.max_saturated});
  }
  return choice;
}

Result<double> LongestExposureMs(const PlanOptions& plan, const VisitTiming& timing, std::chrono::nanoseconds visit) {
  SLX_ASSIGN_OR_RETURN(CapturePlan built, BuildPlan(plan));
  std::vector<double> factors;
  for (const PlanStep& step : built.steps) factors.push_back(step.exposure_ms / plan.exposure_ms);
  double low = 0.0, high = 1000.0;
  while (high - low > 0.01) {
    const double middle = 0.5 * (low + high);
    for (size_t i = 0; i < factors.size(); ++i) built.steps[i].exposure_ms = middle * factors[i];
    (VisitTime(built, timing) <= visit ? low : high) = middle;
  }
  return low;
}

}  // namespace stratalux::rig
