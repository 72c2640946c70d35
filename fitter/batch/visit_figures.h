// SPDX-License-Identifier: Apache-2.0
// What one visitor costs, measured in a store: time of processors and of the rig, bytes.
#pragma once

#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct VisitFigures {
  std::vector<double> fit_cpu_s;     // of whole fits, all their stages
  double longest_stage_share = 1.0;  // of a fit's time: the most that an attempt which dies loses
  double capture_s = 0.0;            // of the rig, from the first trigger to the last frame
  double frames_bytes = 0.0;         // on the rig, and pulled
  double fit_bytes = 0.0;            // files of a fit, those that are artifacts, too, among them
  double artifact_bytes = 0.0;       // what `stratalux-fit clean` removes: made again where a later run wants it
  [[nodiscard]] Status Validate() const;
};

// Medians over the newest fitted visitors of a store, `most` of them, of the same camera as the newest one; their fits'
// times one by one. kNotFound: nobody was fitted.
[[nodiscard]] Result<VisitFigures> MeasureVisits(const db::SessionStore& store, size_t most = 50);

// {"fit_cpu_s": [...], "longest_stage_share": ..., "capture_s": ..., "frames_bytes": ..., "fit_bytes": ...,
// "artifact_bytes": ...}
[[nodiscard]] std::string ToJson(const VisitFigures& figures);
[[nodiscard]] Result<VisitFigures> ParseVisitFigures(const std::string& json);

}  // namespace stratalux::fit
