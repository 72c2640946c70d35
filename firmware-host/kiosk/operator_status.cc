// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/operator_status.h"

#include <utility>

#include <nlohmann/json.hpp>

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

template <typename T>
Json OrNull(const std::optional<T>& value) {
  return value ? Json(*value) : Json(nullptr);
}

Json JsonOf(const RecentSession& one) {
  return {{"id", one.id},         {"kind", one.kind},
          {"status", one.status}, {"started", one.started.ns / kSecondNs},
          {"frames", one.frames}, {"findings", one.reasons}};
}

Json JsonOf(const DayCounts& day) {
  int64_t faults = 0;
  for (const auto& [word, count] : day.faults) faults += count;
  return {{"day", day.day},
          {"visits_begun", day.visits_begun},
          {"visits", Json(day.visits)},
          {"retakes", day.retakes},
          {"faults", faults}};
}

Json JsonOf(const Temperature& one) { return {{"name", one.name}, {"celsius", one.celsius}}; }
Json JsonOf(const KioskFault& one) { return {{"at", one.at.ns / kSecondNs}, {"word", one.word}}; }

template <typename Range>
Json ListOf(const Range& range) {
  Json list = Json::array();
  for (const auto& one : range) list.push_back(JsonOf(one));
  return list;
}

Json SecondsOf(const std::optional<WallNs>& at) { return at ? Json(at->ns / kSecondNs) : Json(nullptr); }

Json BatchJson(const TimerFacts& timer, const std::optional<FitFacts>& of_store) {
  Json fits = nullptr;
  if (of_store)
    fits = {{"without_fit", of_store->without_fit},
            {"has_jobs", of_store->has_jobs},
            {"waiting", of_store->waiting},
            {"fitted", of_store->fitted},
            {"failed", of_store->failed}};
  return {{"timer", ToString(timer.here)},
          {"next", SecondsOf(timer.next)},
          {"last", SecondsOf(timer.last)},
          {"fits", std::move(fits)}};
}

}  // namespace

std::string ToJson(const OperatorStatus& status) {
  const Json json = {{"screen", ToString(status.screen)},
                     {"frames_per_second", OrNull(status.frames_per_second)},
                     {"viewers", status.viewers},
                     {"temperatures", ListOf(status.temperatures)},
                     {"today", JsonOf(status.today)},
                     {"other_days", ListOf(status.other_days)},
                     {"faults", ListOf(status.faults)},
                     {"sessions", ListOf(status.store.sessions)},
                     {"calibration_age_days", OrNull(status.store.calibration_age_days)},
                     {"disk_free_bytes", OrNull(status.store.disk_free_bytes)},
                     {"selfchecks", Json::parse(TrendAsJson(status.selfchecks))},
                     {"batch", BatchJson(status.batch_timer, status.store.fits)},
                     {"notes", status.notes}};
  return json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace stratalux::rig
