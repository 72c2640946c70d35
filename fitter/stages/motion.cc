// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/motion.h"

#include <algorithm>
#include <optional>

#include "fitter/motion/carried.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

bool IsWhite(const FrameRecord& record, int projector) {
  return record.projector == projector && record.pattern.kind == PatternKind::kWhite && record.bracket == 0 &&
         record.level_check != LevelCheck::kFailed;
}

// Of a projector, by time. Also those that a jump had shot again, which alone saw the head jump; but none from before
// `reference`.
std::vector<const db::FrameRow*> WhitesOf(const SessionFrames& frames, int projector, MonotonicNs reference) {
  std::vector<const db::FrameRow*> whites;
  const auto take = [&](const db::FrameRow& row) {
    if (IsWhite(row.record, projector) && row.record.trigger_time >= reference) whites.push_back(&row);
  };
  std::ranges::for_each(frames.rows(), take);
  for (const db::FrameRow& row : frames.replaced())
    if (frames.BeforeJump(row)) take(row);
  std::ranges::sort(whites, {}, [](const db::FrameRow* row) { return row->record.trigger_time; });
  return whites;
}

// Of the first white that counts; nullopt: there is none.
std::optional<MonotonicNs> ReferenceTime(const SessionFrames& frames, int projectors) {
  std::optional<MonotonicNs> first;
  for (const db::FrameRow& row : frames.rows())
    for (int p = 0; p < projectors; ++p)
      if (IsWhite(row.record, p) && (!first || row.record.trigger_time < *first)) first = row.record.trigger_time;
  return first;
}

double MeanMoment(const SessionFrames& frames, const FaceMotion& motion, int projector, CapturePhase phase) {
  double sum = 0.0;
  int count = 0;
  for (const db::FrameRow& row : frames.rows())
    if (row.record.projector == projector && row.record.phase == phase) {
      sum += motion.SecondsOf(row.record.trigger_time);
      ++count;
    }
  return count > 0 ? sum / count : 0.0;
}

// The first white of a projector, and the later ones, on quads.
struct WhiteLight {
  Image<float> first;
  std::vector<Image<float>> later;
};

Result<WhiteLight> LightOf(const SessionFrames& frames, int projector, const std::vector<const db::FrameRow*>& whites) {
  WhiteLight light;
  if (whites.size() < 2 || !frames.HasBlack(projector)) return light;
  SLX_ASSIGN_OR_RETURN(const auto dark, frames.MeanBlack(projector));
  for (const db::FrameRow* white : whites) {
    SLX_ASSIGN_OR_RETURN(const auto frame, frames.ReadLinear(*white));
    Image<float> quads = QuadSignal(frame, dark, frames.calibration()->camera);
    if (light.first.empty())
      light.first = std::move(quads);
    else
      light.later.push_back(std::move(quads));
  }
  return light;
}

ProjectorFlows FlowsOf(const SessionFrames& frames, const FaceMotion& motion, int projector,
                       const std::vector<const db::FrameRow*>& whites, const WhiteLight& light,
                       const SurfaceMap& surface, const Image<uint8_t>& lit, const Eigen::Vector3d& pivot) {
  ProjectorFlows flows;
  flows.projector = projector;
  flows.first_s = motion.SecondsOf(whites.front()->record.trigger_time);
  if (light.later.empty()) return flows;
  const RigCalibration& rig = *frames.calibration();
  const Eigen::Vector3d lamp = rig.projectors[static_cast<size_t>(projector)].CentreInCamera();
  auto found = FindRigidFlows(light.first, light.later, lit, surface, rig.camera, lamp, pivot);
  for (size_t k = 1; k < whites.size(); ++k)
    flows.later.push_back({motion.SecondsOf(whites[k]->record.trigger_time), std::move(found[k - 1]),
                           frames.JumpedBetween(*whites[k - 1], *whites[k])});
  return flows;
}

