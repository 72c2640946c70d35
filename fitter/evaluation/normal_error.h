// SPDX-License-Identifier: Apache-2.0
// Two normals of each quad against a simulation's: of the surface itself, by which it mirrors, and of light that
// scattered (docs/math/photometric.md, "Two normals"). On quads of skin that both know.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fitter/evaluation/surface_error.h"
#include "shared/image/image.h"

namespace stratalux::fit {

struct AngleError {
  double median_deg = 0.0;
  double rms_deg = 0.0;
  int64_t quads = 0;
};

// Where `quads` is 1 and both are finite. W x H x 3, unit.
[[nodiscard]] AngleError CompareNormals(const Image<float>& normal, const Image<float>& truth,
                                        const Image<uint8_t>& quads);

struct NormalFigures {
  AngleError specular;     // the surface's with photometric detail
  AngleError surface;      // without
  AngleError photometric;  // of light alone
  // By colour, against what the simulated skin's light follows. Empty: not known.
  struct Diffuse {
    std::string colour;
    AngleError filtered;    // the diffuse normal
    AngleError unfiltered;  // the specular one in its place
    double width_mm = 0.0;  // medians: of the layers, and of the true skin
    double true_width_mm = 0.0;
  };
  std::vector<Diffuse> diffuse;
};

// What of a fit is held against the truth: maps on quads, as fitter/photometric has them.
struct FoundNormals {
  const Image<float>& specular;
  const Image<float>& surface;
  const Image<float>& photometric;
  const Image<float>& diffuse;   // W x H x 3C
  const Image<float>& width_mm;  // W x H x C, effective_width_mm of its layers
};
[[nodiscard]] NormalFigures CompareNormalsWithTruth(const FoundNormals& found, const TrueSurface& truth);

}  // namespace stratalux::fit
