// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/cloud.h"

#include <algorithm>
#include <set>
#include <string>

#include "fitter/reconstruction/point_cloud.h"
#include "fitter/reconstruction/smooth_surface.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/decode.h"
#include "fitter/stages/lit_quads.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

bool IsCode(const FrameRecord& frame) {
  return frame.phase == CapturePhase::kCorrespondence && frame.pattern.kind == PatternKind::kGray;
}

Status AnotherRig(const std::string& what) {
  return Status::Usage(what +
                       ": the calibration is of another rig; give the calibration of the rig that captured the "
                       "session");
}

std::string SizeText(int width, int height) { return std::to_string(width) + "x" + std::to_string(height); }

// A crop lies in the camera's picture; what begins at its corner is all of it.
Status CheckCamera(const FrameRecord& frame, const Pinhole& camera) {
  const bool inside = frame.crop_x + frame.width <= camera.width && frame.crop_y + frame.height <= camera.height;
  const bool whole = frame.width == camera.width && frame.height == camera.height;
  if (inside && (whole || frame.crop_x > 0 || frame.crop_y > 0)) return Status::Ok();
  return AnotherRig("its frames have " + SizeText(frame.width, frame.height) + " pixels at " +
                    std::to_string(frame.crop_x) + ", " + std::to_string(frame.crop_y) +
                    ", but the calibrated camera has " + SizeText(camera.width, camera.height));
}

Status CheckCode(const FrameRecord& frame, const RigCalibration& record) {
  const std::string name = "projector " + std::to_string(frame.projector);
  if (frame.projector < 0 || frame.projector >= static_cast<int>(record.projectors.size()))
    return AnotherRig(name + " shows codes, but the calibration has only " + std::to_string(record.projectors.size()) +
                      " projectors");
  const Pinhole& model = record.projectors[static_cast<size_t>(frame.projector)].model;
  const bool columns = frame.pattern.axis == PatternAxis::kColumns;
  const int count = columns ? model.width : model.height;
  if (frame.pattern.bits == GrayBits(count)) return Status::Ok();
  return AnotherRig(name + " has codes of " + std::to_string(frame.pattern.bits) +
                    " bits, but the calibrated projector's " + std::to_string(count) +
                    (columns ? " columns need " : " rows need ") + std::to_string(GrayBits(count)));
}

// The record's geometry as these frames see it.
struct CodedRig {
  RigCalibration rig;
  std::vector<int> projectors;  // of the record, in the order of the rig's
};

Result<CodedRig> RigOf(const SessionFrames& frames, int pose, const RigCalibration& record) {
  std::set<int> projectors;
  const FrameRecord* first = nullptr;
  for (const db::FrameRow& row : frames.rows()) {
    const FrameRecord& frame = row.record;
    if (frame.pose != pose || !IsCode(frame)) continue;
    SLX_RETURN_IF_ERROR(CheckCamera(frame, record.camera.model));
    SLX_RETURN_IF_ERROR(CheckCode(frame, record));
    if (first == nullptr) first = &frame;
    projectors.insert(frame.projector);
  }
  if (first == nullptr) return Status::NotFound("it has no codes");
  CodedRig coded{.rig = {}, .projectors = {projectors.begin(), projectors.end()}};
  coded.rig.camera = record.camera;
  coded.rig.camera.cfa = first->cfa;
  Pinhole& camera = coded.rig.camera.model;
  camera.width = first->width;
  camera.height = first->height;
  camera.cx -= first->crop_x;
  camera.cy -= first->crop_y;
  if (first->crop_x % QuadStep(first->cfa) != 0 || first->crop_y % QuadStep(first->cfa) != 0)
    return Status::Usage("its frames begin within a quad of the mosaic: crop them at even pixels");
  for (const int p : coded.projectors) coded.rig.projectors.push_back(record.projectors[static_cast<size_t>(p)]);
  return coded;
}

Status CheckConsistency(const TriangulationCounts& counts) {
  const int64_t coded = counts.sites + counts.inconsistent + counts.uncertain;
  if (static_cast<double>(counts.inconsistent) <= kMostContradicting * static_cast<double>(coded)) return Status::Ok();
  return Status::Failed(std::to_string(counts.inconsistent) + " of " + std::to_string(coded) +
                        " pixels with a code contradict the calibration: it is of another rig, or camera and "
                        "projectors moved against each other; calibrate again");
}

