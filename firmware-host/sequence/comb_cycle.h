// SPDX-License-Identifier: Apache-2.0
// One comb cycle, probe by probe: each probe is passed by one line of the comb, over some frames in a row. What a whole
// cycle gives a probe is w / q of its white, wherever it is and however the skin scatters; so a probe whose surface
// shifts while the line passes gets less or more of it, and a lamp that blinks gives less to all.
//
// Motion. With the probe's mean over the far frames taken off (which takes the black's noise with it), what the near
// frames gave it is L = sum of the near levels. Among neighbours L is even: a plane through each cell of the lattice is
// taken off. A subject that jumps by t shifts the lines under probe i by
//     d_i = a + b dc/dx + c dc/dy,      c(x, y) the projector position that the camera sees at (x, y):
// the projector sees the surface slide (a), the camera sees it slide (b, c); and probes that the line passes just then
// gain or lose light in proportion to d_i. In each stretch of frames a, b, c are fitted, by the probes' known noise;
// their squares over their covariance are the score, about 3 for a subject that holds still.
#pragma once

#include <optional>
#include <vector>

namespace stratalux::rig {

struct CombCycle {
  int frames = 0;  // of the cycle, K
  // By frame, then probe: (I - B) / (W - B), and its variance.
  std::vector<std::vector<float>> level, variance;
  // By probe.
  std::vector<float> contrast;        // W - B, weighs a missing comb and the cycle's sum
  std::vector<float> black_variance;  // of B / (W - B), which all frames have in common
  std::vector<int> passed_in;         // frame whose line passes it; -1: not known
  std::vector<int> position;          // of the projector along the comb's axis, px
  std::vector<int> x, y;              // in the lattice
  int pitch = 1;                      // camera pixels from probe to probe
};

// The lamp in each frame: its light over what the whole cycle's mean passage says of the probes that it meets, all of
// them alike, however bright or dim, none by more than one and a half of its white, and the distances from the line
// weighed by how far probes agree there. About 1, and on uneven scenes a few per cent off, the same in each capture. A
// comb in another's place says nothing of the lamp. Empty where too few probes are known.
[[nodiscard]] std::vector<double> FrameGains(const CombCycle& cycle);

// Frames whose light differs from the middle of the seven about them (themselves among them; at an end of the cycle
// they lie on one side) by more than `tolerance`, and by more than 4.5 standard deviations of what the cycle's other
// frames do: on uneven skin those are a few per cent, and a session asks 256 frames.
struct Blink {
  int frame = 0;
  double light = 1.0;  // over that of the frames about it
  double limit = 0.0;  // of its deviation from 1
};
[[nodiscard]] std::vector<Blink> FindBlinks(const std::vector<double>& gain, double tolerance);

struct MotionOptions {
  int near_frames = 9;              // to both sides of the passage; must hold what blur and footprint spread
  int stretch = 3;                  // frames fitted together
  int cell = 10;                    // probes a side
  double uneven_light = 0.01;       // of L, of all probes of a stretch alike: a lamp that flickers is no motion
  double uneven_slope = 0.001;      // of L, as the rms slope gives it: what a still scene's shape does
  double model_error = 0.02;        // of L, of one probe
  double largest_still_score = 20;  // at 464x348 camera pixels: of 16 still captures at most 6, of 8 sways at least 51
  // A camera that mixes more than `coarse_px` of the projector in a pixel reads its finest codes badly, and where lines
  // pass with them: at 232x174 pixels, still captures reach 38.
  double coarse_px = 3.0, largest_still_score_coarse = 45;
};

struct CombMotion {
  double limit = 0.0;   // of the score of a subject that holds still
  double score = 0.0;   // the largest of all stretches
  double change = 0.0;  // rms of the fitted gain and loss of that stretch's probes, of their white
  int frame = 0;        // in the middle of the first stretch that is too much; where none is, of the largest
};

// nullopt where the cycle is too short to tell near frames from far ones, or too few probes are known.
// `spoilt`: frames (by number) that say nothing of motion, since their light was another.
[[nodiscard]] std::optional<CombMotion> FindMotion(const CombCycle& cycle, const std::vector<bool>& spoilt,
                                                   const MotionOptions& options);

// The frame that shows another comb than its own: lines passed probes with no frame to show for it, and others twice.
// All of its light is there. nullopt: none.
struct MissingComb {
  int frame = 0;
  double sum = 1.0;    // of the cycle at the probes that its line passes, over the mean of all
  double limit = 0.0;  // of its deviation from 1: half of what one frame gives, or what noise may do
};
[[nodiscard]] std::optional<MissingComb> FindMissingComb(const CombCycle& cycle);

}  // namespace stratalux::rig
