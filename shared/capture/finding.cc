// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/finding.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <string_view>

#include <nlohmann/json.hpp>

namespace stratalux {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::array<std::string_view, kFindingKindCount> kWords = {
    "stopped", "device", "preroll", "silent-rig", "no-proof",  "wrong-pattern", "proof-reused", "triggers-unmatched",
    "moved",   "lamp",   "blink",   "mixed-up",   "saturated", "dim",           "watch"};

std::string Text(const char* format, double value) {
  char text[48];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string Percent(double fraction) { return Text("%.1f %%", 100.0 * fraction); }

// "step 3", "steps 3, 17, 18 and 5 more".
std::string ListSteps(const std::vector<int>& steps) {
  constexpr size_t kNamed = 8;
  std::string text = steps.size() == 1 ? "step " : "steps ";
  for (size_t i = 0; i < steps.size() && i < kNamed; ++i) text += (i > 0 ? ", " : "") + std::to_string(steps[i]);
  if (steps.size() > kNamed) text += " and " + std::to_string(steps.size() - kNamed) + " more";
  return text;
}

bool SharesALine(const Finding& f) {
  return f.detail.empty() && (f.kind == FindingKind::kNoProof || f.kind == FindingKind::kWrongPattern ||
                              f.kind == FindingKind::kProofReused);
}

std::string OfSteps(FindingKind kind, const std::vector<int>& steps) {
  switch (kind) {
    case FindingKind::kNoProof:
      return "no proven frame for " + ListSteps(steps);
    case FindingKind::kWrongPattern:
      return "the level check failed for " + ListSteps(steps);
    default:
      return ListSteps(steps) + ": trigger or frame number proves another step, too";
  }
}

std::string OfOne(const Finding& f) {
  const std::string where = (f.projector >= 0 ? "projector " + std::to_string(f.projector) + ": " : "") +
                            (f.step >= 0 ? "step " + std::to_string(f.step) + ": " : "");
  switch (f.kind) {
    case FindingKind::kSilentRig:
      return Text("%.0f", f.value) + " shots in a row without a usable frame" +
             (f.detail.empty() ? "" : " (" + f.detail + ")") + "; check the camera's and projectors' cables and power";
    case FindingKind::kTriggersUnmatched:
      return Text("%.0f", f.value) + " camera triggers and " + Text("%.0f", f.limit) +
             " frames and named losses do not match";
    case FindingKind::kMoved:
      return where + "differs by " + Percent(f.value) + " from what was there before (allowed " + Percent(f.limit) +
             "); the visitor moved";
    case FindingKind::kLamp:
      return where + Percent(f.value) + " of the reference's light; the lamp changed, or something stands in its way";
    case FindingKind::kBlink:
      return where + Percent(f.value) + " of its light in this frame alone; the lamp blinked";
    case FindingKind::kMixedUp:
      return where + "the comb's line gave " + Percent(f.value) + " of what the others give; frames are mixed up";
    case FindingKind::kSaturated:
      return where + Percent(f.value) + " of the lit skin saturates (allowed " + Percent(f.limit) + ")";
    case FindingKind::kDim:
      return where + "the darkest tenth of the lit skin reaches a signal-to-noise ratio of " + Text("%.1f", f.value) +
             " (wanted " + Text("%.1f", f.limit) + ")";
    default:
      return where + f.detail;
  }
}

}  // namespace

const char* ToString(FindingKind kind) { return kWords[static_cast<size_t>(kind)].data(); }

Result<FindingKind> ParseFindingKind(const std::string& word) {
  for (size_t i = 0; i < kWords.size(); ++i)
    if (kWords[i] == word) return static_cast<FindingKind>(i);
  return {
      Status{StatusCode::kNewerSchema, "finding '" + word + "' is not known to this program; a newer one wrote it"}};
}

std::vector<std::string> ToText(const std::vector<Finding>& findings) {
  std::vector<std::string> lines;
  std::map<FindingKind, std::pair<size_t, std::vector<int>>> shared;  // line, steps
  for (const Finding& f : findings) {
    if (!SharesALine(f)) {
      lines.push_back(OfOne(f));
      continue;
    }
    auto [place, fresh] = shared.try_emplace(f.kind, lines.size(), std::vector<int>());
    if (fresh) lines.emplace_back();
    place->second.second.push_back(f.step);
    lines[place->second.first] = OfSteps(f.kind, place->second.second);
  }
  return lines;
}

std::set<int> WithdrawnSteps(const std::vector<Finding>& findings) {
  std::set<int> steps;
  for (const Finding& f : findings)
    if (f.step >= 0 && (f.kind == FindingKind::kNoProof || f.kind == FindingKind::kWrongPattern)) steps.insert(f.step);
  return steps;
}

std::string FindingsToJson(const std::vector<Finding>& findings) {
  Json list = Json::array();
  for (const Finding& f : findings) {
    Json one = {{"kind", ToString(f.kind)}};
    if (f.projector >= 0) one["projector"] = f.projector;
    if (f.step >= 0) one["step"] = f.step;
    one["value"] = f.value;
    one["limit"] = f.limit;
    if (!f.detail.empty()) one["detail"] = f.detail;
    list.push_back(std::move(one));
  }
  return list.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Result<std::vector<Finding>> FindingsFromJson(const std::string& text) {
  const Json list = Json::parse(text, nullptr, false);
  if (!list.is_array()) return Status::Integrity("findings: not a list");
  const auto is_index = [](const Json& one, const char* key) {
    return !one.contains(key) || (one[key].is_number_integer() && one[key] >= 0 && one[key] <= 1'000'000);
  };
  const auto is_figure = [](const Json& one, const char* key) {
    return one.contains(key) && one[key].is_number() && std::isfinite(one[key].get<double>());
  };
  std::vector<Finding> findings;
  for (const Json& one : list) {
    const bool good = one.is_object() && one.contains("kind") && one["kind"].is_string() &&
                      is_index(one, "projector") && is_index(one, "step") && is_figure(one, "value") &&
                      is_figure(one, "limit") && (!one.contains("detail") || one["detail"].is_string());
    if (!good) return Status::Integrity("finding " + std::to_string(findings.size()) + " is not a valid finding");
    Finding f;
    SLX_ASSIGN_OR_RETURN(f.kind, ParseFindingKind(one["kind"].get<std::string>()));
    f.projector = one.value("projector", -1);
    f.step = one.value("step", -1);
    f.value = one["value"].get<double>();
    f.limit = one["limit"].get<double>();
    f.detail = one.value("detail", "");
    findings.push_back(std::move(f));
  }
  return findings;
}

std::string FaultsToJson(const std::map<std::string, int64_t>& faults) {
  return Json(faults).dump(-1, ' ', false, Json::error_handler_t::replace);
}

Result<std::map<std::string, int64_t>> FaultsFromJson(const std::string& text) {
  const Json counts = Json::parse(text, nullptr, false);
  if (!counts.is_object()) return Status::Integrity("faults: not an object of counts");
  std::map<std::string, int64_t> faults;
  for (const auto& [name, count] : counts.items()) {
    if (!count.is_number_unsigned() || count.get<uint64_t>() > uint64_t{INT64_MAX})
      return Status::Integrity("faults: '" + name + "' is not a count");
    faults[name] = count.get<int64_t>();
  }
  return faults;
}

}  // namespace stratalux
