// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/shortfall.h"

namespace stratalux::db {

std::string Shortfall(const SessionInfo& info) {
  if (info.status == SessionStatus::kComplete) return "";
  std::string text = "session " + info.id + " is " + ToString(info.status);
  for (size_t i = 0; i < info.reasons.size(); ++i) text += (i == 0 ? ": " : "; ") + info.reasons[i];
  return text;
}

}  // namespace stratalux::db
