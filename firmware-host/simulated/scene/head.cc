// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/head.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kIrisRadius = 5.9, kPupilRadius = 1.9;
constexpr double kPorePitch = 0.9, kPoreSigma = 0.12, kPoresHalfMm = 120.0;
constexpr double kHairline = -84.0;  // y of the hair's edge above the nose
// A nostril seen from the front: shallow, since the head has no inside. Its dark part reaches to 1.2 of the pit's half
// axes; what little leaves a cavity of skin is reddish.
constexpr double kNostrilHalfWidthMm = 3.0, kNostrilHalfHeightMm = 1.7, kNostrilDepthMm = 1.5, kNostrilReach = 1.2;
constexpr std::array<float, 3> kNostrilAlbedo = {0.03F, 0.012F, 0.01F};

// Brow hairs lie outwards, head hair upwards, a beard's stubble down.
constexpr HairField kBrowHair = {
    .per_cm2 = 330.0, .length_mm = 6.0, .width_mm = 0.12, .direction_rad = 0.25, .surface = SurfaceClass::kBrow};
constexpr HairField kHeadHair = {.per_cm2 = 800.0, .length_mm = 5.0, .width_mm = 0.2, .direction_rad = -1.5};
constexpr double kStubbleWidthMm = 0.11, kStubbleDirectionRad = 1.4;
constexpr double kPi = 3.141592653589793;

Material Hair(SurfaceClass surface) {
  return Material::Opaque(MaterialKind::kHair, {0.035F, 0.025F, 0.02F}, 0.5F, 0.35F, surface);
}

bool InBrow(double x, double y) {
  const double u = (std::abs(x) - 32.0) / 20.0;
  const double centre = -36.0 - 4.0 * (1.0 - u * u), half = 4.2 * (1.0 - 0.6 * std::max(0.0, u));
  return std::abs(u) < 1.0 && std::abs(y - centre) < half * std::sqrt(1.0 - u * u * u * u);
}

bool InBeard(double x, double y) {
  const bool lips = std::pow(x / 24.0, 2) + std::pow((y - 48.0) / 11.0, 2) < 1.0;
  const bool above_lip = std::abs(x) < 24.0 && y > 29.0;
  const bool jaw = y > 38.0 + 0.004 * (60.0 - std::abs(x)) * (60.0 - std::abs(x)) - 14.0 && std::abs(x) > 20.0;
  return !lips && (above_lip || jaw || y > 58.0);
}

// Between the tip of the nose and its wing, where the tip turns under.
Bump NostrilOf(const FaceFeatures& f) {
  return {0.5 * f.wing.cx, f.tip.cy + 0.8 * f.tip.sy, kNostrilHalfWidthMm, kNostrilHalfHeightMm, -kNostrilDepthMm};
}

}  // namespace

Head::Head(const HeadDescription& description, const FaceFeatures& features, FaceSkin skin, const FaceSurface& surface,
           uint64_t seed)
    : description_(description),
      features_(features),
      skin_(std::move(skin)),
      surface_(surface),
      seed_(seed),
      bumps_(features.Bumps()),
      nostril_(NostrilOf(features)),
      eye_y_(features.lid.cy) {
  if (description_.nostrils) bumps_.insert(bumps_.end(), {nostril_, Mirrored(nostril_)});
  if (description_.wrinkles_mm > 0.0) AddWrinkles();
  if (description_.pores_mm > 0.0) AddPores();
  GrowHair();
  Tabulate();
}

void Head::AddWrinkles() {
  Random random(seed_, 3);
  auto add = [&](Polyline line, double sigma_mm, double share) {
    Eigen::AlignedBox2d reach;
    for (const auto& p : line) reach.extend(p);
    const Eigen::Vector2d margin = Eigen::Vector2d::Constant(4.0 * sigma_mm);
    wrinkles_.push_back({std::move(line), sigma_mm, share * description_.wrinkles_mm,
                         Eigen::AlignedBox2d(reach.min() - margin, reach.max() + margin)});
  };
  for (int i = 0; i < 4; ++i) {  // forehead
    Polyline line;
    const double y = -52.0 - 7.0 * i + random.Uniform(-1, 1), half = 38.0 - 4.0 * i;
    for (double x = -half; x <= half; x += 6.0)
      line.emplace_back(x, y + 2.5 * std::cos(x / 14.0) + random.Uniform(-0.4, 0.4));
    add(std::move(line), 0.8, random.Uniform(0.5, 1.0));
  }
  for (const double side : {-1.0, 1.0}) {
    for (int i = 0; i < 3; ++i) {  // crow's feet
      const double angle = -0.35 + 0.35 * i + random.Uniform(-0.1, 0.1);
      const Eigen::Vector2d from(side * 46.0, eye_y_ + 1.0), along(side * std::cos(angle), std::sin(angle));
      add({from, from + 6.0 * along, from + 12.0 * along + Eigen::Vector2d(0, 0.8)}, 0.5, 0.6);
    }
    add({{side * 17, 24}, {side * 23, 32}, {side * 28, 42}, {side * 30, 52}}, 1.2, 1.0);  // beside the nose
    for (int i = 0; i < 2; ++i)                                                           // under the eye
      add({{side * 20.0, eye_y_ + 9 + 3.0 * i},
           {side * 31.0, eye_y_ + 12 + 3.0 * i},
           {side * 42.0, eye_y_ + 9 + 3.0 * i}},
          0.6, 0.4);
  }
}

