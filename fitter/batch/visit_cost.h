// SPDX-License-Identifier: Apache-2.0
// What fitting a visitor takes, foreseen by what it took before in this store: the stages' own records of their making
// (metrics.json), no constants.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct VisitCost {
  double cpu_seconds = 0.0;  // of all stages
  int64_t peak_bytes = 0;    // resident, of its process
};

// kIntegrity for what no computer took, such as a forged file may say: less than nothing, 30 years, 2^50 bytes.
[[nodiscard]] Status CheckCost(const VisitCost& cost);
[[nodiscard]] Status CheckSeconds(double seconds);

class CostHistory {
 public:
  // The newest fits of visitors, `most` of them.
  [[nodiscard]] static Result<CostHistory> Read(const db::SessionStore& store, size_t most = 50);

  // metrics.json of a fit, of a camera with so many sites. Left out where it names no stage's time.
  void Add(const std::string& metrics_json, int64_t sites);
  // A visitor that was fitted whole.
  void AddMeasured(const VisitCost& cost, int64_t sites);
  // Of a camera with so many sites, in proportion to them: the median time, the largest memory. nullopt: nothing was
  // fitted yet.
  [[nodiscard]] std::optional<VisitCost> Foresee(int64_t sites) const;

 private:
  std::vector<double> seconds_per_site_, bytes_per_site_;
};

}  // namespace stratalux::fit
