// SPDX-License-Identifier: Apache-2.0
// stratalux-fit: from a stored session to a face under new light.
#include <cstdio>
#include <string>

#include <CLI/CLI.hpp>
#include <sys/stat.h>

#include "fitter/apps/run_command.h"
#include "fitter/pipeline/interruption.h"
#include "shared/base/finite_options.h"
#include "shared/base/mistyped_command.h"
#include "shared/base/printable.h"
#include "shared/base/standard_output.h"
#include "shared/base/version.h"
#include "shared/manual/manual.h"

int main(int argc, char** argv) {
  stratalux::fit::RemoveOnInterruption();
  CLI::App app("Stratalux's fitter: reconstructs, fits scattering layers, renders, compares, reports");
  app.footer(
      "Examples:\n"
      "  stratalux-fit run latest --store store\n"
      "  stratalux-fit run s000003 --store store --full-evaluation --shift refracted_sine\n"
      "  stratalux-fit calibrate --last 12 --store store\n"
      "  stratalux-fit decode latest --store store --out decoded\n"
      "  stratalux-fit modulation latest --store store --region 170,20,340,590\n"
      "  stratalux-fit cloud latest --store store --calibration rig.json --out points\n"
      "  stratalux-fit render latest --store store --point=-200,-150,250 --out relit\n"
      "  stratalux-fit export latest --store store --out face\n"
      "  stratalux-fit clean latest --store store --dry-run\n"
      "  stratalux-fit profiles fit --in arm.csv --out arm.json");
  app.set_version_flag("--version", stratalux::kVersion);
  app.require_subcommand(1);
  int exit_code = 0;
  umask(0027);  // maps and pictures of a face are as private as its frames
  stratalux::fit::AddRunCommands(app, exit_code);
  stratalux::fit::AddBatchCommands(app, exit_code);
  stratalux::fit::AddDecodeCommand(app, exit_code);
  stratalux::fit::AddModulationCommand(app, exit_code);
  stratalux::fit::AddCloudCommand(app, exit_code);
  stratalux::fit::AddCalibrateCommand(app, exit_code);
  stratalux::fit::AddRenderCommand(app, exit_code);
  stratalux::fit::AddExportCommand(app, exit_code);
  stratalux::fit::AddProfilesCommand(app, exit_code);
  stratalux::RangesTakeFiniteNumbers(app);
  if (const auto manual = stratalux::AskedManual(app, "stratalux-fit", argc, argv)) {
    const stratalux::Status written = stratalux::WriteStdout(*manual);
    if (!written.ok()) std::fprintf(stderr, "stratalux-fit: %s\n", written.message().c_str());
    return written.exit_code();
  }
  if (const std::string mistyped = stratalux::MistypedCommand(app, argc, argv); !mistyped.empty()) {
    std::fprintf(stderr, "stratalux-fit: %s\n", stratalux::PrintableLines(mistyped).c_str());
    return 2;
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "stratalux-fit: out of memory; pool more quads (--pool), or use a machine that has more\n");
    return static_cast<int>(stratalux::StatusCode::kFailed);
  }
  return exit_code;
}
