// SPDX-License-Identifier: Apache-2.0
// In a test program that links counted_new.cc.
#pragma once

#include <cstdint>

namespace stratalux::rig {

[[nodiscard]] int64_t AllocationsOfThisThread();

}  // namespace stratalux::rig
