// SPDX-License-Identifier: Apache-2.0
// What the simulated rig knows of its scene, for comparison alone: no stage that makes maps may read it.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "db/segment/truth_segment.h"
#include "fitter/evaluation/surface_error.h"
#include "fitter/reconstruction/surface_map.h"
#include "shared/capture/rig_calibration.h"

namespace stratalux::fit {

class SceneTruth {
 public:
  // nullopt where the session has no truth.seg (a real capture, or deleted).
  static Result<std::optional<SceneTruth>> Open(const std::filesystem::path& session_folder);
  [[nodiscard]] Result<Image<float>> Depth() const { return segment_.Read("depth"); }
  [[nodiscard]] Result<Image<float>> Normal() const { return segment_.Read("normal"); }
  // "stripe", "white" or "spot" light of a projector, digital numbers above black.
  [[nodiscard]] Result<Image<float>> Subsurface(const std::string& light, int projector) const;
  // On quads: what is skin at all sites of the quad; what of the scene the projector's light reaches. empty where the
  // truth, of an older simulation, does not say.
  [[nodiscard]] Result<Image<uint8_t>> Skin() const;
  // Where a quad's centre sees skin, or skin between the hairs of a shaven beard, which no quad tells apart. Empty as
  // above.
  [[nodiscard]] Result<Image<uint8_t>> SkinOrStubble() const;
  [[nodiscard]] Result<Image<uint8_t>> LitBy(int projector) const;
  // By colour, mm: the standard deviation of one coordinate of where light leaves the skin that came and leaves along
  // its normal; NaN off the skin. Empty as above.
  [[nodiscard]] Result<Image<float>> Spread() const;
  // x y z of each colour: what light that scattered follows, by the simulation's own skin. Empty as above.
  [[nodiscard]] Result<Image<float>> DiffuseNormal() const;
  // The true surface, for the runs that separate errors of the geometry from those of the model. Of sessions that name
  // another calibration than the exact one, on the rays of the exact one, which lies beside the truth.
  [[nodiscard]] Result<SurfaceMap> Surface(const RigCalibration& rig) const;
  // The exact record where the session names another one: that of the rig that the true surface stands in.
  [[nodiscard]] const std::optional<RigCalibration>& exact_calibration() const { return exact_; }
  // The same with the rig that it stands in and what each projector of it reaches.
  [[nodiscard]] Result<TrueSurface> SurfaceInItsRig(const RigCalibration& rig) const;

 private:
  SceneTruth(db::TruthSegment segment, std::optional<RigCalibration> exact)
      : segment_(std::move(segment)), exact_(std::move(exact)) {}
  [[nodiscard]] Result<Image<uint8_t>> SkinAtCentres() const;
  // Empty where there is none of the name.
  [[nodiscard]] Result<Image<float>> ReadIfThere(const std::string& name) const;

  db::TruthSegment segment_;
  std::optional<RigCalibration> exact_;
};

}  // namespace stratalux::fit
