// SPDX-License-Identifier: Apache-2.0
#include "db/apps/statistics.h"

#include <algorithm>
#include <map>

#include <nlohmann/json.hpp>

#include "db/apps/display_text.h"
#include "db/catalogue/named_query.h"

namespace stratalux::db {
namespace {

constexpr int64_t kDay_ns = int64_t{86400} * 1'000'000'000;

struct DayRow {
  int64_t sessions = 0, complete = 0, not_complete = 0, frames = 0, bytes = 0, fits = 0;
  double nrmse_sum = 0.0;
};
using Days = std::map<std::string, DayRow>;  // "2026-11-21" -> ...; in order of time

std::string DayOf(int64_t day) { return ToIso8601({day * kDay_ns}).substr(0, 10); }

Result<ResultTable> Ask(ReadOnlyIndex& index, const char* name, const QueryParameters& parameters) {
  SLX_ASSIGN_OR_RETURN(const NamedQuery* query, FindQuery(name));
  return RunQuery(index, *query, parameters, {.time = std::chrono::minutes(1), .rows = INT64_MAX, .bytes = INT64_MAX});
}

int64_t Whole(const Cell& cell) { return std::get<int64_t>(cell); }

// Every day there ever was: the disk holds the older ones, too.
Result<Days> LoadDays(ReadOnlyIndex& index) {
  Days days;
  SLX_ASSIGN_OR_RETURN(const auto sessions, Ask(index, "sessions-per-day", {}));
  for (const auto& row : sessions.rows) {
    DayRow& day = days[std::get<std::string>(row[0])];
    day.sessions = Whole(row[1]);
    day.complete = Whole(row[2]);
    day.not_complete = Whole(row[3]) + Whole(row[4]);
    day.frames = Whole(row[5]);
    day.bytes = Whole(row[6]);
  }
  SLX_ASSIGN_OR_RETURN(const auto fits, Ask(index, "fit-quality", {}));
  for (const auto& row : fits.rows) {
    if (!std::holds_alternative<double>(row[2])) continue;
    DayRow& day = days[std::get<std::string>(row[0])];
    day.fits = Whole(row[1]);
    day.nrmse_sum = std::get<double>(row[2]) * static_cast<double>(day.fits);
  }
  return days;
}

void AddBin(const std::string& label, const DayRow& bin, int64_t disk_bytes, Statistics& out) {
  out.sessions_per_bin.points.push_back({label, static_cast<double>(bin.sessions)});
  out.not_complete_per_bin.points.push_back({label, static_cast<double>(bin.not_complete)});
  out.disk.points.push_back({label, static_cast<double>(disk_bytes)});
  out.nrmse.points.push_back(
      {label, bin.fits > 0 ? std::optional(bin.nrmse_sum / static_cast<double>(bin.fits)) : std::nullopt});
  out.sessions += bin.sessions;
  out.complete += bin.complete;
  out.frames += bin.frames;
  out.bytes += bin.bytes;
}

void LayOut(const Days& days, int64_t first, int64_t last, Statistics& out) {
  int64_t disk_bytes = 0;
  for (auto day = days.begin(); day != days.end() && day->first < DayOf(first); ++day) disk_bytes += day->second.bytes;
  for (int64_t start = first; start <= last; start += out.days_per_bin) {
    DayRow bin;
    for (int64_t d = start; d < std::min(start + out.days_per_bin, last + 1); ++d) {
      const auto found = days.find(DayOf(d));
      if (found == days.end()) continue;
      const DayRow& day = found->second;
      bin.sessions += day.sessions;
      bin.complete += day.complete;
      bin.not_complete += day.not_complete;
      bin.frames += day.frames;
      bin.bytes += day.bytes;
      bin.fits += day.fits;
      bin.nrmse_sum += day.nrmse_sum;
    }
    disk_bytes += bin.bytes;
    AddBin(DayOf(start), bin, disk_bytes, out);
  }
}

}  // namespace

Result<Statistics> LoadStatistics(ReadOnlyIndex& index, WallNs since, WallNs until) {
  if (until < since) return Status::Usage("the span of time ends before it starts");
  const auto day_of = [](WallNs moment) { return (moment.ns - (moment.ns < 0 ? kDay_ns - 1 : 0)) / kDay_ns; };
  const int64_t first = day_of(since), last = day_of(until);
  Statistics out;
  out.since = {first * kDay_ns};
  out.until = until;
  out.days_per_bin = static_cast<int>((last - first) / kMostBins + 1);
  const std::string per = out.days_per_bin == 1 ? "a day" : "each " + std::to_string(out.days_per_bin) + " days";
  out.sessions_per_bin.title = "Sessions " + per;
  out.not_complete_per_bin.title = "Degraded or failed " + per;
  out.disk = {"Payloads on disk", Series::Unit::kBytes, {}};
  out.nrmse = {"Held-out error of the fits (NRMSE, mean)", Series::Unit::kNumber, {}};
  out.failures.title = "Why sessions were degraded or failed";
  SLX_ASSIGN_OR_RETURN(const Days days, LoadDays(index));
  LayOut(days, first, last, out);
  SLX_ASSIGN_OR_RETURN(
      const auto failures,
      Ask(index, "failures", {{"since_ns", out.since.ns}, {"until_ns", until.ns}, {"limit", int64_t{10}}}));
  for (const auto& row : failures.rows)
    out.failures.points.push_back({std::get<std::string>(row[0]) + ": " + Printable(std::get<std::string>(row[1])),
                                   static_cast<double>(Whole(row[2]))});
  return out;
}

std::string StatisticsAsJson(const Statistics& s) {
  using Json = nlohmann::ordered_json;
  const auto points = [](const Series& series, const char* label) {
    Json json = Json::array();
    for (const SeriesPoint& point : series.points)
      json.push_back({{label, point.label}, {"value", point.value ? Json(*point.value) : Json()}});
    return json;
  };
  const Json json = {{"since", ToIso8601(s.since)},
                     {"until", ToIso8601(s.until)},
                     {"days_per_bin", s.days_per_bin},
                     {"sessions", s.sessions},
                     {"complete", s.complete},
                     {"frames", s.frames},
                     {"bytes", s.bytes},
                     {"sessions_per_bin", points(s.sessions_per_bin, "from")},
                     {"not_complete_per_bin", points(s.not_complete_per_bin, "from")},
                     {"disk_bytes", points(s.disk, "from")},
                     {"nrmse", points(s.nrmse, "from")},
                     {"failures", points(s.failures, "reason")}};
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace stratalux::db
