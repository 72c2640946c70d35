// SPDX-License-Identifier: Apache-2.0
// From raw frames to samples: brackets merged, the gather reading, white frames, the energy check.
#include <algorithm>
#include <cmath>

#include "fitter/srd/srd_extractor.h"
#include "shared/base/median.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr size_t kMaxShots = 8;  // as many brackets as a plan may have
constexpr double kLeastVariance = 1e-6;
constexpr float kQuietShare = 0.05F;  // of the white: noise of a cycle sum that may speak for the capture

// Colours of the sites of a 2x2 block, by 2 (y & 1) + (x & 1).
std::array<int, 4> BlockColours(Cfa cfa) {
  std::array<int, 4> colours{};
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 2; ++x) colours[2 * y + x] = CfaColour(cfa, x, y);
  return colours;
}

// Sums over the sites of one pooled quad, by colour.
struct QuadSums {
  std::array<double, 3> above_dark{}, above_black_level{};
  std::array<int, 3> sites{};
  bool saturated = false;
};

template <typename T>
QuadSums SumQuad(ImageView<const T> raw, ImageView<const float> dark_dn, const CameraCalibration& camera,
                 const std::array<int, 4>& colours, int x0, int y0, int block) {
  QuadSums sums;
  for (int y = y0; y < y0 + block; ++y) {
    const T* values = raw.row(y);
    const float* dark = dark_dn.row(y);
    for (int x = x0; x < x0 + block; ++x) {
      const int c = colours[2 * (y & 1) + (x & 1)];
      sums.above_dark[c] += static_cast<float>(values[x]) - dark[x];
      sums.above_black_level[c] += values[x] - camera.black_level_dn;
      ++sums.sites[c];
      sums.saturated = sums.saturated || values[x] >= camera.saturation_dn;
    }
  }
  return sums;
}

// Median of `values`, which are reordered; 0 of none.
double Quantile(std::vector<float>& values, double fraction) {
  if (values.empty()) return 0.0;
  const auto at = values.begin() + static_cast<int64_t>(fraction * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace

void SrdExtractor::MergeRow(const CombFrame& frame, int y, Row& row) const {
  const CameraCalibration& camera = rig_.camera;
  const auto colours = BlockColours(camera.cfa);
  const int block = QuadStep(camera.cfa) * options_.pool;
  const double read2 = camera.read_noise_dn * camera.read_noise_dn;
  const size_t shots = frame.shots.size();
  SLX_CHECK(shots <= kMaxShots);
  for (int x = 0; x < width_; ++x) {
    if (surface_.mask(x, y) == 0) continue;
    std::array<QuadSums, kMaxShots> sums;
    for (size_t s = 0; s < shots; ++s)
      sums[s] = SumQuad(frame.shots[s].raw, frame.shots[s].dark_dn, camera, colours, x * block, y * block, block);
    for (int c = 0; c < channels_; ++c) {
      // Shot noise of the light that arrived and read noise. The level behind the shot noise is that of all shots
      // together: each shot's own would favour those that noise made darker.
      double level = 0.0, exposure = 0.0;
      for (size_t s = 0; s < shots; ++s) {
        if (sums[s].saturated) continue;
        level += sums[s].above_black_level[c];
        exposure += sums[s].sites[c] * frame.shots[s].exposure_ms / cycle_.exposure_ms;
      }
      double weight = 0.0, signal = 0.0;
      for (size_t s = 0; s < shots; ++s) {
        if (sums[s].saturated) continue;
        const double factor = frame.shots[s].exposure_ms / cycle_.exposure_ms;
        const double to_mean = 1.0 / (sums[s].sites[c] * factor);
        const double variance = sums[s].sites[c] *
                                (std::max(level / exposure, 0.0) * factor / camera.gain_e_per_dn + read2) * to_mean *
                                to_mean;
        const double w = 1.0 / std::max(variance, kLeastVariance * to_mean * to_mean);
        weight += w;
        signal += w * sums[s].above_dark[c] * to_mean;
      }
      row.signal[x * channels_ + c] = weight > 0.0 ? static_cast<float>(signal / weight) : std::nanf("");
      row.variance[x * channels_ + c] = weight > 0.0 ? static_cast<float>(1.0 / weight) : std::nanf("");
    }
  }
}

// Row by row, and all frames of a row at once: a profile's samples lie side by side, so that a frame by itself would
// touch every cache line of the batch.
void SrdExtractor::Gather(std::span<const CombFrame> frames) {
  ParallelFor(height_, 4, [&](int64_t begin, int64_t end) {
    const size_t size = static_cast<size_t>(width_) * static_cast<size_t>(channels_);
    Row row{std::vector<float>(size), std::vector<float>(size)};
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (const CombFrame& frame : frames) {
        MergeRow(frame, y, row);
        const int64_t first = int64_t{y} * width_ * channels_;
        for (size_t i = 0; i < size; ++i) {
          const int64_t profile = first + static_cast<int64_t>(i);
          if (!Valid(profile)) continue;
          if (!std::isfinite(row.signal[i])) {
            Reject(profile, SrdReason::kSaturated);
            continue;
          }
          const float per_white = 1.0F / white_dn_[profile];
          const float sample = row.signal[i] * per_white;
          batch_.Samples(profile)[frame.k] = sample;
          noise_[profile].Add(sample, row.variance[i] * per_white * per_white);
        }
      }
  });
}

void SrdExtractor::SetWhite(ImageView<const float> mean_dn, int count, ImageView<const float> dark_dn) {
  const CameraCalibration& camera = rig_.camera;
  const auto colours = BlockColours(camera.cfa);
  const int block = QuadStep(camera.cfa) * options_.pool;
  const double read2 = camera.read_noise_dn * camera.read_noise_dn;
  // Every column is lit width / step times in a cycle; of a thinned one, in the mean.
  const double cycle = static_cast<double>(cycle_.width) / cycle_.step;
  batch_.white.assign(batch_.valid.size(), 0.0F);
  batch_.white_variance.assign(batch_.valid.size(), 0.0F);
  ParallelFor(height_, 16, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < width_; ++x) {
        if (surface_.mask(x, y) == 0) continue;
        const int64_t first = (int64_t{y} * width_ + x) * channels_;
        const QuadSums sums = SumQuad(mean_dn, dark_dn, camera, colours, x * block, y * block, block);
        for (int c = 0; c < channels_; ++c) {
          const int64_t profile = first + c;
          if (!Valid(profile) || !std::isfinite(sums.above_dark[c])) continue;
          const double scale = cycle / (static_cast<double>(sums.sites[c]) * white_dn_[profile]);
          batch_.white[profile] = static_cast<float>(sums.above_dark[c] * scale);
          const double variance =
              (std::max(sums.above_black_level[c], 0.0) / camera.gain_e_per_dn + sums.sites[c] * read2) / count;
          batch_.white_variance[profile] = static_cast<float>(std::max(variance, kLeastVariance) * scale * scale);
        }
      }
  });
}

