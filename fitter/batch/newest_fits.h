// SPDX-License-Identifier: Apache-2.0
// The last fit of each visitor, newest visitors first: what a store's past tells is told by these.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "db/catalogue/session_store.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// The last of a session's fits; nullptr: it has none.
[[nodiscard]] const db::FitRow* NewestOf(const std::vector<db::FitRow>& fits);

struct NewestFit {
  const db::SessionSummary& session;
  const db::FitRow& fit;
  const std::vector<db::FrameRow>& frames;  // one at least
  int64_t sites = 0;                        // of the camera's mosaic
};
// Visitors with fits and frames, until `look` returns false.
Status LookAtNewestFits(const db::SessionStore& store, const std::function<bool(const NewestFit&)>& look);

}  // namespace stratalux::fit
