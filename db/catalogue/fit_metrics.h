// SPDX-License-Identifier: Apache-2.0
// The numbers of a fit's metrics.json under dotted names, for the index's `metrics` table.
#pragma once

#include <map>
#include <string>

namespace stratalux::db {

// {"fit": {"tau": 2}}                      -> fit.tau
// {"stages": [{"name": "srd", "seconds": 3}]} -> stages.srd.seconds
// {"heldout": [{"projector": 0, "light": "stripe", "model": "tied", "pool": 1, "nrmse": 0.2},
//              {"projector": 1, "light": "stripe", "model": "tied", "pool": 1, "nrmse": 0.4}]}
//                                             -> heldout.stripe.tied.nrmse = 0.3
// An entry of an array of objects is named by its texts, in the order of the file, and by `pool4` where it pools 4
// quads. Entries of one name (they differ in their projector) become one figure, the mean over them. Left out, and kept
// in metrics_json alone: arrays of numbers, truth values, `schema`, `projector`, `pool`, all `options`; numbers that
// are not finite. A text that is no JSON object gives no figure.
[[nodiscard]] std::map<std::string, double> FlattenMetrics(const std::string& metrics_json);

}  // namespace stratalux::db
