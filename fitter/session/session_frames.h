// SPDX-License-Identifier: Apache-2.0
// The frames of one session by what they show: the only door between the store and the stages, which take views.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "fitter/sensor/linear_frame.h"
#include "shared/capture/rig_calibration.h"
#include "shared/capture/thin_plan.h"

namespace stratalux::fit {

// Thread-bound.
class SessionFrames {
 public:
  // kNotFound / kUsage for the selector; kIntegrity where manifest texts are damaged.
  static Result<SessionFrames> Open(const std::string& store_folder, const std::string& selector);

  [[nodiscard]] const SessionInfo& info() const { return session_.info; }
  [[nodiscard]] std::filesystem::path folder() const;
  [[nodiscard]] db::SessionStore& store() { return store_; }
  [[nodiscard]] const db::SessionStore& store() const { return store_; }
  // From the session's manifest; nullopt for imports without one.
  [[nodiscard]] const std::optional<PlanOptions>& plan() const { return plan_; }
  // Of the frames as Read gives them: a linear camera without vignetting (FrameLineariser).
  [[nodiscard]] const std::optional<RigCalibration>& calibration() const { return calibration_; }
  // As the manifest has it.
  [[nodiscard]] const std::optional<RigCalibration>& record() const { return record_; }
  // Those that count: of a step that was shot again none of before its last good frame.
  [[nodiscard]] const std::vector<db::FrameRow>& rows() const { return rows_; }
  // The others.
  [[nodiscard]] const std::vector<db::FrameRow>& replaced() const { return replaced_; }
  // Of those, whether a jump of the subject had it shot again: it shows what was planned, and where the subject was.
  [[nodiscard]] bool BeforeJump(const db::FrameRow& row) const { return before_jump_.contains(row.id); }
  // Whether the subject jumped between two frames of one projector, and was captured anew. Of the whole session, also
  // where KeepOnly took what saw it happen.
  [[nodiscard]] bool JumpedBetween(const db::FrameRow& before, const db::FrameRow& after) const;
  [[nodiscard]] std::vector<int> poses() const;

  // The last good shot (a failed level check does not count) of a pattern in exposure bracket `bracket` (0: nominal);
  // nullptr when there is none.
  [[nodiscard]] const db::FrameRow* Find(int projector, CapturePhase phase, const Pattern& pattern, int pose = -1,
                                         int bracket = 0) const;
  // As Find; kNotFound names projector, phase and pattern.
  [[nodiscard]] Result<const db::FrameRow*> Require(int projector, CapturePhase phase, const Pattern& pattern,
                                                    int pose = -1, int bracket = 0) const;
  // As Require, then decoded pixels, linear.
  [[nodiscard]] Result<Image<uint16_t>> Read(int projector, CapturePhase phase, const Pattern& pattern, int pose = -1,
                                             int bracket = 0) const;
  // The reference white of a projector (and pose), or where it is missing the first other one of its exposure, which
  // shows the same; nullptr: there is none.
  [[nodiscard]] const db::FrameRow* FindWhite(int projector, int pose = -1) const;
  // Whether MeanBlack has a frame to read.
  [[nodiscard]] bool HasBlack(int projector) const;
  // Any frame, linear as Read gives it.
  [[nodiscard]] Result<Image<uint16_t>> ReadLinear(const db::FrameRow& row) const;
  // Any frames, linear, in their order; all threads read and decode.
  [[nodiscard]] Result<std::vector<Image<uint16_t>>> ReadAll(std::span<const db::FrameRow* const> rows) const;
  // From here on as if no other frames had been captured: rows(), Find and whatever reads by them know these alone.
  void KeepOnly(const ThinPlan& thin);
  // What is kept of a cycle: one comb in so many.
  [[nodiscard]] int comb_every() const { return thin_ ? thin_->comb_every : 1; }
  // Whether the plan has a sweep over rows, and it is kept.
  [[nodiscard]] bool row_sweep() const { return plan_ && plan_->row_sweep && (!thin_ || thin_->row_sweep); }
  // Axes along which sinusoids are kept.
  [[nodiscard]] std::vector<PatternAxis> sinusoids() const;
  // Any frame, as the camera gave it.
  [[nodiscard]] Result<Image<uint16_t>> ReadRaw(const db::FrameRow& row) const;
  // Reads on as if the session had been captured with this record.
  void UseRecord(const RigCalibration& record);
  // Mean of the projector's black frames (reference and guards): ambient light, black level and the projector's own
  // black. Kept, since most stages ask for it.
  [[nodiscard]] Result<Image<float>> MeanBlack(int projector) const;
  // The same for frames of another exposure, `factor` times the nominal one: of black frames that were captured so
  // (reference brackets), else the nominal ones with their light scaled.
  [[nodiscard]] Result<Image<float>> MeanBlack(int projector, double factor) const;
  // Mean of the projector's white frames (reference and motion checks); NaN where a site was saturated. `count`
  // receives their number.
  [[nodiscard]] Result<Image<float>> MeanWhite(int projector, int& count) const;
  // Of the session's plan, patterns and pixels, however the frames are coded; and of the record by which they are read.
  [[nodiscard]] Result<std::string> FramesHash() const;
  [[nodiscard]] std::string RecordHash() const;

 private:
  // Mean of the black frames of a bracket, without most of its noise where the rig is known.
  [[nodiscard]] Result<Image<float>> QuietBlack(int projector, int bracket) const;
  [[nodiscard]] Result<Image<float>> MeanOf(int projector, PatternKind kind, int bracket, int& count) const;
  SessionFrames(db::SessionStore store, db::SessionRow session);
  void Index();
  static std::string Key(int projector, CapturePhase phase, const Pattern& pattern, int pose, int bracket);

  db::SessionStore store_;
  db::SessionRow session_;
  std::optional<PlanOptions> plan_;
  std::optional<RigCalibration> record_, calibration_;
  std::optional<FrameLineariser> lineariser_;
  std::optional<ThinPlan> thin_;
  std::vector<db::FrameRow> rows_, replaced_;
  std::set<int64_t> before_jump_;                  // ids
  std::map<int, std::vector<MonotonicNs>> jumps_;  // by projector: of the first frame behind each
  std::map<std::string, size_t> by_key_;
  mutable std::vector<db::SessionStore> readers_;  // of ReadAll's other threads
  mutable std::map<int, Image<float>> black_;      // by projector
};

}  // namespace stratalux::fit
