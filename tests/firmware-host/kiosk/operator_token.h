// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace stratalux::rig {

// Of the operator, for the page's tests.
inline const std::string kOperatorToken = "operator-0123456789abcdef";

}  // namespace stratalux::rig
