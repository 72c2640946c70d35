// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/session.h"

#include <array>
#include <string_view>

namespace stratalux {
namespace {
constexpr std::array<std::string_view, 4> kStatuses = {"recording", "complete", "degraded", "failed"};
}

const char* ToString(SessionStatus status) { return kStatuses[static_cast<size_t>(status)].data(); }

Result<SessionStatus> ParseSessionStatus(const std::string& text) {
  for (size_t i = 0; i < kStatuses.size(); ++i)
    if (kStatuses[i] == text) return static_cast<SessionStatus>(i);
  return Status::Integrity("session status '" + text + "' is unknown");
}

}  // namespace stratalux
