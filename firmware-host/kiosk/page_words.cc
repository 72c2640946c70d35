// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/page_words.h"

#include <algorithm>
#include <set>

#include <nlohmann/json.hpp>

#include "firmware-host/kiosk/selfcheck_book.h"
#include "firmware-host/kiosk/words.h"
#include "shared/base/json_nesting.h"
#include "shared/base/read_file.h"

namespace stratalux::rig {
namespace {

using SortedJson = nlohmann::json;
constexpr int64_t kMostBytes = 256 << 10;

// "/words/moved", and of lists each place: that one text has two paragraphs and another three is the translator's.
void CollectKeys(const SortedJson& json, const std::string& place, std::set<std::string>& keys) {
  if (!json.is_object()) {
    keys.insert(place);
    return;
  }
  for (const auto& [name, value] : json.items()) CollectKeys(value, place + "/" + name, keys);
}

bool IsText(const SortedJson& json) {
  if (json.is_array()) return !json.empty() && std::all_of(json.begin(), json.end(), IsText);
  return json.is_string() && !json.get<std::string>().empty();
}

template <typename E>
void Require(const char* group, int count, std::set<std::string>& keys) {
  for (int i = 0; i < count; ++i) keys.insert(std::string("/") + group + "/" + ToString(static_cast<E>(i)));
}

// What the machine may name.
std::set<std::string> KeysOfTheMachine() {
  std::set<std::string> keys = {"/name"};
  Require<Word>("words", kWords, keys);
  Require<Closure>("closures", kClosures, keys);
  Require<Phase>("operator/phases", kPhases, keys);
  Require<CheckFigure>("operator/selfchecks/figures", kCheckFigures, keys);
  for (int i = 0; i < kPhases; ++i) keys.insert(std::string("/screens/") + ToString(static_cast<Phase>(i)) + "/title");
  return keys;
}

Status CheckKeys(const std::string& file, const SortedJson& json, const std::set<std::string>& wanted) {
  std::set<std::string> keys;
  CollectKeys(json, "", keys);
  for (const std::string& key : wanted)
    if (keys.count(key) == 0) return Status::Usage("language file " + file + " has no text for " + key);
  for (const std::string& key : keys) {
    const bool empty = key == std::string("/words/") + ToString(Word::kNone);
    if (!empty && !IsText(json.at(SortedJson::json_pointer(key))))
      return Status::Usage("language file " + file + ": " + key + " must be a text that is not empty");
  }
  return Status::Ok();
}

Result<SortedJson> ReadLanguage(const std::string& file) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file, kMostBytes));
  if (const Status status = CheckNesting(text); !status.ok())
    return Status::Usage("language file " + file + ": " + status.message());
  SortedJson json = SortedJson::parse(text, nullptr, false);
  if (!json.is_object()) return Status::Usage("language file " + file + " is not a JSON object");
  return json;
}

}  // namespace

Result<std::vector<PageLanguage>> ReadLanguages(const std::filesystem::path& folder,
                                                const std::vector<std::string>& ids) {
  if (ids.empty()) return Status::Usage("the kiosk's page needs a language");
  std::vector<PageLanguage> languages;
  std::set<std::string> wanted = KeysOfTheMachine();
  for (const std::string& id : ids) {
    const bool plain = !id.empty() && id.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ-") ==
                                          std::string::npos;
    if (!plain) return Status::Usage("'" + id + "' is not a language: letters and hyphens, such as de or pt-BR");
    const std::string file = (folder / (id + ".json")).string();
    auto json = ReadLanguage(file);
    if (!json.ok()) return Status::Usage(json.status().message());
    SLX_RETURN_IF_ERROR(CheckKeys(file, *json, wanted));
    if (languages.empty()) CollectKeys(*json, "", wanted);
    languages.push_back({id, json->at("name").get<std::string>()});
  }
  return languages;
}

}  // namespace stratalux::rig
