// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/plan.h"

#include <algorithm>
#include <array>
#include <sstream>
#include <string_view>

namespace stratalux {
namespace {

constexpr std::array<std::string_view, 10> kPhases = {"preroll", "reference", "correspondence", "separation", "sweep",
                                                      "motion",  "spot",      "guard",          "radiometry", "repeat"};
constexpr std::array<std::string_view, 5> kKinds = {"visitor", "calibration", "dark", "flat", "response"};
constexpr std::array<std::string_view, 2> kSyncModes = {"triggered", "free_running"};

constexpr size_t kMostSteps = 100'000;  // a visitor's is some 700

// What the sessions that measure light show beyond white, black and codes; docs/capture-plan.md gives the reasons.
constexpr int kDarkRepeats = 16;        // frames of each exposure
constexpr int kRampRepeats = 2;         // whites of each exposure: their difference is noise alone
constexpr int kGreySteps = 32;          // of a projector's ramp
constexpr int kWhiteEvery = 8;          // steps of the ramp between whites, which tell the lamp's drift
constexpr int kLinePeriodInWidths = 8;  // lines far apart for a matt target, where nothing spreads

template <typename E, size_t N>
Result<E> ParseName(const std::array<std::string_view, N>& names, const std::string& text, const char* what) {
  const auto found = std::find(names.begin(), names.end(), text);
  if (found != names.end()) return static_cast<E>(found - names.begin());
  std::string allowed;
  for (std::string_view name : names) allowed += (allowed.empty() ? "" : ", ") + std::string(name);
  return Status::Usage(std::string(what) + " '" + text + "' is unknown; allowed: " + allowed);
}

Status RequireRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return Status::Ok();
  std::ostringstream text;
  text << "plan: " << name << " = " << value << ", allowed: " << low << " .. " << high;
  return Status::Usage(text.str());
}

// Appends steps with running indices.
class PlanBuilder {
 public:
  explicit PlanBuilder(const PlanOptions& options) { plan_.options = options; }

  void Add(int projector, CapturePhase phase, const Pattern& pattern, int bracket = 0) {
    const PlanOptions& o = plan_.options;
    plan_.steps.push_back({static_cast<int>(plan_.steps.size()), projector, phase, pattern,
                           o.exposure_ms * o.BracketsOf(phase)[bracket], bracket});
  }

  [[nodiscard]] int Brackets(CapturePhase phase) const {
    return static_cast<int>(plan_.options.BracketsOf(phase).size());
  }

  void AddReference(int projector) {
    for (int bracket = 0; bracket < Brackets(CapturePhase::kReference); ++bracket)
      for (const PatternKind kind : {PatternKind::kWhite, PatternKind::kBlack})
        Add(projector, CapturePhase::kReference, {.kind = kind}, bracket);
  }

  void AddPreroll() {
    for (bool white : PrerollCode(plan_.options.preroll_markers))
      Add(-1, CapturePhase::kPreroll, {.kind = white ? PatternKind::kWhite : PatternKind::kBlack});
  }

  void AddCorrespondence(int projector) {
    for (int bracket = 0; bracket < Brackets(CapturePhase::kCorrespondence); ++bracket) AddCodes(projector, bracket);
  }

  void AddCodes(int projector, int bracket) {
    const PlanOptions& o = plan_.options;
    for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
      const int bits = o.PlaneOf(axis, 0, false).bits;
      for (int bit = 0; bit < bits; ++bit)
        for (bool inverse : {false, true})
          Add(projector, CapturePhase::kCorrespondence, o.PlaneOf(axis, bit, inverse), bracket);
    }
  }

  void AddSeparation(int projector) {
    for (int bracket = 0; bracket < Brackets(CapturePhase::kSeparation); ++bracket) AddShifts(projector, bracket);
  }

