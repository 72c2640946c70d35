// SPDX-License-Identifier: Apache-2.0
// Whole numbers of somebody else's JSON. nlohmann's get<int>() makes 1 of 1.5, 1 of 4294967297 (so that a later schema
// passes for the first one), and undefined behaviour of 1e300.
#pragma once

#include <cmath>
#include <concepts>
#include <cstdint>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>

namespace stratalux {

// Throws nlohmann::json::exception, as get<T>() does for a text, where `json` is no whole number that T holds. 3.0 is
// one: programs that know no integers write it.
template <std::integral T>
[[nodiscard]] T Whole(const nlohmann::ordered_json& json, const std::string& name = "number") {
  constexpr double kExact = 9007199254740992.0;  // 2^53
  if (json.is_number_unsigned()) {
    if (const auto number = json.get<uint64_t>(); std::in_range<T>(number)) return static_cast<T>(number);
  } else if (json.is_number_integer()) {
    if (const auto number = json.get<int64_t>(); std::in_range<T>(number)) return static_cast<T>(number);
  } else if (json.is_number_float()) {
    const double real = json.get<double>();
    const bool whole = std::abs(real) <= kExact && std::trunc(real) == real;
    if (whole && std::in_range<T>(static_cast<int64_t>(real))) return static_cast<T>(real);
  }
  const std::string what = json.is_number() ? json.dump() : json.type_name();
  throw nlohmann::json::type_error::create(302, name + ": " + what + " is not a whole number within its range",
                                           nullptr);
}

// The member `key`, which the message names.
template <std::integral T>
[[nodiscard]] T WholeAt(const nlohmann::ordered_json& json, const char* key) {
  return Whole<T>(json.at(key), key);
}

// `otherwise` where there is no such member.
template <std::integral T>
[[nodiscard]] T WholeOr(const nlohmann::ordered_json& json, const char* key, T otherwise) {
  return json.contains(key) ? WholeAt<T>(json, key) : otherwise;
}

}  // namespace stratalux
