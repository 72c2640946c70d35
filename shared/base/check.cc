// SPDX-License-Identifier: Apache-2.0
#include "shared/base/check.h"

#include <atomic>
#include <cstdio>
#include <cstdlib>

namespace stratalux {
namespace {
std::atomic<CheckFailureHook> g_hook{nullptr};
}

void SetCheckFailureHook(CheckFailureHook hook) { g_hook = hook; }

void CheckFailed(const char* file, int line, const char* condition) {
  if (CheckFailureHook hook = g_hook.exchange(nullptr)) hook();
  std::fprintf(stderr, "%s:%d: check failed: %s\n", file, line, condition);
  std::abort();
}

}  // namespace stratalux
