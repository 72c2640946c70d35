// SPDX-License-Identifier: Apache-2.0
#include "db/apps/session_views.h"

#include <array>
#include <cstdio>
#include <map>

#include <nlohmann/json.hpp>

#include "db/manifest.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

std::string SizeText(int64_t bytes) {
  constexpr std::array<const char*, 5> kUnits = {"B", "KiB", "MiB", "GiB", "TiB"};
  size_t unit = 0;
  auto size = static_cast<double>(bytes);
  for (; size >= 1024.0 && unit + 1 < kUnits.size(); ++unit) size /= 1024.0;
  char text[32];
  std::snprintf(text, sizeof text, unit == 0 ? "%.0f %s" : "%.1f %s", size, kUnits[unit]);
  return text;
}

// Names of files and visitors may be no UTF-8, which JSON is.
std::string TextOf(const Json& json) { return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n"; }

Json ParsedOrNull(const std::string& text) { return text.empty() ? Json() : Json::parse(text, nullptr, false); }

Json SessionJson(const SessionRow& row) {
  return {{"session", row.info.id},
          {"started", ToIso8601(row.info.started_wall)},
          {"kind", ToString(row.info.kind)},
          {"rig", row.info.rig},
          {"visitor", row.info.visitor},
          {"status", ToString(row.info.status)},
          {"reasons", row.info.reasons},
          {"simulated", row.info.simulated},
          {"frames", row.frames},
          {"bytes", row.bytes}};
}

// (phase, projector) -> frames, in the order of the phases.
using Counts = std::map<std::pair<CapturePhase, int>, int64_t>;
Counts CountPhases(const std::vector<FrameRow>& frames) {
  Counts counts;
  for (const FrameRow& f : frames) ++counts[{f.record.phase, f.record.projector}];
  return counts;
}

const char* ToString(LevelCheck check) {
  switch (check) {
    case LevelCheck::kPassed:
      return "passed";
    case LevelCheck::kFailed:
      return "failed";
    case LevelCheck::kNotChecked:
      break;
  }
  return "not checked";
}

const char* ToString(ClockSource clock) {
  switch (clock) {
    case ClockSource::kMonotonic:
      return "monotonic";
    case ClockSource::kSimulated:
      return "simulated";
    case ClockSource::kUnknown:
      break;
  }
  return "unknown";
}

Json FrameJson(const FrameRow& f) {
  const FrameRecord& r = f.record;
  return {{"frame", f.id},
          {"step", r.step},
          {"projector", r.projector},
          {"phase", stratalux::ToString(r.phase)},
          {"pattern", r.pattern.ToString()},
          {"bracket", r.bracket},
          {"pose", r.pose},
          {"retry", r.retry},
          {"trigger_number", r.trigger_number},
          {"trigger_ns", r.trigger_time.ns},
          {"sync_ns", r.sync_time.ns},
          {"driver_sequence", r.driver_sequence},
          {"frame_ns", r.frame_time.ns},
          {"frame_clock", ToString(r.frame_clock)},
          {"exposure_ms", r.exposure_ms},
          {"gain", r.gain},
          {"level_check", ToString(r.level_check)},
          {"mean_dn", r.mean_dn},
          {"bit_depth", BitDepth(r.format)},
          {"cfa", static_cast<int>(r.cfa)},
          {"width", r.width},
          {"height", r.height},
          {"channels", r.channels},
          {"crop_x", r.crop_x},
          {"crop_y", r.crop_y},
          {"codec", f.codec},
          {"segment", f.segment},
          {"offset", f.offset},
          {"stored_bytes", f.stored_bytes},
          {"hash", f.hash}};
}

std::string Line(const std::string& name, const std::string& value) {
  std::string line = name;
  line.resize(18, ' ');
  return value.empty() ? std::string() : line + value + "\n";
}

}  // namespace

Result<std::vector<ListedSession>> ListWithFits(const SessionStore& store) {
  SLX_ASSIGN_OR_RETURN(const auto rows, store.ListSessions());
  std::vector<ListedSession> listed;
  for (const SessionRow& row : rows) {
    SLX_ASSIGN_OR_RETURN(const auto fits, store.ListFits(row.info.id));
    listed.push_back({row, static_cast<int64_t>(fits.size())});
  }
  return listed;
}

std::string SessionsAsText(const std::vector<ListedSession>& sessions) {
  char line[320];
  auto format = [&line](const char* id, const char* when, const char* kind, const char* rig, const char* visitor,
                        const char* status, const char* frames, const char* size, const char* fits) {
    std::snprintf(line, sizeof line, "%-16s  %-20s  %-11s  %-18s  %-12s  %-9s  %6s  %10s  %4s\n", id, when, kind, rig,
                  visitor, status, frames, size, fits);
    return std::string(line);
  };
  std::string text = format("session", "started", "kind", "rig", "visitor", "status", "frames", "size", "fits");
  for (const auto& [row, fits] : sessions)
    text += format(row.info.id.c_str(), ToIso8601(row.info.started_wall).c_str(), stratalux::ToString(row.info.kind),
                   row.info.rig.c_str(), row.info.visitor.empty() ? "-" : row.info.visitor.c_str(),
                   stratalux::ToString(row.info.status), std::to_string(row.frames).c_str(),
                   SizeText(row.bytes).c_str(), std::to_string(fits).c_str());
  return text;
}

std::string SessionsAsJson(const std::vector<ListedSession>& sessions) {
  Json json = Json::array();
  for (const auto& [row, fits] : sessions) {
    json.push_back(SessionJson(row));
    json.back()["fits"] = fits;
  }
  return TextOf(json);
}

