// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/face_regions.h"

#include <algorithm>
#include <cmath>

namespace stratalux::rig {
namespace {

// Widths of the soft borders, mm; each lies half inside.
constexpr double kLipBorderMm = 1.0, kLidBorderMm = 4.0, kNoseBorderMm = 5.0, kWideBorderMm = 8.0;

// How far inside the ellipse of `reach` times a bump's half axes, along the line through its centre; mm, negative
// outside.
double Inside(const Bump& bump, double reach, double x, double y) {
  const double dx = x - bump.cx, dy = y - bump.cy;
  const double rho = std::hypot(dx / bump.sx, dy / bump.sy);
  if (rho < 1e-6) return reach * std::min(bump.sx, bump.sy);
  return std::hypot(dx, dy) * (reach / rho - 1.0);
}

// Inside the vermilion: two arcs that meet at the corners of the mouth, the upper one with Cupid's bow. As wide as 1.1
// of the upper lip's bump (a mouth of 48 mm), 6 to 8 mm above and 9 mm below the line between the lips.
double InsideLips(const FaceFeatures& f, double x, double y) {
  const double mouth = 0.5 * (f.upper_lip.cy + f.lower_lip.cy), half = 1.1 * f.upper_lip.sx;
  const double u = x / half, arc = 1.0 - u * u, bow = 1.0 - 0.2 * std::exp(-x * x / 16.0);
  const double above = std::max(0.0, mouth - f.upper_lip.cy);  // 0: drawn the wrong way round (variation 0.2)
  const double top = mouth - (above + 0.6 * f.upper_lip.sy) * arc * bow;
  const double bottom = mouth + (above + 0.7 * f.lower_lip.sy) * arc;
  return std::min(y - top, bottom - y);
}

double InsideLids(const FaceFeatures& f, double x, double y) {
  const Bump eye = {kEyeX, f.lid.cy, kEyeHalfWidth, kEyeHalfHeight, 0.0};
  return std::max(Inside(f.lid, 1.7, std::abs(x), y), Inside(eye, 1.3, std::abs(x), y));
}

double InsideNose(const FaceFeatures& f, double x, double y) {
  return std::max({Inside(f.bridge, 1.0, x, y), Inside(f.tip, 1.1, x, y), Inside(f.wing, 0.9, std::abs(x), y)});
}

double InsideForehead(const FaceFeatures& f, double x, double y) {
  return std::min(f.brow.cy - y, 1.1 * f.brow.sx - std::abs(x));
}

// From below the eye to the jaw's height of the mouth.
double InsideCheek(const FaceFeatures& f, double x, double y) {
  Bump cheek = f.cheekbone;
  cheek.cy += 0.5 * cheek.sy;
  return Inside(cheek, 1.3, std::abs(x), y);
}

// 0 half a border outside, 1 half a border inside, smooth.
double Share(double inside_mm, double border_mm) {
  const double t = std::clamp(inside_mm / border_mm + 0.5, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

}  // namespace

SurfaceClass ClassOf(FaceRegion region) {
  switch (region) {
    case FaceRegion::kForehead:
      return SurfaceClass::kForehead;
    case FaceRegion::kCheek:
      return SurfaceClass::kCheek;
    case FaceRegion::kNose:
      return SurfaceClass::kNose;
    case FaceRegion::kLips:
      return SurfaceClass::kLips;
    case FaceRegion::kEyelids:
      return SurfaceClass::kEyelids;
    case FaceRegion::kChin:
      return SurfaceClass::kChin;
    case FaceRegion::kOther:
      break;
  }
  return SurfaceClass::kSkin;
}

RegionWeights FaceRegions::WeightsAt(double x, double y) const {
  const FaceFeatures& f = features_;
  RegionWeights weights{};
  double left = 1.0;
  // Where regions overlap, the first takes its share and leaves the rest.
  auto take = [&](FaceRegion region, double share) {
    weights[static_cast<size_t>(region)] = left * share;
    left *= 1.0 - share;
  };
  take(FaceRegion::kLips, Share(InsideLips(f, x, y), kLipBorderMm));
  take(FaceRegion::kEyelids, Share(InsideLids(f, x, y), kLidBorderMm));
  take(FaceRegion::kNose, Share(InsideNose(f, x, y), kNoseBorderMm));
  take(FaceRegion::kForehead, Share(InsideForehead(f, x, y), kWideBorderMm));
  take(FaceRegion::kChin, Share(Inside(f.chin, 1.2, x, y), kWideBorderMm));
  take(FaceRegion::kCheek, Share(InsideCheek(f, x, y), kWideBorderMm));
  weights[static_cast<size_t>(FaceRegion::kOther)] = left;
  return weights;
}

FaceRegion FaceRegions::At(double x, double y) const {
  const RegionWeights weights = WeightsAt(x, y);
  return static_cast<FaceRegion>(std::max_element(weights.begin(), weights.end()) - weights.begin());
}

}  // namespace stratalux::rig
