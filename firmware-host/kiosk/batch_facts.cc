// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/batch_facts.h"

#include <chrono>
#include <cstdlib>
#include <ctime>
#include <map>
#include <sstream>
#include <utility>

#include "db/catalogue/read_only_index.h"
#include "db/catalogue/schema_check.h"
#include "shared/base/program.h"

namespace stratalux::rig {
namespace {

constexpr int64_t kDayNs = 24 * 3600 * kSecondNs;

constexpr const char* kAll = R"(
SELECT (SELECT count(*) FROM sessions s
        WHERE s.kind = 'visitor' AND s.status IN ('complete', 'degraded')
          AND NOT EXISTS (SELECT 1 FROM fits f WHERE f.session = s.number)),
       (SELECT count(*) FROM jobs),
       (SELECT count(*) FROM jobs WHERE kind = 'fit' AND state IN ('queued', 'running')),
       (SELECT count(*) FROM jobs WHERE kind = 'fit' AND state = 'done' AND finished_wall_ns >= :since_ns),
       (SELECT count(*) FROM jobs WHERE kind = 'fit' AND state IN ('failed', 'set-aside') AND finished_wall_ns >= :since_ns))";

// "@1795550400", or "Tue 2026-11-24 20:00:00 UTC"; nullopt of "", "n/a", "0" and all else.
std::optional<WallNs> MomentOf(const std::string& text) {
  if (text.starts_with("@")) {
    const int64_t seconds = std::strtoll(text.c_str() + 1, nullptr, 10);
    return seconds > 0 && seconds < 9'000'000'000 ? std::optional(WallNs{seconds * kSecondNs}) : std::nullopt;
  }
  std::tm utc{};
  const char* end = strptime(text.c_str(), "%a %Y-%m-%d %H:%M:%S", &utc);
  if (end == nullptr || std::string(end) != " UTC") return std::nullopt;
  return WallNs{static_cast<int64_t>(timegm(&utc)) * kSecondNs};
}

// The properties of `unit`, among those of others, each group behind an empty line.
std::map<std::string, std::string> PropertiesOf(const std::string& shown, const std::string& unit) {
  std::map<std::string, std::string> properties;
  std::istringstream lines(shown);
  for (std::string line; std::getline(lines, line);) {
    if (line.empty() && properties["Id"] == unit) break;
    if (line.empty()) properties.clear();
    const size_t equals = line.find('=');
    if (equals != std::string::npos) properties[line.substr(0, equals)] = line.substr(equals + 1);
  }
  if (properties["Id"] != unit) properties.clear();
  return properties;
}

}  // namespace

const char* ToString(TimerFacts::Here here) {
  switch (here) {
    case TimerFacts::Here::kUnknown:
      return "unknown";
    case TimerFacts::Here::kAbsent:
      return "absent";
    case TimerFacts::Here::kOff:
      return "off";
    case TimerFacts::Here::kOn:
      return "on";
  }
  return "unknown";
}

TimerFacts TimerOf(const std::string& shown, const std::string& unit) {
  auto properties = PropertiesOf(shown, unit);
  TimerFacts timer;
  const std::string load = properties["LoadState"];
  if (load.empty()) return timer;
  timer.here = load == "not-found"                     ? TimerFacts::Here::kAbsent
               : properties["ActiveState"] == "active" ? TimerFacts::Here::kOn
                                                       : TimerFacts::Here::kOff;
  if (timer.here != TimerFacts::Here::kOn) return timer;
  timer.next = MomentOf(properties["NextElapseUSecRealtime"]);
  timer.last = MomentOf(properties["LastTriggerUSec"]);
  return timer;
}

TimerFacts AskTimer(const std::string& systemctl, const std::string& unit) {
  // Whatever holds systemd's answer up, the operator's screen does not wait for it.
  constexpr ProgramLimit kLimit{std::chrono::seconds(3)};
  const auto shown = RunProgram({"env", "TZ=UTC", "LC_ALL=C", systemctl, "show", "--no-pager",
                                 "--property=Id,LoadState,ActiveState,NextElapseUSecRealtime,LastTriggerUSec", unit},
                                kLimit);
  return shown.ok() && shown->code == 0 ? TimerOf(shown->output, unit) : TimerFacts();
}

Result<FitFacts> FitsOf(const std::filesystem::path& store, WallNs now) {
  SLX_RETURN_IF_ERROR(db::RequireCurrentSchema(store));
  SLX_ASSIGN_OR_RETURN(auto index, db::ReadOnlyIndex::Open(store));
  SLX_ASSIGN_OR_RETURN(const auto table, index.Run(kAll, {{"since_ns", now.ns - kDayNs}}));
  const auto& row = table.rows.at(0);
  const auto count = [&row](size_t column) {
    const auto* value = std::get_if<int64_t>(&row.at(column));
    return value == nullptr ? 0 : *value;
  };
  return FitFacts{count(0), count(1) > 0, count(2), count(3), count(4)};
}

}  // namespace stratalux::rig
