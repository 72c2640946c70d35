// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/night_status.h"

#include <algorithm>

namespace stratalux::fit {

int NightStatus::Count(NightEventKind kind) const {
  return static_cast<int>(std::count_if(visits.begin(), visits.end(), [&](const auto& v) { return v.kind == kind; }));
}

int NightStatus::Over() const {
  return Count(NightEventKind::kDone) + Count(NightEventKind::kFailed) + Count(NightEventKind::kSetAside) +
         Count(NightEventKind::kDropped);
}

NightStatus StatusOf(const std::vector<NightEvent>& events) {
  NightStatus status;
  std::map<std::string, size_t> places;
  for (const NightEvent& event : events) {
    switch (event.kind) {
      case NightEventKind::kBegan:
        status.began = event.at;
        status.chosen = event.count;
        break;
      case NightEventKind::kEnded:
        status.ended = event.at;
        status.end_reason = event.reason;
        status.ended_by_error = event.by_error;
        break;
      case NightEventKind::kLeftOut:
        status.left_out.push_back(event);
        break;
      default: {
        // Of whom was forgotten no more is known than how it ended: each is another.
        if (event.session.empty()) {
          if (IsEnd(event.kind)) status.visits.push_back({.kind = event.kind, .at = event.at, .reason = event.reason});
          break;
        }
        const auto [place, is_new] = places.try_emplace(event.session, status.visits.size());
        if (is_new) status.visits.push_back({.session = event.session});
        NightVisit& visit = status.visits[place->second];
        if (!event.fit.empty()) visit.fit = event.fit;
        visit.kind = event.kind;
        visit.at = event.at;
        visit.attempts = std::max(visit.attempts, event.attempt);
        visit.peak_bytes = std::max(visit.peak_bytes, event.peak_bytes);
        if (event.kind == NightEventKind::kStarted) break;
        visit.seconds = event.seconds;
        visit.cpu_seconds = event.cpu_seconds;
        visit.reason = event.reason;
      }
    }
  }
  return status;
}

Status CheckNewestNight(const std::filesystem::path& store, WallNs since) {
  const auto degraded = [](const std::string& why) { return Status(StatusCode::kDegraded, why); };
  const std::string none = "no night has begun since " + ToIso8601(since);
  const auto nights = Nights(store);
  if (nights.empty()) return degraded(none);
  const auto record = ReadNight(store / "nights" / nights.back());
  if (!record.ok()) return degraded(record.status().message());
  const NightStatus night = StatusOf(record->events);
  // One that failed before it could say that it begins has an end alone.
  const WallNs began = night.began.ns != 0 ? night.began : night.ended.value_or(WallNs{});
  if (began < since) return degraded(none);
  const std::string name = "the night of " + ToIso8601(began);
  if (!night.ended) return degraded(name + " was cut off, or is still running");
  if (night.ended_by_error) return degraded(name + " was ended by an error: " + night.end_reason);
  if (const int failed = night.Count(NightEventKind::kFailed) + night.Count(NightEventKind::kSetAside); failed > 0)
    return degraded(name + ": " + std::to_string(failed) + " visitors could not be fitted");
  return Status::Ok();
}

}  // namespace stratalux::fit
