// SPDX-License-Identifier: Apache-2.0
// PatternWitness: do the frames of one projector show the patterns they are said to show?
//
// A lattice of single camera pixels (probes) is kept from each frame. With white W and black B of the same projector, a
// probe is lit where W - B stands well above the noise, and n = (I - B) / (W - B) is its relative level. Checked are:
//   every frame  no probe brighter than W or darker than B, in any band of rows;
//   reference    enough lit probes; black not brighter, white not beyond that of the pre-roll, where all shine;
//   code         a bit and its inverse add up, n + n' = 1, in every band, and far better than they differ; decoded,
//                neighbours in the picture are neighbours of the projector (else a bit was exchanged with its inverse);
//                and something else must bear it out (UnborneCodes);
//   sinusoid     N shifts add up, sum n = N / 2; each frame agrees best with its own shift;
//   checkerboard each frame agrees best with its own shift;
//   comb         the frame agrees best with its own shift among all of the cycle, and no band of rows with another; its
//                mean level is a comb's;
//   motion       n = 1, probe by probe (no jump, the lamp is steady);
//   cycle        each probe's combs add up to its white (comb_cycle.h);
//   spot, guard  the mean level is that of the spots, and that of black; nothing far from the spots is as bright. Where
//                all spots together are fainter than a picture's noise, or hardly meet the subject, frames of either
//                are refuted by more light alone, and doubted only where another frame of their load was refuted.
// Agreement (pattern_score.h) needs the projector coordinates of the probes, decoded from the Gray codes.
//
// A head that sways is no wrong picture: the white that sums and levels are held against follows what adds up to it,
// every pair of a code, every set of sinusoids, every white (Follow). Whether the visitor moved since the reference is
// another question (CheckWhite, CheckProjector). One that jumps contradicts the white for good; that is told by frames
// that fail as they failed before (FailsAsBefore) and by a reference that is proven once more and another picture
// (FindJump). Then the projector begins anew.
//
// Each check confirms a frame, refutes it, or is silent: fine stripes on blurring skin may be too faint to tell. A
// memory that is out of step stays so until it is loaded anew, hence a silent frame is trusted when the next frame of
// that load that speaks is confirmed; it is doubtful when that is refuted, or when the load ends before one speaks.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "firmware-host/sequence/comb_cycle.h"
#include "firmware-host/sequence/pattern_score.h"
#include "firmware-host/sequence/probe_lattice.h"
#include "shared/capture/finding.h"
#include "shared/capture/frame_record.h"
#include "shared/capture/plan.h"
#include "shared/image/image.h"

namespace stratalux::rig {

struct WitnessOptions {
  double saturation_dn = 4000.0;   // brighter probes are left out
  double min_contrast_dn = 60.0;   // W - B of a lit probe
  double gain_e_per_dn = 4.0;      // of the camera; gain and read noise set the tolerance of a single probe
  double read_noise_dn = 5.0;      // 0: a camera without any noise
  int min_lit_probes = 100;        // fewer: the light does not reach the scene
  double max_off_fraction = 0.06;  // of a band's probes that break an identity
  double sum_tolerance = 0.03;     // of W - B, for one probe, beyond its noise
  double steady_tolerance = 0.08;  // mean n of motion frames and of the comb cycle
  double still_tolerance = 0.03;   // rms of what the projectors' whites leave of the pre-roll's, over that: a move
  double moved_tolerance = 0.006;  // rms difference of a white from the reference, after its mean, over W - B: a move
  double blink_tolerance = 0.15;   // of one comb's light, against the combs beside it
  double dark_tolerance = 0.01;    // mean n of guard frames
  double min_evidence = 5.0;       // standard deviations by which the planned shift must beat all others, or be beaten
  MotionOptions motion;
  // By projector: mean light of a whole set of sinusoid shifts, as its response gives it; empty: 1/2, all linear.
  std::vector<double> sinusoid_mean;

  // Of one raw pixel's noise.
  [[nodiscard]] double VarianceDn(double dn) const { return dn / gain_e_per_dn + read_noise_dn * read_noise_dn; }
};

class PatternWitness {
 public:
  PatternWitness(const CapturePlan& plan, WitnessOptions options);

