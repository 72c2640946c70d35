// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/morning_facts.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/catalogue/deletions.h"
#include "db/catalogue/session_store.h"
#include "fitter/batch/bytes_below.h"
#include "fitter/batch/newest_fits.h"
#include "shared/base/json_nesting.h"
#include "shared/base/median.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using SortedJson = nlohmann::json;

constexpr size_t kEarlier = 200, kFewest = 8;
constexpr double kFar = 3.5;

SortedJson Parsed(const std::string& text) {
  if (!CheckNesting(text).ok()) return {};
  SortedJson json = SortedJson::parse(text, nullptr, false);
  return json.is_object() ? json : SortedJson();
}

std::optional<double> Number(const SortedJson& json, const char* key) {
  const auto found = json.is_object() ? json.find(key) : json.end();
  if (!json.is_object() || found == json.end() || !found->is_number()) return std::nullopt;
  const double value = found->get<double>();
  return std::isfinite(value) ? std::optional(value) : std::nullopt;
}

// The objects of an array of that name.
std::vector<SortedJson> Objects(const SortedJson& json, const char* key) {
  std::vector<SortedJson> objects;
  if (!json.is_object() || !json.contains(key) || !json[key].is_array()) return objects;
  for (const SortedJson& entry : json[key])
    if (entry.is_object()) objects.push_back(entry);
  return objects;
}

bool Says(const SortedJson& json, const char* key, const char* value) {
  return json.contains(key) && json[key].is_string() && json[key].get<std::string>() == value;
}

// Of the skin that the light truly reaches, or, of a real capture, of what the surface and the mask take for it.
std::optional<double> JudgedShare(const SortedJson& coverage) {
  const auto judged = Number(coverage, "judged"), lit = Number(coverage, "lit_skin");
  if (!judged) return std::nullopt;
  double all = lit.value_or(0.0);
  if (!(all > 0.0)) {
    all = *judged;
    for (const char* lost : {"unlit", "not_fitted", "not_separated"}) all += Number(coverage, lost).value_or(0.0);
  }
  return all > 0.0 ? std::optional(*judged / all) : std::nullopt;
}

std::vector<SlowStage> SlowStages(const std::vector<Figures>& tonight, const std::vector<Figures>& earlier) {
  std::map<std::string, std::vector<double>> now, before;
  for (const Figures& one : tonight)
    for (const auto& [stage, seconds] : one) now[stage].push_back(seconds);
  for (const Figures& one : earlier)
    for (const auto& [stage, seconds] : one) before[stage].push_back(seconds);
  std::vector<SlowStage> stages;
  for (const auto& [stage, seconds] : now) stages.push_back({stage, Median(seconds), Median(before[stage])});
  std::sort(stages.begin(), stages.end(), [](const auto& a, const auto& b) { return a.tonight_s > b.tonight_s; });
  return stages;
}

}  // namespace

Figures FiguresOf(const std::string& metrics_json) {
  const SortedJson json = Parsed(metrics_json);
  Figures figures;
  // The figure that every fit has, of the projector that it held out: those of others follow (--full-evaluation).
  for (const SortedJson& one : Objects(json, "prediction")) {
    if (!Says(one, "light", "stripe") || !Says(one, "model", "tied") || !Says(one, "geometry", "reconstructed") ||
        !Says(one, "part", "total") || !Says(one, "direct", "predicted"))
      continue;
    if (const auto error = Number(one, "nrmse_without_noise"))
      figures.try_emplace("error of stripes, %", 100.0 * *error);
  }
  for (const SortedJson& one : Objects(json, "coverage"))
    if (const auto share = JudgedShare(one); share && Says(one, "geometry", "reconstructed"))
      figures.try_emplace("coverage, %", 100.0 * *share);
  if (json.is_object() && json.contains("fit"))
    if (const auto divergence = Number(json["fit"], "divergence")) figures["divergence"] = *divergence;
  if (json.is_object() && json.contains("drift"))
    for (const SortedJson& one : Objects(json["drift"], "projectors"))
      // 0: not judged (ProjectorDrift::judged), which is no small drift.
      if (const auto shift = Number(one, "shift_px"); shift && *shift > 0.0) {
        double& largest = figures["drift, px"];
        largest = std::max(largest, *shift);
      }
  return figures;
}

Figures StageSecondsOf(const std::string& metrics_json) {
  Figures seconds;
  for (const SortedJson& stage : Objects(Parsed(metrics_json), "stages"))
    if (stage.contains("name") && stage["name"].is_string())
      if (const auto cpu = Number(stage, "cpu_seconds")) seconds[stage["name"].get<std::string>()] += *cpu;
  return seconds;
}

