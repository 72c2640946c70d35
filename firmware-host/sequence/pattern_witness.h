// SPDX-License-Identifier: Apache-2.0
// PatternWitness: do the frames of one projector show the patterns they are said to show?
//
// A lattice of single camera pixels (probes) is kept from each frame. With white W and black B of the same projector, a
// probe is lit where W - B stands well above the noise, and n = (I - B) / (W - B) is its relative level. Checked are:
//   reference    enough lit probes;
//   Gray code    a bit and its inverse add up: n + n' = 1;
//   sinusoid     N shifts add up: sum n = N / 2; and each frame agrees best with its own shift (or a neighbour);
//   comb         the frame agrees best with its own shift (or a neighbour) among the shifts of the plan;
//   motion       n = 1 (the visitor held still, the lamp is steady);
//   guard        n = 0.
// Agreement needs the projector coordinates of the probes, decoded from the Gray codes (bit = I > I'). The mean of n
// over probes that the pattern lights, less the mean over all, is the score of a pattern: the right one scores highest,
// whatever the scattering. At the end of a projector the comb cycle must add up: sum_k n_k = width / step.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "shared/capture/frame_record.h"
#include "shared/capture/plan.h"
#include "shared/image/image.h"

namespace stratalux::rig {

struct WitnessOptions {
  double saturation_dn = 4000.0;  // brighter probes are left out
  double min_contrast_dn = 60.0;  // W - B of a lit probe
  double gain_e_per_dn = 4.0;     // of the camera; gain and read noise only set the tolerance of a single probe
  double read_noise_dn = 5.0;
  int min_lit_probes = 100;        // fewer: the light does not reach the scene
  double max_off_fraction = 0.1;   // of lit probes that break an identity
  double sum_tolerance = 0.03;     // of W - B, for one probe, beyond its noise
  double steady_tolerance = 0.08;  // mean n of motion frames and of the comb cycle
  double dark_tolerance = 0.01;    // mean n of guard frames
};

class PatternWitness {
 public:
  PatternWitness(const CapturePlan& plan, WitnessOptions options);

  // Forgets the projector before; call where a new projector's steps begin.
  void StartProjector(int projector);
  // Keeps the probes of a step's frame; a later shot of the step replaces them.
  void Add(const PlanStep& step, const Image<uint16_t>& pixels);
  // Checks the group that ends with this step (GroupOf). kNotChecked where the plan or the scene offers no check.
  [[nodiscard]] LevelCheck Check(const PlanStep& step);
  // Comb cycle and white of the projector: what does not add up, for people; empty when all is well.
  [[nodiscard]] std::vector<std::string> CheckProjector() const;

  // Steps that are judged together: {white, black}, a Gray bit and its inverse, the shifts of a sinusoid; else the step
  // alone. Plan indices, ascending and adjacent.
  [[nodiscard]] static std::vector<int> GroupOf(const CapturePlan& plan, int step);

 private:
  using Probes = std::vector<float>;

  [[nodiscard]] const Probes* Find(int step) const;
  [[nodiscard]] bool UpdateReference();
  [[nodiscard]] bool AddsUp(std::span<const int> steps) const;
  [[nodiscard]] double MeanLevel(const Probes& frame) const;
  // Projector coordinate of each lit probe along the axis, -1 where unknown; empty until all bits are there and passed.
  const std::vector<int>& Coordinates(PatternAxis axis);
  // True when `step` agrees best with its own pattern or a neighbouring shift; nullopt when it cannot be told.
  [[nodiscard]] std::optional<bool> AgreesBest(const PlanStep& step, int shift_count, int shift_step);
  [[nodiscard]] std::vector<int> StepsOf(CapturePhase phase) const;

  const CapturePlan& plan_;
  WitnessOptions options_;
  int projector_ = -1;
  std::map<int, Probes> frames_;  // by step
  std::vector<int> lit_;          // probe indices
  Probes white_, black_;
  std::map<PatternAxis, std::vector<int>> coordinates_;
};

}  // namespace stratalux::rig