  // Marker frames of the pre-roll, which show all projectors at once.
  void AddPreroll(const PlanStep& step, const Image<uint16_t>& pixels);
  // Forgets the projector before; call where a new projector's steps begin.
  void StartProjector(int projector);
  // Where the projector's memory stands is not known any more, or it is loaded anew: nothing that follows speaks for
  // the frames before.
  void EndLoad() { ++load_; }
  // Keeps the probes of a step's frame, and the mean of all its pixels; a later shot of the step replaces them.
  void Add(const PlanStep& step, const Image<uint16_t>& pixels, double mean_dn);
  // Checks the group that ends with this step (GroupOf). kNotChecked where the plan or the scene offers no check.
  [[nodiscard]] LevelCheck Check(const PlanStep& step);
  // False where no check says anything of the step's frame, whatever it shows: further exposures of phases but the
  // sweep, phases without patterns, and all while the reference lights nothing.
  [[nodiscard]] bool CanSpeak(const PlanStep& step) const;
  // Whether frames of other steps are to speak for the step's where its own check is silent. Not in phases without
  // patterns, which nothing follows that speaks, nor spots and guards in light so faint that none of them speaks.
  [[nodiscard]] bool IsSpokenFor(const PlanStep& step) const;
  // Nothing but the reference has been confirmed yet: when frames contradict it, it may be the reference that is wrong.
  [[nodiscard]] bool ReferenceStandsAlone() const;
  // Each frame of the step's group shows what the shot before it of the same step showed, within noise: what refutes it
  // is no fault of a single frame.
  [[nodiscard]] bool FailsAsBefore(const PlanStep& step) const;
  // Of the reference of this projector, shot again in the midst of its steps: it is proven by all that is asked of a
  // reference, its light is what it was, and the white before refutes it. The finding's value is that white's
  // difference, of no step yet.
  [[nodiscard]] std::optional<Finding> FindJump(const PlanStep& white, const Image<uint16_t>& white_pixels,
                                                const PlanStep& black, const Image<uint16_t>& black_pixels) const;
  // Steps of this projector, whole groups in ascending order, that silence cannot be trusted for.
  [[nodiscard]] std::vector<int> TakeDoubtful();
  // Steps of this projector's codes that nothing bears out: a memory that stands some pairs on shows other bits with
  // their inverses, which add up as well. A whole code is borne out by a sinusoid or comb that agrees with it; else a
  // bit is by whatever else is confirmed behind it in the same load. `unproven`: code steps that do not count anyway.
  [[nodiscard]] std::vector<int> UnborneCodes(const std::set<int>& unproven);
  // A motion white that was added: the lamp has changed, or the visitor moved. At once, before the projector is
  // through.
  [[nodiscard]] std::optional<Finding> CheckWhite(const PlanStep& step) const;
  // Whites and comb cycles of the projector: moved, lamp, blink, mixed-up; empty when all is well. Can be asked when
  // its last step was checked.
  [[nodiscard]] std::vector<Finding> CheckProjector();
  // The projectors' whites against the pre-roll, which shows their sum: a visitor or a lamp that changed between two
  // projectors. After the last CheckProjector().
  [[nodiscard]] std::vector<Finding> CheckSession() const;

  // Steps that are judged together: {white, black}, a Gray bit and its inverse, the shifts of a sinusoid; else the step
  // alone. Plan indices, ascending and adjacent.
  [[nodiscard]] static std::vector<int> GroupOf(const CapturePlan& plan, int step);
  // Of the step's group, those that only tell of each other when one load of the memory showed them all, in its order:
  // a Gray bit and its inverse add up in each other's place, too. Else the step alone.
  [[nodiscard]] static std::vector<int> OneLoadOf(const CapturePlan& plan, int step);

 private:
  enum class Testimony { kSilent, kConfirms, kRefutes };
  struct Frame {
    Probes probes;
    double mean_dn = 0.0;  // of all pixels
    size_t pixels = 0;
    int load = 0;      // of the memory
    int64_t shot = 0;  // in the order of Add
    Probes earlier;    // of the step's shot before; empty: none
    Testimony testimony = Testimony::kSilent;
  };
  struct Coordinates {
    std::vector<int> column, row;  // of each lit probe; empty: not known

    [[nodiscard]] bool Tell(const Pattern& pattern) const;  // what a probe gets of it
  };

