// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/day_book.h"

#include <algorithm>
#include <cstdlib>
#include <ctime>
#include <iterator>
#include <utility>

#include <nlohmann/json.hpp>

#include "firmware-host/kiosk/book_values.h"
#include "shared/base/json_number.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

constexpr int64_t kDayNs = 24 * 3600 * kSecondNs;
constexpr size_t kMostNames = 64, kLongestName = 32;  // of ends and faults: twice what the vocabulary has

// They become words of a screen and labels of metrics.
std::string NameOf(const std::string& name) {
  const bool plain = !name.empty() && name.size() <= kLongestName &&
                     name.find_first_not_of("abcdefghijklmnopqrstuvwxyz_") == std::string::npos;
  if (!plain) Refuse("a name is 1 to 32 letters a-z and _");
  return name;
}

std::string DayOf(const std::string& day) {
  bool plain = day.size() == 10;
  for (size_t i = 0; plain && i < day.size(); ++i)
    plain = i == 4 || i == 7 ? day[i] == '-' : day[i] >= '0' && day[i] <= '9';
  if (!plain) Refuse("a day is written as 2026-11-24");
  return day;
}

int64_t CountOf(const Json& json) {
  const auto count = Whole<int64_t>(json, "count");
  if (count < 0) Refuse("a count is 0 or more");
  return count;
}

std::map<std::string, int64_t> CountsOf(const Json& json) {
  if (!json.is_object() || json.size() > kMostNames) Refuse("counts are an object of at most 64 names");
  std::map<std::string, int64_t> counts;
  for (const auto& [name, count] : json.items()) counts[NameOf(name)] = CountOf(count);
  return counts;
}

DayCounts DayCountsOf(const Json& json) {
  DayCounts counts;
  counts.day = DayOf(json.at("day").get<std::string>());
  counts.visits_begun = CountOf(json.at("visits_begun"));
  counts.visits = CountsOf(json.at("visits"));
  counts.retakes = CountOf(json.at("retakes"));
  counts.faults = CountsOf(json.at("faults"));
  return counts;
}

// A list of at most `most`.
const Json& ListOf(const Json& json, const char* name, size_t most) {
  const Json& list = json.at(name);
  if (!list.is_array() || list.size() > most) Refuse(std::string(name) + " is not a list, or is too long");
  return list;
}

}  // namespace

std::string LocalDay(WallNs at) {
  const std::time_t seconds = at.ns / kSecondNs;
  std::tm local{};
  localtime_r(&seconds, &local);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%d", &local);
  return text;
}

DayBook DayBook::From(const std::string& text) {
  const Json json = Json::parse(text);
  DayBook book;
  for (const Json& day : ListOf(json, "days", kMostDays)) book.days_.push_back(DayCountsOf(day));
  for (const Json& fault : ListOf(json, "last_faults", kMostFaults))
    book.faults_.push_back({TimeOf(WholeAt<int64_t>(fault, "at")), NameOf(fault.at("word").get<std::string>())});
  book.open_ = json.at("open").get<std::string>();
  if (!book.open_.empty()) DayOf(book.open_);
  return book;
}

std::string DayBook::ToJson() const {
  nlohmann::ordered_json days = nlohmann::ordered_json::array(), faults = nlohmann::ordered_json::array();
  for (const DayCounts& day : days_)
    days.push_back({{"day", day.day},
                    {"visits_begun", day.visits_begun},
                    {"visits", day.visits},
                    {"retakes", day.retakes},
                    {"faults", day.faults}});
  for (const KioskFault& fault : faults_) faults.push_back({{"at", fault.at.ns / kSecondNs}, {"word", fault.word}});
  const nlohmann::ordered_json json = {
      {"schema", kSchema}, {"open", open_}, {"days", std::move(days)}, {"last_faults", std::move(faults)}};
  return json.dump() + "\n";
}

DayCounts& DayBook::Of(const std::string& day) {
  ++changes_;
  const auto found = std::find_if(days_.begin(), days_.end(), [&](const DayCounts& one) { return one.day == day; });
  DayCounts counts;
  counts.day = day;
  if (found != days_.end()) {
    counts = std::move(*found);
    days_.erase(found);
  }
  days_.push_back(std::move(counts));
  if (days_.size() > kMostDays) days_.pop_front();
  return days_.back();
}

void DayBook::Begun(WallNs at) {
  ++At(at).visits_begun;
  open_ = LocalDay(at);
}

void DayBook::Ended(const std::string& end, WallNs at) {
  ++At(at).visits[end];
  open_.clear();
}

void DayBook::Told(Word word, WallNs at) {
  ++At(at).faults[ToString(word)];
  faults_.push_front({{at.ns / kSecondNs * kSecondNs}, ToString(word)});
  if (faults_.size() > kMostFaults) faults_.pop_back();
}

void DayBook::CutOff() {
  if (!open_.empty()) ++Of(open_).visits["cut_off"];
  open_.clear();
}

DayCounts DayBook::Today(WallNs now) const {
  DayCounts none;
  none.day = LocalDay(now);
  const auto found =
      std::find_if(days_.begin(), days_.end(), [&](const DayCounts& one) { return one.day == none.day; });
  return found == days_.end() ? none : *found;
}

std::vector<DayCounts> DayBook::Others(WallNs now) const {
  std::vector<DayCounts> others;
  const std::string today = LocalDay(now);
  std::copy_if(days_.begin(), days_.end(), std::back_inserter(others),
               [&](const DayCounts& one) { return one.day != today; });
  std::sort(others.begin(), others.end(), [](const DayCounts& a, const DayCounts& b) { return a.day > b.day; });
  return others;
}

std::deque<KioskFault> DayBook::LastFaults(WallNs now) const {
  std::deque<KioskFault> faults = faults_;
  std::erase_if(faults, [now](const KioskFault& fault) { return std::abs(now.ns - fault.at.ns) > kDayNs; });
  return faults;
}

}  // namespace stratalux::rig
