// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/book_values.h"

#include <cstdlib>

#include <nlohmann/json.hpp>

namespace stratalux::rig {

void Refuse(const std::string& what) { throw nlohmann::json::type_error::create(302, what, nullptr); }

WallNs TimeOf(int64_t seconds_since_1970) {
  if (std::abs(seconds_since_1970) >= 9'000'000'000) Refuse("at is no time");
  return {seconds_since_1970 * kSecondNs};
}

}  // namespace stratalux::rig
