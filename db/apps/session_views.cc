// SPDX-License-Identifier: Apache-2.0
#include "db/apps/session_views.h"

#include <algorithm>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "db/apps/display_text.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/read_only_index.h"
#include "shared/base/json_nesting.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

// Names of files and visitors may be no UTF-8, which JSON is.
std::string TextOf(const Json& json) {
  return PrintableJson(json.dump(2, ' ', false, Json::error_handler_t::replace)) + "\n";
}

// What is no JSON is null, bytes in it that are no UTF-8 become U+FFFD.
Json ParsedOrNull(const std::string& text) {
  if (!CheckNesting(text).ok()) return {};
  Json json = Json::parse(PrintableJson(text), nullptr, false);
  return json.is_discarded() ? Json() : json;
}

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

constexpr size_t kValueColumn = 18;
constexpr int kLineColumns = 100;

// Name and value, which goes on below itself where it is long.
std::string Line(const std::string& name, const std::string& value) {
  if (value.empty()) return {};
  std::string line = name;
  line.resize(std::max(kValueColumn, name.size() + 2), ' ');
  return line +
         Wrapped(Printable(value), kLineColumns - static_cast<int>(kValueColumn), std::string(kValueColumn, ' ')) +
         "\n";
}

// A moment of a view, which has it to the nanosecond, as the other lines have theirs: to the second.
std::string ToTheSecond(const std::string& iso8601) {
  const size_t point = iso8601.find('.');
  return point == std::string::npos ? iso8601 : iso8601.substr(0, point) + "Z";
}

// "text 3 (de): fit, research; WITHDRAWN 2026-11-21T11:08:06Z".
std::string ConsentAsText(const std::string& consent_json) {
  const Json consent = ParsedOrNull(consent_json);
  if (!consent.is_object()) return "none";
  const auto text = [&consent](const char* key) {
    const auto found = consent.find(key);
    return found != consent.end() && found->is_string() ? found->get<std::string>() : std::string();
  };
  std::string scope;
  if (const auto found = consent.find("scope"); found != consent.end() && found->is_array())
    for (const Json& word : *found)
      if (word.is_string()) scope += (scope.empty() ? "" : ", ") + word.get<std::string>();
  const std::string language = text("language"), withdrawn = text("withdrawn");
  return "text " + text("text_version") + (language.empty() ? "" : " (" + language + ")") + ": " +
         (scope.empty() ? "nothing" : scope) + (withdrawn.empty() ? "" : "; WITHDRAWN " + ToTheSecond(withdrawn));
}

// What views say of the session beyond its row.
Status LoadFromViews(const SessionStore& store, SessionDetails& details) {
  SLX_ASSIGN_OR_RETURN(auto index, ReadOnlyIndex::Open(store.folder()));
  const QueryParameters session{{"session", details.row.info.id}};
  SLX_ASSIGN_OR_RETURN(const auto phases,
                       index.Run("SELECT f.phase, f.projector, count(*) FROM sessions s JOIN frames f ON f.session ="
                                 " s.number WHERE s.id = :session GROUP BY f.phase, f.projector ORDER BY min(f.step)",
                                 session));
  for (const auto& row : phases.rows)
    details.phases.push_back({std::get<std::string>(row[0]), std::get<int64_t>(row[1]), std::get<int64_t>(row[2])});
  // Subqueries: a view that is joined would be computed for every session of the store.
  SLX_ASSIGN_OR_RETURN(const auto facts,
                       index.Run("SELECT coalesce(o.consent, ''),"
                                 " coalesce((SELECT e.due FROM retention_ends e WHERE e.session = o.number), ''),"
                                 " coalesce((SELECT e.reason FROM retention_ends e WHERE e.session = o.number), '')"
                                 " FROM session_overview o WHERE o.id = :session",
                                 session));
  if (facts.rows.empty()) return Status::NotFound("session " + details.row.info.id + " is gone");
  details.consent_json = std::get<std::string>(facts.rows[0][0]);
  details.due = std::get<std::string>(facts.rows[0][1]);
  details.due_reason = std::get<std::string>(facts.rows[0][2]);
  return Status::Ok();
}

std::string VisitAsText(const SessionInfo& info) {
  const std::string attempt = info.attempt > 0 ? "attempt " + std::to_string(info.attempt) : "";
  return info.visit + (info.visit.empty() || attempt.empty() ? "" : ", ") + attempt;
}

