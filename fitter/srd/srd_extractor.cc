// SPDX-License-Identifier: Apache-2.0
#include "fitter/srd/srd_extractor.h"

#include <cmath>

#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {

const char* ToString(SrdReason reason) {
  constexpr const char* kNames[] = {"valid", "no surface", "unlit", "grazing", "saturated", "too dark"};
  return kNames[static_cast<int>(reason)];
}

Status CombCycle::Validate() const {
  if (period < 2 || width < 1 || step < 1 || width >= period || period % step != 0)
    return Status::Usage("comb: period " + std::to_string(period) + ", width " + std::to_string(width) + ", step " +
                         std::to_string(step) + ": the step must divide the period and the line be narrower than it");
  if (!(exposure_ms > 0.0)) return Status::Usage("comb: exposure must be positive");
  return Status::Ok();
}

Status SrdOptions::Validate() const {
  if (pool < 1 || pool > 16) return Status::Usage("srd: pool = " + std::to_string(pool) + ", allowed: 1 .. 16");
  if (!(min_cos > 0.0 && min_cos < 1.0)) return Status::Usage("srd: min_cos must lie between 0 and 1");
  return Status::Ok();
}

SrdExtractor::SrdExtractor(const SurfaceMap& surface, ImageView<const uint8_t> lit, const RigCalibration& rig,
                           int projector, const CombCycle& cycle, const SrdOptions& options)
    : rig_(rig),
      projector_(projector),
      cycle_(cycle),
      options_(options),
      width_(surface.width() / options.pool),
      height_(surface.height() / options.pool),
      channels_(QuadChannels(rig.camera.cfa)) {
  Prepare(surface, lit);
}

void SrdExtractor::Prepare(const SurfaceMap& surface, ImageView<const uint8_t> lit) {
  const int64_t profiles = int64_t{width_} * height_ * channels_;
  batch_.samples = cycle_.frames();
  batch_.wrapped = true;
  batch_.y.assign(profiles * batch_.samples, 0.0F);
  batch_.variance.assign(profiles * batch_.samples, 1.0F);
  for (auto* v : {&batch_.slope_in, &batch_.slope_out, &batch_.slope_in_across, &batch_.slope_out_across,
                  &batch_.first_u_mm, &batch_.pair_mm, &white_dn_})
    v->assign(profiles, 0.0F);
  for (auto* v : {&batch_.step_mm, &batch_.line_width_mm, &batch_.blur_mm, &batch_.cos_in, &batch_.cos_out})
    v->assign(profiles, 1.0F);
  batch_.valid.assign(profiles, 0);
  reason_.assign(profiles, static_cast<uint8_t>(SrdReason::kNoSurface));

  const SurfaceMap pooled = PoolSurface(surface, options_.pool);
  ParallelFor(height_, 4, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < width_; ++x) {
        if (pooled.mask(x, y) == 0) continue;
        bool all_lit = true;
        for (int j = y * options_.pool; j < (y + 1) * options_.pool; ++j)
          for (int i = x * options_.pool; i < (x + 1) * options_.pool; ++i) all_lit = all_lit && lit(i, j) != 0;
        const int64_t first = (int64_t{y} * width_ + x) * channels_;
        const int step = QuadStep(rig_.camera.cfa) * options_.pool;
        const Eigen::Vector2d pixel(step * x + (step - 1) * 0.5, step * y + (step - 1) * 0.5);
        for (int c = 0; c < channels_; ++c) {
          if (!all_lit) {
            reason_[first + c] = static_cast<uint8_t>(SrdReason::kUnlit);
            continue;
          }
          PrepareProfile(first + c, ComputeSrdGeometry(rig_, projector_, pooled.Point(x, y), pooled.Normal(x, y), pixel,
                                                       options_.pool, c, cycle_.exposure_ms));
        }
      }
  });
}

void SrdExtractor::PrepareProfile(int64_t profile, const SrdGeometry& g) {
  if (g.cos_in < options_.min_cos || g.cos_out < options_.min_cos) {
    reason_[profile] = static_cast<uint8_t>(SrdReason::kGrazing);
    return;
  }
  if (!(g.white_dn > 0.0) || !(g.mm_per_column > 0.0)) {
    reason_[profile] = static_cast<uint8_t>(SrdReason::kUnlit);
    return;
  }
  // Line k has its centre at column (width - 1) / 2 + k step, modulo the period; u_0 is the nearest of its copies.
  const double offset = std::remainder((cycle_.width - 1) * 0.5 - g.column, cycle_.period);
  batch_.first_u_mm[profile] = static_cast<float>(offset * g.mm_per_column);
  batch_.step_mm[profile] = static_cast<float>(cycle_.step * g.mm_per_column);
  batch_.line_width_mm[profile] = static_cast<float>(cycle_.width * g.mm_per_column);
  batch_.pair_mm[profile] = static_cast<float>(g.pair_mm);
  batch_.blur_mm[profile] = static_cast<float>(g.blur_mm);
  batch_.slope_in[profile] = static_cast<float>(g.slope_in);
  batch_.slope_out[profile] = static_cast<float>(g.slope_out);
  batch_.slope_in_across[profile] = static_cast<float>(g.slope_in_across);
  batch_.slope_out_across[profile] = static_cast<float>(g.slope_out_across);
  batch_.cos_in[profile] = static_cast<float>(g.cos_in);
  batch_.cos_out[profile] = static_cast<float>(g.cos_out);
  white_dn_[profile] = static_cast<float>(g.white_dn);
  reason_[profile] = static_cast<uint8_t>(SrdReason::kValid);
}

