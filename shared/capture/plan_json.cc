// SPDX-License-Identifier: Apache-2.0
#include <utility>

#include <nlohmann/json.hpp>

#include "shared/base/json_number.h"
#include "shared/capture/plan.h"

namespace stratalux {

using Json = nlohmann::ordered_json;

namespace {
constexpr int64_t kNewestSchema = 2;
}

std::string PlanOptionsToJson(const PlanOptions& o) {
  Json json = {{"schema", 1},
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
  // What older programs would take for the reflected Gray code is of a schema that they refuse.
  if (o.ShownCode() != ColumnCode::kGray) {
    json["schema"] = kNewestSchema;
    json["code"] = ToString(o.code);
  }
  return json.dump();
}

Result<PlanOptions> PlanOptionsFromJson(const std::string& text) {
  try {
    const Json json = Json::parse(text);
    if (WholeAt<int64_t>(json, "schema") > kNewestSchema)
      return Status(StatusCode::kNewerSchema, "plan: schema " + json.at("schema").dump() +
                                                  " is newer than this program (" + std::to_string(kNewestSchema) +
                                                  ")");
    PlanOptions o;
    SLX_ASSIGN_OR_RETURN(o.kind, ParseSessionKind(json.at("kind").get<std::string>()));
    SLX_ASSIGN_OR_RETURN(o.sync_mode, ParseSyncMode(json.at("sync_mode").get<std::string>()));
    o.projectors = WholeAt<int>(json, "projectors");
    o.projector_width = WholeAt<int>(json, "projector_width");
    o.projector_height = WholeAt<int>(json, "projector_height");
    json.at("exposure_ms").get_to(o.exposure_ms);
    json.at("brackets").get_to(o.brackets);
    // Plans from before these have none.
    for (const auto& [key, value] : {std::pair{"reference_brackets", &o.reference_brackets},
                                     {"correspondence_brackets", &o.correspondence_brackets},
                                     {"separation_brackets", &o.separation_brackets},
                                     {"spot_brackets", &o.spot_brackets}})
      if (json.contains(key)) json.at(key).get_to(*value);
    if (WholeAt<int64_t>(json, "schema") > 1) {  // else reflected Gray
      SLX_ASSIGN_OR_RETURN(o.code, ParseColumnCode(json.at("code").get<std::string>()));
    }
    o.preroll_markers = WholeAt<int>(json, "preroll_markers");
    o.separation_period = WholeAt<int>(json, "separation_period");
    o.separation_shifts = WholeAt<int>(json, "separation_shifts");
    json.at("checkerboard").get_to(o.checkerboard);
    o.checkerboard_period = WholeAt<int>(json, "checkerboard_period");
    o.checkerboard_shifts = WholeAt<int>(json, "checkerboard_shifts");
    o.comb_width = WholeAt<int>(json, "comb_width");
    o.comb_period = WholeAt<int>(json, "comb_period");
    o.comb_step = WholeAt<int>(json, "comb_step");
    json.at("row_sweep").get_to(o.row_sweep);
    o.motion_whites = WholeAt<int>(json, "motion_whites");
    o.spot_radius = WholeAt<int>(json, "spot_radius");
    o.spot_pitch = WholeAt<int>(json, "spot_pitch");
    o.second_takes = json.value("second_takes", false);  // plans from before these have none
    o.guards = WholeAt<int>(json, "guards");
    SLX_RETURN_IF_ERROR(BuildPlan(o).status());
    return o;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(std::string("plan JSON: ") + error.what());
  }
}

}  // namespace stratalux
