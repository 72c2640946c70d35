// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/selfcheck_book.h"

#include <cmath>
#include <cstdlib>
#include <utility>

#include <nlohmann/json.hpp>

#include "firmware-host/kiosk/book_values.h"
#include "shared/base/formatted.h"
#include "shared/base/json_number.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::array<const char*, kCheckFigures> kNames = {"level", "dark", "red_green", "blue_green",
                                                           "even",  "lit",  "sync",      "frame_rate"};
constexpr size_t kMostProjectors = 64, kMostBytes = 60'000;

std::optional<double> Rounded(std::optional<double> value) {
  if (!value || !std::isfinite(*value)) return std::nullopt;
  return std::strtod(Formatted("%.5g", *value).c_str(), nullptr);
}

Json JsonOf(const Selfcheck& check) {
  Json figures = Json::object();
  for (size_t f = 0; f < kNames.size(); ++f) {
    Json& values = figures[kNames[f]] = Json::array();
    for (const auto& value : check.figures[f]) values.push_back(value ? Json(*value) : Json(nullptr));
  }
  return {{"at", check.at.ns / kSecondNs}, {"passed", check.passed}, {"exposure_ms", check.exposure_ms},
          {"width", check.width},          {"height", check.height}, {"figures", std::move(figures)}};
}

Selfcheck CheckFrom(const Json& json) {
  Selfcheck check;
  check.at = TimeOf(WholeAt<int64_t>(json, "at"));
  check.passed = json.at("passed").get<bool>();
  check.exposure_ms = json.at("exposure_ms").get<double>();
  check.width = WholeAt<int>(json, "width");
  check.height = WholeAt<int>(json, "height");
  const Json& figures = json.at("figures");
  for (size_t f = 0; f < kNames.size(); ++f) {
    const Json& values = figures.at(kNames[f]);
    if (!values.is_array() || values.size() > kMostProjectors) Refuse("figures are lists of at most 64 numbers");
    for (const Json& value : values)
      check.figures[f].push_back(value.is_null() ? std::nullopt : std::optional(value.get<double>()));
  }
  return check;
}

}  // namespace

const char* ToString(CheckFigure figure) { return kNames.at(static_cast<size_t>(figure)); }

SelfcheckBook SelfcheckBook::From(const std::string& text) {
  const Json json = Json::parse(text);
  const Json& checks = json.at("checks");
  if (!checks.is_array() || checks.size() > kMostChecks) Refuse("checks are a list of at most 100");
  SelfcheckBook book;
  for (const Json& check : checks) book.checks_.push_back(CheckFrom(check));
  return book;
}

std::string SelfcheckBook::ToJson() const {
  std::deque<std::string> texts;
  size_t bytes = 0;
  for (auto check = checks_.rbegin(); check != checks_.rend(); ++check) {
    std::string text = JsonOf(*check).dump();
    bytes += text.size() + 2;
    if (bytes > kMostBytes - 100) break;
    texts.push_front(std::move(text));
  }
  std::string json = "{\"schema\": " + std::to_string(kSchema) + ", \"checks\": [";
  for (const std::string& text : texts) json += (&text == &texts.front() ? "\n" : ",\n") + text;
  return json + "\n]}\n";
}

void SelfcheckBook::Add(Selfcheck check) {
  check.at.ns = check.at.ns / kSecondNs * kSecondNs;
  for (auto& values : check.figures)
    for (auto& value : values) value = Rounded(value);
  checks_.push_back(std::move(check));
  if (checks_.size() > kMostChecks) checks_.pop_front();
}

}  // namespace stratalux::rig
