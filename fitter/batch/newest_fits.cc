// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/newest_fits.h"

#include <algorithm>

namespace stratalux::fit {

const db::FitRow* NewestOf(const std::vector<db::FitRow>& fits) {
  const auto newest = std::max_element(fits.begin(), fits.end(),
                                       [](const auto& a, const auto& b) { return a.created_wall < b.created_wall; });
  return newest == fits.end() ? nullptr : &*newest;
}

Status LookAtNewestFits(const db::SessionStore& store, const std::function<bool(const NewestFit&)>& look) {
  SLX_ASSIGN_OR_RETURN(const auto sessions, store.ListSessions());
  for (const db::SessionSummary& session : sessions) {
    if (session.info.kind != SessionKind::kVisitor) continue;
    SLX_ASSIGN_OR_RETURN(const auto fits, store.ListFits(session.info.id));
    const db::FitRow* fit = NewestOf(fits);
    if (fit == nullptr) continue;
    SLX_ASSIGN_OR_RETURN(const auto frames, store.ListFrames(session.info.id));
    if (frames.empty()) continue;
    const FrameRecord& frame = frames.front().record;
    if (!look({session, *fit, frames, int64_t{frame.width} * frame.height})) break;
  }
  return Status::Ok();
}

}  // namespace stratalux::fit