// Why FindMotion cannot be asked, which reads the whites of all projectors by the session's own calibration and the
// times of a capture's own plan.
std::string WhyMotionIsUnasked(const SessionFrames& frames, int pose, const CodedRig& coded) {
  if (!frames.plan() || !frames.calibration()) return "the session was not captured by a plan with a calibration";
  if (pose >= 0) return "poses are taken to hold still";
  const RigCalibration& whole = *frames.calibration();
  if (coded.projectors.size() != whole.projectors.size()) return "not all calibrated projectors show codes";
  const Pinhole &camera = coded.rig.camera.model, &calibrated = whole.camera.model;
  if (camera.width != calibrated.width || camera.height != calibrated.height)
    return "the frames are crops of the calibrated camera's";
  return "";
}

// Cloud and counts of codes of one time; the surface that they lie on.
Result<SurfaceMap> Surface(std::span<const DecodedMap> decoded, const RigCalibration& rig, CodedCloud& made) {
  SLX_ASSIGN_OR_RETURN(const auto rough, Triangulate(decoded, rig));
  made.counts = rough.counts;
  SLX_RETURN_IF_ERROR(CheckConsistency(rough.counts));
  SLX_ASSIGN_OR_RETURN(auto surface, SmoothSurface(rough.surface, rough.noise_sigma_mm, rig, {}, &made.unsmoothed));
  made.cloud = CloudFromSurface(surface, rig.camera, {});
  if (made.cloud.positions_mm.empty())
    return Status::Failed("no point is left: " + WhyNoSurface(rough.counts, made.unsmoothed));
  return surface;
}

// As ReconstructMovingShape, without separation.
Result<CodedCloud> CloudOf(const SessionFrames& frames, int pose, std::vector<DecodedMap> decoded, CodedRig coded) {
  CodedCloud made;
  SLX_ASSIGN_OR_RETURN(auto surface, Surface(decoded, coded.rig, made));
  made.motion_unasked = WhyMotionIsUnasked(frames, pose, coded);
  if (made.motion_unasked.empty()) {
    SLX_ASSIGN_OR_RETURN(const auto lit, LitQuads(decoded, {}, surface, coded.rig));
    SLX_ASSIGN_OR_RETURN(made.motion, FindMotion(frames, decoded, surface, lit));
  }
  if (made.motion.moved()) {
    decoded = AtReference(decoded, surface, coded.rig, made.motion);
    coded.rig = RigAt(coded.rig, made.motion, &ProjectorMoments::codes_s);
    SLX_ASSIGN_OR_RETURN(surface, Surface(decoded, coded.rig, made));
  }
  SLX_ASSIGN_OR_RETURN(made.drift, CheckDrift(decoded, surface, coded.rig, {}, coded.projectors));
  made.projectors = std::move(coded.projectors);
  return made;
}

}  // namespace

std::vector<int> CodedPoses(const SessionFrames& frames, std::optional<int> projector) {
  std::set<int> poses;
  for (const db::FrameRow& row : frames.rows())
    if (IsCode(row.record) && row.record.projector == projector.value_or(row.record.projector))
      poses.insert(row.record.pose);
  return {poses.begin(), poses.end()};
}

Result<CodedCloud> CloudFromCodes(const SessionFrames& frames, int pose, const RigCalibration& record) {
  const std::string where = "session " + frames.info().id + (pose >= 0 ? ", pose " + std::to_string(pose) : "");
  auto coded = RigOf(frames, pose, record);
  if (!coded.ok()) return coded.status().WithContext(where);
  std::vector<DecodedMap> decoded;
  for (size_t p = 0; p < coded->projectors.size(); ++p) {
    const Pinhole& model = coded->rig.projectors[p].model;
    SLX_ASSIGN_OR_RETURN(
        auto report, DecodeProjector(frames, coded->projectors[p], pose, model.width, model.height, NoiseOf(frames)));
    decoded.push_back(std::move(report.map));
  }
  auto made = CloudOf(frames, pose, std::move(decoded), std::move(*coded));
  if (!made.ok()) return made.status().WithContext(where);
  return made;
}

}  // namespace stratalux::fit