  void AddShifts(int projector, int bracket) {
    const PlanOptions& o = plan_.options;
    for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows})
      for (int shift = 0; shift < o.separation_shifts; ++shift)
        Add(projector, CapturePhase::kSeparation,
            {.kind = PatternKind::kSinusoid,
             .axis = axis,
             .period = o.separation_period,
             .shift = shift,
             .shifts = o.separation_shifts},
            bracket);
    if (!o.checkerboard) return;
    for (int shift = 0; shift < o.checkerboard_shifts * o.checkerboard_shifts; ++shift)
      Add(projector, CapturePhase::kSeparation,
          {.kind = PatternKind::kCheckerboard,
           .period = o.checkerboard_period,
           .shift = shift,
           .shifts = o.checkerboard_shifts},
          bracket);
  }

  // One comb cycle along `axis`, with `whites` all-white frames in it: the first before it, the last after it, the
  // others evenly between. A single one stands after it. The first comb of the columns comes again behind the last.
  void AddSweep(int projector, PatternAxis axis, int whites) {
    const PlanOptions& o = plan_.options;
    const int frames = o.comb_period / o.comb_step;
    int shown = 0;
    for (int k = 0; k <= frames; ++k) {
      if (k == frames && axis == PatternAxis::kColumns) AddSecondTake(projector, CapturePhase::kSweep);
      while (shown < whites && k == (whites == 1 ? frames : shown * frames / (whites - 1))) {
        Add(projector, CapturePhase::kMotion, {.kind = PatternKind::kWhite});
        ++shown;
      }
      for (int bracket = 0; k < frames && bracket < static_cast<int>(o.brackets.size()); ++bracket)
        Add(projector, CapturePhase::kSweep,
            {.kind = PatternKind::kComb,
             .axis = axis,
             .period = o.comb_period,
             .width = o.comb_width,
             .shift = k * o.comb_step},
            bracket);
    }
  }

  // Both takes of the spots stand a sweep apart, as those of its first comb do: what moves or drifts meanwhile shows in
  // their difference. Beside spots stands nothing about as dark as they are but not black: only the mean level tells
  // them from what a projector out of step shows (PatternWitness).
  void AddVisitor(int projector) {
    const PlanOptions& o = plan_.options;
    AddReference(projector);
    AddCorrespondence(projector);
    AddSeparation(projector);
    // Plans of sessions from before second takes have the spots behind the sweep.
    if (o.second_takes) AddSpots(projector);
    AddSweep(projector, PatternAxis::kColumns, o.motion_whites);
    if (o.row_sweep) AddSweep(projector, PatternAxis::kRows, 0);
    if (!o.second_takes) AddSpots(projector);
    AddSecondTake(projector, CapturePhase::kSpot);
    AddGuards(projector);
  }

  void AddSpots(int projector) {
    const PlanOptions& o = plan_.options;
    for (int bracket = 0; o.spot_radius > 0 && bracket < Brackets(CapturePhase::kSpot); ++bracket)
      Add(projector, CapturePhase::kSpot, {.kind = PatternKind::kSpots, .period = o.spot_pitch, .width = o.spot_radius},
          bracket);
  }

  // Of the phase's first frame.
  void AddSecondTake(int projector, CapturePhase phase) {
    const auto first = std::find_if(plan_.steps.begin(), plan_.steps.end(), [&](const PlanStep& step) {
      return step.projector == projector && step.phase == phase;
    });
    if (!plan_.options.second_takes || first == plan_.steps.end()) return;
    PlanStep again = *first;
    again.index = static_cast<int>(plan_.steps.size());
    again.phase = CapturePhase::kRepeat;
    plan_.steps.push_back(again);
  }

  void AddReferenceAndCodes(int projector) {
    AddReference(projector);
    AddCorrespondence(projector);
    AddGuards(projector);
  }

  void AddDark(int projector) {
    for (int bracket = 0; bracket < Brackets(CapturePhase::kRadiometry); ++bracket)
      for (int i = 0; i < kDarkRepeats; ++i)
        Add(projector, CapturePhase::kRadiometry, {.kind = PatternKind::kBlack}, bracket);
  }

  void AddFlat(int projector) {
    AddReference(projector);
    AddCorrespondence(projector);
    AddLines(projector);
    // One lamp is enough for the camera's own curve and noise.
    if (projector == 0) AddExposureRamp(projector);
    AddGuards(projector);
  }

  void AddLines(int projector) {
    const PlanOptions& o = plan_.options;
    const int period = kLinePeriodInWidths * o.comb_width;
    for (int shift = 0; shift < period; shift += o.comb_width)
      Add(projector, CapturePhase::kRadiometry,
          {.kind = PatternKind::kComb, .period = period, .width = o.comb_width, .shift = shift});
  }

  void AddExposureRamp(int projector) {
    for (int bracket = 0; bracket < Brackets(CapturePhase::kRadiometry); ++bracket) {
      for (int i = 0; i < kRampRepeats; ++i)
        Add(projector, CapturePhase::kRadiometry, {.kind = PatternKind::kWhite}, bracket);
      Add(projector, CapturePhase::kRadiometry, {.kind = PatternKind::kBlack}, bracket);
    }
  }

  void AddResponse(int projector) {
    AddReference(projector);
    for (int level = 1; level < kGreySteps; ++level) {
      Add(projector, CapturePhase::kRadiometry, {.kind = PatternKind::kGrey, .shift = level, .shifts = kGreySteps});
      if (level % kWhiteEvery == 0) Add(projector, CapturePhase::kRadiometry, {.kind = PatternKind::kWhite});
    }
    Add(projector, CapturePhase::kRadiometry, {.kind = PatternKind::kWhite});
    AddGuards(projector);
  }

  void AddGuards(int projector) {
    for (int i = 0; i < plan_.options.guards; ++i) Add(projector, CapturePhase::kGuard, {.kind = PatternKind::kBlack});
  }

  [[nodiscard]] size_t size() const { return plan_.steps.size(); }
  CapturePlan Take() { return std::move(plan_); }

 private:
  CapturePlan plan_;
};

}  // namespace

