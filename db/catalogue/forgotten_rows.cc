// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/forgotten_rows.h"

namespace stratalux::db {

Status RemoveForgottenRows(SessionIndex& index, const std::vector<VisitorSession>& forgotten,
                           const std::vector<std::string>& visitors) {
  Connection& connection = index.connection();
  SLX_ASSIGN_OR_RETURN(auto session, connection.Prepare("DELETE FROM sessions WHERE id = ?1"));
  SLX_ASSIGN_OR_RETURN(auto access,
                       connection.Prepare("UPDATE access_log SET detail = replace(detail, ?2, '(forgotten)') WHERE"
                                          " session_id = ?1 AND ?2 <> ''"));
  SLX_ASSIGN_OR_RETURN(auto visitor, connection.Prepare("DELETE FROM visitors WHERE id = ?1 AND NOT EXISTS"
                                                        " (SELECT 1 FROM sessions WHERE visitor = ?1)"));
  for (const VisitorSession& row : forgotten) {
    SLX_RETURN_IF_ERROR(session.Bind(1, row.session).Run());
    SLX_RETURN_IF_ERROR(access.Bind(1, row.session).Bind(2, row.visitor).Run());
  }
  for (const VisitorSession& row : forgotten) SLX_RETURN_IF_ERROR(visitor.Bind(1, row.visitor).Run());
  for (const std::string& id : visitors) SLX_RETURN_IF_ERROR(visitor.Bind(1, id).Run());
  return Status::Ok();
}

}  // namespace stratalux::db
