// SPDX-License-Identifier: Apache-2.0
// stratalux-db: the store's command line.
#include <cstdio>
#include <sstream>
#include <string>

#include "db/apps/command.h"
#include "db/apps/display_text.h"
#include "shared/base/finite_options.h"
#include "shared/base/mistyped_command.h"
#include "shared/base/version.h"
#include "shared/manual/manual.h"

namespace stratalux::db {
namespace {

constexpr const char* kExamples = R"(Examples:
  stratalux-db init --store store
  stratalux-db ls --store store
  stratalux-db ls --since 12h --status degraded,failed
  stratalux-db query last-night
  stratalux-db show latest --json
  stratalux-db frames latest --phase sweep --projector 2
  stratalux-db verify --deep
  stratalux-db export latest --out pictures --format tiff
  stratalux-db backup --store store --to /media/disk/store-backup
  stratalux-db pull --store store --from kiosk@rig-1:/var/lib/stratalux/store
  stratalux-db consent give --visitor v-5f3a91c2 --text-version 2026-03 --language de --scope fit,research
  stratalux-db forget s000017 --dry-run
  stratalux-db serve --store store
Each command has examples of its own: stratalux-db forget --help

SESSION is an id, a unique prefix of one, or 'latest'. Without --store, $STRATALUX_STORE names the store.
Exit codes: 0 ok, 1 failed, 2 usage, 3 partial, 4 not found, 5 store busy, 6 damaged, 7 store of a newer version.)";

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
  AddKeyCommand(commands);
  AddForgetCommands(commands);
  AddServeCommand(commands);
  RangesTakeFiniteNumbers(app);
  if (const auto manual = AskedManual(app, "stratalux-db", argc, argv)) return PrintBytes(*manual);
  if (const std::string mistyped = MistypedCommand(app, argc, argv); !mistyped.empty())
    return Report(Status::Usage(mistyped));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    // CLI11's own codes are not ours: any wrong flag is a usage error. What it prints may quote what was typed.
    std::ostringstream out, complaint;
    const bool help = app.exit(error, out, complaint) == 0;
    if (help) return Print(out.str());
    std::fputs(PrintableLines(complaint.str()).c_str(), stderr);
    return static_cast<int>(StatusCode::kUsage);
  }
  return commands.Run();
}

}  // namespace
}  // namespace stratalux::db

int main(int argc, char** argv) { return stratalux::db::Main(argc, argv); }