// Between the codes of every two projectors.
std::vector<CodesFlow> CodesFlowsOf(std::span<const DecodedMap> decoded, const RigCalibration& rig,
                                    const SurfaceMap& surface, const Eigen::Vector3d& pivot, const FaceMotion& motion) {
  std::vector<RangeMap> ranges(decoded.size());
  ParallelEach(decoded.size(), [&](size_t p) { ranges[p] = RangesOf(decoded[p], rig, p); });
  std::vector<CodesFlow> flows;
  for (size_t a = 0; a < ranges.size(); ++a)
    for (size_t b = a + 1; b < ranges.size(); ++b)
      if (const auto flow = FindDepthFlow(ranges[a], ranges[b], surface, pivot))
        flows.push_back({motion.projectors[a].codes_s, motion.projectors[b].codes_s, *flow});
  return flows;
}

// Where the surface's quads were at a moment.
Image<float> PlacesAt(const FaceMotion& motion, double seconds, const SurfaceMap& surface,
                      const CameraCalibration& camera) {
  const Rigid3 pose = motion.head.At(seconds);
  return PlacesNow(surface, camera, [&](const Eigen::Vector3d&) { return pose; });
}

std::vector<double> Numbers(const SmallMotion& motion) {
  const auto v = motion.Vector();
  return {v.data(), v.data() + v.size()};
}

}  // namespace

Result<FaceMotion> FindMotion(const SessionFrames& frames, std::span<const DecodedMap> decoded,
                              const SurfaceMap& surface, std::span<const Image<uint8_t>> lit) {
  FaceMotion motion;
  motion.later_whites = 0;
  const std::optional<MonotonicNs> reference = ReferenceTime(frames, static_cast<int>(lit.size()));
  if (!reference) return motion;
  motion.reference = *reference;
  std::vector<std::vector<const db::FrameRow*>> whites;
  std::vector<size_t> order;
  for (size_t p = 0; p < lit.size(); ++p) {
    whites.push_back(WhitesOf(frames, static_cast<int>(p), *reference));
    if (whites.back().empty()) continue;
    order.push_back(p);
    *motion.later_whites += static_cast<int>(whites.back().size()) - 1;
  }
  const auto first_of = [&](size_t p) { return whites[p].front()->record.trigger_time; };
  std::ranges::sort(order, {}, first_of);
  for (int p = 0; p < static_cast<int>(lit.size()); ++p)
    motion.projectors.push_back({MeanMoment(frames, motion, p, CapturePhase::kCorrespondence),
                                 MeanMoment(frames, motion, p, CapturePhase::kSeparation),
                                 MeanMoment(frames, motion, p, CapturePhase::kSweep)});
  const Eigen::Vector3d pivot = MiddleOf(surface);
  std::vector<WhiteLight> lights;
  for (const size_t p : order) {
    SLX_ASSIGN_OR_RETURN(lights.emplace_back(), LightOf(frames, static_cast<int>(p), whites[p]));
  }
  std::vector<ProjectorFlows> flows(order.size());
  ParallelEach(order.size(), [&](size_t k) {
    const size_t p = order[k];
    flows[k] = FlowsOf(frames, motion, static_cast<int>(p), whites[p], lights[k], surface, lit[p], pivot);
  });
  motion.head = TrackHead(flows, CodesFlowsOf(decoded, *frames.calibration(), surface, pivot, motion), pivot, surface);
  return motion;
}

RigCalibration RigAt(const RigCalibration& rig, const FaceMotion& motion, double ProjectorMoments::*moment) {
  RigCalibration moved = rig;
  if (motion.moved())
    for (size_t p = 0; p < motion.projectors.size(); ++p)
      moved.projectors[p].camera_from_projector =
          motion.head.At(motion.projectors[p].*moment).Inverse() * rig.projectors[p].camera_from_projector;
  return moved;
}

std::vector<DecodedMap> AtReference(std::span<const DecodedMap> decoded, const SurfaceMap& surface,
                                    const RigCalibration& rig, const FaceMotion& motion) {
  std::vector<DecodedMap> carried;
  for (size_t p = 0; p < decoded.size(); ++p)
    carried.push_back(
        Carried(decoded[p], PlacesAt(motion, motion.projectors[p].codes_s, surface, rig.camera), rig.camera.cfa));
  return carried;
}

