// SPDX-License-Identifier: Apache-2.0
// Figures as JSON, as artifacts and metrics.json hold them.
#pragma once

#include <nlohmann/json.hpp>

#include "fitter/evaluation/metrics.h"

namespace stratalux::fit {

// A name, a figure: what is not finite is null, and reads back as NaN.
void to_json(nlohmann::ordered_json& json, const HeldOutFigure& figure);
void from_json(const nlohmann::json& json, HeldOutFigure& figure);
void to_json(nlohmann::ordered_json& json, const PredictionError& error);
void from_json(const nlohmann::json& json, PredictionError& error);
void to_json(nlohmann::ordered_json& json, const Coverage& coverage);
void from_json(const nlohmann::json& json, Coverage& coverage);

}  // namespace stratalux::fit
