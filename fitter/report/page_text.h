// SPDX-License-Identifier: Apache-2.0
// Numbers as pages write them; "-" for those that are none.
#pragma once

#include <string>

namespace stratalux::fit {

[[nodiscard]] std::string Fixed(double value, int digits = 3);
[[nodiscard]] std::string Signed(double value, int digits);
[[nodiscard]] std::string PlusMinus(double value, double sd, int digits);

}  // namespace stratalux::fit
