// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/fit_metrics.h"

#include <cmath>

#include <nlohmann/json.hpp>

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

struct Mean {
  double sum = 0.0;
  int count = 0;
};
using Means = std::map<std::string, Mean>;

constexpr int kDeepest = 16;  // nothing that metrics.json holds; a hostile file ends here

bool NamesSomething(const std::string& key) {
  return key == "schema" || key == "projector" || key == "pool" || key == "options";
}

std::string Joined(const std::string& name, const std::string& part) { return name.empty() ? part : name + "." + part; }

// "heldout" + {"light": "stripe", "model": "tied", "pool": 4} -> "heldout.stripe.tied.pool4".
std::string EntryName(std::string name, const Json& entry) {
  for (const auto& [key, value] : entry.items()) {
    if (value.is_string()) name = Joined(name, value.get<std::string>());
    if (key == "pool" && value.is_number_integer() && value != 1) name = Joined(name, "pool" + value.dump());
  }
  return name;
}

void Flatten(const Json& json, const std::string& name, int depth, Means& means) {
  if (depth > kDeepest) return;
  if (json.is_number()) {
    const auto number = json.get<double>();
    if (!std::isfinite(number)) return;
    Mean& mean = means[name];
    mean.sum += number;
    ++mean.count;
  }
  if (json.is_object())
    for (const auto& [key, value] : json.items())
      if (!NamesSomething(key)) Flatten(value, Joined(name, key), depth + 1, means);
  if (json.is_array())
    for (const Json& entry : json)
      if (entry.is_object()) Flatten(entry, EntryName(name, entry), depth + 1, means);
}

}  // namespace

std::map<std::string, double> FlattenMetrics(const std::string& metrics_json) {
  const Json json = Json::parse(metrics_json, nullptr, false);
  if (!json.is_object()) return {};
  Means means;
  Flatten(json, "", 0, means);
  std::map<std::string, double> figures;
  for (const auto& [name, mean] : means) figures[name] = mean.sum / mean.count;
  return figures;
}

}  // namespace stratalux::db
