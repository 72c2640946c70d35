// SPDX-License-Identifier: Apache-2.0
// What a kiosk's days counted, by the local calendar, over restarts of the program: how visits ended, retakes, what the
// operator was told. Counts alone, of nobody. No file, no clock of its own.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <vector>

#include "firmware-host/kiosk/words.h"
#include "shared/units/time.h"

namespace stratalux::rig {

// "2026-11-24", by the computer's time zone.
[[nodiscard]] std::string LocalDay(WallNs at);

struct DayCounts {
  std::string day;
  int64_t visits_begun = 0;
  std::map<std::string, int64_t> visits;  // by how they ended: "kept", "withdrawn", "cut_off", else the word
  int64_t retakes = 0;
  std::map<std::string, int64_t> faults;  // told to the operator, by word

  friend bool operator==(const DayCounts&, const DayCounts&) = default;
};

struct KioskFault {
  WallNs at;  // whole seconds
  std::string word;
  friend bool operator==(const KioskFault&, const KioskFault&) = default;
};

// A day is its date: a clock that is set back over midnight goes on with what the earlier date had counted, and the
// later date's counts wait for it. The last eight days that were counted in stay.
class DayBook {
 public:
  static constexpr size_t kMostDays = 8, kMostFaults = 50;

  DayBook() = default;
  // Of what ToJson() gave. Throws what the JSON library throws where that is not what it gives.
  [[nodiscard]] static DayBook From(const std::string& json);
  // With a number `schema`; at most some 30 kB.
  [[nodiscard]] std::string ToJson() const;
  static constexpr int kSchema = 1;

  void Begun(WallNs at);
  // Of the visit that was begun; counted on the day of `at`.
  void Ended(const std::string& end, WallNs at);
  void Retaken(WallNs at) { ++At(at).retakes; }
  void Told(Word word, WallNs at);
  // A program begins: a visit that the last one left open ended with it ("cut_off"), on the day that it began.
  void CutOff();

  [[nodiscard]] DayCounts Today(WallNs now) const;
  // All but today, the latest date first.
  [[nodiscard]] std::vector<DayCounts> Others(WallNs now) const;
  // Of the 24 hours before `now`, newest first. What a wrong clock put more than a day ahead is left out, too.
  [[nodiscard]] std::deque<KioskFault> LastFaults(WallNs now) const;

  // Grows with each event that was counted; 0 of what From() gave.
  [[nodiscard]] int64_t changes() const { return changes_; }

 private:
  DayCounts& Of(const std::string& day);
  DayCounts& At(WallNs at) { return Of(LocalDay(at)); }

  std::deque<DayCounts> days_;  // the one that was counted in last is the last
  std::deque<KioskFault> faults_;
  int64_t changes_ = 0;
  std::string open_;  // the day on which a visit began that is not over; empty: none
};

}  // namespace stratalux::rig
