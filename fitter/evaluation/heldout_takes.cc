// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/heldout_takes.h"

#include <map>
#include <vector>

#include "fitter/session/quad_signal.h"

namespace stratalux::fit {
namespace {

bool IsTake(const FrameRecord& r, int projector, const std::string& light, const Pattern& pattern) {
  const bool phase = light == "white" ? r.phase == CapturePhase::kMotion
                                      : r.phase == HeldOutPhase(light) || r.phase == CapturePhase::kRepeat;
  return phase && r.projector == projector && r.bracket == 0 && r.pattern == pattern &&
         r.level_check != LevelCheck::kFailed;
}

}  // namespace

Pattern HeldOutPattern(const std::string& light, const PlanOptions& plan) {
  if (light == "stripe")
    return {.kind = PatternKind::kComb, .period = plan.comb_period, .width = plan.comb_width, .shift = 0};
  if (light == "spot") return {.kind = PatternKind::kSpots, .period = plan.spot_pitch, .width = plan.spot_radius};
  return {.kind = PatternKind::kWhite};
}

CapturePhase HeldOutPhase(const std::string& light) {
  return light == "stripe" ? CapturePhase::kSweep : light == "spot" ? CapturePhase::kSpot : CapturePhase::kReference;
}

double HeldOutFactor(const std::string& light, const PlanOptions& plan) {
  return light == "white" ? 1.0 : plan.BracketsOf(HeldOutPhase(light))[0];
}

std::vector<const db::FrameRow*> HeldOutTakesOf(const SessionFrames& frames, int projector, const std::string& light) {
  const Pattern pattern = HeldOutPattern(light, *frames.plan());
  std::map<int, const db::FrameRow*> of_step;
  for (const db::FrameRow& row : frames.rows())
    if (IsTake(row.record, projector, light, pattern)) of_step[row.record.step] = &row;
  std::vector<const db::FrameRow*> takes;
  for (const auto& [step, row] : of_step) takes.push_back(row);
  return takes;
}

Result<Image<float>> HeldOutBlack(const SessionFrames& frames, int projector, const std::string& light) {
  const double factor = HeldOutFactor(light, *frames.plan());
  return factor == 1.0 ? frames.MeanBlack(projector) : frames.MeanBlack(projector, factor);
}

Result<HeldOutTarget> ReadHeldOutTarget(const SessionFrames& frames, int projector, const std::string& light) {
  if (!frames.plan() || !frames.calibration())
    return Status::NotFound("session " + frames.info().id +
                            " has no plan or no calibration: which frames are takes is not known");
  std::vector<const db::FrameRow*> takes = HeldOutTakesOf(frames, projector, light);
  if (takes.size() % 2 == 1) takes.erase(takes.begin() + static_cast<int64_t>(takes.size() / 2));
  if (takes.size() < 2)
    return Status::NotFound("session " + frames.info().id + " has less than two good takes of the " + light +
                            " light of projector " + std::to_string(projector) +
                            "; capture it with `second_takes` and `motion_whites` in [plan]");
  const CameraCalibration& camera = frames.calibration()->camera;
  SLX_ASSIGN_OR_RETURN(const auto black, HeldOutBlack(frames, projector, light));
  const double factor = HeldOutFactor(light, *frames.plan());
  HeldOutTarget result;
  result.takes = static_cast<int>(takes.size());
  for (size_t k = 0; k < takes.size(); ++k) {
    SLX_ASSIGN_OR_RETURN(const auto raw, frames.ReadLinear(*takes[k]));
    const Image<float> y = QuadSignal(raw, black, camera);
    if (k == 0) result.target = result.noise = Image<float>(y.width(), y.height(), y.channels());
    if (y.size() != result.target.size())
      return Status::Integrity("session " + frames.info().id + ": takes of the " + light + " light of projector " +
                               std::to_string(projector) + " differ in size");
    const float share = 1.0F / static_cast<float>(static_cast<double>(takes.size()) * factor),
                sign = 2 * k < takes.size() ? share : -share;
    for (size_t i = 0; i < y.size(); ++i) {
      result.target.pixels()[i] += share * y.pixels()[i];
      result.noise.pixels()[i] += sign * y.pixels()[i];
    }
  }
  return result;
}

}  // namespace stratalux::fit
