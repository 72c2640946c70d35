// SPDX-License-Identifier: Apache-2.0
#include "db/apps/moment.h"

#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <optional>

namespace stratalux::db {
namespace {

constexpr int64_t kMostAge_s = int64_t{200} * 366 * 86400;  // the ns of int64 reach back to 1677

std::optional<int64_t> AgeSeconds(const std::string& text) {
  int64_t count = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), count);
  if (error != std::errc() || count < 0 || end != text.data() + text.size() - 1) return std::nullopt;
  const int64_t unit = *end == 'm' ? 60 : *end == 'h' ? 3600 : *end == 'd' ? 86400 : *end == 'w' ? 7 * 86400 : 0;
  if (unit == 0 || count > kMostAge_s / unit) return std::nullopt;
  return count * unit;
}

std::optional<int64_t> DateSeconds(std::string text) {
  if (text.ends_with('Z')) text.pop_back();
  // Digits and separators where they belong; sscanf alone would take blanks and signs.
  const std::string_view shape = "dddd-dd-ddTdd:dd:dd";
  if (text.size() != 10 && text.size() != 16 && text.size() != 19) return std::nullopt;
  for (size_t i = 0; i < text.size(); ++i) {
    const bool digit = text[i] >= '0' && text[i] <= '9';
    if (shape[i] == 'd' ? !digit : text[i] != shape[i] && !(shape[i] == 'T' && text[i] == ' ')) return std::nullopt;
  }
  const auto number = [&](size_t at, size_t digits) {
    return at < text.size() ? std::stoi(text.substr(at, digits)) : 0;
  };
  using namespace std::chrono;
  const year_month_day day(year(number(0, 4)), month(static_cast<unsigned>(number(5, 2))),
                           std::chrono::day(static_cast<unsigned>(number(8, 2))));
  const int hour = number(11, 2), minute = number(14, 2), second = number(17, 2);
  if (!day.ok() || hour > 23 || minute > 59 || second > 59 || number(0, 4) < 1700 || number(0, 4) > 2261)
    return std::nullopt;
  const int64_t days = sys_days(day).time_since_epoch().count();
  return ((days * 24 + hour) * 60 + minute) * 60 + second;
}

}  // namespace

Result<WallNs> ParseMoment(const std::string& text, WallNs now) {
  if (const auto age = AgeSeconds(text)) return WallNs{now.ns - *age * kSecondNs};
  if (const auto date = DateSeconds(text)) return WallNs{*date * kSecondNs};
  return Status::Usage("'" + text +
                       "' is not a time; give an age such as 30m, 12h, 7d, 2w or a date such as 2026-11-21 or " +
                       "2026-11-21T04:06 (UTC)");
}

}  // namespace stratalux::db
