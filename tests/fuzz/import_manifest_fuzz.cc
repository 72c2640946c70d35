// SPDX-License-Identifier: Apache-2.0
// Manifests of `stratalux-db import`.
#include "db/interchange/import_manifest.h"
#include "tests/fuzz/target.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  static const fuzz::InputFolder folder;
  const auto file = folder.Put("import.toml", {data, size});
  (void)fuzz::Judge(db::ReadImportManifest({.manifest = file, .root = {}, .pose = {}}));
  (void)fuzz::Judge(db::ReadImportManifest({.manifest = file, .root = "elsewhere", .pose = 1}));
  return 0;
}