namespace {

std::string ConsentAsText(const Consent& consent) {
  if (consent.text_version.empty()) return "none";
  std::string scope;
  if (consent.fit) scope += " fit";
  if (consent.research) scope += " research";
  if (consent.publication) scope += " publication";
  return "text " + consent.text_version + (consent.language.empty() ? "" : " (" + consent.language + ")") + ":" +
         (scope.empty() ? " nothing" : scope);
}

}  // namespace

Result<SessionDetails> LoadDetails(const SessionStore& store, const std::string& selector) {
  SessionDetails details;
  SLX_ASSIGN_OR_RETURN(details.row, store.FindSession(selector));
  SLX_ASSIGN_OR_RETURN(details.frames, store.ListFrames(details.row.info.id));
  SLX_ASSIGN_OR_RETURN(details.fits, store.ListFits(details.row.info.id));
  return details;
}

std::string DetailsAsText(const SessionDetails& details) {
  const SessionInfo& info = details.row.info;
  std::string text = Line("session", info.id) + Line("started", ToIso8601(info.started_wall)) +
                     Line("kind", stratalux::ToString(info.kind)) + Line("rig", info.rig) +
                     Line("visitor", info.visitor) + Line("consent", ConsentAsText(info.consent)) +
                     Line("retention", stratalux::ToString(info.retention)) +
                     Line("status", stratalux::ToString(info.status));
  for (const std::string& reason : info.reasons) text += Line("  reason", reason);
  if (info.simulated) text += Line("simulated", "seed " + std::to_string(info.seed));
  text += Line("program", info.program_version) +
          Line("frames", std::to_string(details.row.frames) + ", " + SizeText(details.row.bytes));
  for (const auto& [key, count] : CountPhases(details.frames)) {
    const std::string lit = key.second < 0 ? "all projectors" : "projector " + std::to_string(key.second);
    text += Line(std::string("  ") + stratalux::ToString(key.first), std::to_string(count) + ", " + lit);
  }
  const Json calibration = ParsedOrNull(info.calibration_json);
  text += Line("plan", info.plan_json.empty() ? "none" : "kept (--json prints it)");
  const Json source = calibration.is_object() ? calibration.value("source", Json()) : Json("none");
  text += Line("calibration", source.is_string() ? source.get<std::string>() : "source unknown");
  for (const FitRow& fit : details.fits) text += Line("fit", fit.id + "  " + ToIso8601(fit.created_wall));
  return text;
}

std::string DetailsAsJson(const SessionDetails& details) {
  const SessionInfo& info = details.row.info;
  Json json = SessionJson(details.row);
  json["consent"] = ParsedOrNull(ConsentToJson(info.consent));
  json["retention"] = stratalux::ToString(info.retention);
  json["seed"] = info.seed;
  json["program_version"] = info.program_version;
  json["plan"] = ParsedOrNull(info.plan_json);
  json["calibration"] = ParsedOrNull(info.calibration_json);
  json["phases"] = Json::array();
  for (const auto& [key, count] : CountPhases(details.frames))
    json["phases"].push_back({{"phase", stratalux::ToString(key.first)}, {"projector", key.second}, {"frames", count}});
  json["fits"] = Json::array();
  for (const FitRow& fit : details.fits)
    json["fits"].push_back({{"fit", fit.id},
                            {"created", ToIso8601(fit.created_wall)},
                            {"options", ParsedOrNull(fit.options_json)},
                            {"metrics", ParsedOrNull(fit.metrics_json)}});
  return TextOf(json);
}

std::vector<FrameRow> Filter(std::vector<FrameRow> frames, const FrameFilter& filter) {
  std::erase_if(frames, [&filter](const FrameRow& f) {
    return (filter.phase && f.record.phase != *filter.phase) ||
           (filter.projector && f.record.projector != *filter.projector);
  });
  return frames;
}

std::string FramesAsText(const std::vector<FrameRow>& frames) {
  std::string text = " frame   step  proj  pose  retry  phase           mean DN  check        codec  pattern\n";
  char line[256];
  for (const FrameRow& f : frames) {
    const FrameRecord& r = f.record;
    std::snprintf(line, sizeof line, "%6lld %6d %5d %5d %6d  %-14s %8.1f  %-11s  %-5s  %s\n",
                  static_cast<long long>(f.id), r.step, r.projector, r.pose, r.retry, stratalux::ToString(r.phase),
                  r.mean_dn, ToString(r.level_check), f.codec.c_str(), r.pattern.ToString().c_str());
    text += line;
  }
  return text;
}

std::string FramesAsJson(const std::vector<FrameRow>& frames) {
  Json json = Json::array();
  for (const FrameRow& f : frames) json.push_back(FrameJson(f));
  return TextOf(json);
}

std::string VerifiedAsText(const Verified& verified) {
  std::string text;
  for (const auto& [id, report] : verified) {
    const std::string verdict = report.problems.empty() ? "ok" : std::to_string(report.problems.size()) + " problem(s)";
    text += id + ": " + verdict + ", " + std::to_string(report.frames) + " frames and maps, " + SizeText(report.bytes) +
            "\n";
    for (const std::string& problem : report.problems) text += "  problem: " + problem + "\n";
    for (const std::string& note : report.notes) text += "  note: " + note + "\n";
  }
  return text;
}

std::string VerifiedAsJson(const Verified& verified) {
  Json json = Json::array();
  for (const auto& [id, report] : verified)
    json.push_back({{"session", id},
                    {"frames", report.frames},
                    {"bytes", report.bytes},
                    {"problems", report.problems},
                    {"notes", report.notes}});
  return TextOf(json);
}

}  // namespace stratalux::db
