// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/consent_rows.h"

namespace stratalux::db {

Status InsertConsent(Connection& connection, const std::string& visitor, const Consent& consent, ConsentSource source) {
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_ASSIGN_OR_RETURN(auto person,
                       connection.Prepare("INSERT OR IGNORE INTO visitors (id, created_wall_ns) VALUES (?1, ?2)"));
  SLX_RETURN_IF_ERROR(person.Bind(1, visitor).Bind(2, consent.given_wall.ns).Run());
  SLX_ASSIGN_OR_RETURN(
      auto insert,
      connection.Prepare("INSERT INTO consents (visitor, text_version, language, fit, research, publication,"
                         " given_wall_ns) SELECT ?1, ?2, ?3, ?4, ?5, ?6, ?7 WHERE ?8 OR NOT EXISTS (SELECT 1 FROM"
                         " consents WHERE visitor = ?1 AND text_version = ?2 AND given_wall_ns = ?7)"));
  insert.Bind(1, visitor).Bind(2, consent.text_version).Bind(3, consent.language);
  insert.Bind(4, int64_t{consent.fit}).Bind(5, int64_t{consent.research}).Bind(6, int64_t{consent.publication});
  insert.Bind(7, consent.given_wall.ns).Bind(8, int64_t{source == ConsentSource::kGiven});
  SLX_RETURN_IF_ERROR(insert.Run());
  return transaction.Commit();
}

Result<std::vector<WallNs>> ConsentMoments(Connection& connection, const std::string& visitor, ConsentsThat which) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT given_wall_ns FROM consents WHERE visitor = ?1 AND"
                                                       " (?2 OR withdrawn_wall_ns IS NULL) ORDER BY number"));
  select.Bind(1, visitor).Bind(2, int64_t{which == ConsentsThat::kWereGiven});
  std::vector<WallNs> given;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return given;
    given.push_back({select.Integer(0)});
  }
}

Result<std::optional<WallNs>> WithdrawnOn(Connection& connection, int64_t session_number) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT withdrawn_wall_ns FROM session_consents WHERE session ="
                                                       " ?1 AND withdrawn_wall_ns IS NOT NULL"));
  SLX_ASSIGN_OR_RETURN(const bool any, select.Bind(1, session_number).Step());
  return any ? std::optional(WallNs{select.Integer(0)}) : std::nullopt;
}

}  // namespace stratalux::db
