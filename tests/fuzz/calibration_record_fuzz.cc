// SPDX-License-Identifier: Apache-2.0
// Calibration records: of a manifest, and FILE.json of `capture --calibration`.
#include "shared/capture/rig_calibration.h"
#include "tests/fuzz/target.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  const auto record = RigCalibration::FromJson(fuzz::TextOf(data, size));
  if (!fuzz::Judge(record)) return 0;
  const Eigen::Vector3d face(10.0, -20.0, 700.0);
  (void)record->camera.LinearDn(100.0);
  (void)record->camera.Vignetting(3.0, 4.0);
  (void)record->camera.model.Unproject({1.0, 2.0});
  for (const ProjectorCalibration& p : record->projectors) {
    (void)p.WhiteTargetDn(face, {0.0, 0.0, -1.0}, 1, 16.0);
    (void)p.SinusoidAmplitude();
    (void)p.model.Unproject({1.0, 2.0});
  }
  (void)fuzz::Judge(RigCalibration::FromJson(record->ToJson()));
  return 0;
}