  [[nodiscard]] const Frame* Find(int step) const;
  [[nodiscard]] Testimony Judge(const PlanStep& step, std::span<const int> group);
  [[nodiscard]] Testimony JudgeReference();
  [[nodiscard]] Testimony JudgeGray(std::span<const int> pair) const;
  [[nodiscard]] Testimony JudgeShifts(const PlanStep& step, std::span<const int> group);
  [[nodiscard]] Testimony JudgeComb(const PlanStep& step);
  [[nodiscard]] Testimony JudgeWhite(const Probes& white) const;
  // Takes what a group that was not refuted adds up to for the white. What of it is wrong (max_off_fraction at most)
  // counts as off in the next one.
  void Follow(const PlanStep& step, std::span<const int> group);
  // Of the light of a sinusoid's shifts, on the way from black to white.
  [[nodiscard]] double SinusoidMean(int projector) const;
  [[nodiscard]] Testimony JudgeLevel(const PlanStep& step);
  // The silent ones of loads that ended before a frame spoke for them.
  void DoubtUnspokenFor();
  // A bit whose frame shows its inverse and the other way round still adds up; but with it, stretches of the picture
  // run backwards. Not to be told of stripes: a top bit that mirrors the whole picture (of all codes but that of
  // minimum stripe width), and bits finer than the lattice. Doubts the pair's frames, or refutes them where they are
  // `group`.
  [[nodiscard]] Testimony JudgeOrder(PatternAxis axis, std::span<const int> group);
  // Planes of the axis' whole code that show something else than they should; nullopt: too few lit probes tell. Of
  // stripes the one whose exchange with its inverse makes the picture the smoothest, of waves the plane
  // or the period that disagrees with all others, if by so much.
  [[nodiscard]] std::optional<std::vector<int>> ExchangedStripes(PatternAxis axis) const;
  [[nodiscard]] std::optional<std::vector<int>> OtherWaves(PatternAxis axis) const;
  // Whether the frames' mean lies at `mean` on the way from black to white.
  [[nodiscard]] bool AddsUp(std::span<const int> steps, double mean) const;
  // One of a sinusoid's shifts has another light than the others: the lamp blinked.
  [[nodiscard]] bool OneIsDimmer(std::span<const int> shifts);
  // Between black and white of the reference, in every band.
  [[nodiscard]] bool WithinReference(const PlanStep& step) const;
  // Of the planned shift of a comb or a sinusoid against the others (pattern_score.h).
  [[nodiscard]] double EvidenceOf(const PlanStep& step, const LevelsAt& frame) const;
  // Lines or waves stand elsewhere in some rows, as in a torn frame, or in some columns, of the picture.
  enum class Bands { kOfRows, kOfColumns };
  [[nodiscard]] bool OtherShiftInABand(const PlanStep& step, const LevelsAt& frame, Bands bands) const;
  // The axis' code agrees with one of the sinusoids or combs that are judged by it, and with none of them is another
  // shift right anywhere in the picture: where planes stand for each other, positions may be right within a period, in
  // a part of the picture or of the shifts.
  [[nodiscard]] bool AgreesWithOthers(PatternAxis axis);
  // Beside a comb's lines, or spots.
  [[nodiscard]] bool LightElsewhere(const PlanStep& step, const LevelsAt& frame) const;
  [[nodiscard]] bool BrightAsTheExposure(const PlanStep& step) const;
  [[nodiscard]] double MeanLevel(const Probes& frame) const;
  // Of a black frame's MeanLevel, by the noise of it and of the reference's black.
  [[nodiscard]] double MeanLevelSd() const;
  // Mean level of the pattern on the lit probes, by their coordinates (without these: of the whole picture), and how
  // many of them it meets (without these: all).
  struct Expected {
    double level = 0.0;
    int bright = 0;
  };
  [[nodiscard]] Expected ExpectedLevel(const Pattern& pattern);
  // Of the plan's spots, 0 where it has none; not `met`: by their share of the projector's picture, since the subject
  // meets too few of them.
  struct Spots {
    double level = 0.0;
    bool met = true;
  };
  [[nodiscard]] Spots ExpectedSpots();
  // The most that black may be above black: dark_tolerance and the noise, but less than any lines give.
  [[nodiscard]] double DarkLimit() const;
  // Of all pixels: mean level above black over that of white.
  [[nodiscard]] double WholeLevel(const Frame& frame) const;
  [[nodiscard]] double WholeLevelSd() const;  // of a black frame
  // rms difference of a white from `reference` after its mean, over W - B, beyond the noise; and what four standard
  // deviations of the noise make of that.
  struct Stillness {
    double rms = 0.0, noise = 0.0;
  };
  [[nodiscard]] Stillness StillnessOf(const Probes& white, const Probes& reference) const;
  void CheckWhites(std::vector<Finding>& findings) const;
  // Light and motion of the axis' comb cycle, as far as the plan has it.
  void CheckCycle(PatternAxis axis, std::vector<Finding>& findings);
  // Steps of the axis' cycle at the nominal exposure, in its order; empty where one is missing.
  [[nodiscard]] std::vector<int> StepsOfCycle(PatternAxis axis) const;
  [[nodiscard]] CombCycle CycleOf(PatternAxis axis, const std::vector<int>& steps);
  struct Black {
    std::vector<double> dn;  // by probe
    int frames = 0;          // that this is the mean of
  };
  [[nodiscard]] Black MeanBlack() const;
  [[nodiscard]] double VarianceDn(double dn) const { return options_.VarianceDn(dn); }
  [[nodiscard]] int ExtentOf(PatternAxis axis) const {
    return axis == PatternAxis::kColumns ? plan_.options.projector_width : plan_.options.projector_height;
  }
  // Projector pixels of the lit probes; -1 where they cannot be told. Empty where the axis' code is not whole.
  [[nodiscard]] std::vector<int> Decode(PatternAxis axis) const;
  using PairsOfBits = std::map<int, std::array<int, 2>>;  // bit -> steps of the bit and of its inverse
  // Of the axis' whole code; else empty.
  [[nodiscard]] PairsOfBits PairsOf(PatternAxis axis) const;
  struct Waves;  // of micro phase shifting
  [[nodiscard]] Waves WavesOf(PatternAxis axis, const PairsOfBits& bits, size_t every) const;
  [[nodiscard]] std::vector<int> DecodeWaves(PatternAxis axis, const PairsOfBits& bits) const;
  // Of a code that may be misread by far: probes away from most of their neighbours are, and -1.
  void ForgetStrays(std::vector<int>& at) const;
  // Steps of a bit and its inverse differ at the probe beyond noise and stray light.
  [[nodiscard]] bool IsPlain(std::span<const int> pair, int probe) const;
  const Coordinates& Where();
  [[nodiscard]] LevelsAt LevelsOf(const PlanStep& step, std::vector<float>& level);
  // Of the present projector; of other phases than the sweep only those of the nominal exposure.
  [[nodiscard]] std::vector<int> StepsOf(CapturePhase phase) const;