// Findings that are no reason, and how many shots did not count for which fault: "lost frame 2, wrong level 14".
std::string FoundAsText(const SessionInfo& info) {
  std::string text, faults;
  for (const std::string& line : ToText(info.found.findings))
    if (std::find(info.reasons.begin(), info.reasons.end(), line) == info.reasons.end())
      text += Line("  finding", line);
  for (const auto& [fault, shots] : info.found.faults)
    faults += (faults.empty() ? "" : ", ") + fault + " " + std::to_string(shots);
  return text + Line("spoilt shots", faults);
}

std::string RetentionAsText(const SessionDetails& details) {
  const std::string retention = stratalux::ToString(details.row.info.retention);
  if (details.due.empty()) return retention;
  const bool withdrawn = details.due_reason == "consent withdrawn";
  return retention +
         (withdrawn ? "; `stratalux-db purge` removes it: consent withdrawn" : "; due " + ToTheSecond(details.due));
}

}  // namespace

Result<SessionDetails> LoadDetails(const SessionStore& store, const std::string& selector) {
  SessionDetails details;
  SLX_ASSIGN_OR_RETURN(details.row, store.FindSession(selector));
  SLX_RETURN_IF_ERROR(LoadFromViews(store, details));
  SLX_ASSIGN_OR_RETURN(details.fits, store.ListFits(details.row.info.id));
  return details;
}

std::string DetailsAsText(const SessionDetails& details) {
  const SessionInfo& info = details.row.info;
  std::string text = Line("session", info.id) + Line("started", ToIso8601(info.started_wall)) +
                     Line("kind", stratalux::ToString(info.kind)) + Line("rig", info.rig) +
                     Line("visitor", info.visitor) + Line("visit", VisitAsText(info)) +
                     Line("consent", ConsentAsText(details.consent_json)) +
                     Line("retention", RetentionAsText(details)) + Line("status", stratalux::ToString(info.status));
  for (const std::string& reason : info.reasons) text += Line("  reason", reason);
  text += FoundAsText(info);
  if (info.simulated) text += Line("simulated", "seed " + std::to_string(info.seed));
  text += Line("program", info.program_version) +
          Line("frames", std::to_string(details.row.frames) + ", " + SizeText(details.row.bytes) +
                             (details.row.key_id.empty() ? "" : ", encrypted"));
  for (const auto& [phase, projector, count] : details.phases) {
    const std::string lit = projector < 0 ? "all projectors" : "projector " + std::to_string(projector);
    text += Line("  " + phase, std::to_string(count) + ", " + lit);
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
  json["visit"] = info.visit;
  json["attempt"] = info.attempt;
  json["findings"] = ParsedOrNull(FindingsToJson(info.found.findings));
  json["faults"] = ParsedOrNull(FaultsToJson(info.found.faults));
  json["consent"] = ParsedOrNull(details.consent_json);
  json["retention"] = stratalux::ToString(info.retention);
  json["due"] = details.due.empty() ? Json() : Json(details.due);
  json["encrypted"] = !details.row.key_id.empty();
  json["seed"] = info.seed;
  json["program_version"] = info.program_version;
  json["plan"] = ParsedOrNull(info.plan_json);
  json["calibration"] = ParsedOrNull(info.calibration_json);
  json["phases"] = Json::array();
  for (const auto& [phase, projector, count] : details.phases)
    json["phases"].push_back({{"phase", phase}, {"projector", projector}, {"frames", count}});
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
  return frames.empty() ? text + "(none)\n" : text;
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
    text += id + ": " + verdict + ", " + std::to_string(report.frames) + " frames and maps, " + SizeText(report.bytes);
    if (report.signed_by) text += ", signed by " + Fingerprint(*report.signed_by);
    text += "\n";
    for (const std::string& problem : report.problems) text += "  problem: " + problem + "\n";
    for (const std::string& note : report.notes) text += "  note: " + note + "\n";
  }
  return text;
}

std::string VerifiedAsJson(const Verified& verified) {
  Json json = Json::array();
  for (const auto& [id, report] : verified)
    json.push_back({{"session", id},
                    {"signed_by", report.signed_by ? Json(ToHex(*report.signed_by)) : Json()},
                    {"frames", report.frames},
                    {"bytes", report.bytes},
                    {"problems", report.problems},
                    {"notes", report.notes}});
  return TextOf(json);
}

}  // namespace stratalux::db
