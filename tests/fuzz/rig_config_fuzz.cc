// SPDX-License-Identifier: Apache-2.0
// /etc/stratalux/rig.toml, read by the controller and by stratalux-db.
#include "firmware-host/config/rig_config.h"
#include "shared/config/store_config.h"
#include "tests/fuzz/target.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  static const fuzz::InputFolder folder;
  const auto config = rig::ParseRigConfig(fuzz::TextOf(data, size), "rig.toml");
  if (fuzz::Judge(config)) (void)rig::MemoryTimingsOf(*config);
  (void)fuzz::Judge(LoadStoreConfig(folder.Put("rig.toml", {data, size})));
  return 0;
}