std::vector<SeparationMap> AtReference(std::span<const SeparationMap> separation, const SurfaceMap& surface,
                                       const RigCalibration& rig, const FaceMotion& motion) {
  std::vector<SeparationMap> carried;
  for (size_t p = 0; p < separation.size(); ++p)
    carried.push_back(Carried(separation[p], PlacesAt(motion, motion.projectors[p].separation_s, surface, rig.camera)));
  return carried;
}

std::string WhyUnknown(const FaceMotion& motion) {
  if (!motion.later_whites)
    return motion.projectors.empty() ? "it was not looked for"
                                     : "no two white frames of one projector show enough of the face";
  if (*motion.later_whites == 0) return "finding it takes two white frames of one projector";
  return Formatted("%d white frames after the first ones of their projectors, but in none do enough quads tell: ",
                   *motion.later_whites) +
         Formatted("it takes %d that are lit and not saturated", FlowOptions().least_quads);
}

std::string Describe(const FaceMotion& motion) {
  const HeadMotion& head = motion.head;
  if (head.poses.empty()) return "motion of the head: unknown (" + WhyUnknown(motion) + ")";
  const std::string size = Formatted("%.3f mm at most (noise: %.3f mm)", head.largest_mm, head.sigma_mm);
  return head.moved ? "the head moved by " + size + ": everything is carried to the moment of the first white frame"
                    : "the head held still: moved by " + size;
}

Status SaveMotion(const std::filesystem::path& folder, const FaceMotion& motion) {
  const HeadMotion& head = motion.head;
  nlohmann::ordered_json poses = nlohmann::ordered_json::array(), projectors = poses;
  for (const HeadPose& pose : head.poses)
    poses.push_back({{"seconds", pose.seconds}, {"turn_rad_shift_mm", Numbers(pose.motion)}});
  for (const ProjectorMoments& m : motion.projectors)
    projectors.push_back({{"codes_s", m.codes_s}, {"separation_s", m.separation_s}, {"sweep_s", m.sweep_s}});
  const auto later_whites =
      motion.later_whites ? nlohmann::ordered_json(*motion.later_whites) : nlohmann::ordered_json();
  return WriteJson(folder / "motion.json", {{"moved", head.moved},
                                            {"largest_mm", head.largest_mm},
                                            {"sigma_mm", head.sigma_mm},
                                            {"detail_before", head.detail_before},
                                            {"detail_after", head.detail_after},
                                            {"reference_ns", motion.reference.ns},
                                            {"pivot_mm", {head.pivot.x(), head.pivot.y(), head.pivot.z()}},
                                            {"poses", poses},
                                            {"projectors", projectors},
                                            {"later_whites", later_whites}});
}

Result<FaceMotion> LoadMotion(const std::filesystem::path& folder) {
  FaceMotion motion;
  // A fit of before is read for ever: nothing was asked of its head.
  if (std::error_code error; !std::filesystem::exists(folder / "motion.json", error)) return motion;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "motion.json", [&](const nlohmann::json& json) {
    HeadMotion& head = motion.head;
    json.at("moved").get_to(head.moved);
    json.at("largest_mm").get_to(head.largest_mm);
    json.at("sigma_mm").get_to(head.sigma_mm);
    json.at("detail_before").get_to(head.detail_before);
    json.at("detail_after").get_to(head.detail_after);
    json.at("reference_ns").get_to(motion.reference.ns);
    for (int k = 0; k < 3; ++k) head.pivot[k] = json.at("pivot_mm").at(static_cast<size_t>(k));
    for (const auto& pose : json.at("poses")) {
      Eigen::Matrix<double, 6, 1> v;
      for (int k = 0; k < 6; ++k) v[k] = pose.at("turn_rad_shift_mm").at(static_cast<size_t>(k));
      head.poses.push_back({pose.at("seconds"), SmallMotion::From(v)});
    }
    for (const auto& m : json.at("projectors"))
      motion.projectors.push_back({m.at("codes_s"), m.at("separation_s"), m.at("sweep_s")});
    if (const auto whites = json.find("later_whites"); whites != json.end() && !whites->is_null())
      motion.later_whites = whites->get<int>();
  }));
  return motion;
}

}  // namespace stratalux::fit
