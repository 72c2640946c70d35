// SPDX-License-Identifier: Apache-2.0
// SLX_CHECK(condition): our own bugs. Prints file, line and condition, then aborts.
#pragma once

namespace stratalux {

// Called once before abort; the rig installs one that switches every ENABLE line off (async-signal-safe).
using CheckFailureHook = void (*)();
void SetCheckFailureHook(CheckFailureHook hook);
[[noreturn]] void CheckFailed(const char* file, int line, const char* condition);

}  // namespace stratalux

#define SLX_CHECK(condition) \
  (static_cast<bool>(condition) ? void(0) : ::stratalux::CheckFailed(__FILE__, __LINE__, #condition))
