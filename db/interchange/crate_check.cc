// SPDX-License-Identifier: Apache-2.0
#include <map>
#include <set>
#include <vector>

#include <nlohmann/json.hpp>

#include "db/interchange/crate_metadata.h"
#include "shared/base/json_nesting.h"

namespace stratalux::db {
namespace {

using SortedJson = nlohmann::json;

constexpr int64_t kMetadataLimit = int64_t{1} << 29;  // bytes
constexpr int kNewestRoCrate = 3;                     // of 1.x

bool HasType(const SortedJson& entity, const char* type) {
  const SortedJson& types = entity.at("@type");
  if (types.is_string()) return types == type;
  for (const SortedJson& one : types)
    if (one == type) return true;
  return false;
}

// The @ids that a property names: of one reference, or of a list of them.
Result<std::vector<std::string>> IdsOf(const SortedJson& entity, const char* property) {
  std::vector<std::string> ids;
  if (!entity.contains(property)) return ids;
  const SortedJson& value = entity.at(property);
  const auto names = [](const SortedJson& one) {
    return one.is_object() && one.contains("@id") && one.at("@id").is_string();
  };
  const bool list = value.is_array();
  for (size_t i = 0; i < (list ? value.size() : 1); ++i) {
    const SortedJson& one = list ? value.at(i) : value;
    if (!names(one)) return Status::Integrity(entity.at("@id").get<std::string>() + ": " + property + " names no @id");
    ids.push_back(one.at("@id").get<std::string>());
  }
  return ids;
}

class Checker {
 public:
  explicit Checker(const CrateFiles& files) : files_(files) {}

  Status Check(const SortedJson& document) {
    if (!document.is_object() || !document.contains("@graph") || !document.at("@graph").is_array())
      return Status::Integrity("not JSON-LD with a flat @graph");
    for (const SortedJson& entity : document.at("@graph")) SLX_RETURN_IF_ERROR(Enter(entity));
    SLX_ASSIGN_OR_RETURN(const std::string root, Root());
    SLX_RETURN_IF_ERROR(CheckParts(root));
    for (const auto& [id, entity] : entities_)
      if (HasType(*entity, "File")) SLX_RETURN_IF_ERROR(CheckFile(id, *entity));
    return Status::Ok();
  }

 private:
  Status Enter(const SortedJson& entity) {
    if (!entity.is_object() || !entity.contains("@id") || !entity.at("@id").is_string())
      return Status::Integrity("an entity of @graph has no @id");
    const std::string id = entity.at("@id").get<std::string>();
    if (!entity.contains("@type") || (!entity.at("@type").is_string() && !entity.at("@type").is_array()))
      return Status::Integrity("entity '" + id + "' has no @type");
    if (!entities_.emplace(id, &entity).second) return Status::Integrity("two entities have the @id '" + id + "'");
    return Status::Ok();
  }
  Result<std::string> Root() {
    const auto descriptor = entities_.find(kCrateMetadataFile);
    if (descriptor == entities_.end()) return Status::Integrity("no metadata descriptor");
    SLX_ASSIGN_OR_RETURN(const auto conforms, IdsOf(*descriptor->second, "conformsTo"));
    const std::string prefix = "https://w3id.org/ro/crate/1.";
    if (conforms.size() != 1 || !conforms[0].starts_with("https://w3id.org/ro/crate/"))
      return Status::Integrity("the descriptor names no version of RO-Crate");
    const std::string minor = conforms[0].starts_with(prefix) ? conforms[0].substr(prefix.size()) : "";
    if (minor.size() != 1 || minor[0] < '1' || minor[0] > '0' + kNewestRoCrate)
      return Status(StatusCode::kNewerSchema, conforms[0] +
                                                  " is not known to this program; it reads RO-Crate 1.1 to 1." +
                                                  std::to_string(kNewestRoCrate) + ": update it");
    SLX_ASSIGN_OR_RETURN(const auto about, IdsOf(*descriptor->second, "about"));
    if (about.size() != 1 || !entities_.contains(about[0]) || !HasType(*entities_.at(about[0]), "Dataset"))
      return Status::Integrity("the descriptor does not describe a root Dataset");
    return about[0];
  }
  // Depth first without recursion: a hostile crate may nest as deep as it likes.
  Status CheckParts(const std::string& root) {
    struct Open {
      std::string id;
      std::vector<std::string> parts;
      size_t next = 0;
    };
    std::set<std::string> path = {root}, done;
    SLX_ASSIGN_OR_RETURN(auto parts, IdsOf(*entities_.at(root), "hasPart"));
    std::vector<Open> stack;
    stack.push_back({root, std::move(parts)});
    while (!stack.empty()) {
      Open& top = stack.back();
      if (top.next == top.parts.size()) {
        path.erase(top.id);
        done.insert(top.id);
        stack.pop_back();
        continue;
      }
      const std::string id = top.parts[top.next++];
      if (path.contains(id)) return Status::Integrity("'" + id + "' is a part of itself");
      const auto entity = entities_.find(id);
      if (entity == entities_.end()) return Status::Integrity("part '" + id + "' is not described");
      if (done.contains(id)) continue;
      SLX_ASSIGN_OR_RETURN(auto inner, IdsOf(*entity->second, "hasPart"));
      path.insert(id);
      stack.push_back({id, std::move(inner)});
    }
    return Status::Ok();
  }
  Status CheckFile(const std::string& id, const SortedJson& entity) {
    const std::string path = PathOfUri(id);
    if (!IsCratePath(path)) return Status::Integrity("file '" + id + "' lies outside the crate");
    const auto file = files_.find(path);
    if (file == files_.end()) return Status::Integrity("file '" + id + "' is not in the crate");
    if (entity.contains("sha256") && entity.at("sha256") != file->second.sha256)
      return Status::Integrity(path + ": its checksum is not the one that the description states");
    if (entity.contains("contentSize") && entity.at("contentSize") != std::to_string(file->second.bytes))
      return Status::Integrity(path + ": its size is not the one that the description states");
    return Status::Ok();
  }

  const CrateFiles& files_;
  std::map<std::string, const SortedJson*> entities_;
};

}  // namespace

Status CheckCrateMetadata(const std::filesystem::path& file, const CrateFiles& files) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadCrateFile(file, kMetadataLimit));
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
  const SortedJson document = SortedJson::parse(text, nullptr, false);
  if (document.is_discarded()) return Status::Integrity(file.string() + ": not JSON");
  return Checker(files).Check(document).WithContext(file.string());
}

}  // namespace stratalux::db
