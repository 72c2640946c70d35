// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/shard_plan.h"

#include <cstdio>
#include <functional>
#include <queue>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/base/own_hash.h"
#include "db/base/paths.h"
#include "fitter/mixture/em_kernel.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"
#include "shared/base/version.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int kPlanSchema = 1;
constexpr const char* kPlanFile = "plan.json";
constexpr int kMostShards = 1'000'000;

std::string TextOf(const ShardPlan& plan) {
  Json visits = Json::array(), left_out = Json::array();
  for (const PlannedVisit& visit : plan.visits) {
    Json one = {{"session", visit.session}, {"fit", visit.fit}, {"sites", visit.sites}};
    if (visit.cost) {
      one["cpu_seconds"] = visit.cost->cpu_seconds;
      one["peak_bytes"] = visit.cost->peak_bytes;
    }
    visits.push_back(std::move(one));
  }
  for (const NightEvent& event : plan.left_out) left_out.push_back(Json::parse(ToJson(event)));
  const Json json = {{"schema", kPlanSchema},   {"made_ns", plan.made.ns},     {"isa", plan.isa},
                     {"program", plan.program}, {"arguments", plan.arguments}, {"visits", visits},
                     {"left_out", left_out}};
  return db::WithOwnHash(json.dump(1, ' ', false, Json::error_handler_t::replace));
}

Result<PlannedVisit> PlannedVisitFrom(const Json& json) {
  PlannedVisit visit{json.at("session"), json.at("fit"), WholeAt<int64_t>(json, "sites"), {}};
  for (const std::string& id : {visit.session, visit.fit}) SLX_RETURN_IF_ERROR(CheckId(id));
  if (json.contains("cpu_seconds"))
    visit.cost = VisitCost{json.at("cpu_seconds").get<double>(), WholeAt<int64_t>(json, "peak_bytes")};
  if (visit.cost) SLX_RETURN_IF_ERROR(CheckCost(*visit.cost));
  return visit;
}

// The merge writes it to a file of that name, into the night's log: an "ended" there would end the night.
Result<NightEvent> LeftOutFrom(const Json& json) {
  SLX_ASSIGN_OR_RETURN(NightEvent event, ParseNightEvent(json.dump()));
  SLX_RETURN_IF_ERROR(CheckId(event.session));
  if (event.kind != NightEventKind::kLeftOut)
    return Status::Integrity(std::string("'") + ToString(event.kind) + "' leaves nobody out");
  return event;
}

}  // namespace

ShardPlan PlanOf(const NightChoice& choice, const CostHistory& history, const std::vector<std::string>& arguments) {
  ShardPlan plan;
  plan.made = WallNow();
  plan.isa = KernelIsa();
  plan.program = kVersion;
  plan.arguments = arguments;
  for (const LeftOutVisit& visit : choice.left_out) {
    NightEvent event = EventOf(visit);
    event.at = plan.made;
    plan.left_out.push_back(std::move(event));
  }
  for (const ChosenVisit& visit : choice.visits)
    plan.visits.push_back({visit.session, visit.fit, visit.sites, history.Foresee(visit.sites)});
  plan.id = db::HashHex(TextOf(plan));
  return plan;
}

Result<fs::path> WritePlan(const fs::path& results, const ShardPlan& plan) {
  fs::path file = results / kPlanFile;
  std::error_code error;
  if (fs::exists(file, error))
    return Status::Usage(file.string() +
                         " exists: its shards may be at work. Use another folder, or remove this one once it is "
                         "merged (`stratalux-fit batch merge`)");
  SLX_RETURN_IF_ERROR(db::MakeFolder(results));
  SLX_RETURN_IF_ERROR(db::ReplaceFile(file, TextOf(plan)));
  return file;
}

Result<ShardPlan> ReadPlan(const fs::path& results) {
  const fs::path file = results / kPlanFile;
  const auto text = ReadFile(file, kMostPictureBytes);
  if (text.status().code() == StatusCode::kNotFound)
    return Status::NotFound(file.string() + " is missing; `stratalux-fit batch plan --out " + results.string() +
                            "`, run where the store is, makes it");
  SLX_RETURN_IF_ERROR(text.status());
  if (db::CheckOwnHash(*text) != db::OwnHash::kRight)
    return Status::Integrity(file.string() + " does not match its own hash");
  SLX_RETURN_IF_ERROR(CheckNesting(*text).WithContext(file.string()));
  try {
    const Json json = Json::parse(*text);
    if (const auto schema = WholeAt<int64_t>(json, "schema"); schema != kPlanSchema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(schema) +
                                                  ", this program reads " + std::to_string(kPlanSchema) +
                                                  "; use the stratalux that made it");
    ShardPlan plan;
    plan.id = db::HashHex(*text);
    plan.made.ns = WholeAt<int64_t>(json, "made_ns");
    json.at("isa").get_to(plan.isa);
    json.at("program").get_to(plan.program);
    json.at("arguments").get_to(plan.arguments);
    for (const Json& one : json.at("visits")) {
      auto visit = PlannedVisitFrom(one);
      SLX_RETURN_IF_ERROR(visit.status().WithContext(file.string()));
      plan.visits.push_back(std::move(*visit));
    }
    for (const Json& event : json.at("left_out")) {
      auto parsed = LeftOutFrom(event);
      SLX_RETURN_IF_ERROR(parsed.status().WithContext(file.string()));
      plan.left_out.push_back(std::move(*parsed));
    }
    return plan;
  } catch (const Json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

Status CheckId(const std::string& id) {
  const bool name = !id.empty() && !id.starts_with('.') && id.find('/') == std::string::npos && db::StaysInside(id);
  return name ? Status::Ok() : Status::Integrity("'" + id + "' is not an id of a session or a fit");
}

Result<Shard> ParseShard(const std::string& text) {
  Shard shard;
  int length = 0;
  const int read = std::sscanf(text.c_str(), "%9d/%9d%n", &shard.index, &shard.count, &length);
  if (read != 2 || static_cast<size_t>(length) != text.size() || shard.index < 1 || shard.index > shard.count ||
      shard.count > kMostShards)
    return Status::Usage("shard " + text + ": expected I/N with 1 <= I <= N, such as 3/20");
  return shard;
}

std::vector<size_t> VisitsOf(const ShardPlan& plan, const Shard& shard) {
  using Load = std::pair<double, int>;  // seconds, shard
  std::priority_queue<Load, std::vector<Load>, std::greater<>> loads;
  for (int i = 1; i <= shard.count; ++i) loads.emplace(0.0, i);
  std::vector<size_t> own;
  for (size_t place = 0; place < plan.visits.size(); ++place) {
    const auto& cost = plan.visits[place].cost;
    const auto [seconds, least] = loads.top();
    loads.pop();
    loads.emplace(seconds + (cost ? cost->cpu_seconds : 1.0), least);
    if (least == shard.index) own.push_back(place);
  }
  return own;
}

}  // namespace stratalux::fit
