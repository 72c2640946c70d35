// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/face_skin.h"

#include <algorithm>
#include <cmath>

#include "firmware-host/simulated/skin/skin_table.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr double kVesselSigmaMm = 0.9, kVesselBlood = 3.0;  // blood of a vessel's axis, relative to the skin's
constexpr double kScarSigmaMm = 1.1;
// The axis of scattering that tables are made for.
constexpr double kLeastScattering = 0.5, kMostScattering = 1.1;

double ClampScattering(double scattering, double of_the_face) {
  return std::clamp(scattering, std::min(kLeastScattering, of_the_face), std::max(kMostScattering, of_the_face));
}

SkinFactors LogOf(const SkinFactors& f, double strength) {
  return {strength * std::log(f.epidermis), strength * std::log(f.blood), strength * std::log(f.melanin),
          strength * std::log(f.scattering)};
}

void AddTo(SkinFactors& sum, double weight, const SkinFactors& f) {
  sum.epidermis += weight * f.epidermis;
  sum.blood += weight * f.blood;
  sum.melanin += weight * f.melanin;
  sum.scattering += weight * f.scattering;
}

// Down across forehead and temple.
Polyline WalkVessel(Random& random, double left, double right, double top) {
  Polyline line;
  Eigen::Vector2d at(random.Uniform(left, right), top);
  for (int i = 0; i < 14; ++i) {
    line.push_back(at);
    at += Eigen::Vector2d(random.Uniform(1, 7), random.Uniform(1.5, 6));
  }
  return line;
}

}  // namespace

FaceSkin::FaceSkin(const SkinDescription& skin, const FaceRegions& regions, uint64_t seed)
    : regions_(regions), strength_(skin.regions), cheek_(skin.Of(seed)) {
  Random random(seed, 2);
  // Patches of a few centimetres.
  for (int i = 0; i < 24; ++i) {
    const double x = random.Uniform(-80, 80), y = random.Uniform(-100, 100), s = random.Uniform(12, 35);
    melanin_bumps_.push_back({x, y, s, s, skin.patches * random.Uniform(-0.2, 0.25)});
    blood_bumps_.push_back({y * 0.8, x, s, s, skin.patches * random.Uniform(-0.2, 0.3)});
  }
  // Freckles and moles: small, strong.
  const int by_seed = 30 + static_cast<int>(random.Uniform() * 60);
  const int freckles = skin.freckles.value_or(by_seed);
  for (int i = 0; i < std::max(freckles, by_seed); ++i) {
    const double s = random.Uniform(0.7, 1.8);
    const Bump freckle = {55 * random.Normal(), 25 + 40 * random.Normal(), s, s, random.Uniform(0.4, 2.5)};
    if (i < freckles) melanin_bumps_.push_back(freckle);
  }
  for (const double side : {-1.0, 1.0})
    blood_bumps_.push_back({side * 42, 16, 22, 18, skin.redness * random.Uniform(0.6, 1.4)});
  // Nose and lips: where regions bring blood of their own, only what is left of these.
  const double left = skin.redness * std::max(0.0, 1.0 - skin.regions);
  blood_bumps_.push_back({0, 20, 13, 12, left * random.Uniform(0.3, 0.9)});
  blood_bumps_.push_back({0, 44, 21, 5, left * 2.0});
  blood_bumps_.push_back({0, 53, 18, 5.5, left * 2.2});
  for (int i = 0; i < skin.vessels; ++i)
    vessels_.push_back(i == 0 ? WalkVessel(random, -20, 10, -78)
                              : WalkVessel(random, -55, 30, random.Uniform(-85, 10)));
  if (skin.scar) scar_ = {{24, 12}, {31, 19}, {35, 28}, {44, 33}};
  for (size_t r = 0; r < kFaceRegions; ++r) log_factors_[r] = LogOf(kRegionFactors[r], strength_);
  log_scar_ = LogOf(kScarFactors, strength_);
}

double FaceSkin::ScarAt(double x, double y) const {
  const double distance = DistanceTo(scar_, {x, y});
  return distance < 6.0 ? std::exp(-distance * distance / (2 * kScarSigmaMm * kScarSigmaMm)) : 0.0;
}

SkinParameters FaceSkin::At(double x, double y) const {
  double melanin = cheek_.melanin * std::max(0.3, 1.0 + Sum(melanin_bumps_, x, y));
  double vessel = 0.0;
  for (const Polyline& line : vessels_) {
    const double distance = DistanceTo(line, {x, y});
    if (distance < 5.0)
      vessel = std::max(vessel, kVesselBlood * std::exp(-distance * distance / (2 * kVesselSigmaMm * kVesselSigmaMm)));
  }
  double blood = cheek_.blood * (std::max(0.3, 1.0 + Sum(blood_bumps_, x, y)) + vessel);
  const double scar = ScarAt(x, y);
  melanin *= 1.0 - (1.0 - kScarFactors.melanin) * scar;
  blood *= 1.0 - (1.0 - kScarFactors.blood) * scar;
  double epidermis_mm = cheek_.epidermis_mm, scattering = cheek_.scattering;
  if (strength_ > 0.0) {
    SkinFactors log{0.0, 0.0, 0.0, 0.0};
    const RegionWeights weights = regions_.WeightsAt(x, y);
    for (size_t r = 0; r < kFaceRegions; ++r) AddTo(log, weights[r], log_factors_[r]);
    melanin *= std::exp(log.melanin);
    blood *= std::exp(log.blood);
    epidermis_mm = std::clamp(epidermis_mm * std::exp(log.epidermis + scar * log_scar_.epidermis),
                              SkinGrid::kEpidermisMm.front(), SkinGrid::kEpidermisMm.back());
    scattering =
        ClampScattering(scattering * std::exp(log.scattering + scar * log_scar_.scattering), cheek_.scattering);
  }
  // What the table knows: beyond its ends it would light other skin than is told here.
  const auto within = [](double value, const auto& nodes) {
    return static_cast<float>(std::clamp(value, nodes.front(), nodes.back()));
  };
  SkinParameters here = cheek_;  // the subcutis is the same everywhere
  here.melanin = within(melanin, SkinGrid::kMelanin);
  here.blood = within(blood, SkinGrid::kBlood);
  here.epidermis_mm = static_cast<float>(epidermis_mm);
  here.scattering = static_cast<float>(scattering);
  return here;
}

SurfaceClass FaceSkin::ClassAt(double x, double y) const {
  return ScarAt(x, y) > 0.5 ? SurfaceClass::kScar : ClassOf(regions_.At(x, y));
}

ScatteringRange ScatteringOf(const SkinDescription& skin, uint64_t seed) {
  const double cheek = skin.Of(seed).scattering;
  ScatteringRange range{cheek, cheek};
  auto take = [&](const SkinFactors& f) {
    const double here = ClampScattering(cheek * std::pow(f.scattering, skin.regions), cheek);
    range = {std::min(range.least, here), std::max(range.most, here)};
  };
  for (const SkinFactors& f : kRegionFactors) take(f);
  if (skin.scar) take(kScarFactors);
  return range;
}

}  // namespace stratalux::rig