// The lines of a cycle light each column w / q times, so their frames add up to w / q whites, noise apart: that of the
// samples, and that of the dark frame, which is in all of them alike. The latter is taken from the differences
// themselves, since most of a face does not move: their median, by channel.
void SrdExtractor::CheckEnergy() {
  if (batch_.white.empty() || !cycle_.LightsAllAlike() || std::count(seen_.begin(), seen_.end(), 0) != 0) return;
  const int64_t profiles = batch_.profiles();
  std::vector<float> sums(profiles, 0.0F), variances(profiles, 0.0F);
  ParallelFor(profiles, 4096, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (!Valid(i)) continue;
      for (const float y : batch_.Samples(i)) sums[i] += y;
      variances[i] = static_cast<float>(VarianceOfSum(i));
    }
  });
  auto checked = [&](int64_t i) { return Valid(i) && batch_.white_variance[i] > 0.0F && batch_.white[i] > 0.0F; };
  std::array<double, 3> usual_dn{};
  std::vector<float> all_ratios, all_errors;
  for (int c = 0; c < channels_; ++c) {
    std::vector<float> differences_dn;
    for (int64_t i = c; i < profiles; i += channels_) {
      if (!checked(i)) continue;
      differences_dn.push_back(std::abs(sums[i] - batch_.white[i]) * white_dn_[i]);
      if (std::sqrt(variances[i] + batch_.white_variance[i]) > kQuietShare * batch_.white[i]) continue;
      all_ratios.push_back(sums[i] / batch_.white[i]);
      all_errors.push_back(std::abs(all_ratios.back() - 1.0F));
    }
    usual_dn[c] = kMadToDeviation * Quantile(differences_dn, 0.5);
  }
  energy_ = {static_cast<int64_t>(all_ratios.size()), Quantile(all_ratios, 0.5), Quantile(all_errors, 0.95)};
  for (int64_t i = 0; i < profiles; ++i) {
    if (!checked(i)) continue;
    const double difference = std::abs(double(sums[i]) - batch_.white[i]);
    const double noise = std::sqrt(double(variances[i]) + batch_.white_variance[i]);
    if (difference > options_.energy_tolerance * batch_.white[i] && difference > 5.0 * noise &&
        difference * white_dn_[i] > 5.0 * usual_dn[i % channels_])
      Reject(i, SrdReason::kMoved);
  }
}

}  // namespace stratalux::fit
