// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/config/kiosk_config.h"

#include <charconv>
#include <string_view>

#include "shared/capture/session.h"
#include "shared/config/toml_reader.h"

namespace stratalux::rig {
namespace {

constexpr int kDay = 24 * 60;

// "08:30"; nullopt for anything else.
std::optional<int> MinuteOf(std::string_view text) {
  int hour = 0, minute = 0;
  if (text.size() != 5 || text[2] != ':') return std::nullopt;
  const auto number = [&](size_t at, int& value) {
    const char* end = text.data() + at + 2;
    return std::from_chars(text.data() + at, end, value).ptr == end && value >= 0;
  };
  if (!number(0, hour) || !number(3, minute) || minute > 59 || hour * 60 + minute > kDay) return std::nullopt;
  return hour * 60 + minute;
}

Result<int> TimeOfDay(const TomlTable& kiosk, const std::string& key, const std::string& text) {
  if (const std::optional<int> minute = MinuteOf(text)) return *minute;
  return Status::Usage(kiosk.Where(key) + ": kiosk." + key + " = \"" + text +
                       "\" is not a time of day; write it as \"08:30\"");
}

Status ReadHours(TomlTable& kiosk, std::optional<OpeningHours>& hours) {
  if (!kiosk.Has("opens") && !kiosk.Has("closes")) return Status::Ok();
  hours.emplace();
  std::string opens, closes;
  kiosk.Require("opens");
  kiosk.Get("opens", opens);
  kiosk.Require("closes");
  kiosk.Get("closes", closes);
  if (!kiosk.Has("opens") || !kiosk.Has("closes")) return Status::Ok();  // Finish says which is missing
  SLX_ASSIGN_OR_RETURN(hours->opens, TimeOfDay(kiosk, "opens", opens));
  SLX_ASSIGN_OR_RETURN(hours->closes, TimeOfDay(kiosk, "closes", closes));
  if (hours->opens == hours->closes)
    return Status::Usage(kiosk.Where("closes") +
                         ": kiosk.closes is the same as kiosk.opens: leave both out for a kiosk that is always open");
  return Status::Ok();
}

Status CheckNames(const TomlTable& kiosk, const char* key, const std::vector<std::string>& names) {
  if (names.empty() || names.size() > 255)
    return Status::Usage(kiosk.Where(key) + ": kiosk." + key + " has " + std::to_string(names.size()) +
                         " names, allowed: 1 .. 255");
  for (const std::string& name : names)
    if (name.empty()) return Status::Usage(kiosk.Where(key) + ": kiosk." + key + " has an empty name");
  return Status::Ok();
}

void ReadTimes(TomlTable& kiosk, KioskConfig& c) {
  kiosk.Get("countdown_s", c.countdown_s, 1, 30);
  kiosk.Get("question_s", c.question_s, 5, 3600);
  kiosk.Get("consent_s", c.consent_s, 5, 3600);
  kiosk.Get("position_s", c.position_s, 5, 3600);
  kiosk.Get("capture_s", c.capture_s, 5, 3600);
  kiosk.Get("gate_s", c.gate_s, 5, 3600);
  kiosk.Get("thanks_s", c.thanks_s, 5, 3600);
  kiosk.Get("forgetting_s", c.forgetting_s, 5, 3600);
  kiosk.Get("selfcheck_s", c.selfcheck_s, 5, 3600);
}

void ReadLimits(TomlTable& kiosk, KioskConfig& c) {
  kiosk.Get("attempts", c.attempts, 1, 3);
  kiosk.Get("steady_looks", c.steady_looks, 1, 20);
  kiosk.Get("calibration_days", c.calibration_days, 0, 10000);
  kiosk.Get("margin", c.margin, 0, 0.4);
  kiosk.Get("height", c.height, 0, 1);
  kiosk.Get("off_centre", c.off_centre, 0, 1);
  kiosk.Get("nearest_mm", c.nearest_mm, 0, 10000);
  kiosk.Get("furthest_mm", c.furthest_mm, 0, 10000);
  kiosk.Get("snr", c.snr, 0, 10);
  kiosk.Get("most_saturated", c.most_saturated, 0, 1);
  kiosk.Get("least_coverage", c.least_coverage, 0, 1);
}

void ReadPage(TomlTable page, KioskPageConfig& c) {
  page.Get("address", c.address);
  page.Get("port", c.port, 0, 65535);
  page.Get("token_file", c.token_file);
  page.Get("operator_token_file", c.operator_token_file);
  page.Get("host_names", c.host_names);
  page.Get("ticket_text", c.ticket_text);
  page.Get("page_folder", c.page_folder);
  page.Get("language_folder", c.language_folder);
}

}  // namespace

Result<KioskConfig> ReadKiosk(TomlTable kiosk) {
  KioskConfig c;
  kiosk.Get("languages", c.languages);
  kiosk.Get("consent_texts", c.consent_texts);
  kiosk.Get("paper_scope", c.paper_scope);
  kiosk.Get("retention", c.retention);
  ReadTimes(kiosk, c);
  ReadLimits(kiosk, c);
  if (kiosk.Has("page")) ReadPage(kiosk.Table("page"), c.page.emplace());
  SLX_RETURN_IF_ERROR(ReadHours(kiosk, c.hours));
  SLX_RETURN_IF_ERROR(CheckNames(kiosk, "languages", c.languages));
  SLX_RETURN_IF_ERROR(CheckNames(kiosk, "consent_texts", c.consent_texts));
  SLX_RETURN_IF_ERROR(ParseRetention(c.retention).status().WithContext(kiosk.Where("retention")));
  if (c.furthest_mm > 0.0 && c.furthest_mm <= c.nearest_mm)
    return Status::Usage(kiosk.Where("furthest_mm") +
                         ": kiosk.furthest_mm is not beyond nearest_mm: nobody could sit there");
  return c;
}

}  // namespace stratalux::rig
