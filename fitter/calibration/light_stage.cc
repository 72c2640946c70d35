// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/light_stage.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "fitter/calibration/camera_light.h"
#include "fitter/calibration/flat_target.h"
#include "fitter/calibration/light_field.h"
#include "fitter/calibration/line_profile.h"
#include "fitter/calibration/projector_ramp.h"
#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

constexpr double kMaxDarkLightDn = 3.0;  // that reaches a covered camera in the nominal exposure
constexpr double kStraight = 5e-4;       // responses nearer to a line than this are lines
constexpr double kMaxResponseResidual = 0.004;
constexpr double kMinReached = 0.6;      // of the camera's range, by the exposure ramp
constexpr double kMinWhiteShare = 0.05;  // of the range: darker targets tell nothing
constexpr double kMaxSaturated = 0.2;    // of the target
constexpr double kMaxDrift = 0.1, kWarnDrift = 0.02;
constexpr double kMaxFall = 0.02, kWarnFall = 0.005;  // of a grey ramp
constexpr double kMaxFieldResidual = 0.03;            // relative
constexpr double kMaxLineError = 0.1;                 // of a line's width

std::string Percent(double share) { return Formatted("%.1f %%", 100.0 * share); }

std::string NameOf(int projector) { return "projector " + std::to_string(projector); }

class LightStage {
 public:
  LightStage(const RigCalibration& rig, const LightStageOptions& options, Logger& logger)
      : options_(options), logger_(logger), record_(rig) {
    report_.target_albedo = options.target_albedo;
    for (const ProjectorCalibration& p : rig.projectors) report_.projectors.emplace_back().name = p.name;
  }

  Status Open(const std::string& store, const std::vector<std::string>& sessions);
  Status Run() {
    SLX_RETURN_IF_ERROR(MeasureDark());
    SLX_RETURN_IF_ERROR(MeasureCamera());
    SLX_RETURN_IF_ERROR(MeasureProjectors());
    return MeasureFlats();
  }
  LightCalibration Take() { return {std::move(report_), std::move(record_)}; }

 private:
  // Unusable, and nothing is stored; the findings go on, so that all that is wrong is told at once.
  void Refuse(const std::string& what, const std::string& remedy) {
    report_.findings.push_back({Severity::kRefusal, what, remedy});
  }
  void Warn(const std::string& what, const std::string& remedy) {
    report_.findings.push_back({Severity::kWarning, what, remedy});
  }
  void Keep(const std::string& what, const std::string& why) { report_.carried_over.push_back(what + ": " + why); }
  [[nodiscard]] double RangeDn() const { return record_.camera.saturation_dn - record_.camera.black_level_dn; }

  Status CheckSession(const SessionFrames& frames) const;
  Status MeasureDark();
  Status MeasureCamera();
  Status AddRamp(const SessionFrames& frames, ExposureRamp& ramp) const;
  void UseTransfer(const std::string& session, const ExposureRamp& ramp);
  void UseCameraResponse(const std::string& session, const ExposureRamp& ramp);
  Status MeasureProjectors();
  Status MeasureProjector(const SessionFrames& frames, int projector);
  Status MeasureFlats();
  void JudgeFlat(const FlatTarget& target);
  void UseBlackLevels(const std::vector<FlatTarget>& targets);
  void UseLightField(std::vector<FlatTarget>& targets);
  void UseLines(const std::vector<FlatTarget>& targets);

  LightStageOptions options_;
  Logger& logger_;
  std::vector<SessionFrames> dark_, flat_, response_;
  RigCalibration record_;
  LightReport report_;
};

Status LightStage::Open(const std::string& store, const std::vector<std::string>& sessions) {
  for (const std::string& selector : sessions) {
    SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(store, selector));
    for (const std::string& note : frames.store().notes()) logger_.Warning(note);
    SLX_RETURN_IF_ERROR(CheckSession(frames));
    report_.sessions.push_back(frames.info().id);
    switch (frames.info().kind) {
      case SessionKind::kDark:
        dark_.push_back(std::move(frames));
        break;
      case SessionKind::kFlat:
        flat_.push_back(std::move(frames));
        break;
      default:
        response_.push_back(std::move(frames));
    }
  }
  return Status::Ok();
}

