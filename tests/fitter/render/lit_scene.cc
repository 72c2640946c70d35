// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/render/lit_scene.h"

#include <cmath>

#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr int kQuadsWide = 48, kQuadsHigh = 36;

// Newton's method for the range along a camera ray where it meets the field.
Eigen::Vector3d Meet(const HeightField& field, const Eigen::Vector3d& ray) {
  double range = kDistanceMm / ray.z();
  for (int i = 0; i < 30; ++i) {
    const Eigen::Vector3d p = range * ray;
    const Height h = field(p.x(), p.y());
    range -= (p.z() - h.z) / (ray.z() - h.dz_dx * ray.x() - h.dz_dy * ray.y());
  }
  return range * ray;
}

SurfaceMap Sample(const RigCalibration& rig, const HeightField& field) {
  SurfaceMap s{Image<float>(kQuadsWide, kQuadsHigh, 3), Image<float>(kQuadsWide, kQuadsHigh, 3),
               Image<float>(kQuadsWide, kQuadsHigh, 1, 0.05F), Image<uint8_t>(kQuadsWide, kQuadsHigh, 1, 1)};
  for (int j = 0; j < kQuadsHigh; ++j)
    for (int i = 0; i < kQuadsWide; ++i) {
      const Eigen::Vector3d p = Meet(field, rig.camera.model.Unproject(QuadCentre(rig.camera.cfa, i, j)));
      const Height h = field(p.x(), p.y());
      const Eigen::Vector3d n = Eigen::Vector3d(h.dz_dx, h.dz_dy, -1.0).normalized();
      for (int k = 0; k < 3; ++k) {
        s.point_mm(i, j, k) = static_cast<float>(p[k]);
        s.normal(i, j, k) = static_cast<float>(n[k]);
      }
    }
  return s;
}

}  // namespace

HeightField FrontalPlane() {
  return [](double, double) { return Height{kDistanceMm, 0.0, 0.0}; };
}

HeightField FaceLike() {
  return [](double x, double y) {
    constexpr double kRadius = 70.0, kNose = 7.0, kNoseX = 4.5, kNoseY = 8.0;
    const double nose = kNose * std::exp(-0.5 * (x * x / (kNoseX * kNoseX) + y * y / (kNoseY * kNoseY)));
    return Height{kDistanceMm + 0.5 * (x * x + y * y) / kRadius - nose, x / kRadius + nose * x / (kNoseX * kNoseX),
                  y / kRadius + nose * y / (kNoseY * kNoseY)};
  };
}

LitScene MakeScene(const HeightField& field, const Eigen::Vector3d& lamp_mm, Cfa cfa, double light_blur_px) {
  LitScene scene;
  const int step = QuadStep(cfa), width = step * kQuadsWide, height = step * kQuadsHigh;
  const double f = kDistanceMm / kMosaicPixelMm;
  scene.rig.camera.model = {width, height, f, f, 0.5 * (width - 1), 0.5 * (height - 1), {}};
  scene.rig.camera.cfa = cfa;
  const Eigen::Vector3d middle(0.0, 0.0, kDistanceMm);
  ProjectorCalibration light;
  light.camera_from_projector = LookAt(lamp_mm, middle);
  const double f_light = (lamp_mm - middle).norm() / kLightPixelMm;
  light.model = {160, 120, f_light, f_light, 79.5, 59.5, {}};
  light.line_blur_px = light_blur_px;
  light.white_dn_mm2_per_ms = {8e7, 1e8, 6e7};
  scene.rig.projectors = {light};
  scene.surface = Sample(scene.rig, field);
  scene.lit = BuildLitSurface(scene.surface, light, kExposureMs);
  return scene;
}

MixtureMap UniformSkin(const LitScene& scene, const std::vector<Layer>& layers) {
  MixtureMap map;
  map.width = scene.surface.width();
  map.height = scene.surface.height();
  map.channels = QuadChannels(scene.rig.camera.cfa);
  map.layers = static_cast<int>(layers.size());
  map.scattering.tau = 0.2;
  map.training_projectors = {0};
  for (int64_t i = 0; i < map.profiles(); ++i)
    for (const Layer& l : layers) {
      map.weight.push_back(l.weight);
      map.depth_mm.push_back(l.depth_mm);
      map.sigma_mm.push_back(l.sigma_mm);
    }
  map.surface.assign(map.profiles(), 0.0F);
  map.background.assign(map.profiles(), 0.0F);
  map.divergence.assign(map.profiles(), 0.0F);
  map.iterations.assign(map.profiles(), 1);
  map.reason.assign(map.profiles(), static_cast<uint8_t>(FitReason::kFitted));
  return map;
}

MixtureMap VaryingSkin(const LitScene& scene, const std::vector<Layer>& layers) {
  MixtureMap map = UniformSkin(scene, layers);
  for (int j = 0; j < map.height; ++j)
    for (int i = 0; i < map.width; ++i)
      for (int c = 0; c < map.channels; ++c)
        for (int l = 0; l < map.layers; ++l) {
          const auto wave = [&](double a, double b) {
            return static_cast<float>(1.0 + 0.5 * std::sin(a * i + b * j + 1.7 * l + c));
          };
          const int64_t at = map.ProfileIndex(i, j, c) * map.layers + l;
          map.weight[at] *= wave(0.31, 0.17);
          map.depth_mm[at] *= wave(-0.11, 0.23);
          map.sigma_mm[at] *= wave(0.13, -0.19);
        }
  return map;
}

std::vector<Layer> SkinLayers() {
  return {{0.08F, 0.1F, 0.3F}, {0.14F, 0.4F, 0.8F}, {0.16F, 0.9F, 1.6F}, {0.10F, 1.5F, 3.0F}};
}

Pattern MiddleLine(const LitScene& scene, int width) {
  const int columns = scene.lit.light.model.width;
  return {.kind = PatternKind::kComb, .period = columns, .width = width, .shift = (columns - width) / 2};
}

}  // namespace stratalux::fit