std::vector<Outlier> OutliersOf(const std::string& session, const Figures& figures,
                                const std::vector<Figures>& earlier) {
  std::vector<Outlier> outliers;
  for (const auto& [name, value] : figures) {
    std::vector<double> before;
    for (const Figures& one : earlier)
      if (const auto found = one.find(name); found != one.end()) before.push_back(found->second);
    if (before.size() < kFewest) continue;
    const double usual = Median(before);
    for (double& each : before) each = std::abs(each - usual);
    const double spread = kMadToDeviation * Median(before);
    if (std::abs(value - usual) > kFar * spread && spread > 0.0)
      outliers.push_back({session, name, value, usual, spread});
  }
  return outliers;
}

Result<std::set<std::string>> ForgottenOf(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(const auto deletions, db::ListDeletions(store));
  std::set<std::string> forgotten;
  for (const db::Deletion& deletion : deletions) forgotten.insert(deletion.session);
  return forgotten;
}

Result<MorningFacts> GatherMorning(const fs::path& store_folder, const std::string& night) {
  MorningFacts facts;
  facts.folder = store_folder / "nights" / night;
  SLX_ASSIGN_OR_RETURN(NightRecord record, ReadNight(facts.folder));
  // A forgetting enters the ledger before it comes to the nights' files.
  SLX_ASSIGN_OR_RETURN(const auto forgotten, ForgottenOf(store_folder));
  std::erase_if(record.events, [&](const NightEvent& event) { return forgotten.contains(event.session); });
  facts.night = StatusOf(record.events);
  facts.unread = record.unread;
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(store_folder, db::AccessMode::kReadOnly));

  std::map<std::string, const NightVisit*> tonight;
  for (const NightVisit& visit : facts.night.visits)
    if (visit.kind == NightEventKind::kDone) tonight[visit.session] = &visit;
  std::vector<Figures> earlier, seconds_tonight, seconds_earlier;
  SLX_ASSIGN_OR_RETURN(const auto sessions, store.ListSessions());
  int64_t bytes = 0;
  for (const db::SessionSummary& session : sessions) {
    if (session.info.kind != SessionKind::kVisitor) continue;
    const auto done = tonight.find(session.info.id);
    if (done == tonight.end() && earlier.size() >= kEarlier) continue;
    const auto listed = store.ListFits(session.info.id);
    if (listed.status().code() == StatusCode::kNotFound) continue;  // forgotten since
    SLX_RETURN_IF_ERROR(listed.status());
    const std::vector<db::FitRow>& fits = *listed;
    if (done == tonight.end()) {
      const db::FitRow* fit = NewestOf(fits);
      if (fit == nullptr || fit->created_wall >= facts.night.began) continue;
      earlier.push_back(FiguresOf(fit->metrics_json));
      seconds_earlier.push_back(StageSecondsOf(fit->metrics_json));
      continue;
    }
    FittedVisit visit{.visit = *done->second, .sealed = !session.key_id.empty()};
    for (const db::FitRow& fit : fits) {
      if (fit.id != visit.visit.fit) continue;
      visit.figures = FiguresOf(fit.metrics_json);
      seconds_tonight.push_back(StageSecondsOf(fit.metrics_json));
    }
    const auto row = store.FindSession(session.info.id);
    if (row.status().code() == StatusCode::kNotFound) continue;
    SLX_RETURN_IF_ERROR(row.status());
    for (const Finding& finding : row->info.found.findings) visit.findings.emplace_back(ToString(finding.kind));
    SeenFiles seen;
    visit.bytes = BytesBelow(store.SessionFolder(session.info.id), seen);
    bytes += visit.bytes;
    facts.fitted.push_back(std::move(visit));
  }
  facts.earlier = earlier.size();
  for (const FittedVisit& visit : facts.fitted)
    for (Outlier& outlier : OutliersOf(visit.visit.session, visit.figures, earlier))
      facts.outliers.push_back(std::move(outlier));
  facts.stages = SlowStages(seconds_tonight, seconds_earlier);
  std::error_code error;
  const fs::space_info space = fs::space(store_folder, error);
  facts.free_bytes = error ? 0 : static_cast<int64_t>(space.available);
  if (bytes > 0) facts.nights_left = static_cast<double>(facts.free_bytes) / static_cast<double>(bytes);
  return facts;
}

}  // namespace stratalux::fit
