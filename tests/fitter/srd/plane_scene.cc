// SPDX-License-Identifier: Apache-2.0
#include "tests/fitter/srd/plane_scene.h"

#include "shared/geometry/quad.h"

namespace stratalux::fit {

RigCalibration SmallRig() {
  RigCalibration rig;
  rig.camera.model = {kWidth, kHeight, 1600, 1600, (kWidth - 1) / 2.0, (kHeight - 1) / 2.0, {}};
  rig.camera.black_level_dn = 64;
  rig.camera.gain_e_per_dn = 4;
  rig.camera.read_noise_dn = 3;
  ProjectorCalibration p;
  p.name = "left";
  p.model = {1024, 768, 2690, 2690, 511, 384, {}};
  p.camera_from_projector = LookAt({-350, -40, 0}, {0, 0, 700});
  p.white_dn_mm2_per_ms = {1.1e8, 1.2e8, 1.0e8};
  rig.projectors.push_back(p);
  return rig;
}

SurfaceMap Plane(const RigCalibration& rig, double slope) {
  const int w = kWidth / 2, h = kHeight / 2;
  SurfaceMap s{Image<float>(w, h, 3), Image<float>(w, h, 3), Image<float>(w, h, 1, 0.1F), Image<uint8_t>(w, h, 1, 1)};
  const Eigen::Vector3d n = Eigen::Vector3d(slope, 0, -1).normalized();
  for (int j = 0; j < h; ++j)
    for (int i = 0; i < w; ++i) {
      const Eigen::Vector3d ray = rig.camera.model.Unproject(QuadCentre(Cfa::kRggb, i, j));
      const Eigen::Vector3d x = ray * (n.dot(Eigen::Vector3d(0, 0, 700)) / n.dot(ray));
      for (int k = 0; k < 3; ++k) {
        s.point_mm(i, j, k) = static_cast<float>(x[k]);
        s.normal(i, j, k) = static_cast<float>(n[k]);
      }
    }
  return s;
}

}  // namespace stratalux::fit
