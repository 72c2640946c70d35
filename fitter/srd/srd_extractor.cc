// SPDX-License-Identifier: Apache-2.0
#include "fitter/srd/srd_extractor.h"

#include <algorithm>
#include <cmath>
#include <string_view>

#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr std::array<const char*, 2> kReadings = {"gather", "scatter"};
constexpr std::array<const char*, 2> kDistances = {"tangent", "surface"};

template <typename Name>
Result<Name> ParseName(const std::array<const char*, 2>& names, const std::string& text, const std::string& what) {
  for (size_t i = 0; i < names.size(); ++i)
    if (text == names[i]) return static_cast<Name>(i);
  return Status::Usage(what + " '" + text + "' is unknown; allowed: " + names[0] + ", " + names[1]);
}

// Quads of `lit`, pool x pool at a time: lit where all are.
Image<uint8_t> PoolLit(ImageView<const uint8_t> lit, int pool) {
  Image<uint8_t> pooled(lit.width() / pool, lit.height() / pool, 1, 1);
  for (int y = 0; y < pooled.height() * pool; ++y)
    for (int x = 0; x < pooled.width() * pool; ++x)
      if (lit(x, y) == 0) pooled(x / pool, y / pool) = 0;
  return pooled;
}

}  // namespace

const char* ToString(SrdReason reason) {
  constexpr const char* kNames[] = {"valid",     "no surface", "unlit", "grazing",
                                    "saturated", "too dark",   "moved", "cut off"};
  return kNames[static_cast<int>(reason)];
}

const char* ToString(SrdReading reading) { return kReadings[static_cast<size_t>(reading)]; }
const char* ToString(SrdDistance distance) { return kDistances[static_cast<size_t>(distance)]; }
Result<SrdReading> ParseSrdReading(const std::string& text) {
  return ParseName<SrdReading>(kReadings, text, "reading");
}
Result<SrdDistance> ParseSrdDistance(const std::string& text) {
  return ParseName<SrdDistance>(kDistances, text, "distance");
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
  if (!(energy_tolerance > 0.0)) return Status::Usage("srd: energy_tolerance must be positive");
  if (reading == SrdReading::kScatter && distance == SrdDistance::kSurface)
    return Status::Usage("srd: the scatter reading measures distances on the tangent plane only");
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
      channels_(QuadChannels(rig.camera.cfa)),
      surface_(PoolSurface(surface, options.pool)),
      lit_(PoolLit(lit, options.pool)),
      seen_(static_cast<size_t>(cycle.frames()), 0) {
  Prepare();
  if (options_.distance == SrdDistance::kSurface) MeasureAlongSurface();
}

Eigen::Vector2d SrdExtractor::PixelCentre(int x, int y) const {
  const int step = QuadStep(rig_.camera.cfa) * options_.pool;
  return {step * x + (step - 1) * 0.5, step * y + (step - 1) * 0.5};
}

void SrdExtractor::Prepare() {
  const int64_t profiles = int64_t{width_} * height_ * channels_;
  const bool scatter = options_.reading == SrdReading::kScatter;
  // Scatter: half a period, so that the neighbouring lines, a whole period off, light none of it.
  batch_.samples = scatter ? cycle_.frames() / 4 * 2 + 1 : cycle_.frames();
  batch_.wrapped = !scatter;
  for (auto* v :
       {&batch_.slope_in, &batch_.slope_out, &batch_.slope_in_across, &batch_.slope_out_across, &batch_.first_u_mm,
        &batch_.pair_mm, &batch_.box_x_mm, &batch_.box_y_mm, &batch_.noise_floor, &batch_.noise_slope, &white_dn_})
    v->assign(profiles, 0.0F);
  for (auto* v : {&batch_.step_mm, &batch_.line_width_mm, &batch_.blur_mm, &batch_.cos_in, &batch_.cos_out})
    v->assign(profiles, 1.0F);
  batch_.pool = options_.pool;
  if (batch_.pool > 1)
    for (auto* v : {&batch_.quad_x_mm, &batch_.quad_y_mm}) v->assign(profiles, 0.0F);
  if (scatter) along_.assign(profiles, Eigen::Vector3f::Zero());
  noise_.assign(profiles, {});
  if (scatter || options_.distance == SrdDistance::kSurface) column_.assign(profiles, 0.0F);
  batch_.valid.assign(profiles, 0);
  reason_.assign(profiles, static_cast<uint8_t>(SrdReason::kNoSurface));

  ParallelFor(height_, 4, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < width_; ++x) {
        if (surface_.mask(x, y) == 0) continue;
        const int64_t first = (int64_t{y} * width_ + x) * channels_;
        for (int c = 0; c < channels_; ++c) {
          if (lit_(x, y) == 0) {
            Reject(first + c, SrdReason::kUnlit);
            continue;
          }
          PrepareProfile(first + c, ComputeSrdGeometry(rig_, projector_, surface_.Point(x, y), surface_.Normal(x, y),
                                                       PixelCentre(x, y), c, cycle_.exposure_ms, cycle_.axis));
        }
      }
  });
  std::vector<uint8_t> shown(reason_.size());
  for (size_t i = 0; i < shown.size(); ++i) shown[i] = Valid(static_cast<int64_t>(i)) ? 1 : 0;
  batch_.AllotRows(shown, 0.0F);
}

