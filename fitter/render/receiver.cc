// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/receiver.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "fitter/mixture/normal_table.h"
#include "shared/geometry/pixel_box.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

Eigen::Vector3d ShiftVector(ShiftLaw law, const Eigen::Vector3d& omega, const Eigen::Vector3d& n, double eta) {
  const Eigen::Vector3d t = omega / n.dot(omega) - n;
  const double slope = t.norm();
  if (slope < 1e-9) return Eigen::Vector3d::Zero();
  return t / slope * TangentialShift(law, slope, 0.0, eta);
}

}  // namespace

std::vector<PixelPart> PixelParts(const SurfaceMap& surface, const RigCalibration& rig,
                                  const ProjectorCalibration& light, int i, int j,
                                  std::span<const Eigen::Vector2d> sites) {
  const QuadPlane plane(surface, rig, i, j);
  const Eigen::Vector2d centre = QuadCentre(rig.camera.cfa, i, j);
  const auto middle = light.ProjectFromCamera(plane.At(centre));
  const auto is_long = [&](const Eigen::Vector2d& axis) {
    const auto beside = light.ProjectFromCamera(plane.At(centre + axis));
    return middle && beside && IsLongBox((*beside - *middle).norm(), light.line_blur_px * light.line_blur_px);
  };
  const std::array<bool, 2> split = {is_long({1, 0}), is_long({0, 1})};
  std::vector<PixelPart> parts;
  for (const Eigen::Vector2d& site : sites)
    for (int x = split[0] ? -1 : 0; x <= 1; x += 2)
      for (int y = split[1] ? -1 : 0; y <= 1; y += 2)
        parts.push_back({site + kHalfBoxPlace * Eigen::Vector2d(x, y),
                         {split[0] ? kHalfBoxVariance : kBoxVariance, split[1] ? kHalfBoxVariance : kBoxVariance}});
  for (PixelPart& part : parts) part.share = 1.0 / static_cast<double>(parts.size());
  return parts;
}

std::optional<Receiver> MakeReceiver(const ScatteringModel& model, const SurfaceMap& surface, const RigCalibration& rig,
                                     const ProjectorCalibration& light, int i, int j, const PixelPart& part) {
  Receiver r;
  r.normal = surface.Normal(i, j);
  const QuadPlane plane(surface, rig, i, j);
  const Eigen::Vector2d site = QuadCentre(rig.camera.cfa, i, j) + part.site;
  r.point = plane.At(site);
  const Eigen::Vector3d in = (light.CentreInCamera() - r.point).normalized(), out = -r.point.normalized();
  const double cos_in = r.normal.dot(in), cos_out = r.normal.dot(out);
  if (cos_in < 0.02 || cos_out < 0.02) return std::nullopt;
  r.shift =
      ShiftVector(model.shift_law, in, r.normal, model.eta) - ShiftVector(model.shift_law, out, r.normal, model.eta);
  r.gain = AngularGain(model, cos_in);
  r.directions = DirectionsOf(in, out, r.normal, model.eta);
  const Eigen::Vector2d square_mm((plane.At(site + Eigen::Vector2d(1, 0)) - r.point).squaredNorm(),
                                  (plane.At(site + Eigen::Vector2d(0, 1)) - r.point).squaredNorm());
  const double optics = rig.camera.line_blur_px * rig.camera.line_blur_px;
  r.footprint2 = 0.5 * (part.variance_px2.array() + optics).matrix().dot(square_mm);
  // Mean pitch of the light's pixels: distance / focal length, stretched by the tilt along one axis.
  const double distance = (light.CentreInCamera() - r.point).norm();
  r.pitch_mm = distance / std::sqrt(light.model.fx * light.model.fy) / std::sqrt(cos_in);
  r.narrowest2 = std::pow(0.55 * r.pitch_mm, 2) / cos_in;
  const Rigid3& pose = light.camera_from_projector;
  const Eigen::Vector3d in_light = pose.Inverse() * r.point;
  r.point_in_light = in_light;
  r.shift_in_light = pose.rotation.conjugate() * r.shift;
  r.column_per_mm =
      light.model.fx / in_light.z() * (pose.rotation * Eigen::Vector3d(1.0, 0.0, -in_light.x() / in_light.z()));
  r.row_per_mm =
      light.model.fy / in_light.z() * (pose.rotation * Eigen::Vector3d(0.0, 1.0, -in_light.y() / in_light.z()));
  return r;
}

