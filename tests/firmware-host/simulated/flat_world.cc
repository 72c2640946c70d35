// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/simulated/flat_world.h"

#include <cmath>
#include <numbers>

#include "shared/base/check.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

constexpr double kTilt = 10.0;           // of the scene "plane", degrees
constexpr double kHeightOnAxis = 700.0;  // its depth at x = 0, mm
constexpr double kWhiteDnMm2PerMs = 3500.0 / 16.0 * 700.0 * 700.0;

Scene UniformPlane(const SkinParameters& skin) {
  Scene scene = *Scene::Create("plane", 1);
  scene.UseUniformSkin(skin);
  return scene;
}

}  // namespace

FlatWorld::FlatWorld(const FlatWorldOptions& options)
    : options_(options),
      scene_(UniformPlane(options.skin)),
      table_(*SkinTable::Load(SkinTable::DefaultPath())),
      albedo_(table_) {
  const double tilt = RadFromDeg(kTilt);
  normal_ = {std::sin(tilt), 0.0, -std::cos(tilt)};
  tangent_ = {std::cos(tilt), 0.0, std::sin(tilt)};
  // The camera, at the origin, sees the aim along -(cos v n + sin v t).
  const double height = kHeightOnAxis * std::cos(tilt);
  const Eigen::Vector3d aim = -height * (normal_ + std::tan(RadFromDeg(options.view_deg)) * tangent_);
  CameraCalibration& camera = rig_.camera;
  const double f = 700.0 * options.camera_width / 300.0;
  const int height_px = options.camera_width * 3 / 4;
  camera.model = {options.camera_width, height_px, f, f, 0.0, 0.0, {}};
  // The principal point puts the aim on the centre of a pixel with even coordinates.
  const Eigen::Vector2d offset = f * aim.head<2>() / aim.z();
  aim_px_ = {static_cast<int>(options.camera_width / 2.0 + offset.x()) / 2 * 2, height_px / 4 * 2};
  camera.model.cx = aim_px_.x() - offset.x();
  camera.model.cy = aim_px_.y() - offset.y();
  camera.cfa = options.cfa;
  camera.gain_e_per_dn = 4.0;

  const double light = RadFromDeg(options.light_deg), turn = RadFromDeg(options.light_row_deg);
  const Eigen::Vector3d side = std::cos(turn) * tangent_ + std::sin(turn) * Eigen::Vector3d::UnitY();
  ProjectorCalibration projector;
  projector.name = "lamp";
  const double centre = (options.projector_px - 1) / 2.0;
  projector.model = {options.projector_px, options.projector_px, 2690.0, 2690.0, centre, centre, {}};
  projector.camera_from_projector =
      LookAt(aim + options.light_mm * (std::cos(light) * normal_ + std::sin(light) * side), aim);
  projector.line_blur_px = options.line_blur_px;
  projector.white_dn_mm2_per_ms = {kWhiteDnMm2PerMs, kWhiteDnMm2PerMs, kWhiteDnMm2PerMs};
  rig_.projectors.push_back(projector);
}

SubjectPixel FlatWorld::Pixel(int dx, int dy) const {
  SubjectPixel pixel;
  pixel.x = aim_px_.x() + dx;
  pixel.y = aim_px_.y() + dy;
  const Eigen::Vector3d ray = rig_.camera.model.Unproject({double(pixel.x), double(pixel.y)});
  pixel.point = ray * (kHeightOnAxis * normal_.z() / normal_.dot(ray));
  pixel.normal = normal_;
  pixel.material = Material::Skin(options_.skin);
  return pixel;
}

LightTransport FlatWorld::Transport(const std::vector<SubjectPixel>& pixels, LightTransportOptions options) const {
  return {scene_, table_, albedo_, rig_, 0, pixels, options};
}

