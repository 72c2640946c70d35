// SPDX-License-Identifier: Apache-2.0
// A fitted face under a light that nobody captured: `stratalux-fit render`.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "fitter/stages/layers_file.h"
#include "shared/base/log.h"
#include "shared/pattern/pattern.h"

namespace stratalux::fit {

// One light. Point and directional lights have the strength that makes a white target at the middle of the face, facing
// the light, read 1 per colour times `colour`; a rig's projector reads as in the captured frames over its own white.
struct VirtualLight {
  enum class Kind { kPoint, kDirectional, kProjector };
  Kind kind = Kind::kPoint;
  Eigen::Vector3d vector = Eigen::Vector3d(0, 0, 0);  // position, mm, or direction TO the light (camera frame)
  int projector = 0;
  Pattern pattern{.kind = PatternKind::kWhite};
  std::array<double, 3> colour = {1.0, 1.0, 1.0};
  [[nodiscard]] Status Validate() const;
};

struct Relit {
  // Quads x colours, linear; 0 outside the face, NaN where that colour was not fitted.
  Image<float> subsurface, surface, total;
  Image<float> white;  // the total with all of the light's pattern on, what is not fitted unmarked; empty: no pattern
  Image<uint8_t> covered;   // by quads: 1 on the face
  Image<float> half_width;  // half the 95 % interval of `total`, as the caller finds it; empty: unknown
  Eigen::Vector3d light_mm = Eigen::Vector3d::Zero();  // where the light stands
  std::string provenance;                              // of the layers: ProvenanceOf
  int64_t face = 0;                                    // quads of it
  int64_t incomplete = 0;                              // of them without one colour or more: black in the PNGs
  // What a look at the pictures would not tell: no light reaches the face, colours are missing.
  [[nodiscard]] std::vector<std::string> Notes() const;
};

// kUsage: the light is inside the face, the projector does not exist, the pattern does not fit it.
[[nodiscard]] Result<Relit> Relight(const SavedFit& fit, const VirtualLight& light);

// subsurface, surface and total as EXR (linear) and PNG (sRGB; `white` maps to 255, 0: the 99.5th percentile of total),
// each with alpha: 1 on the face, 0 outside (`covered`), where light is 0, so that it is straight and premultiplied;
// relit.json: `session` and `fit` by name, where its layers come from, and how wide intervals are; where these are
// known interval.exr, their halves. All names: RelitFiles(). relit.json is written last, and an earlier one removed
// first: pictures that a failure has mixed have none.
Status WriteRelit(const std::filesystem::path& folder, const Relit& relit, double white, const std::string& session,
                  const std::string& fit);
[[nodiscard]] std::vector<std::string> RelitFiles();

}  // namespace stratalux::fit
