// SPDX-License-Identifier: Apache-2.0
#include <utility>

#include <nlohmann/json.hpp>

#include "shared/capture/plan.h"

namespace stratalux {

using Json = nlohmann::ordered_json;

std::string PlanOptionsToJson(const PlanOptions& o) {
  const Json json = {{"schema", 1},
                     {"kind", ToString(o.kind)},
                     {"sync_mode", ToString(o.sync_mode)},
                     {"projectors", o.projectors},
                     {"projector_width", o.projector_width},
                     {"projector_height", o.projector_height},
                     {"exposure_ms", o.exposure_ms},
                     {"brackets", o.brackets},
                     {"reference_brackets", o.reference_brackets},
                     {"correspondence_brackets", o.correspondence_brackets},
                     {"separation_brackets", o.separation_brackets},
                     {"spot_brackets", o.spot_brackets},
                     {"preroll_markers", o.preroll_markers},
                     {"separation_period", o.separation_period},
                     {"separation_shifts", o.separation_shifts},
                     {"checkerboard", o.checkerboard},
                     {"checkerboard_period", o.checkerboard_period},
                     {"checkerboard_shifts", o.checkerboard_shifts},
                     {"comb_width", o.comb_width},
                     {"comb_period", o.comb_period},
                     {"comb_step", o.comb_step},
                     {"row_sweep", o.row_sweep},
                     {"motion_whites", o.motion_whites},
                     {"spot_radius", o.spot_radius},
                     {"spot_pitch", o.spot_pitch},
                     {"second_takes", o.second_takes},
                     {"guards", o.guards}};
  return json.dump();
}

Result<PlanOptions> PlanOptionsFromJson(const std::string& text) {
  try {
    const Json json = Json::parse(text);
    if (json.at("schema").get<int>() > 1)
      return Status(StatusCode::kNewerSchema,
                    "plan: schema " + json.at("schema").dump() + " is newer than this program (1)");
    PlanOptions o;
    SLX_ASSIGN_OR_RETURN(o.kind, ParseSessionKind(json.at("kind").get<std::string>()));
    SLX_ASSIGN_OR_RETURN(o.sync_mode, ParseSyncMode(json.at("sync_mode").get<std::string>()));
    json.at("projectors").get_to(o.projectors);
    json.at("projector_width").get_to(o.projector_width);
    json.at("projector_height").get_to(o.projector_height);
    json.at("exposure_ms").get_to(o.exposure_ms);
    json.at("brackets").get_to(o.brackets);
    // Plans from before these have none.
    for (const auto& [key, value] : {std::pair{"reference_brackets", &o.reference_brackets},
                                     {"correspondence_brackets", &o.correspondence_brackets},
                                     {"separation_brackets", &o.separation_brackets},
                                     {"spot_brackets", &o.spot_brackets}})
      if (json.contains(key)) json.at(key).get_to(*value);
    json.at("preroll_markers").get_to(o.preroll_markers);
    json.at("separation_period").get_to(o.separation_period);
    json.at("separation_shifts").get_to(o.separation_shifts);
    json.at("checkerboard").get_to(o.checkerboard);
    json.at("checkerboard_period").get_to(o.checkerboard_period);
    json.at("checkerboard_shifts").get_to(o.checkerboard_shifts);
    json.at("comb_width").get_to(o.comb_width);
    json.at("comb_period").get_to(o.comb_period);
    json.at("comb_step").get_to(o.comb_step);
    json.at("row_sweep").get_to(o.row_sweep);
    json.at("motion_whites").get_to(o.motion_whites);
    json.at("spot_radius").get_to(o.spot_radius);
    json.at("spot_pitch").get_to(o.spot_pitch);
    o.second_takes = json.value("second_takes", false);  // plans from before these have none
    json.at("guards").get_to(o.guards);
    SLX_RETURN_IF_ERROR(BuildPlan(o).status());
    return o;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(std::string("plan JSON: ") + error.what());
  }
}

}  // namespace stratalux
