// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/time_of_day.h"

#include <cstdio>

namespace stratalux::fit {
namespace {

struct TimeOfDay {
  int hour = 0, minute = 0;
};

Result<TimeOfDay> Parse(const std::string& text, const char* option) {
  int hour = -1, minute = -1, length = 0;
  const int read = std::sscanf(text.c_str(), "%2d:%2d%n", &hour, &minute, &length);
  if (read != 2 || static_cast<size_t>(length) != text.size() || hour < 0 || hour > 23 || minute < 0 || minute > 59)
    return Status::Usage(std::string(option) + " " + text + ": expected a time of day, such as 07:00");
  return TimeOfDay{hour, minute};
}

// On the day of `now`, or so many days after it.
std::time_t On(const TimeOfDay& time, std::time_t now, int days) {
  std::tm then{};
  localtime_r(&now, &then);
  then.tm_mday += days;
  then.tm_hour = time.hour;
  then.tm_min = time.minute;
  then.tm_sec = 0;
  then.tm_isdst = -1;
  return std::mktime(&then);
}

}  // namespace

Result<std::chrono::seconds> TimeUntil(const std::string& text, std::time_t now, const char* option) {
  SLX_ASSIGN_OR_RETURN(const TimeOfDay time, Parse(text, option));
  const std::time_t today = On(time, now, 0);
  return std::chrono::seconds((today > now ? today : On(time, now, 1)) - now);
}

Result<std::chrono::seconds> TimeSince(const std::string& text, std::time_t now, const char* option) {
  SLX_ASSIGN_OR_RETURN(const TimeOfDay time, Parse(text, option));
  const std::time_t today = On(time, now, 0);
  return std::chrono::seconds(now - (today <= now ? today : On(time, now, -1)));
}

// Within: it ends before it begins again.
Result<bool> IsBetween(const std::string& from, const std::string& until, std::time_t now) {
  SLX_ASSIGN_OR_RETURN(const auto to_begin, TimeUntil(from, now, "--from"));
  SLX_ASSIGN_OR_RETURN(const auto to_end, TimeUntil(until, now));
  if (to_begin == to_end)
    return Status::Usage("--from " + from + " --until " + until + ": expected two different times of day");
  return to_end < to_begin;
}

}  // namespace stratalux::fit
