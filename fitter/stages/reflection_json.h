// SPDX-License-Identifier: Apache-2.0
// How the surface itself reflects, in the JSON files of artifacts and in metrics.json (docs/file-formats.md).
#pragma once

#include <nlohmann/json.hpp>

#include "fitter/mixture/surface_reflection.h"

namespace stratalux::fit {

// null where it is not known.
[[nodiscard]] nlohmann::ordered_json ReflectionJson(const SurfaceReflection& reflection);
// Throws what nlohmann throws. Of a program that knew no curve and no hairs: GGX alone.
[[nodiscard]] SurfaceReflection ReflectionFrom(const nlohmann::json& json);

}  // namespace stratalux::fit
