// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit export`: a face as files for other programs.
#include <memory>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "fitter/apps/run_command.h"
#include "fitter/pipeline/session_export.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

struct ExportFlags {
  SessionExportOptions options;
  std::string out;
  std::vector<std::string> formats = ExportFormatNames();
  bool json = false;
};

Status Export(ExportFlags& f, Logger& logger) {
  f.options.out = f.out;
  f.options.formats = ParseExportFormats(f.formats);
  SLX_ASSIGN_OR_RETURN(const auto outcome, ExportSession(f.options, logger));
  if (outcome.sealed) logger.Info(PlainCopyNote(outcome.session, f.out));
  if (f.json) {
    auto json = nlohmann::ordered_json::parse(outcome.record);
    json["folder"] = f.out;
    json["sealed"] = outcome.sealed;
    return WriteStdout(json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
  }
  std::string text;
  for (const auto& file : outcome.files) text += file.string() + "\n";
  return WriteStdout(text);
}

}  // namespace

void AddExportCommand(CLI::App& app, int& exit_code) {
  auto flags = std::make_shared<ExportFlags>();
  auto* verb =
      app.add_subcommand("export",
                         "Export the face for other programs: mesh as PLY and glTF, points with covariance, depth, "
                         "normals, skin");
  verb->footer(
      "ply: mesh.ply; glb: mesh.glb (glTF 2.0, metres, y up, albedo and photometric normals as its textures);\n"
      "cloud: cloud.ply, each point with its covariance and whether it is skin;\n"
      "tiff: depth.tif, normal.tif, skin.tif (16 bits); exr: depth.exr, normal.exr, skin.exr (floats).\n"
      "PLY, TIFF and EXR are in the camera frame, mm: +x right, +y down, +z away from the camera. A session without\n"
      "a fit gives its surface, without colour. Files of an earlier export are replaced, each in one step.\n"
      "Examples:\n"
      "  stratalux-fit export latest --store store --out face\n"
      "  stratalux-fit export s000017 --store store --format glb,cloud --out for-the-artist --json");
  verb->add_option("session", flags->options.session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb->add_option("--store", flags->options.store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb->add_option("--fit", flags->options.fit, "Fit (default: the newest complete one, else the surface so far)");
  verb->add_option("--format", flags->formats, "Formats, separated by commas (default: all)")
      ->delimiter(',')
      ->check(CLI::IsMember(ExportFormatNames()));
  verb->add_option("--out", flags->out, "Folder for the files, unencrypted; logged, so that `forget` finds it")
      ->required();
  verb->add_flag("--json", flags->json, "Machine-readable result on stdout: export.json, folder and whether sealed");
  verb->callback([flags, &exit_code] {
    Logger logger;
    const Status status = Export(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