void SrdExtractor::PrepareProfile(int64_t profile, const SrdGeometry& g) {
  if (g.cos_in < options_.min_cos || g.cos_out < options_.min_cos) return Reject(profile, SrdReason::kGrazing);
  if (!(g.white_dn > 0.0) || !(g.mm_per_column > 0.0)) return Reject(profile, SrdReason::kUnlit);
  // Line k has its centre at column (width - 1) / 2 + k step, modulo the period; u_0 is the nearest of its copies.
  const double offset = std::remainder((cycle_.width - 1) * 0.5 - g.column, cycle_.period);
  batch_.first_u_mm[profile] = static_cast<float>(offset * g.mm_per_column);
  batch_.step_mm[profile] = static_cast<float>(cycle_.step * g.mm_per_column);
  batch_.line_width_mm[profile] = static_cast<float>(cycle_.width * g.mm_per_column);
  batch_.pair_mm[profile] = static_cast<float>(g.pair_mm);
  batch_.box_x_mm[profile] = static_cast<float>(g.box_x_mm);
  batch_.box_y_mm[profile] = static_cast<float>(g.box_y_mm);
  if (batch_.pool > 1) {
    batch_.quad_x_mm[profile] = static_cast<float>(g.quad_x_mm);
    batch_.quad_y_mm[profile] = static_cast<float>(g.quad_y_mm);
  }
  batch_.blur_mm[profile] = static_cast<float>(g.blur_mm);
  batch_.slope_in[profile] = static_cast<float>(g.slope_in);
  batch_.slope_out[profile] = static_cast<float>(g.slope_out);
  batch_.slope_in_across[profile] = static_cast<float>(g.slope_in_across);
  batch_.slope_out_across[profile] = static_cast<float>(g.slope_out_across);
  batch_.cos_in[profile] = static_cast<float>(g.cos_in);
  batch_.cos_out[profile] = static_cast<float>(g.cos_out);
  // A frame less its black one: the projector's own black is in both.
  white_dn_[profile] = static_cast<float>(g.white_dn * (1.0 - rig_.projectors[projector_].black_level));
  if (!column_.empty()) column_[profile] = static_cast<float>(g.column);
  if (!along_.empty()) {
    along_[profile] = g.across_line.cast<float>();
    // The line nearest to the pixel; samples on both sides of it.
    const double nearest = std::remainder((cycle_.width - 1) * 0.5 - g.column, cycle_.step);
    batch_.first_u_mm[profile] = static_cast<float>((nearest - batch_.samples / 2 * cycle_.step) * g.mm_per_column);
  }
  Reject(profile, SrdReason::kValid);
}

void SrdExtractor::AddFrames(std::span<const CombFrame> frames) {
  for (const CombFrame& frame : frames) {
    SLX_CHECK(frame.k >= 0 && frame.k < cycle_.frames() && !frame.shots.empty());
    seen_[frame.k] = 1;
  }
  if (options_.reading == SrdReading::kGather) return Gather(frames);
  for (const CombFrame& frame : frames) Scatter(frame);
}

void SrdExtractor::SetNoise() {
  for (int64_t i = 0; i < batch_.profiles(); ++i) {
    if (!Valid(i)) continue;
    batch_.noise_floor[i] = noise_[i].Floor();
    batch_.noise_slope[i] = noise_[i].Slope();
  }
}

SrdBatch SrdExtractor::Take() {
  SetNoise();
  if (options_.reading == SrdReading::kGather) {
    FillMissingFrame();
    CheckEnergy();
    if (options_.distance == SrdDistance::kSurface) ResampleAlongSurface();
  }
  RejectTooDark();
  for (int64_t i = 0; i < batch_.profiles(); ++i) {
    batch_.valid[i] = Valid(i) ? 1 : 0;
    ++counts_[reason_[i]];
  }
  batch_.KeepValidRows();
  return std::move(batch_);
}

void SrdExtractor::FillMissingFrame() {
  const auto missing = std::find(seen_.begin(), seen_.end(), 0);
  const bool any_lit = std::ranges::find(reason_, static_cast<uint8_t>(SrdReason::kValid)) != reason_.end();
  if (missing == seen_.end() || !any_lit) return;
  SLX_CHECK(std::count(seen_.begin(), seen_.end(), 0) == 1 && !batch_.white.empty());
  const int samples = batch_.samples, k = static_cast<int>(missing - seen_.begin());
  ParallelFor(batch_.profiles(), 4096, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (!Valid(i)) continue;
      if (!(batch_.white_variance[i] > 0.0F)) {
        Reject(i, SrdReason::kSaturated);
        continue;
      }
      const auto y = batch_.Samples(i);
      double others = 0.0;
      for (int j = 0; j < samples; ++j) others += j == k ? 0.0 : y[j];
      y[k] = static_cast<float>(batch_.white[i] - others);
      batch_.white_variance[i] = 0.0F;  // told already: the samples' sum is the white
    }
  });
}

void SrdExtractor::RejectTooDark() {
  ParallelFor(batch_.profiles(), 4096, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (!Valid(i)) continue;
      double sum = 0.0, variance = VarianceOfSum(i);
      for (const float y : batch_.Samples(i)) sum += y;
      // Between the lines of a thinned cycle it is dark; white frames light all of it.
      if (!cycle_.LightsAllAlike() && !batch_.white.empty() && batch_.white_variance[i] > 0.0F) {
        sum = batch_.white[i];
        variance = batch_.white_variance[i];
      }
      if (!(sum > options_.min_signal_to_noise * std::sqrt(variance))) Reject(i, SrdReason::kTooDark);
    }
  });
}

}  // namespace stratalux::fit
