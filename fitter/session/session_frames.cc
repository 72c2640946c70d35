// SPDX-License-Identifier: Apache-2.0
#include "fitter/session/session_frames.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <ranges>
#include <set>
#include <string>
#include <utility>

#include "db/base/own_hash.h"
#include "db/catalogue/pixel_digest.h"
#include "fitter/sensor/dark_frame.h"
#include "shared/base/parallel_each.h"
#include "shared/capture/retake_cause.h"

namespace stratalux::fit {
namespace {

constexpr size_t kReadAtATime = 8;  // frames of a mean, held at once

// Takes out of `rows` what counts no more: of a step that was shot again, all before its last good frame. `before_jump`
// gets those of it that a jump of the subject had shot again.
std::vector<db::FrameRow> TakeReplaced(std::vector<db::FrameRow>& rows, std::set<int64_t>& before_jump) {
  std::set<std::pair<int, int>> taken_again;       // pose, step
  std::map<std::pair<int, int>, bool> for_a_jump;  // of the next shot of the step
  std::vector<db::FrameRow> counting, replaced;
  for (db::FrameRow& row : std::views::reverse(rows)) {
    const FrameRecord& r = row.record;
    const std::pair place(r.pose, r.step);
    const bool counts = !taken_again.contains(place);
    if (!counts && for_a_jump[place]) before_jump.insert(row.id);
    for_a_jump[place] = r.retake_cause == kRetakenForAJump;
    if (r.retry > 0 && r.level_check != LevelCheck::kFailed) taken_again.insert(place);
    (counts ? counting : replaced).push_back(std::move(row));
  }
  std::ranges::reverse(counting);
  std::ranges::reverse(replaced);
  rows = std::move(counting);
  return replaced;
}

// When a projector was begun anew for a jump of the subject: something was refuted, and its first step is shot again.
// What is shot again once more behind that (the reference, after it was asked) follows nothing refuted.
std::map<int, std::vector<MonotonicNs>> JumpsIn(const std::vector<db::FrameRow>& rows) {
  struct Shown {
    int step = -1;
    bool refuted = false;
  };
  std::map<int, Shown> last;  // by projector
  std::map<int, std::vector<MonotonicNs>> jumps;
  for (const db::FrameRow& row : rows) {
    const FrameRecord& r = row.record;
    Shown& shown = last[r.projector];
    const bool back = r.step <= shown.step && r.retake_cause == kRetakenForAJump;
    if (back && shown.refuted) jumps[r.projector].push_back(r.trigger_time);
    shown = {r.step, (shown.refuted && !back) || r.level_check == LevelCheck::kFailed};
  }
  return jumps;
}

}  // namespace

SessionFrames::SessionFrames(db::SessionStore store, db::SessionRow session)
    : store_(std::move(store)), session_(std::move(session)) {}

std::string SessionFrames::Key(int projector, CapturePhase phase, const Pattern& pattern, int pose, int bracket) {
  return std::to_string(projector) + "|" + ToString(phase) + "|" + pattern.ToString() + "|" + std::to_string(pose) +
         "|" + std::to_string(bracket);
}

Result<SessionFrames> SessionFrames::Open(const std::string& store_folder, const std::string& selector) {
  SLX_ASSIGN_OR_RETURN(auto store, db::SessionStore::Open(store_folder, db::AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(auto session, store.FindSession(selector));
  const std::string where = "session " + session.info.id;
  session.info.devices = store.DevicesOf(session.info.id);
  SessionFrames frames(std::move(store), std::move(session));
  const SessionInfo& info = frames.session_.info;
  if (!info.plan_json.empty()) {
    SLX_ASSIGN_OR_RETURN(frames.plan_, PlanOptionsFromJson(info.plan_json).WithContext(where));
  }
  if (!info.calibration_json.empty()) {
    SLX_ASSIGN_OR_RETURN(const auto record, RigCalibration::FromJson(info.calibration_json).WithContext(where));
    frames.UseRecord(record);
  }
  SLX_ASSIGN_OR_RETURN(frames.rows_, frames.store_.ListFrames(info.id));
  frames.jumps_ = JumpsIn(frames.rows_);
  frames.replaced_ = TakeReplaced(frames.rows_, frames.before_jump_);
  frames.Index();
  return frames;
}

bool SessionFrames::JumpedBetween(const db::FrameRow& before, const db::FrameRow& after) const {
  const auto of = jumps_.find(before.record.projector);
  return of != jumps_.end() && std::ranges::any_of(of->second, [&](MonotonicNs jump) {
           return before.record.trigger_time < jump && jump <= after.record.trigger_time;
         });
}

void SessionFrames::Index() {
  by_key_.clear();
  for (size_t i = 0; i < rows_.size(); ++i) {
    const FrameRecord& r = rows_[i].record;
    if (r.level_check == LevelCheck::kFailed) continue;
    by_key_[Key(r.projector, r.phase, r.pattern, r.pose, r.bracket)] = i;
  }
}

void SessionFrames::KeepOnly(const ThinPlan& thin) {
  thin_ = thin;
  for (std::vector<db::FrameRow>* rows : {&rows_, &replaced_})
    std::erase_if(*rows,
                  [&](const db::FrameRow& row) { return !std::ranges::binary_search(thin.kept, row.record.step); });
  Index();
  black_.clear();
}

void SessionFrames::UseRecord(const RigCalibration& record) {
  record_ = calibration_ = record;
  lineariser_.emplace(record.camera);
  calibration_ = LinearRig(record);
  black_.clear();
}

std::vector<PatternAxis> SessionFrames::sinusoids() const {
  if (!thin_) return {PatternAxis::kColumns, PatternAxis::kRows};
  return thin_->sinusoids;
}

Result<Image<uint16_t>> SessionFrames::ReadRaw(const db::FrameRow& row) const {
  return store_.ReadFrame(info().id, row);
}

Result<Image<uint16_t>> SessionFrames::ReadLinear(const db::FrameRow& row) const {
  SLX_ASSIGN_OR_RETURN(auto frame, ReadRaw(row));
  if (lineariser_) lineariser_->Apply(frame, row.record.crop_x, row.record.crop_y);
  return frame;
}

std::filesystem::path SessionFrames::folder() const { return store_.SessionFolder(session_.info.id); }

std::vector<int> SessionFrames::poses() const {
  std::set<int> poses;
  for (const db::FrameRow& row : rows_) poses.insert(row.record.pose);
  return {poses.begin(), poses.end()};
}

const db::FrameRow* SessionFrames::Find(int projector, CapturePhase phase, const Pattern& pattern, int pose,
                                        int bracket) const {
  const auto found = by_key_.find(Key(projector, phase, pattern, pose, bracket));
  return found == by_key_.end() ? nullptr : &rows_[found->second];
}

Result<const db::FrameRow*> SessionFrames::Require(int projector, CapturePhase phase, const Pattern& pattern, int pose,
                                                   int bracket) const {
  const db::FrameRow* row = Find(projector, phase, pattern, pose, bracket);
  if (row == nullptr)
    return Status::NotFound("session " + info().id + " has no good frame of projector " + std::to_string(projector) +
                            ", " + ToString(phase) + ", '" + pattern.ToString() + "'" +
                            (pose >= 0 ? ", pose " + std::to_string(pose) : "") +
                            (bracket > 0 ? ", bracket " + std::to_string(bracket) : "") +
                            " (its reasons: `stratalux-db show`); capture it again with nothing moving");
  return row;
}

const db::FrameRow* SessionFrames::FindWhite(int projector, int pose) const {
  const Pattern white = {.kind = PatternKind::kWhite};
  if (const db::FrameRow* row = Find(projector, CapturePhase::kReference, white, pose)) return row;
  const auto other = std::ranges::find_if(rows_, [&](const db::FrameRow& row) {
    const FrameRecord& r = row.record;
    return r.projector == projector && r.pose == pose && r.pattern == white && r.bracket == 0 &&
           r.level_check != LevelCheck::kFailed;
  });
  return other == rows_.end() ? nullptr : &*other;
}

bool SessionFrames::HasBlack(int projector) const {
  return std::ranges::any_of(rows_, [&](const db::FrameRow& row) {
    const FrameRecord& r = row.record;
    return r.projector == projector && r.pattern.kind == PatternKind::kBlack && r.bracket == 0 &&
           r.level_check != LevelCheck::kFailed;
  });
}

Result<Image<uint16_t>> SessionFrames::Read(int projector, CapturePhase phase, const Pattern& pattern, int pose,
                                            int bracket) const {
  SLX_ASSIGN_OR_RETURN(const db::FrameRow* row, Require(projector, phase, pattern, pose, bracket));
  return ReadLinear(*row);
}

Result<std::vector<Image<uint16_t>>> SessionFrames::ReadAll(std::span<const db::FrameRow* const> rows) const {
  const auto threads = std::min(rows.size(), static_cast<size_t>(DefaultThreadCount()));
  // A store is bound to its thread.
  while (readers_.size() + 1 < threads) {
    SLX_ASSIGN_OR_RETURN(auto reader, db::SessionStore::Open(store_.folder(), db::AccessMode::kReadOnly));
    readers_.push_back(std::move(reader));
  }
  std::vector<Image<uint16_t>> frames(rows.size());
  std::vector<Status> failed(rows.size());
  std::atomic<size_t> next{0};
  const auto read_with = [&](const db::SessionStore& store) {
    for (size_t i = next++; i < rows.size(); i = next++) {
      auto frame = store.ReadFrame(info().id, *rows[i]);
      if (frame.ok())
        frames[i] = std::move(*frame);
      else
        failed[i] = frame.status();
    }
  };
  ParallelEach(threads, [&](size_t reader) { read_with(reader == 0 ? store_ : readers_[reader - 1]); });
  for (const Status& status : failed) SLX_RETURN_IF_ERROR(status);
  for (size_t i = 0; lineariser_ && i < rows.size(); ++i)
    lineariser_->Apply(frames[i], rows[i]->record.crop_x, rows[i]->record.crop_y);
  return frames;
}

Result<Image<float>> SessionFrames::MeanOf(int projector, PatternKind kind, int bracket, int& count) const {
  const float saturation = calibration_ ? static_cast<float>(calibration_->camera.saturation_dn) : 1e9F;
  const std::string name = kind == PatternKind::kWhite ? "white" : "black";
  std::vector<const db::FrameRow*> rows;
  for (const db::FrameRow& row : rows_) {
    const FrameRecord& r = row.record;
    if (r.projector == projector && r.pattern.kind == kind && r.bracket == bracket &&
        r.level_check != LevelCheck::kFailed)
      rows.push_back(&row);
  }
  Image<float> mean;
  count = static_cast<int>(rows.size());
  for (size_t first = 0; first < rows.size(); first += kReadAtATime) {
    const auto block = std::span(rows).subspan(first, std::min(kReadAtATime, rows.size() - first));
    SLX_ASSIGN_OR_RETURN(const auto images, ReadAll(block));
    for (const Image<uint16_t>& image : images) {
      if (mean.empty()) mean = Image<float>(image.width(), image.height());
      if (mean.width() != image.width() || mean.height() != image.height())
        return Status::Integrity("session " + info().id + ": " + name + " frames of projector " +
                                 std::to_string(projector) + " differ in size");
      for (size_t i = 0; i < mean.size(); ++i) {
        const float level = image.pixels()[i];
        mean.pixels()[i] += kind == PatternKind::kWhite && level >= saturation ? std::nanf("") : level;
      }
    }
  }
  if (count == 0)
    return Status::NotFound("session " + info().id + " has no " + name + " frame of projector " +
                            std::to_string(projector));
  for (float& v : mean.pixels()) v /= static_cast<float>(count);
  return mean;
}

Result<Image<float>> SessionFrames::MeanBlack(int projector) const {
  const auto kept = black_.find(projector);
  if (kept != black_.end()) return kept->second;
  SLX_ASSIGN_OR_RETURN(auto mean, QuietBlack(projector, 0));
  return black_.emplace(projector, std::move(mean)).first->second;
}

Result<Image<float>> SessionFrames::QuietBlack(int projector, int bracket) const {
  int count = 0, whites = 0;
  SLX_ASSIGN_OR_RETURN(auto mean, MeanOf(projector, PatternKind::kBlack, bracket, count));
  if (!calibration_) return mean;
  if (projector < 0) return QuietDarkFrame({mean.view(), count}, calibration_->camera);  // all of them: no one's white
  const auto white = MeanWhite(projector, whites);
  if (white.status().code() == StatusCode::kNotFound) return QuietDarkFrame({mean.view(), count}, calibration_->camera);
  if (!white.ok()) return white.status();
  if (white->width() != mean.width() || white->height() != mean.height())
    return Status::Integrity("session " + info().id + ": white and black frames of projector " +
                             std::to_string(projector) + " differ in size");
  return QuietDarkFrame({mean.view(), count}, calibration_->camera, {white->view(), whites});
}

Result<Image<float>> SessionFrames::MeanBlack(int projector, double factor) const {
  const std::vector<double> captured = plan_ ? plan_->reference_brackets : std::vector<double>{1.0};
  for (size_t b = 1; b < captured.size(); ++b) {
    if (std::abs(captured[b] / factor - 1.0) > 0.01) continue;
    auto mean = QuietBlack(projector, static_cast<int>(b));
    if (mean.status().code() == StatusCode::kNotFound) break;
    return mean;
  }
  SLX_ASSIGN_OR_RETURN(auto mean, MeanBlack(projector));
  const auto level = static_cast<float>(calibration_ ? calibration_->camera.black_level_dn : 0.0);
  for (float& v : mean.pixels()) v = level + (v - level) * static_cast<float>(factor);
  return mean;
}

Result<Image<float>> SessionFrames::MeanWhite(int projector, int& count) const {
  return MeanOf(projector, PatternKind::kWhite, 0, count);
}

std::string SessionFrames::RecordHash() const { return db::HashHex(record_ ? record_->ToJson() : std::string()); }

Result<std::string> SessionFrames::FramesHash() const {
  std::vector<db::FrameRow> rows = rows_;
  rows.insert(rows.end(), replaced_.begin(), replaced_.end());
  SLX_ASSIGN_OR_RETURN(const std::string pixels, db::PixelDigest(store_, session_, rows));
  std::string all = info().id + info().plan_json + pixels;
  for (const db::FrameRow& row : rows) {
    all += row.record.pattern.ToString();
    // What no reader takes says so: a frame may be withdrawn after fits were made of it.
    if (row.record.level_check == LevelCheck::kFailed) all += " failed " + std::to_string(row.id);
  }
  return db::HashHex(all);
}

}  // namespace stratalux::fit
