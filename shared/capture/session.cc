// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/session.h"

#include <array>
#include <string_view>

namespace stratalux {
namespace {
constexpr std::array<std::string_view, 4> kStatuses = {"recording", "complete", "degraded", "failed"};
constexpr std::array<std::string_view, 4> kRetentions = {"short", "standard", "long", "keep"};
}  // namespace

const char* ToString(Retention retention) { return kRetentions[static_cast<size_t>(retention)].data(); }

Result<Retention> ParseRetention(const std::string& text) {
  for (size_t i = 0; i < kRetentions.size(); ++i)
    if (kRetentions[i] == text) return static_cast<Retention>(i);
  return Status::Usage("retention '" + text + "' is unknown; allowed: short, standard, long, keep");
}

const char* ToString(SessionStatus status) { return kStatuses[static_cast<size_t>(status)].data(); }

Result<SessionStatus> ParseSessionStatus(const std::string& text) {
  for (size_t i = 0; i < kStatuses.size(); ++i)
    if (kStatuses[i] == text) return static_cast<SessionStatus>(i);
  return Status::Integrity("session status '" + text + "' is unknown");
}

}  // namespace stratalux