bool InShadow(const LitSurface& lit, const Eigen::Vector2d& at, const Eigen::Vector3d& point) {
  constexpr double kSamePlaceMm = 3.0;
  const LitSample& s = lit.samples(std::clamp(static_cast<int>(std::lround(at.x())), 0, lit.samples.width() - 1),
                                   std::clamp(static_cast<int>(std::lround(at.y())), 0, lit.samples.height() - 1));
  const bool lit_there = std::ranges::any_of(s.flux, [](float flux) { return flux > 0.0F; });
  return lit_there && (point - lit.light.CentreInCamera()).norm() >
                          (s.point_mm.cast<double>() - lit.light.CentreInCamera()).norm() + kSamePlaceMm;
}

PixelShares::PixelShares(double mean, double sigma) {
  const int reach = static_cast<int>(std::ceil(4.0 * sigma + 0.5));
  first = static_cast<int>(std::lround(mean)) - reach;
  const double inverse = 1.0 / sigma;
  auto below = [&](double x) { return NormalBelow((x - mean) * inverse); };
  share.reserve(static_cast<size_t>(2 * reach + 1));
  double last = below(first - 0.5);
  for (int k = 0; k <= 2 * reach; ++k) {
    const double next = below(first + k + 0.5);
    share.push_back(next - last);
    last = next;
  }
}

std::pair<int, int> PixelShares::Read(int pixels) const {
  const int last = first + static_cast<int>(share.size()) - 1;
  return {std::clamp(first, 0, pixels - 1), std::clamp(last, 0, pixels - 1)};
}

double ShownTo(const PixelShares& columns, const PixelShares& rows, const Image<float>& shown, const BlockWindow& lit) {
  const auto [x0, x1] = columns.Read(shown.width());
  const auto [y0, y1] = rows.Read(shown.height());
  if (BlockWindow{x0, x1, y0, y1}.Within(lit).Empty()) return 0.0;
  const auto count = static_cast<int>(columns.share.size());
  const bool inside = columns.first >= 0 && columns.first + count <= shown.width();
  double sum = 0.0;
  for (size_t j = 0; j < rows.share.size(); ++j) {
    const float* pixels = shown.row(std::clamp(rows.first + static_cast<int>(j), 0, shown.height() - 1));
    double row = 0.0;
    if (inside) {
      pixels += columns.first;
      for (int i = 0; i < count; ++i) row += columns.share[i] * pixels[i];
    } else {
      for (int i = 0; i < count; ++i)
        row += columns.share[i] * pixels[std::clamp(columns.first + i, 0, shown.width() - 1)];
    }
    sum += rows.share[j] * row;
  }
  return sum;
}

double NarrowLayer::PixelSigma(const Receiver& receiver, const LitSurface& lit, const Eigen::Vector3d& per_mm,
                               double variance) {
  const double along_normal = receiver.normal.dot(per_mm), optics = lit.light.line_blur_px;
  return std::sqrt(std::max(per_mm.squaredNorm() - along_normal * along_normal, 1e-12) * variance + optics * optics);
}

NarrowLayer::NarrowLayer(const Receiver& receiver, const LitSurface& lit, const Eigen::Vector3d& centre,
                         const Eigen::Vector2d& at, double variance, int channel)
    : columns_(at.x(), PixelSigma(receiver, lit, receiver.column_per_mm, variance)),
      rows_(at.y(), PixelSigma(receiver, lit, receiver.row_per_mm, variance)) {
  if (lit.light.model.Contains(at) && !InShadow(lit, at, centre))
    white_dn_ = lit.light.WhiteTargetDn(centre, receiver.normal, channel, lit.exposure_ms);
}

double NarrowLayer::Under(const Image<float>& shown, const BlockWindow& lit) const {
  return white_dn_ == 0.0 ? 0.0 : white_dn_ * ShownTo(columns_, rows_, shown, lit);
}

}  // namespace stratalux::fit
