// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/heldout_view.h"

#include "fitter/evaluation/heldout_takes.h"
#include "fitter/motion/carried.h"
#include "fitter/render/surface_light.h"
#include "fitter/render/surface_rim.h"
#include "fitter/sensor/linear_frame.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {

namespace {

void MoveTo(const ProjectorMoments& moments, const HeadMotion& head, HeldOutView& view) {
  const Rigid3 pose = head.At(moments.sweep_s);
  auto moved = MoveSurface(view.shape.surface, view.rig.camera, [&](const Eigen::Vector3d&) { return pose; });
  view.shape.surface = std::move(moved.surface);
  for (Image<uint8_t>& lit : view.shape.lit) lit = Carried(lit, moved.home);
  view.home = std::move(moved.home);
  view.to_separation = head.At(moments.separation_s) * pose.Inverse();
  Rigid3& place = view.separation_rig.projectors[static_cast<size_t>(view.projector)].camera_from_projector;
  place = view.to_separation.Inverse() * place;
}

}  // namespace

HeldOutView ViewOf(FaceShape shape, const PlanOptions& plan, int projector, const std::vector<std::string>& lights) {
  HeldOutView view;
  view.shape = std::move(shape);
  view.rig = LinearRig(view.shape.record);
  view.projector = projector;
  view.separation_rig = view.rig;
  if (const FaceMotion& motion = view.shape.motion; motion.moved())
    MoveTo(motion.projectors[static_cast<size_t>(projector)], motion.head, view);
  view.exposure_ms = plan.exposure_ms;
  view.separation_period = double(plan.separation_period);
  view.lights = lights;
  const ProjectorCalibration& held_out = view.rig.projectors[projector];
  const double open = 1.0 - held_out.black_level;  // a frame minus its black frame
  view.lit = BuildLitSurface(WithRim(view.shape.surface), held_out, plan.exposure_ms);
  view.pyramids.resize(lights.size());
  ParallelEach(lights.size(),
               [&](size_t k) { view.pyramids[k] = LightWith(view.lit, HeldOutPattern(lights[k], plan), open); });
  view.irradiance = SurfaceIrradiance(view.shape.surface, view.rig, view.lit, view.pyramids);
  return view;
}

Image<uint8_t> OnView(const HeldOutView& view, const Image<uint8_t>& mask) {
  return view.home.empty() ? mask : Carried(mask, view.home);
}

SeparationMap OnView(const HeldOutView& view, const SeparationMap& separation) {
  if (view.home.empty()) return separation;
  return Carried(separation, PlacesNow(view.shape.surface, view.rig.camera,
                                       [&](const Eigen::Vector3d&) { return view.to_separation; }));
}

std::vector<int64_t> ProfilesOnView(const HeldOutView& view, int pool, int channels) {
  return view.home.empty() ? std::vector<int64_t>() : CarriedProfiles(view.home, pool, channels);
}

}  // namespace stratalux::fit
