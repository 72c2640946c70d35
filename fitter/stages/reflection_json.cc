// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/reflection_json.h"

namespace stratalux::fit {

nlohmann::ordered_json ReflectionJson(const SurfaceReflection& reflection) {
  if (!reflection.Known()) return nullptr;
  return {{"strength", reflection.strength},
          {"roughness", reflection.roughness},
          {"over_ggx", reflection.over_ggx},
          {"hairs", reflection.hairs},
          {"by_gloss", reflection.by_gloss},
          {"gloss",
           {{"width", reflection.gloss.width},
            {"channels", reflection.gloss.channels},
            {"cell_px", reflection.gloss.cell_px},
            {"columns", reflection.gloss.columns},
            {"nodes", reflection.gloss.nodes}}}};
}

SurfaceReflection ReflectionFrom(const nlohmann::json& json) {
  if (json.is_null()) return {};
  SurfaceReflection reflection{json.at("strength"), json.at("roughness")};
  if (json.contains("over_ggx")) json.at("over_ggx").get_to(reflection.over_ggx);
  reflection.hairs = json.value("hairs", 0.0);
  if (json.contains("by_gloss")) {
    json.at("by_gloss").get_to(reflection.by_gloss);
    const auto& gloss = json.at("gloss");
    reflection.gloss = {gloss.at("width"), gloss.at("channels"), gloss.at("cell_px"), gloss.at("columns"),
                        gloss.at("nodes")};
  }
  return reflection;
}

}  // namespace stratalux::fit
