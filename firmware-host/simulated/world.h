// SPDX-License-Identifier: Apache-2.0
// What the simulated camera sees: the subject under the light of all projectors during one exposure.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "firmware-host/simulated/device_options.h"
#include "firmware-host/simulated/interreflection.h"
#include "firmware-host/simulated/light_cache.h"
#include "firmware-host/simulated/light_transport.h"
#include "firmware-host/simulated/scene/scene.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "firmware-host/simulated/work_watch.h"

namespace stratalux::rig {

// A projector's picture from a moment on; nullopt: its light is off.
struct Shown {
  std::optional<Pattern> pattern;
  MonotonicNs since;
};

struct Exposure {
  MonotonicNs start;  // of the first row
  double exposure_ms = 0.0;
  double gain = 1.0;
  int64_t number = 0;                                 // of the frame; names its noise and flicker
  std::vector<std::vector<Shown>> timeline;           // per projector, in order; the first has been on for ever
  Eigen::Vector3d push_mm = Eigen::Vector3d::Zero();  // of the subject, by a fault
  double light = 1.0;                                 // of all lamps, relative, by a fault
};

// Share of each picture of a projector in an exposure that begins at `start`, the projector answering to a change with
// time constant `lag_ms`. Shares of all pictures add up to 1.
[[nodiscard]] std::vector<double> ShareOfPictures(const std::vector<Shown>& timeline, MonotonicNs start,
                                                  double exposure_ms, double lag_ms);

// Used by one thread at a time. What takes long is made when it is first looked at; where the options' stop token ends
// it, kFailed says why, and the next look begins it anew.
class World {
 public:
  World(const SimulatedRigOptions& options, Scene scene, SkinTable table, MonotonicNs start, Logger& logger);

  [[nodiscard]] const RigCalibration& calibration() const { return calibration_; }
  // Digital numbers above black of a perfect camera.
  Result<Image<float>> Light(const Exposure& exposure);
  Result<std::vector<TruthMap>> Truth(const CapturePlan& plan);
  // Another subject, whose motion begins at `now`; devices and lamps stay. `table`: where the tissue is another.
  void SetSubject(Scene scene, std::optional<SkinTable> table, MonotonicNs now);
  void CoverLens(bool covered) { lens_covered_ = covered; }
  [[nodiscard]] const SkinTable& table() const { return table_; }

 private:
  // The subject in one state, with the light transport of each projector, made on first use.
  struct Stage {
    SubjectState state;
    Scene scene;
    std::vector<SubjectPixel> pixels;
    std::vector<std::unique_ptr<LightTransport>> transports;
    std::vector<std::unique_ptr<Interreflection>> bounces;
    std::vector<std::vector<float>> white;  // light of each projector's full white
    // Of each projector, the last picture of two dimensions: its sum over all columns and rows takes seconds, and a
    // visit shows it twice and asks for its truth.
    struct Picture {
      Pattern pattern;
      std::vector<float> subsurface, direct;
    };
    std::vector<std::optional<Picture>> pictures;
  };
  Result<Stage*> StageIn(const SubjectState& state);
  [[nodiscard]] Result<std::unique_ptr<Stage>> MakeStage(const SubjectState& state) const;
  Result<const LightTransport*> Transport(Stage& stage, size_t projector) const;
  Result<const Interreflection*> Bounce(Stage& stage, size_t projector) const;
  Result<const std::vector<float>*> White(Stage& stage, size_t projector) const;
  [[nodiscard]] WorkWatch Watch(const std::string& label) const { return {logger_, label, options_.stop}; }
  // Adds the light of one picture, surface and subsurface apart or together.
  Status RenderTransport(Stage& stage, size_t projector, const Pattern& pattern, std::vector<float>& subsurface,
                         std::vector<float>& direct) const;
  Status Render(Stage& stage, size_t projector, const Pattern& pattern, std::vector<float>& light) const;
  Status AddProjector(Stage& stage, size_t projector, const Exposure& exposure, std::vector<float>& light) const;
  // Whether light enters skin and wax at all; else they are matt.
  [[nodiscard]] bool Scatters() const {
    return options_.scattering && scene_.description().skin.body == SkinBody::kTranslucent;
  }
  void AddTruthOfShape(const Stage& stage, std::vector<TruthMap>& maps) const;
  Status AddTruthOfLights(Stage& stage, const CapturePlan& plan, std::vector<TruthMap>& maps) const;
  Status AddTruthOfLight(Stage& stage, size_t projector, const std::string& name, const Pattern& pattern,
                         double exposure_ms, std::vector<TruthMap>& maps) const;
  [[nodiscard]] Image<float> ToQuads(const Stage& stage, const std::vector<float>& per_pixel, double exposure_ms) const;

  SimulatedRigOptions options_;
  Logger& logger_;
  Scene scene_;
  SkinTable table_;
  SkinAlbedo albedo_;                  // of table_, which it refers to
  std::unique_ptr<LightCache> cache_;  // null: none is wanted
  bool lens_covered_;
  MonotonicNs start_;  // of the lamps
  MonotonicNs subject_start_;
  RigCalibration calibration_;
  std::unique_ptr<Stage> resting_, moved_;  // as described; where it is now
};

}  // namespace stratalux::rig