Status LightStage::CheckSession(const SessionFrames& frames) const {
  const std::string name = "session " + frames.info().id;
  const SessionKind kind = frames.info().kind;
  if (kind != SessionKind::kDark && kind != SessionKind::kFlat && kind != SessionKind::kResponse)
    return Status::Usage(name + " is of kind " + ToString(kind) + "; light is calibrated from dark, flat and response");
  if (!frames.plan() || frames.rows().empty())
    return Status::Usage(name + " has no frames or no plan; capture it with `stratalux-rig capture --kind " +
                         ToString(kind) + "`");
  if (frames.info().status == SessionStatus::kFailed)
    return Status::Usage(name + " failed (its reasons: `stratalux-db show`); capture it again");
  const FrameRecord& first = frames.rows()[0].record;
  const Pinhole& camera = record_.camera.model;
  if (first.width != camera.width || first.height != camera.height)
    return Status::Usage(name + " has frames of " + std::to_string(first.width) + "x" + std::to_string(first.height) +
                         ", the rig's camera is " + std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                         "; give sessions of one rig");
  if (first.cfa != record_.camera.cfa)
    return Status::Usage(name + ": its frames' mosaic is not that of the rig's camera; give sessions of one rig");
  const PlanOptions& plan = *frames.plan();
  const Pinhole& projector = record_.projectors[0].model;
  if (plan.projectors != static_cast<int>(record_.projectors.size()) || plan.projector_width != projector.width ||
      plan.projector_height != projector.height)
    return Status::Usage(name + " has " + std::to_string(plan.projectors) + " projectors of " +
                         std::to_string(plan.projector_width) + "x" + std::to_string(plan.projector_height) +
                         ", the rig " + std::to_string(record_.projectors.size()) + " of " +
                         std::to_string(projector.width) + "x" + std::to_string(projector.height) +
                         "; give sessions of one rig");
  return Status::Ok();
}

Status LightStage::MeasureDark() {
  if (dark_.empty()) {
    Keep(flat_.empty() ? "black level, read noise" : "black level",
         "no session of kind dark (cover the lens: stratalux-rig capture --kind dark)");
    return Status::Ok();
  }
  DarkStatistics statistics;
  std::string names;
  for (const SessionFrames& frames : dark_) {
    names += (names.empty() ? "session " : ", ") + frames.info().id;
    for (const db::FrameRow* row : GoodRows(frames)) {
      if (row->record.phase != CapturePhase::kRadiometry) continue;
      SLX_ASSIGN_OR_RETURN(const auto raw, frames.ReadRaw(*row));
      SLX_RETURN_IF_ERROR(statistics.Add(raw, row->record.exposure_ms).WithContext(names));
    }
  }
  auto dark = statistics.Finish();
  if (!dark.ok()) {
    Refuse(names + ": " + dark.status().message(), "capture it again with --kind dark");
    return Status::Ok();
  }
  report_.dark = std::move(dark).value();
  const double light_dn = report_.dark->dark_current_dn_per_s * 1e-3 * dark_[0].plan()->exposure_ms;
  if (light_dn > kMaxDarkLightDn)
    Refuse(names + ": " + std::to_string(light_dn) + " DN reach the camera in the dark",
           "cover the lens and capture it again");
  if (report_.dark->black_level_dn < 3.0 * report_.dark->read_noise_dn)
    Warn(names + ": the black level lies within 3 standard deviations of 0, where noise is cut off",
         "raise the camera's black level");
  record_.camera.black_level_dn = report_.dark->black_level_dn;
  record_.camera.read_noise_dn = NoiseInTheDark(report_.dark->read_noise_dn, report_.dark->step_dn);
  return Status::Ok();
}