double FlatWorld::Irradiance(const Eigen::Vector3d& point, int colour) const {
  const Eigen::Vector3d to_light = projector().CentreInCamera() - point;
  const double d = to_light.norm();
  return projector().white_dn_mm2_per_ms[colour] * normal_.dot(to_light) / (d * d * d) *
         projector().Falloff(*projector().ProjectFromCamera(point));
}

FlatWorld::LocalKernel FlatWorld::KernelAt(const SubjectPixel& pixel) const {
  const Eigen::Vector3d in = (projector().CentreInCamera() - pixel.point).normalized();
  const Eigen::Vector3d out = -pixel.point.normalized();
  const Eigen::Vector3d in_t = in - normal_.dot(in) * normal_, out_t = out - normal_.dot(out) * normal_;
  LocalKernel local;
  local.x = in_t.norm() > 1e-6 ? in_t.normalized() : tangent_;
  local.y = normal_.cross(local.x);
  if (out_t.dot(local.y) < 0.0) local.y = -local.y;
  const double azimuth = std::atan2(out_t.dot(local.y), out_t.dot(local.x));
  table_.Interpolate(CfaColour(rig_.camera.cfa, pixel.x, pixel.y), pixel.material.skin,
                     {static_cast<float>(std::acos(std::min(1.0, normal_.dot(in)))),
                      static_cast<float>(std::acos(std::min(1.0, normal_.dot(out)))), static_cast<float>(azimuth)},
                     local.kernel);
  return local;
}

std::vector<double> FlatWorld::ColumnResponse(const SubjectPixel& pixel) const {
  constexpr int kFootprint = 5, kAngles = 96;
  constexpr double kFirst = 0.002, kRatio = 1.04;
  const LocalKernel local = KernelAt(pixel);
  const int colour = CfaColour(rig_.camera.cfa, pixel.x, pixel.y);
  std::vector<double> response(projector().model.width, 0.0);
  for (int j = 0; j < kFootprint; ++j)
    for (int i = 0; i < kFootprint; ++i) {
      const Eigen::Vector3d ray =
          rig_.camera.model.Unproject({pixel.x + (i + 0.5) / kFootprint - 0.5, pixel.y + (j + 0.5) / kFootprint - 0.5});
      const Eigen::Vector3d leave = ray * (kHeightOnAxis * normal_.z() / normal_.dot(ray));
      double inner = 0.0, outer = kFirst;
      for (int ring = 0; inner < SkinGrid::kMaxRadiusMm; ++ring) {
        const double r = inner > 0.0 ? std::sqrt(inner * outer) : outer / 2.0;
        const double area = std::numbers::pi * (outer * outer - inner * inner) / kAngles;
        for (int k = 0; k < kAngles; ++k) {
          const double psi = 2.0 * std::numbers::pi * (k + 0.618 * ring) / kAngles;
          const double x = r * std::cos(psi), y = r * std::sin(psi);
          const Eigen::Vector3d enter = leave - x * local.x - y * local.y;
          const auto at = projector().ProjectFromCamera(enter);
          if (!at || !projector().model.Contains(*at)) continue;
          response[std::lround(at->x())] += std::numbers::pi *
                                            local.kernel(static_cast<float>(x), static_cast<float>(y)) * area *
                                            Irradiance(enter, colour) / (kFootprint * kFootprint);
        }
        inner = outer;
        outer *= kRatio;
      }
    }
  return response;
}

std::vector<std::vector<double>> RenderedColumnResponses(const LightTransport& transport, size_t pixels, int columns) {
  std::vector<std::vector<double>> responses(pixels, std::vector<double>(columns));
  for (int c = 0; c < columns; ++c) {
    std::vector<float> subsurface(pixels, 0.0F), direct(pixels, 0.0F);
    transport.Render({.kind = PatternKind::kComb, .period = columns, .width = 1, .shift = c}, subsurface, direct);
    for (size_t i = 0; i < pixels; ++i) responses[i][c] = subsurface[i];
  }
  return responses;
}

}  // namespace stratalux::rig