  // The plan's spots, discs around them that more probes meet, and what share of the projector's picture each lights.
  struct SpotPatterns {
    Pattern spots, wide;
    double share = 0.0, wide_share = 0.0;
  };
  [[nodiscard]] static std::optional<SpotPatterns> SpotsOf(const CapturePlan& plan);

  const CapturePlan& plan_;
  WitnessOptions options_;
  std::optional<SpotPatterns> spots_;  // none: a plan without spots
  ProbeLattice lattice_;
  int projector_ = -1;
  int load_ = 0;
  int64_t shots_ = 0;
  std::map<int, Frame> frames_;  // by step
  std::vector<int> doubtful_;
  std::set<int> contradicted_;  // loads of which some frame was refuted
  std::vector<int> lit_;        // probe indices
  Frame white_, black_;
  Probes white_now_;  // as the head stands by now (Follow); of the reference's frame at first
  bool decoded_ = false;
  bool spots_show_ = true;  // on the subject, above the noise of a whole picture; as the last spots or guard found
  Coordinates where_;
  std::vector<float> preroll_white_, preroll_black_;  // means of the markers, by probe; empty: none
  int preroll_whites_ = 0, preroll_blacks_ = 0;
  std::map<int, std::vector<float>> contrast_;  // W - B of each projector, by probe; NaN where saturated
};

}  // namespace stratalux::rig
