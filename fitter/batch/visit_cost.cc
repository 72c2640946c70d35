// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/visit_cost.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "fitter/batch/newest_fits.h"
#include "shared/base/formatted.h"
#include "shared/base/json_nesting.h"
#include "shared/base/median.h"

namespace stratalux::fit {
namespace {

double Positive(const nlohmann::json& stage, const char* key) {
  const auto found = stage.find(key);
  return found != stage.end() && found->is_number() ? std::max(0.0, found->get<double>()) : 0.0;
}

}  // namespace

void CostHistory::Add(const std::string& metrics_json, int64_t sites) {
  if (sites <= 0 || !CheckNesting(metrics_json).ok()) return;
  const auto json = nlohmann::json::parse(metrics_json, nullptr, false);
  if (!json.is_object() || !json.contains("stages") || !json["stages"].is_array()) return;
  double seconds = 0.0, peak = 0.0;
  for (const auto& stage : json["stages"]) {
    if (!stage.is_object()) continue;
    seconds += Positive(stage, "cpu_seconds");
    peak = std::max(peak, Positive(stage, "peak_rss_bytes"));
  }
  if (seconds > 0.0) AddMeasured({seconds, static_cast<int64_t>(peak)}, sites);
}

void CostHistory::AddMeasured(const VisitCost& cost, int64_t sites) {
  if (sites <= 0) return;
  seconds_per_site_.push_back(cost.cpu_seconds / static_cast<double>(sites));
  bytes_per_site_.push_back(static_cast<double>(cost.peak_bytes) / static_cast<double>(sites));
}

std::optional<VisitCost> CostHistory::Foresee(int64_t sites) const {
  if (seconds_per_site_.empty()) return std::nullopt;
  const double many = static_cast<double>(sites);
  return VisitCost{Median(seconds_per_site_) * many,
                   static_cast<int64_t>(*std::max_element(bytes_per_site_.begin(), bytes_per_site_.end()) * many)};
}

Status CheckSeconds(double seconds) {
  constexpr double kMost = 1e9;
  if (seconds >= 0.0 && seconds <= kMost) return Status::Ok();
  return Status::Integrity(Formatted("%g seconds cannot be what a visitor took; 0 to %g are allowed", seconds, kMost));
}

Status CheckCost(const VisitCost& cost) {
  constexpr int64_t kMostBytes = int64_t{1} << 50;
  if (cost.peak_bytes < 0 || cost.peak_bytes > kMostBytes)
    return Status::Integrity(std::to_string(cost.peak_bytes) + " bytes cannot be what a visitor took; 0 to " +
                             std::to_string(kMostBytes) + " are allowed");
  return CheckSeconds(cost.cpu_seconds);
}

Result<CostHistory> CostHistory::Read(const db::SessionStore& store, size_t most) {
  CostHistory history;
  SLX_RETURN_IF_ERROR(LookAtNewestFits(store, [&](const NewestFit& newest) {
    history.Add(newest.fit.metrics_json, newest.sites);
    return history.seconds_per_site_.size() < most;
  }));
  return history;
}

}  // namespace stratalux::fit
