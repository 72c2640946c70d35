// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/book_values.h"

#include <nlohmann/json.hpp>

namespace stratalux::rig {

void Refuse(const std::string& what) { throw nlohmann::json::type_error::create(302, what, nullptr); }

WallNs TimeOf(int64_t seconds_since_1970) {
  constexpr int64_t kMost = 9'000'000'000;
  if (seconds_since_1970 <= -kMost || seconds_since_1970 >= kMost) Refuse("at is not a time");
  return {seconds_since_1970 * kSecondNs};
}

}  // namespace stratalux::rig
