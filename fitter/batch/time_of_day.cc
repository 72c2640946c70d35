// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/time_of_day.h"

#include <cstdio>

namespace stratalux::fit {

Result<std::chrono::seconds> TimeUntil(const std::string& text, std::time_t now, const char* option) {
  int hour = -1, minute = -1, length = 0;
  const int read = std::sscanf(text.c_str(), "%2d:%2d%n", &hour, &minute, &length);
  if (read != 2 || static_cast<size_t>(length) != text.size() || hour < 0 || hour > 23 || minute < 0 || minute > 59)
    return Status::Usage(std::string(option) + " " + text + ": a time of day, such as 07:00");
  std::tm then{};
  localtime_r(&now, &then);
  then.tm_hour = hour;
  then.tm_min = minute;
  then.tm_sec = 0;
  then.tm_isdst = -1;
  std::time_t at = std::mktime(&then);
  if (at <= now) {
    ++then.tm_mday;
    then.tm_hour = hour;
    then.tm_min = minute;
    then.tm_isdst = -1;
    at = std::mktime(&then);
  }
  return std::chrono::seconds(at - now);
}

// Within: it ends before it begins again.
Result<bool> IsBetween(const std::string& from, const std::string& until, std::time_t now) {
  SLX_ASSIGN_OR_RETURN(const auto to_begin, TimeUntil(from, now, "--from"));
  SLX_ASSIGN_OR_RETURN(const auto to_end, TimeUntil(until, now));
  if (to_begin == to_end) return Status::Usage("--from " + from + " --until " + until + ": two times of day");
  return to_end < to_begin;
}

}  // namespace stratalux::fit