Status LightStage::AddRamp(const SessionFrames& frames, ExposureRamp& ramp) const {
  struct Rows {
    std::vector<const db::FrameRow*> whites;
    const db::FrameRow* black = nullptr;
  };
  std::map<int, Rows> brackets;
  for (const db::FrameRow* row : GoodRows(frames)) {
    const FrameRecord& r = row->record;
    if (r.phase != CapturePhase::kRadiometry || r.projector != 0) continue;
    if (r.pattern.kind == PatternKind::kWhite) brackets[r.bracket].whites.push_back(row);
    if (r.pattern.kind == PatternKind::kBlack) brackets[r.bracket].black = row;
  }
  for (const auto& [bracket, rows] : brackets) {
    if (rows.whites.size() < 2 || rows.black == nullptr) continue;
    SLX_ASSIGN_OR_RETURN(const auto a, frames.ReadRaw(*rows.whites[0]));
    SLX_ASSIGN_OR_RETURN(const auto b, frames.ReadRaw(*rows.whites[1]));
    SLX_ASSIGN_OR_RETURN(const auto black, frames.ReadRaw(*rows.black));
    ramp.Add({a, b, black, rows.black->record.exposure_ms});
  }
  return Status::Ok();
}

Status LightStage::MeasureCamera() {
  if (flat_.empty()) {
    Keep("camera gain, camera response", "no session of kind flat (a matt white target: --kind flat)");
    return Status::Ok();
  }
  // Of all targets the one whose light reaches furthest, or the newest if none tells anything.
  std::optional<ExposureRamp> best;
  std::string session;
  double reached = -1.0;
  for (const SessionFrames& frames : flat_) {
    ExposureRamp ramp(record_.camera.cfa, record_.camera.saturation_dn, record_.camera.black_level_dn);
    SLX_RETURN_IF_ERROR(AddRamp(frames, ramp));
    const auto response = ramp.Response();
    const double here = response.ok() ? response->reached : 0.0;
    if (here < reached) continue;
    reached = here;
    session = frames.info().id;
    best = std::move(ramp);
  }
  UseCameraResponse(session, *best);
  UseTransfer(session, *best);
  return Status::Ok();
}

void LightStage::UseTransfer(const std::string& session, const ExposureRamp& ramp) {
  auto transfer = ramp.Transfer(record_.camera.response);
  if (!transfer.ok()) {
    Refuse("session " + session + ": " + transfer.status().message(),
           "light the target by projector 0, unsaturated, and capture the flat session again");
    return;
  }
  report_.transfer = std::move(transfer).value();
  record_.camera.gain_e_per_dn = report_.transfer->gain_e_per_dn;
  if (report_.transfer->gain_sd > 0.03 * report_.transfer->gain_e_per_dn)
    Warn("session " + session + ": the camera's gain is known to " +
             Percent(report_.transfer->gain_sd / report_.transfer->gain_e_per_dn) + " only",
         "let the target fill more of the picture");
  if (!report_.dark)  // the next best
    record_.camera.read_noise_dn = NoiseInTheDark(report_.transfer->read_noise_dn, report_.transfer->step_dn);
}

void LightStage::UseCameraResponse(const std::string& session, const ExposureRamp& ramp) {
  auto response = ramp.Response();
  if (!response.ok()) {
    Refuse("session " + session + ": " + response.status().message(),
           "light the target by projector 0, unsaturated, and capture the flat session again");
    return;
  }
  report_.camera_response = std::move(response).value();
  const CameraResponseReport& r = *report_.camera_response;
  record_.camera.response = r.largest_deviation < kStraight ? std::vector<double>{} : r.response;
  if (r.residual > kMaxResponseResidual)
    Refuse("session " + session + ": the exposure ramp deviates from its curve by " + Percent(r.residual) +
               " of full scale; lamp or shutter is not steady",
           "let the lamps warm up, check the camera's exposure setting, and capture the flat session again");
  if (r.reached < kMinReached)
    Warn("session " + session + ": the exposure ramp reaches " + Percent(r.reached) +
             " of the camera's range; above that its response is continued in a straight line",
         "capture the flat session with a longer exposure (--exposure)");
}

Status LightStage::MeasureProjectors() {
  if (response_.empty())
    Keep("projector response", "no session of kind response (stratalux-rig capture --kind response)");
  for (SessionFrames& frames : response_) {
    RigCalibration record = record_;
    record.camera.vignetting = {};
    frames.UseRecord(record);
    for (int p = 0; p < static_cast<int>(record_.projectors.size()); ++p)
      SLX_RETURN_IF_ERROR(MeasureProjector(frames, p));
  }
  return Status::Ok();
}

