// SPDX-License-Identifier: Apache-2.0
// Frames of the simulated rig, taken through its devices with the noise off, beside brute-force photons.
#pragma once

#include <string>
#include <vector>

#include "firmware-host/simulated/simulated_rig.h"
#include "tests/firmware-host/simulated/brute_force.h"

namespace stratalux::rig {

struct NamedLight {
  std::string name;
  ProjectedLight light;
};

// One pixel under one light, digital numbers above the dark frame.
struct ComparedPixel {
  std::string light;
  int projector = 0, colour = 0, x = 0, y = 0;
  double light_deg = 0.0, view_deg = 0.0;  // from the normal
  double rig = 0.0;                        // the frame, less the frame without light
  double traced = 0.0, traced_error = 0.0;
  double direct = 0.0;  // surface reflection within `traced`
  [[nodiscard]] double Deviation() const { return rig / traced - 1.0; }
  // One sigma, DN: of two frames, of lines and spots at four exposures.
  [[nodiscard]] double RoundingDn() const { return light == "white" ? 0.41 : 0.11; }
};

struct CompareOptions {
  SimulatedRigOptions rig;
  double exposure_ms = 16.0;
  BruteForceOptions tracing;
};

// White, stripes and spots of projectors 0 and 3, as wide and as far apart on the subject whatever the projector's
// resolution.
[[nodiscard]] std::vector<NamedLight> CrossCheckLights(const SimulatedRigOptions& options);
// Pixels of the face, three a place (R, G, B): forehead, cheeks, side of the nose, upper lip, chin.
[[nodiscard]] std::vector<Eigen::Vector2i> CrossCheckPixels(const SimulatedRigOptions& options, int places);
// Expected failures: those of SimulatedRig::Create.
[[nodiscard]] Result<std::vector<ComparedPixel>> CompareWithRig(const CompareOptions& options,
                                                                const std::vector<NamedLight>& lights,
                                                                const std::vector<Eigen::Vector2i>& pixels,
                                                                Logger& logger);
// DN by which frame and photons of an exposure of so many ms may differ, one sigma: the photons' errors; two frames are
// rounded (0.4 DN, lines and spots a quarter of it); and what the rig may be off beside that is the table's
// interpolation over melanin and blood (docs), and where a pattern is dark the tails of its lines.
[[nodiscard]] double SigmaOf(const ComparedPixel& pixel, double exposure_ms);
// Lines of a Markdown table.
[[nodiscard]] std::string ComparisonTable(const std::vector<ComparedPixel>& pixels);

}  // namespace stratalux::rig