const char* ToString(SessionKind kind) { return kKinds[static_cast<size_t>(kind)].data(); }
const char* ToString(CapturePhase phase) { return kPhases[static_cast<size_t>(phase)].data(); }
const char* ToString(SyncMode mode) { return kSyncModes[static_cast<size_t>(mode)].data(); }
Result<CapturePhase> ParseCapturePhase(const std::string& text) {
  return ParseName<CapturePhase>(kPhases, text, "phase");
}
Result<SessionKind> ParseSessionKind(const std::string& text) { return ParseName<SessionKind>(kKinds, text, "kind"); }
Result<SyncMode> ParseSyncMode(const std::string& text) { return ParseName<SyncMode>(kSyncModes, text, "sync mode"); }

const std::vector<double>& PlanOptions::BracketsOf(CapturePhase phase) const {
  static const std::vector<double> kNominal = {1.0};
  static const std::vector<double> kDark = {1.0, 0.25, 4.0};
  static const std::vector<double> kRamp = {1.0,   0.015625, 0.03125, 0.0625, 0.125, 0.1875, 0.25,
                                            0.375, 0.5,      0.625,   0.75,   0.875, 1.125};
  switch (phase) {
    case CapturePhase::kReference:
      return reference_brackets;
    case CapturePhase::kCorrespondence:
      return correspondence_brackets;
    case CapturePhase::kSeparation:
      return separation_brackets;
    case CapturePhase::kSweep:
      return brackets;
    case CapturePhase::kSpot:
      return spot_brackets;
    case CapturePhase::kRadiometry:
      return kind == SessionKind::kDark ? kDark : kind == SessionKind::kFlat ? kRamp : kNominal;
    default:
      return kNominal;
  }
}

Pattern PlanOptions::PlaneOf(PatternAxis axis, int bit, bool inverse) const {
  return {.kind = PatternKind::kGray,
          .axis = axis,
          .bit = bit,
          .bits = GrayBits(axis == PatternAxis::kColumns ? projector_width : projector_height),
          .inverse = inverse,
          .code = ShownCode(),
          .period = IsOfStripes(ShownCode()) ? 0 : separation_period};
}

