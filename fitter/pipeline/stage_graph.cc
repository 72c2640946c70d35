// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/stage_graph.h"

#include <nlohmann/json.hpp>

#include "shared/base/check.h"
#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

std::string Seconds(const db::ArtifactRecord& record) {
  return Formatted("%.1f s (%.1f s of processor), peak %.2f GiB", record.seconds, record.cpu_seconds,
                   static_cast<double>(record.peak_rss_bytes) / (1 << 30));
}

std::string Short(const nlohmann::json& value) {
  std::string text = value.dump();
  return text.size() > 40 ? text.substr(0, 37) + "..." : text;
}

}  // namespace

std::string StageGraph::KeyOf(db::ArtifactIdentity identity) {
  identity.seal = store_.files().seal().key_id();
  return identity.Key();
}

std::string StageGraph::Add(StageNode node) {
  node.identity.seal = store_.files().seal().key_id();
  std::string key = node.identity.Key();
  for (const std::string& upstream : node.upstream) SLX_CHECK(nodes_.contains(upstream));
  nodes_.try_emplace(key, std::move(node));
  return key;
}

Result<Artifact> StageGraph::Need(const std::string& key) {
  const StageNode& node = nodes_.at(key);
  if (!store_.Has(node.identity)) {
    for (const std::string& upstream : node.upstream) SLX_RETURN_IF_ERROR(Need(upstream).status());
    if (!store_.Has(node.identity)) logger_.Info(node.label + " ...");
  }
  const int made_before = store_.made();
  SLX_ASSIGN_OR_RETURN(auto artifact, store_.Obtain(node.identity, node.make));
  if (store_.made() > made_before) logger_.Info(node.label + ": " + Seconds(artifact.record));
  return artifact;
}

Result<std::filesystem::path> StageGraph::StoredFolder(const std::string& key) {
  SLX_ASSIGN_OR_RETURN(const Artifact artifact, Need(key));
  return artifact.folder;
}

std::vector<PlannedStage> StageGraph::Plan(const std::vector<std::string>& keys) const {
  std::vector<PlannedStage> plan;
  std::set<std::string> seen;
  for (const std::string& key : keys) PlanNode(key, seen, plan);
  return plan;
}

void StageGraph::PlanNode(const std::string& key, std::set<std::string>& seen, std::vector<PlannedStage>& plan) const {
  if (!seen.insert(key).second) return;
  const StageNode& node = nodes_.at(key);
  const bool exists = store_.Has(node.identity);
  if (!exists)
    for (const std::string& upstream : node.upstream) PlanNode(upstream, seen, plan);
  plan.push_back({node.identity.stage, node.label, key, exists, exists ? "" : WhyItRuns(node)});
}

std::string StageGraph::WhyItRuns(const StageNode& node) const {
  const auto earlier = store_.OfStage(node.identity.stage);
  if (earlier.empty()) return "never run";
  // Against the one that differs least.
  std::string least;
  size_t fewest = ~size_t{0};
  for (const db::ArtifactRecord& record : earlier) {
    const db::ArtifactIdentity &now = node.identity, &before = record.identity;
    std::vector<std::string> changes;
    if (before.version != now.version)
      changes.push_back("stage version " + std::to_string(before.version) + " -> " + std::to_string(now.version));
    if (before.isa != now.isa) changes.push_back("instruction set " + before.isa + " -> " + now.isa);
    if (before.seal != now.seal) changes.push_back(before.seal.empty() ? "it is plain" : "another key of the session");
    const auto was = nlohmann::json::parse(before.options_json), is = nlohmann::json::parse(now.options_json);
    for (const auto& [name, value] : is.items())
      if (!was.contains(name))
        changes.push_back(name + " is new");
      else if (was[name] != value)
        changes.push_back(name + " " + Short(was[name]) + " -> " + Short(value));
    for (const auto& [name, input] : now.inputs)
      if (const auto found = before.inputs.find(name); found == before.inputs.end() || found->second != input)
        changes.push_back("another " + name);
    if (changes.size() >= fewest) continue;
    fewest = changes.size();
    least.clear();
    for (const std::string& change : changes) least += (least.empty() ? "" : ", ") + change;
  }
  return least.empty() ? "its artifact is gone" : least;
}

}  // namespace stratalux::fit
