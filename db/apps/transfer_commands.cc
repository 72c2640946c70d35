// SPDX-License-Identifier: Apache-2.0
// `stratalux-db import`: what comes into a store and leaves it.
#include <memory>
#include <optional>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/interchange/import.h"

namespace stratalux::db {
namespace {

struct ImportFlags {
  std::string manifest, root;
  std::optional<int> pose;
};

int RunImport(const CommonFlags& common, const ImportFlags& flags) {
  auto store = OpenStore(common, AccessMode::kReadWrite);
  if (!store.ok()) return Report(store.status());
  Logger logger;
  const auto report = ImportSession(*store, {flags.manifest, flags.root, flags.pose}, logger);
  if (!report.ok()) return Report(report.status());
  const nlohmann::ordered_json json = {{"session", report->session}, {"frames", report->frames}};
  return Print(common.json ? TextOf(json)
                           : "session " + report->session + ": " + std::to_string(report->frames) + " frames\n");
}

}  // namespace

void AddTransferCommands(Commands& commands) {
  const auto flags = std::make_shared<ImportFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* import = commands.Add("import", "Store image files of another rig as a session",
                                  [&common, flags] { return RunImport(common, *flags); });
  import->add_option("--manifest", flags->manifest, "TOML file (docs/file-formats.md)")->required();
  import->add_option("--root", flags->root, "folder of the image files (default: the manifest's)");
  import->add_option("--pose", flags->pose, "this pose only (default: all)");
}

}  // namespace stratalux::db