void SrdExtractor::AddFrame(int k, ImageView<const uint16_t> raw, ImageView<const float> dark_dn) {
  SLX_CHECK(k >= 0 && k < batch_.samples);
  const CameraCalibration& camera = rig_.camera;
  const int block = QuadStep(camera.cfa) * options_.pool;
  const double read2 = camera.read_noise_dn * camera.read_noise_dn;
  ParallelFor(height_, 16, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < width_; ++x) {
        const int64_t first = (int64_t{y} * width_ + x) * channels_;
        double sum[3] = {}, level[3] = {};
        int count[3] = {};
        bool saturated = false;
        for (int j = y * block; j < (y + 1) * block; ++j)
          for (int i = x * block; i < (x + 1) * block; ++i) {
            const int c = CfaColour(camera.cfa, i, j);
            sum[c] += raw(i, j) - dark_dn(i, j);
            level[c] += raw(i, j) - camera.black_level_dn;
            ++count[c];
            saturated = saturated || raw(i, j) >= camera.saturation_dn;
          }
        for (int c = 0; c < channels_; ++c) {
          const int64_t profile = first + c;
          if (reason_[profile] != static_cast<uint8_t>(SrdReason::kValid)) continue;
          if (saturated) {
            reason_[profile] = static_cast<uint8_t>(SrdReason::kSaturated);
            continue;
          }
          const double scale = 1.0 / (static_cast<double>(count[c]) * white_dn_[profile]);
          batch_.y[profile * batch_.samples + k] = static_cast<float>(sum[c] * scale);
          // Shot noise of the light that arrived and read noise, both of the mean over `count` sites.
          const double variance = std::max(level[c], 0.0) / camera.gain_e_per_dn + count[c] * read2;
          batch_.variance[profile * batch_.samples + k] = static_cast<float>(std::max(variance, 1e-6) * scale * scale);
        }
      }
  });
}

void SrdExtractor::SetWhite(ImageView<const float> mean_dn, int count, ImageView<const float> dark_dn) {
  const CameraCalibration& camera = rig_.camera;
  const int block = QuadStep(camera.cfa) * options_.pool;
  const double read2 = camera.read_noise_dn * camera.read_noise_dn;
  // Every column is lit width / step times in a cycle.
  const double cycle = static_cast<double>(cycle_.width) / cycle_.step;
  batch_.white.assign(batch_.valid.size(), 0.0F);
  batch_.white_variance.assign(batch_.valid.size(), 0.0F);
  ParallelFor(height_, 16, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < width_; ++x) {
        const int64_t first = (int64_t{y} * width_ + x) * channels_;
        double sum[3] = {}, level[3] = {};
        int sites[3] = {};
        for (int j = y * block; j < (y + 1) * block; ++j)
          for (int i = x * block; i < (x + 1) * block; ++i) {
            const int c = CfaColour(camera.cfa, i, j);
            sum[c] += mean_dn(i, j) - dark_dn(i, j);
            level[c] += mean_dn(i, j) - camera.black_level_dn;
            ++sites[c];
          }
        for (int c = 0; c < channels_; ++c) {
          const int64_t profile = first + c;
          if (reason_[profile] != static_cast<uint8_t>(SrdReason::kValid) || !std::isfinite(sum[c])) continue;
          const double scale = cycle / (static_cast<double>(sites[c]) * white_dn_[profile]);
          batch_.white[profile] = static_cast<float>(sum[c] * scale);
          const double variance = (std::max(level[c], 0.0) / camera.gain_e_per_dn + sites[c] * read2) / count;
          batch_.white_variance[profile] = static_cast<float>(std::max(variance, 1e-6) * scale * scale);
        }
      }
  });
}

SrdBatch SrdExtractor::Take() {
  for (int64_t i = 0; i < batch_.profiles(); ++i) {
    if (reason_[i] == static_cast<uint8_t>(SrdReason::kValid)) {
      double sum = 0.0, variance = 0.0;
      for (int k = 0; k < batch_.samples; ++k) {
        sum += batch_.y[i * batch_.samples + k];
        variance += batch_.variance[i * batch_.samples + k];
      }
      if (!(sum > options_.min_signal_to_noise * std::sqrt(variance)))
        reason_[i] = static_cast<uint8_t>(SrdReason::kTooDark);
    }
    batch_.valid[i] = reason_[i] == static_cast<uint8_t>(SrdReason::kValid) ? 1 : 0;
    ++counts_[reason_[i]];
  }
  return std::move(batch_);
}

}  // namespace stratalux::fit
