// SPDX-License-Identifier: Apache-2.0
// stratalux-brute-force: the simulated rig's frames beside brute-force photons, as the table of docs/simulated-rig.md.
#include <cmath>
#include <cstdio>
#include <string>
#include <tuple>
#include <vector>

#include <CLI/CLI.hpp>

#include "shared/base/log.h"
#include "shared/base/version.h"
#include "tests/firmware-host/simulated/brute_force_frames.h"

namespace stratalux::rig {
namespace {

// Of pixels that the photons find brighter than 10 DN and that the light meets at such angles. Chi-square with 2 % of
// the rig's own beside the photons' error and the rounding of frames.
void PrintSummary(const std::vector<ComparedPixel>& compared, const char* name, double least_deg, double most_deg) {
  for (const std::string light : {"white", "stripe", "spot"})
    for (int colour = 0; colour < 3; ++colour) {
      double squares = 0.0, sum = 0.0, errors = 0.0, chi_square = 0.0;
      int count = 0;
      for (const ComparedPixel& c : compared) {
        if (c.light != light || c.colour != colour || c.traced < 10.0 || c.light_deg < least_deg ||
            c.light_deg >= most_deg)
          continue;
        const double error = std::hypot(c.traced_error, c.RoundingDn()) / c.traced;
        squares += c.Deviation() * c.Deviation();
        sum += c.Deviation();
        errors += error * error;
        chi_square += c.Deviation() * c.Deviation() / (error * error + 0.02 * 0.02);
        ++count;
      }
      if (count == 0) continue;
      std::printf("| %s | %c | %s | %d | %.1f %% | %+.1f %% | %.1f %% | %.1f |\n", light.c_str(), "RGB"[colour], name,
                  count, 100.0 * std::sqrt(squares / count), 100.0 * sum / count, 100.0 * std::sqrt(errors / count),
                  chi_square / count);
    }
}

}  // namespace

int Main(int argc, char** argv) {
  CLI::App app(
      "Compares frames of the simulated rig (noise off) with photons traced by brute force on the same scene.\n\n"
      "Examples:\n  stratalux-brute-force --photons 200000\n"
      "  stratalux-brute-force --scene sphere --camera-width 1392 --photons 50000 --places 2");
  app.set_version_flag("--version", kVersion);
  CompareOptions options;
  options.rig.camera_width = 696;
  options.tracing.photons = 100000;
  int places = 7;
  app.add_option("--scene", options.rig.scene, "Scene: a name or a TOML file");
  app.add_option("--seed", options.rig.seed, "Seed of the scene");
  app.add_option("--camera-width", options.rig.camera_width, "Mosaic pixels across, even; 3/4 of it down");
  app.add_option("--projector-width", options.rig.projector_width, "Columns; 3/4 of it rows");
  app.add_option("--photons", options.tracing.photons, "Photons a pixel")->check(CLI::Range(100, 1000000000));
  app.add_option("--photon-seed", options.tracing.seed, "Seed of the photons");
  app.add_option("--threads", options.tracing.threads, "Threads (0: all cores)");
  app.add_option("--places", places, "Places of the face, three pixels each")->check(CLI::Range(1, 7));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  options.rig.camera_height = options.rig.camera_width * 3 / 4 / 2 * 2;
  options.rig.projector_height = options.rig.projector_width * 3 / 4 / 2 * 2;
  Logger logger;
  const auto compared =
      CompareWithRig(options, CrossCheckLights(options.rig), CrossCheckPixels(options.rig, places), logger);
  if (!compared.ok()) {
    logger.Error(compared.status().message());
    return compared.status().exit_code();
  }
  std::fputs(ComparisonTable(*compared).c_str(), stdout);
  std::printf(
      "\n| light | colour | incidence, degrees | pixels above 10 DN | rms deviation | mean | rms std error and "
      "rounding | "
      "chi-square a pixel |\n|---|---|---|---|---|---|---|---|\n");
  for (const auto& [name, least, most] : {std::tuple{"below 70", 0.0, 70.0}, {"above 70", 70.0, 90.0}})
    PrintSummary(*compared, name, least, most);
  return 0;
}

}  // namespace stratalux::rig

int main(int argc, char** argv) { return stratalux::rig::Main(argc, argv); }