Status PlanOptions::Validate() const {
  SLX_RETURN_IF_ERROR(RequireRange("projectors", projectors, 1, 16));
  SLX_RETURN_IF_ERROR(RequireRange("projector_width", projector_width, 16, 8192));
  SLX_RETURN_IF_ERROR(RequireRange("projector_height", projector_height, 16, 8192));
  SLX_RETURN_IF_ERROR(RequireRange("exposure_ms", exposure_ms, 0.01, 10000));
  SLX_RETURN_IF_ERROR(RequireRange("number of brackets", static_cast<double>(brackets.size()), 1, 8));
  for (double factor : brackets) SLX_RETURN_IF_ERROR(RequireRange("bracket", factor, 0.001, 1000));
  for (const CapturePhase phase :
       {CapturePhase::kReference, CapturePhase::kCorrespondence, CapturePhase::kSeparation, CapturePhase::kSpot}) {
    const std::vector<double>& factors = BracketsOf(phase);
    const std::string name = std::string(ToString(phase)) + "_brackets";
    SLX_RETURN_IF_ERROR(RequireRange(("number of " + name).c_str(), static_cast<double>(factors.size()), 1, 8));
    for (double factor : factors) SLX_RETURN_IF_ERROR(RequireRange(name.c_str(), factor, 0.001, 1000));
    if (factors[0] != 1.0)
      return Status::Usage("plan: " + name + " begins with " + std::to_string(factors[0]) +
                           ", not with 1, the exposure that all stages read");
  }
  SLX_RETURN_IF_ERROR(RequireRange("preroll_markers", preroll_markers, 0, 64));
  SLX_RETURN_IF_ERROR(RequireRange("motion_whites", motion_whites, 0, 64));
  SLX_RETURN_IF_ERROR(RequireRange("guards", guards, 0, 16));
  SLX_RETURN_IF_ERROR(RequireRange("separation_period", separation_period, 3, 8192));
  SLX_RETURN_IF_ERROR(RequireRange("separation_shifts", separation_shifts, 3, 64));
  SLX_RETURN_IF_ERROR(RequireRange("checkerboard_period", checkerboard_period, 2, 8192));
  SLX_RETURN_IF_ERROR(RequireRange("checkerboard_shifts", checkerboard_shifts, 1, 64));
  SLX_RETURN_IF_ERROR(RequireRange("comb_width", comb_width, 1, 1024));
  SLX_RETURN_IF_ERROR(RequireRange("comb_period", comb_period, 2, 8192));
  SLX_RETURN_IF_ERROR(RequireRange("spot_radius", spot_radius, 0, 256));
  SLX_RETURN_IF_ERROR(RequireRange("spot_pitch", spot_pitch, 2, 8192));
  SLX_RETURN_IF_ERROR(RequireRange("comb_step (at most comb_width)", comb_step, 1, comb_width));
  if (comb_period % comb_step != 0 || comb_width % comb_step != 0)
    return Status::Usage("plan: comb_step = " + std::to_string(comb_step) + " must divide comb_period = " +
                         std::to_string(comb_period) + " and comb_width = " + std::to_string(comb_width));
  return Status::Ok();
}

std::vector<bool> PrerollCode(int markers) {
  // Aperiodic, so that a shift by any number of frames shows: the 7-bit Barker code, then its complement, repeated.
  constexpr std::array<bool, 7> kBarker = {true, true, true, false, false, true, false};
  std::vector<bool> code;
  for (int i = 0; i < markers; ++i) code.push_back(kBarker[i % 7] != ((i / 7) % 2 == 1));
  return code;
}

Result<CapturePlan> BuildPlan(const PlanOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  PlanBuilder builder(options);
  builder.AddPreroll();
  for (int p = 0; p < options.projectors; ++p) {
    if (builder.size() > kMostSteps)
      return Status::Usage("plan: more than " + std::to_string(kMostSteps) + " steps; no visitor holds still for them");
    switch (options.kind) {
      case SessionKind::kVisitor:
        builder.AddVisitor(p);
        break;
      case SessionKind::kCalibration:
        builder.AddReferenceAndCodes(p);
        break;
      case SessionKind::kFlat:
        builder.AddFlat(p);
        break;
      case SessionKind::kDark:
        if (p == 0) builder.AddDark(p);
        break;
      case SessionKind::kResponse:
        builder.AddResponse(p);
        break;
    }
  }
  CapturePlan plan = builder.Take();
  for (const PlanStep& step : plan.steps)
    SLX_RETURN_IF_ERROR(step.pattern.Validate(options.projector_width, options.projector_height)
                            .WithContext("plan: step " + std::to_string(step.index)));
  return plan;
}

}  // namespace stratalux
