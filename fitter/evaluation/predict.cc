// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/predict.h"

#include "fitter/evaluation/direct_light.h"
#include "fitter/evaluation/heldout_takes.h"
#include "fitter/export/exr_file.h"
#include "fitter/render/mlsss.h"
#include "fitter/sensor/linear_frame.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/stage_json.h"

namespace stratalux::fit {

std::vector<std::string> HeldOutLights(const PlanOptions& plan) {
  std::vector<std::string> lights = {"stripe", "white"};
  if (plan.spot_radius > 0) lights.emplace_back("spot");
  return lights;
}

Predictions Predict(const MixtureMap& map, int pool, const FaceShape& shape, const PlanOptions& plan, int projector,
                    const std::vector<std::string>& lights) {
  const RigCalibration rig = LinearRig(shape.record);
  const SurfaceMap& surface = shape.surface;
  const ProjectorCalibration& held_out = rig.projectors[projector];
  const double open = 1.0 - held_out.black_level;  // a frame minus its black frame
  const LitSurface lit = BuildLitSurface(surface, held_out, plan.exposure_ms);
  const Image<float> reflectance = SurfaceReflectance(map, surface, lit.light, pool),
                     part = DirectPart({rig, projector, plan.exposure_ms, double(plan.separation_period)}, surface, map,
                                       pool);
  Predictions predictions;
  for (const std::string& light : lights) {
    const LitPyramid pyramid = LightWith(lit, HeldOutPattern(light, plan), open);
    predictions[light] = {RenderSubsurface(map, surface, rig, pyramid, lit, {pool}),
                          RenderSurface(reflectance, surface, rig, pyramid, lit),
                          RenderSurface(part, surface, rig, pyramid, lit)};
  }
  return predictions;
}

namespace {

constexpr const char* kParts[] = {"_subsurface.exr", "_surface.exr", "_direct_part.exr"};

}  // namespace

Status SavePredictions(const std::filesystem::path& folder, const Predictions& predictions) {
  nlohmann::ordered_json lights = nlohmann::ordered_json::array();
  int channels = 1;
  for (const auto& [light, p] : predictions) {
    lights.push_back(light);
    channels = p.subsurface.channels();
    const Image<float>* parts[] = {&p.subsurface, &p.surface, &p.direct_part};
    for (int k = 0; k < 3; ++k)
      SLX_RETURN_IF_ERROR(WriteExr(folder / (light + kParts[k]), *parts[k], Colours(channels)));
  }
  return WriteJson(folder / "predict.json", {{"lights", lights}, {"channels", channels}});
}

Result<Predictions> LoadPredictions(const std::filesystem::path& folder) {
  std::vector<std::string> lights;
  int channels = 1;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "predict.json", [&](const nlohmann::json& json) {
    json.at("lights").get_to(lights);
    json.at("channels").get_to(channels);
  }));
  Predictions predictions;
  for (const std::string& light : lights) {
    Prediction& p = predictions[light];
    Image<float>* parts[] = {&p.subsurface, &p.surface, &p.direct_part};
    for (int k = 0; k < 3; ++k) {
      SLX_ASSIGN_OR_RETURN(*parts[k], ReadExr(folder / (light + kParts[k]), Colours(channels)));
    }
  }
  return predictions;
}

}  // namespace stratalux::fit