Status LightStage::MeasureProjector(const SessionFrames& frames, int projector) {
  const std::string name = "session " + frames.info().id + ", " + NameOf(projector);
  const int pose = GoodRows(frames).empty() ? -1 : GoodRows(frames).front()->record.pose;
  auto white = frames.Read(projector, CapturePhase::kReference, {.kind = PatternKind::kWhite}, pose);
  auto black = frames.MeanBlack(projector);
  if (!white.ok() || !black.ok()) {
    const Status& why = white.ok() ? black.status() : white.status();
    if (why.code() != StatusCode::kNotFound) return why;
    Refuse(name + ": no good white or black frame",
           "its reasons (`stratalux-db show`) say what to change; capture the response session again");
    return Status::Ok();
  }
  const double saturation = frames.calibration()->camera.saturation_dn;
  std::vector<float> contrast(white->size());
  for (size_t i = 0; i < contrast.size(); ++i)
    contrast[i] = static_cast<float>(white->pixels()[i]) - black->pixels()[i];
  std::vector<float> sorted = contrast;
  const auto high = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() * 95 / 100);
  std::nth_element(sorted.begin(), high, sorted.end());
  const float bright = *high;
  if (bright < kMinWhiteShare * RangeDn()) {
    Refuse(name + ": white gives " + std::to_string(static_cast<int>(bright)) + " DN only",
           "show it a light target, or expose longer (--exposure)");
    return Status::Ok();
  }
  std::vector<size_t> sites;
  size_t saturated = 0;
  for (size_t i = 0; i < contrast.size(); ++i) {
    if (contrast[i] < 0.3F * bright) continue;
    if (white->pixels()[i] >= saturation) {
      ++saturated;
    } else {
      sites.push_back(i);
    }
  }
  const double saturated_share =
      static_cast<double>(saturated) / static_cast<double>(std::max<size_t>(sites.size() + saturated, 1));
  if (saturated_share > kMaxSaturated) {
    Refuse(name + ": " + Percent(saturated_share) + " of the lit target is saturated",
           "expose shorter (--exposure) and capture the response session again");
    return Status::Ok();
  }
  std::vector<RampFrame> ramp;
  for (const db::FrameRow* row : GoodRows(frames)) {
    const FrameRecord& r = row->record;
    const bool grey = r.pattern.kind == PatternKind::kGrey, is_white = r.pattern.kind == PatternKind::kWhite;
    if (r.projector != projector || (!grey && !is_white)) continue;
    SLX_ASSIGN_OR_RETURN(const auto frame, frames.ReadLinear(*row));
    double light = 0.0;
    for (const size_t i : sites) light += frame.pixels()[i] - black->pixels()[i];
    ramp.push_back({grey ? static_cast<double>(r.pattern.shift) / r.pattern.shifts : 1.0, light, r.step});
  }
  auto fitted = FitProjectorRamp(ramp);
  if (!fitted.ok()) {
    Refuse(name + ": " + fitted.status().message(), "capture the response session again");
    return Status::Ok();
  }
  ProjectorLightReport& report = report_.projectors[projector];
  report.response = fitted->response;
  report.largest_deviation = fitted->largest_deviation;
  report.lamp_drift = fitted->lamp_drift;
  report.worst_fall = fitted->worst_fall;
  record_.projectors[projector].response =
      fitted->largest_deviation < kStraight ? std::vector<double>{} : fitted->response;
  if (fitted->worst_fall > kWarnFall) {
    const std::string what = name + ": the grey ramp falls by " + Percent(fitted->worst_fall) + " of white somewhere";
    const std::string remedy = "check the projector's picture modes (dynamic contrast, dithering) and its lamp";
    fitted->worst_fall > kMaxFall ? Refuse(what, remedy) : Warn(what, remedy);
  }
  if (fitted->lamp_drift > kWarnDrift) {
    const std::string what = name + ": white changes by " + Percent(fitted->lamp_drift) + " during the ramp";
    const std::string remedy = "let the lamp warm up, let nothing move, and capture the response session again";
    fitted->lamp_drift > kMaxDrift ? Refuse(what, remedy) : Warn(what, remedy);
  }
  return Status::Ok();
}