double Head::Height(double x, double y) const {
  const double u = x / features_.radius_x_mm, v = y / features_.radius_y_mm;
  if (std::abs(u) >= 1.0 || std::abs(v) >= 1.0) return kNaN;
  // A superellipse keeps the forehead and cheeks fuller than an ellipsoid.
  const double q = 1.0 - std::pow(u * u, 1.15) - std::pow(v * v, 1.25);
  if (!(q > 0.0)) return kNaN;
  double height = centre_z_ - features_.radius_z_mm * std::sqrt(q) - Sum(bumps_, x, y);
  for (const Wrinkle& w : wrinkles_) {
    if (!w.reach.contains(Eigen::Vector2d(x, y))) continue;
    const double distance = DistanceTo(w.line, {x, y});
    height += w.depth_mm * std::exp(-0.5 * distance * distance / (w.sigma_mm * w.sigma_mm));
  }
  if (description_.pores_mm > 0.0) height += description_.pores_mm * Pores(x, y);
  return height;
}

void Head::AddPores() {
  const int size = static_cast<int>(2 * kPoresHalfMm / kPorePitch);
  pores_ = Image<float>(size, size, 3);
  Random random(seed_, 4);
  for (int j = 0; j < size; ++j)
    for (int i = 0; i < size; ++i) {
      pores_(i, j, 0) = static_cast<float>((i + random.Uniform()) * kPorePitch - kPoresHalfMm);
      pores_(i, j, 1) = static_cast<float>((j + random.Uniform()) * kPorePitch - kPoresHalfMm);
      pores_(i, j, 2) = static_cast<float>(random.Uniform(0.3, 1.0));
    }
}

// Small pits, one in each cell of a jittered lattice; 0 .. about 1.
double Head::Pores(double x, double y) const {
  const int column = static_cast<int>(std::floor((x + kPoresHalfMm) / kPorePitch)),
            row = static_cast<int>(std::floor((y + kPoresHalfMm) / kPorePitch));
  double sum = 0.0;
  for (int j = row - 1; j <= row + 1; ++j)
    for (int i = column - 1; i <= column + 1; ++i) {
      if (!pores_.contains(i, j)) continue;
      const double dx = pores_(i, j, 0) - x, dy = pores_(i, j, 1) - y;
      const double q = 0.5 * (dx * dx + dy * dy) / (kPoreSigma * kPoreSigma);
      if (q < 12.0) sum += pores_(i, j, 2) * std::exp(-q);
    }
  return sum;
}

void Head::GrowHair() {
  if (description_.brows)
    for (const double side : {-1.0, 1.0}) {
      HairField field = kBrowHair;
      if (side < 0) field.direction_rad = kPi - field.direction_rad;
      hairs_.Grow(field, seed_, side < 0 ? 6 : 7, [side](double x, double y) { return side * x > 0 && InBrow(x, y); });
    }
  if (description_.hair)
    hairs_.Grow(kHeadHair, seed_, 8, [](double x, double y) { return y < kHairline + 0.008 * x * x; });
  if (description_.stubble_per_cm2 > 0.0)
    hairs_.Grow({description_.stubble_per_cm2, description_.stubble_mm, kStubbleWidthMm, kStubbleDirectionRad,
                 SurfaceClass::kStubble},
                seed_, 9, InBeard);
}

std::optional<Material> Head::EyeAt(double x, double y) const {
  const double u = std::abs(x) - kEyeX, v = y - eye_y_;
  const double q = u / kEyeHalfWidth;
  if (std::abs(q) >= 1.0 || std::abs(v) >= kEyeHalfHeight * (1.0 - q * q)) return std::nullopt;
  const double r = std::hypot(u, v + 0.6);
  Random random(seed_, 5);
  Material eye = Material::Opaque(MaterialKind::kEye, {0.62F, 0.55F, 0.5F}, 0.9F, 0.08F, SurfaceClass::kEye);
  if (r < kIrisRadius) {  // brown to blue
    const auto t = static_cast<float>(random.Uniform());
    eye.albedo = {0.12F - 0.06F * t, 0.06F + 0.05F * t, 0.03F + 0.11F * t};
  }
  if (r < kPupilRadius) eye.albedo = {0.005F, 0.005F, 0.005F};
  return eye;
}

bool Head::InNostril(double x, double y) const {
  return std::hypot((std::abs(x) - nostril_.cx) / nostril_.sx, (y - nostril_.cy) / nostril_.sy) < kNostrilReach;
}

Material Head::MaterialAt(const Eigen::Vector3d& point, EyeLids lids) const {
  const double x = point.x(), y = point.y();
  if (description_.eyes == Eyes::kOpen && lids == EyeLids::kAsDescribed)
    if (const auto eye = EyeAt(x, y)) return *eye;
  if (description_.nostrils && InNostril(x, y))
    return Material::Opaque(MaterialKind::kMatt, kNostrilAlbedo, 0.0F, 1.0F, SurfaceClass::kNostril);
  if (const SurfaceClass hair = hairs_.At(x, y); hair != SurfaceClass::kNone) return Hair(hair);
  // The slit of a closed eye: lashes.
  if (description_.eyes != Eyes::kNone) {
    const double q = (std::abs(x) - kEyeX) / kEyeHalfWidth;
    if (std::abs(q) < 1.0 && std::abs(y - eye_y_ - 0.8 * kEyeHalfHeight * (1.0 - q * q)) < 0.5)
      return Hair(SurfaceClass::kLashes);
  }
  return Material::Skin(skin_.At(x, y), surface_.At(x, y), skin_.ClassAt(x, y));
}

}  // namespace stratalux::rig
