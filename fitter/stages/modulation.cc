// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/modulation.h"

#include <set>
#include <utility>

#include "fitter/session/quad_signal.h"
#include "fitter/session/sinusoid_sets.h"
#include "fitter/stages/decode.h"

namespace stratalux::fit {
namespace {

constexpr PatternAxis kSinusoidAxes[] = {PatternAxis::kColumns, PatternAxis::kRows};

struct SetChoice {
  std::vector<SinusoidSet> read;
  std::vector<std::pair<SinusoidSet, std::string>> left;  // and why
};

std::string MissingShifts(const SinusoidSet& set) {
  std::set<int> there;
  for (const db::FrameRow* row : set.rows) there.insert(row->record.pattern.shift);
  std::string missing;
  for (int shift = 0; shift < set.shifts; ++shift)
    if (!there.contains(shift))
      missing += (missing.empty() ? "" : ", ") + std::to_string(shift) + "/" + std::to_string(set.shifts);
  return "shift " + missing + " is missing, and steps must be equal";
}

SetChoice ChooseSets(const SessionFrames& frames, const SinusoidPlace& place, PatternAxis axis) {
  SetChoice choice;
  for (SinusoidSet& set : SinusoidSets(frames, place.projector, place.pose, axis)) {
    if (set.rows.empty()) continue;  // planned, and not captured
    std::string why;
    if (!set.IsWhole())
      why = MissingShifts(set);
    else if (!choice.read.empty() && choice.read.back().period_px == set.period_px)
      why = "the set of " + std::to_string(choice.read.back().shifts) + " shifts is read";
    if (why.empty())
      choice.read.push_back(std::move(set));
    else
      choice.left.emplace_back(std::move(set), why);
  }
  return choice;
}

}  // namespace

std::string SinusoidPlace::ToString() const {
  return "projector " + std::to_string(projector) + (pose >= 0 ? ", pose " + std::to_string(pose) : std::string());
}

std::vector<SinusoidPlace> SinusoidPlaces(const SessionFrames& frames) {
  std::set<std::pair<int, int>> found;
  for (const db::FrameRow& row : frames.rows())
    if (row.record.pattern.kind == PatternKind::kSinusoid && row.record.phase == CapturePhase::kSeparation)
      found.emplace(row.record.projector, row.record.pose);
  std::vector<SinusoidPlace> places;
  for (const auto& [projector, pose] : found) places.push_back({projector, pose});
  return places;
}

std::string UnreadSets(const SessionFrames& frames, const SinusoidPlace& place) {
  std::string text;
  for (const PatternAxis axis : kSinusoidAxes)
    for (const auto& [set, why] : ChooseSets(frames, place, axis).left)
      text += (text.empty() ? place.ToString() + ": sinusoids that are not read: " : "; ") + AxisName(axis) +
              ", period " + std::to_string(set.period_px) + " px: " + why;
  return text;
}

Result<std::vector<SetModulation>> MeasureSets(const SessionFrames& frames, const SinusoidPlace& place) {
  std::vector<SetModulation> measured;
  std::vector<SinusoidSet> sets;
  for (const PatternAxis axis : kSinusoidAxes)
    for (SinusoidSet& set : ChooseSets(frames, place, axis).read) sets.push_back(std::move(set));
  if (sets.empty()) return measured;
  SLX_ASSIGN_OR_RETURN(const auto black, BlackOfPose(frames, place.projector, place.pose));
  const SensorNoise noise = NoiseOf(frames);
  for (const SinusoidSet& set : sets) {
    SLX_ASSIGN_OR_RETURN(const auto images, frames.ReadAll(set.rows));
    const std::vector<ImageView<const uint16_t>> shifts(images.begin(), images.end());
    SLX_ASSIGN_OR_RETURN(auto modulation, MeasureModulation({.black = black, .shifts = shifts}, noise)
                                              .WithContext("session " + frames.info().id + ", " + place.ToString()));
    measured.push_back({set.rows.front()->record.pattern.axis, set.period_px, set.shifts, std::move(modulation)});
  }
  return measured;
}

}  // namespace stratalux::fit