Status LightStage::MeasureFlats() {
  if (flat_.empty()) {
    Keep("fall-off, vignetting, white scale, projector black, blur", "no session of kind flat");
    return Status::Ok();
  }
  std::vector<FlatTarget> targets;
  Progress progress(logger_, "flat targets", static_cast<int64_t>(flat_.size()));
  for (SessionFrames& frames : flat_) {
    // Vignetting is what is looked for: frames keep it.
    RigCalibration record = record_;
    record.camera.vignetting = {};
    frames.UseRecord(record);
    auto target = MeasureFlat(frames, static_cast<int>(targets.size()));
    progress.Advance();
    if (!target.ok()) {
      if (target.status().code() == StatusCode::kIntegrity) return target.status();
      Refuse("session " + frames.info().id + ": " + target.status().message(), "capture the flat session again");
      continue;
    }
    JudgeFlat(*target);
    targets.push_back(std::move(target).value());
  }
  if (targets.empty()) return Status::Ok();
  UseBlackLevels(targets);
  UseLightField(targets);
  UseLines(targets);
  for (FlatTarget& target : targets) report_.flats.push_back(std::move(target.report));
  return Status::Ok();
}

void LightStage::JudgeFlat(const FlatTarget& target) {
  for (size_t p = 0; p < target.saturated.size(); ++p) {
    const std::string name = "session " + target.report.session + ", " + NameOf(static_cast<int>(p));
    if (target.saturated[p] > kMaxSaturated)
      Refuse(name + ": " + Percent(target.saturated[p]) + " of the target is saturated",
             "expose shorter (--exposure) and capture the flat session again");
    if (target.median_white_dn[p] < kMinWhiteShare * RangeDn())
      Refuse(name + ": white gives " + std::to_string(static_cast<int>(target.median_white_dn[p])) + " DN only",
             "bring the target to the working distance, or expose longer (--exposure)");
  }
}

void LightStage::UseBlackLevels(const std::vector<FlatTarget>& targets) {
  std::vector<BlackSample> samples;
  for (const FlatTarget& target : targets) samples.insert(samples.end(), target.blacks.begin(), target.blacks.end());
  const auto levels = FitBlackLevels(samples);
  if (!levels.ok()) {
    Keep("projector black level", levels.status().message() + " (pre-roll markers show all projectors' black)");
    return;
  }
  for (size_t p = 0; p < levels->size(); ++p) {
    report_.projectors[p].black_level = (*levels)[p];
    record_.projectors[p].black_level = (*levels)[p];
  }
}

void LightStage::UseLightField(std::vector<FlatTarget>& targets) {
  std::vector<FlatSample> samples;
  for (const FlatTarget& target : targets) samples.insert(samples.end(), target.samples.begin(), target.samples.end());
  // White less black lacks the projector's own black.
  for (FlatSample& s : samples) s.white_dn /= 1.0 - record_.projectors[s.projector].black_level;
  auto field = FitLightField(samples, record_, options_.target_albedo, VignettingFit::kFree);
  if (!field.ok()) {
    Warn(field.status().message() + "; the camera's vignetting stays as it was",
         "capture more flat sessions, with the target nearer, farther and tilted");
    Keep("vignetting", field.status().message());
    field = FitLightField(samples, record_, options_.target_albedo, VignettingFit::kKnown);
  } else {
    report_.vignetting = field->vignetting;
    report_.vignetting_sd = field->vignetting_sd;
    const double edge = std::abs(field->vignetting[0] + field->vignetting[1]);
    const bool none = edge < 0.002 || edge < field->vignetting_sd;
    record_.camera.vignetting = none ? std::array<double, 2>{} : field->vignetting;
  }
  if (!field.ok()) {
    Refuse(field.status().message(), "bring the target to the working distance and capture the flat sessions again");
    return;
  }
  for (size_t p = 0; p < field->projectors.size(); ++p) {
    const LightField::OfProjector& of = field->projectors[p];
    report_.projectors[p].falloff = of.falloff;
    report_.projectors[p].falloff_sd = of.falloff_sd;
    report_.projectors[p].white_dn_mm2_per_ms = of.white_dn_mm2_per_ms;
    record_.projectors[p].falloff = of.falloff;
    record_.projectors[p].white_dn_mm2_per_ms = of.white_dn_mm2_per_ms;
  }
  for (size_t k = 0; k < targets.size(); ++k) {
    const double residual = field->residual[k];
    targets[k].report.residual = residual;
    if (residual > kMaxFieldResidual)
      Refuse("session " + targets[k].report.session + ": the target's light deviates from the model by " +
                 Percent(residual),
             "use a matt, evenly white, clean target with nothing else in the light, and warm lamps");
  }
}

