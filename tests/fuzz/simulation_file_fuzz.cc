// SPDX-License-Identifier: Apache-2.0
// Scene files of `--simulate=FILE.toml`; and faults as `--fault` takes them.
#include "firmware-host/simulated/simulation_file.h"
#include "tests/fuzz/target.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  static const fuzz::InputFolder folder;
  (void)fuzz::Judge(rig::ParseFault(fuzz::TextOf(data, size)));
  auto simulation = rig::LoadSimulation(folder.Put("scene.toml", {data, size}).string());
  if (!fuzz::Judge(simulation)) return 0;
  fuzz::Judge(simulation->scene.TakePose(1));
  const rig::FaultScript faults(simulation->faults);
  for (const int64_t number : {0, 17}) {
    (void)faults.AtExposure(number);
    (void)faults.AtPulse(number);
  }
  return 0;
}
