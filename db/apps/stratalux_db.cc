// SPDX-License-Identifier: Apache-2.0
// stratalux-db: the store's command line.
#include <string>

#include "db/apps/command.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

constexpr const char* kExamples = R"(Examples:
  stratalux-db init --store store
  stratalux-db ls --store store
  stratalux-db ls --since 12h --status degraded,failed
  stratalux-db query last-night
  stratalux-db show latest --json
  stratalux-db frames s000017 --phase sweep --projector 2
  stratalux-db frames latest --phase reference --extract pictures
  stratalux-db verify --deep
  stratalux-db export latest --out pictures --format tiff
  stratalux-db backup --store store --to /media/disk/store-backup
  stratalux-db pull --store store --from kiosk@rig-1:/var/lib/stratalux
  stratalux-db import --manifest procam_gray_kamino.toml --root captures --pose 2
  stratalux-db transcode --all --codec delta
  stratalux-db consent give --visitor v-5f3a91c2 --text-version 2026-03 --language de --scope fit,research
  stratalux-db forget s000017 --dry-run
  stratalux-db forget --visitor v-5f3a91c2 --yes
  stratalux-db purge --dry-run --now 2027-01-31
  stratalux-db access s000017
  stratalux-db key export s000017 --out s000017.key
  stratalux-db serve --store store

SESSION is an id, a unique prefix of one, or 'latest'. Without --store, $STRATALUX_STORE names the store.
Exit codes: 0 ok, 1 failed, 2 usage, 3 partial, 4 not found, 5 store busy, 6 damaged, 7 store of a newer program.)";

int Main(int argc, char** argv) {
  CLI::App app("Stratalux's session store: list, show, verify and import sessions");
  app.footer(kExamples);
  app.set_version_flag("--version", std::string("stratalux-db ") + kVersion);
  app.require_subcommand(1);
  Commands commands(app);
  AddViewCommands(commands);
  AddQueryCommands(commands);
  AddStatsCommand(commands);
  AddTransferCommands(commands);
  AddTranscodeCommand(commands);
  AddPrivacyCommands(commands);
  AddForgetCommands(commands);
  AddServeCommand(commands);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    // CLI11's own codes are not ours: any wrong flag is a usage error.
    return app.exit(error) == 0 ? 0 : static_cast<int>(StatusCode::kUsage);
  }
  return commands.Run();
}

}  // namespace
}  // namespace stratalux::db

int main(int argc, char** argv) { return stratalux::db::Main(argc, argv); }
