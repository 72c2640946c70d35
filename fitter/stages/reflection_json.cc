// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/reflection_json.h"

namespace stratalux::fit {

nlohmann::ordered_json ReflectionJson(const SurfaceReflection& reflection) {
  if (!reflection.Known()) return nullptr;
  return {{"strength", reflection.strength},
          {"roughness", reflection.roughness},
          {"over_ggx", reflection.over_ggx},
          {"hairs", reflection.hairs}};
}

SurfaceReflection ReflectionFrom(const nlohmann::json& json) {
  if (json.is_null()) return {};
  SurfaceReflection reflection{json.at("strength"), json.at("roughness")};
  if (json.contains("over_ggx")) json.at("over_ggx").get_to(reflection.over_ggx);
  reflection.hairs = json.value("hairs", 0.0);
  return reflection;
}

}  // namespace stratalux::fit
