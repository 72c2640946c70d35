// SPDX-License-Identifier: Apache-2.0
// The capture plan: which projector shows which pattern for which frame (docs/capture-plan.md, model section 2).
#pragma once

#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/pattern/pattern.h"

namespace stratalux {

enum class SessionKind { kVisitor, kCalibration, kDark, kFlat, kResponse };
enum class CapturePhase {
  kPreroll,
  kReference,
  kCorrespondence,
  kSeparation,
  kSweep,
  kMotion,
  kSpot,
  kGuard,
  kRadiometry,
  kRepeat  // a light that is evaluated, shown a second time: no training data
};
enum class SyncMode { kTriggered, kFreeRunning };

[[nodiscard]] const char* ToString(SessionKind);
[[nodiscard]] const char* ToString(CapturePhase);
[[nodiscard]] const char* ToString(SyncMode);
[[nodiscard]] Result<CapturePhase> ParseCapturePhase(const std::string& text);
[[nodiscard]] Result<SessionKind> ParseSessionKind(const std::string& text);
[[nodiscard]] Result<SyncMode> ParseSyncMode(const std::string& text);

struct PlanStep {
  int index = 0;       // 0, 1, ... over the whole plan
  int projector = -1;  // the lit projector; -1: every projector shows the pattern (pre-roll markers)
  CapturePhase phase = CapturePhase::kReference;
  Pattern pattern;
  double exposure_ms = 0.0;
  int bracket = 0;  // exposure bracket, 0 = nominal
};

struct PlanOptions {
  SessionKind kind = SessionKind::kVisitor;
  SyncMode sync_mode = SyncMode::kTriggered;
  int projectors = 4;
  int projector_width = 1024;
  int projector_height = 768;
  double exposure_ms = 16.0;
  std::vector<double> brackets = {1.0};  // exposure factors of every step of the sweep
  // Of the other phases; each begins with 1, the exposure that all stages read.
  std::vector<double> reference_brackets = {1.0};
  std::vector<double> correspondence_brackets = {1.0};
  std::vector<double> separation_brackets = {1.0};
  std::vector<double> spot_brackets = {1.0};
  // Of a visitor's correspondence. Boards and targets have the reflected Gray code, whatever this says.
  ColumnCode code = ColumnCode::kGray;
  int preroll_markers = 8;    // white/black code on all projectors (docs/capture-plan.md)
  int separation_period = 8;  // px; sinusoid, both axes
  int separation_shifts = 4;
  bool checkerboard = false;  // shifted checkerboards on top of the sinusoids
  int checkerboard_period = 8;
  int checkerboard_shifts = 2;  // moves along each axis: shifts^2 frames
  int comb_width = 2;           // w, px
  int comb_period = 128;        // S, px
  int comb_step = 2;            // q <= w; a cycle adds up to w/q whites
  bool row_sweep = false;
  int motion_whites = 4;  // whites before, during and after the sweep
  int spot_radius = 4;    // px; 0 leaves the spot frame out
  int spot_pitch = 160;   // px
  // The sweep's first comb and the spots once more after the sweep: what differs from the first take is noise.
  bool second_takes = true;
  int guards = 2;  // black guard frames after each projector

  // Exposure factors of a phase; {1} for those that have no brackets. Those of `radiometry` follow from the kind: a
  // ramp for the camera's linearity and photon transfer (flat), a few for dark current (dark). A repeat has the first
  // factor of the phase that it repeats.
  [[nodiscard]] const std::vector<double>& BracketsOf(CapturePhase phase) const;
  // That sessions of this kind show.
  [[nodiscard]] ColumnCode ShownCode() const { return kind == SessionKind::kVisitor ? code : ColumnCode::kGray; }
  // A plane of that code.
  [[nodiscard]] Pattern PlaneOf(PatternAxis axis, int bit, bool inverse) const;
  [[nodiscard]] Status Validate() const;
};

struct CapturePlan {
  PlanOptions options;
  std::vector<PlanStep> steps;
};

// The marker code shown before the first projector: true = white.
[[nodiscard]] std::vector<bool> PrerollCode(int markers);

// Fails with kUsage when the options are out of range or no projector of that size can show them.
[[nodiscard]] Result<CapturePlan> BuildPlan(const PlanOptions& options);

// One JSON text for manifests and `stratalux-rig plan show --json`; FromJson checks it as BuildPlan does.
[[nodiscard]] std::string PlanOptionsToJson(const PlanOptions& options);
[[nodiscard]] Result<PlanOptions> PlanOptionsFromJson(const std::string& text);

}  // namespace stratalux