void LightStage::UseLines(const std::vector<FlatTarget>& targets) {
  std::vector<BlurSample> blurs;
  for (size_t p = 0; p < record_.projectors.size(); ++p) {
    ProjectedLine line;
    double width = 0.0;
    int shapes = 0;
    for (const FlatTarget& target : targets) {
      if (target.lines.empty()) continue;
      LineSamples all = target.lines[2 * p];
      all.Merge(target.lines[2 * p + 1]);
      const auto shape = FitLine(all);
      if (!shape.ok()) {
        Keep(NameOf(static_cast<int>(p)) + ", blur in session " + target.report.session, shape.status().message());
        continue;
      }
      ++shapes;
      width += shape->width_px;
      line.width_px = all.width_px();
      line.mm += shape->width_px * target.mm_per_column[p];
      line.offset_px.clear();
      line.light.clear();
      for (size_t k = 0; k < all.bins().size(); ++k) {
        line.offset_px.push_back(all.OffsetOf(k));
        line.light.push_back(all.bins()[k].sum / static_cast<double>(all.bins()[k].count));
      }
      for (const LineSamples& half : {target.lines[2 * p], target.lines[2 * p + 1]})
        if (const auto of_half = FitLine(half); of_half.ok())
          blurs.push_back({static_cast<int>(p), of_half->sigma_px, half.MeanColumnsPerPx2()});
    }
    if (shapes == 0) continue;
    line.measured_px = width / shapes;
    line.mm /= shapes;
    if (std::abs(line.measured_px / line.width_px - 1.0) > kMaxLineError)
      Warn(
          NameOf(static_cast<int>(p)) + ": lines of " + std::to_string(line.width_px) + " columns carry the light of " +
              std::to_string(line.measured_px),
          "check that the projector shows its own pixels (no scaling, no keystone correction) and that lamps are warm");
    report_.projectors[p].line = std::move(line);
  }
  if (blurs.empty()) {
    Keep("blur of projectors and camera", "no lines in the flat sessions");
    return;
  }
  const LineBlur blur = SplitBlur(blurs, record_.projectors.size(), record_.camera.line_blur_px);
  report_.camera_blur_px = blur.camera_px;
  if (blur.camera_px) {
    record_.camera.line_blur_px = *blur.camera_px;
  } else {
    Keep("camera blur", "the lines' footprints differ too little; tilt the flat target more from session to session");
  }
  for (size_t p = 0; p < record_.projectors.size(); ++p) {
    auto& line = report_.projectors[p].line;
    if (!line) continue;
    report_.projectors[p].line_blur_px = blur.projector_px[p];
    record_.projectors[p].line_blur_px = blur.projector_px[p];
    line->fwhm_mm = FullWidthAtHalf(line->measured_px, blur.projector_px[p]) * line->mm / line->measured_px;
  }
}

}  // namespace

Status LightStageOptions::Validate() const {
  if (target_albedo > 0.0 && target_albedo <= 1.2) return Status::Ok();
  return Status::Usage("--target-albedo " + std::to_string(target_albedo) + ", allowed: above 0 .. 1.2");
}

Result<LightCalibration> CalibrateLight(const std::string& store, const std::vector<std::string>& sessions,
                                        const RigCalibration& rig, const LightStageOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  LightStage stage(rig, options, logger);
  SLX_RETURN_IF_ERROR(stage.Open(store, sessions));
  SLX_RETURN_IF_ERROR(stage.Run());
  return stage.Take();
}

}  // namespace stratalux::fit
