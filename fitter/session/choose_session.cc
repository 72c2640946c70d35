// SPDX-License-Identifier: Apache-2.0
#include "fitter/session/choose_session.h"

#include <variant>

#include "db/catalogue/session_filter.h"
#include "db/catalogue/session_store.h"

namespace stratalux::fit {
namespace {

struct Need {
  std::vector<SessionKind> kinds;
  db::Fitted fitted = db::Fitted::kAny;
  const char* what;  // of the message, and of the remedy
  const char* remedy;
};

Need NeedOf(SessionUse use) {
  if (use == SessionUse::kVisitor)
    return {{SessionKind::kVisitor},
            db::Fitted::kAny,
            "a visitor's capture that is complete or degraded",
            "stratalux-rig capture"};
  if (use == SessionUse::kCalibration)
    return {{SessionKind::kCalibration, SessionKind::kDark, SessionKind::kFlat, SessionKind::kResponse},
            db::Fitted::kAny,
            "a calibration capture that did not fail",
            "stratalux-rig capture --kind calibration"};
  return {{SessionKind::kVisitor}, db::Fitted::kYes, "a visitor's capture with a fit", "stratalux-fit run"};
}

Result<std::string> NewestWithFrames(const std::string& folder) {
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto row, store.FindSession("latest"));
  return row.info.id;
}

Result<std::string> Newest(const std::string& folder, const Need& need) {
  SLX_ASSIGN_OR_RETURN(auto index, db::ReadOnlyIndex::Open(folder));
  db::SessionFilter filter;
  filter.kinds = need.kinds;
  filter.statuses = {SessionStatus::kComplete, SessionStatus::kDegraded};
  filter.fitted = need.fitted;
  filter.limit = 1;
  SLX_ASSIGN_OR_RETURN(const auto found, db::ListSessions(index, filter));
  if (found.rows.empty())
    return Status::NotFound(folder + " has no session that is " + need.what + " (`" + need.remedy + "`)");
  return std::get<std::string>(found.rows.front().front());
}

}  // namespace

Result<std::string> ChooseSession(const std::string& store_folder, const std::string& selector, SessionUse use,
                                  Logger& logger) {
  if (selector != "latest") return selector;
  SLX_ASSIGN_OR_RETURN(const std::string id,
                       use == SessionUse::kFrames ? NewestWithFrames(store_folder) : Newest(store_folder, NeedOf(use)));
  logger.Info("latest: session " + id);
  return id;
}

}  // namespace stratalux::fit
