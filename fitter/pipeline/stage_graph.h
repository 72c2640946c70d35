// SPDX-License-Identifier: Apache-2.0
// Stages as a graph: each names what its result depends on, so that its key says whether it must run.
//
// A node is added after the nodes that it reads; its key follows from its identity, before anything is computed.
// Need() gives its artifact: found, or made, its inputs before it. So a run that was killed goes on where it was, a
// changed option runs the stages that read it and those behind them, and two runs share their work (artifact_store.h).
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <type_traits>
#include <vector>

#include "fitter/pipeline/artifact_store.h"

namespace stratalux::fit {

// What a run would do with a node.
struct PlannedStage {
  std::string stage, label, key;
  bool exists = false;
  std::string why;  // it runs: what is new against the newest artifact of that stage
};

struct StageNode {
  db::ArtifactIdentity identity;
  std::string label;                  // for people, such as "fit (projector 3 held out)"
  std::vector<std::string> upstream;  // keys of the nodes that `make` reads
  // Writes the files of the artifact into the folder. A pure function of what the identity names.
  std::function<Status(const std::filesystem::path& folder)> make;
};

class StageGraph {
 public:
  StageGraph(ArtifactStore store, Logger& logger) : store_(std::move(store)), logger_(logger) {}

  // Its key; a node of the same key is there once.
  std::string Add(StageNode node);
  // Of an encrypted session with the seal.
  [[nodiscard]] std::string KeyOf(db::ArtifactIdentity identity);
  [[nodiscard]] Result<Artifact> Need(const std::string& key);
  // What `load` makes of the files of a node's artifact: a function of the folder that holds them, which is there for
  // as long as it runs, to a Result.
  template <typename Loading>
  [[nodiscard]] auto Load(const std::string& key, const Loading& load);
  // Where the files of a node's artifact are stored, once it was needed; of an encrypted session they are sealed.
  [[nodiscard]] Result<std::filesystem::path> StoredFolder(const std::string& key);
  // The nodes that Need(key) would look at, in the order in which they would run.
  [[nodiscard]] std::vector<PlannedStage> Plan(const std::vector<std::string>& keys) const;
  // Whether its artifact is there.
  [[nodiscard]] bool Has(const std::string& key) const { return store_.Has(Node(key).identity); }
  [[nodiscard]] const StageNode& Node(const std::string& key) const { return nodes_.at(key); }
  [[nodiscard]] const ArtifactStore& store() const { return store_; }
  [[nodiscard]] ArtifactStore& store() { return store_; }

 private:
  void PlanNode(const std::string& key, std::set<std::string>& seen, std::vector<PlannedStage>& plan) const;
  [[nodiscard]] std::string WhyItRuns(const StageNode& node) const;

  ArtifactStore store_;
  Logger& logger_;
  std::map<std::string, StageNode> nodes_;
};

template <typename Loading>
auto StageGraph::Load(const std::string& key, const Loading& load) {
  using Loaded = std::invoke_result_t<const Loading&, const std::filesystem::path&>;
  std::optional<Loaded> loaded;
  const auto read = [&](const std::filesystem::path& folder) {
    loaded.emplace(load(folder));
    return loaded->status();
  };
  const auto artifact = Need(key);
  const Status status = artifact.ok() ? store_.ReadFiles(*artifact, read) : artifact.status();
  return status.ok() ? std::move(*loaded) : Loaded(status);
}

}  // namespace stratalux::fit
