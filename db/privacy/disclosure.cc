// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/disclosure.h"

#include "db/catalogue/manifest.h"
#include "db/privacy/access_log.h"

namespace stratalux::db {
namespace {

constexpr const char* kWhatCounts = R"(
SELECT kind, consent_json, (SELECT c.withdrawn_wall_ns FROM session_consents c WHERE c.session = sessions.number)
FROM sessions WHERE id = :session)";

constexpr const char* kAtAGlance = R"(
SELECT f.frame FROM sessions s JOIN frames f ON f.session = s.number
  LEFT JOIN proofs p ON p.session = f.session AND p.frame = f.frame
WHERE s.id = :session ORDER BY f.phase = 'reference' DESC, p.mean_dn DESC, f.frame LIMIT 1)";

std::string TextIn(const Cell& cell) {
  const auto* text = std::get_if<std::string>(&cell);
  return text == nullptr ? "" : *text;
}

}  // namespace

std::string WhyWithheld(SessionKind kind, const Consent& consent, std::optional<WallNs> withdrawn) {
  if (kind != SessionKind::kVisitor) return "";
  if (withdrawn) return "the visitor's consent was withdrawn on " + ToIso8601(*withdrawn);
  return consent.fit ? "" : "no consent of the visitor allows viewing them (scope fit)";
}

Result<bool> IsForgotten(KeptLedger& ledger, ReadOnlyIndex& index, const std::string& id) {
  SLX_ASSIGN_OR_RETURN(const bool forgotten, ledger.IsForgotten(id));
  if (forgotten) return true;
  SLX_ASSIGN_OR_RETURN(const auto deleted,
                       index.Run("SELECT 1 FROM deletions WHERE session_id = :session", {{"session", id}}));
  return !deleted.rows.empty();
}

Status MayBeShown(KeptLedger& ledger, ReadOnlyIndex& index, const std::string& id) {
  SLX_ASSIGN_OR_RETURN(const bool forgotten, IsForgotten(ledger, index, id));
  if (forgotten) return Status::NotFound("session '" + id + "' was forgotten");
  SLX_ASSIGN_OR_RETURN(const auto table, index.Run(kWhatCounts, {{"session", id}}));
  if (table.rows.empty()) return Status::NotFound("no session '" + id + "' in this store");
  const auto& row = table.rows.front();
  SLX_ASSIGN_OR_RETURN(const SessionKind kind, ParseSessionKind(TextIn(row[0])));
  std::optional<WallNs> withdrawn;
  if (const auto* at = std::get_if<int64_t>(&row[2])) withdrawn = WallNs{*at};
  if (!withdrawn) {  // what stands in the ledger alone
    SLX_ASSIGN_OR_RETURN(withdrawn, ledger.WithdrawnAt(id));
  }
  const std::string why = WhyWithheld(kind, ConsentFromJson(TextIn(row[1])), withdrawn);
  return why.empty() ? Status::Ok() : Status::Usage("pictures and reports are not shown: " + why);
}

Result<int64_t> FrameAtAGlance(ReadOnlyIndex& index, const std::string& id) {
  SLX_ASSIGN_OR_RETURN(const auto table, index.Run(kAtAGlance, {{"session", id}}));
  const auto* frame = table.rows.empty() ? nullptr : std::get_if<int64_t>(&table.rows.front()[0]);
  return frame == nullptr ? Result<int64_t>(Status::NotFound("session '" + id + "' has no frame")) : *frame;
}

Status DisclosureLog::Enter(const std::string& id, const std::string& what, const std::string& peer) {
  const std::lock_guard lock(mutex_);
  const std::string key = id + "\n" + what;
  if (entered_.count(key) != 0) return Status::Ok();
  SLX_RETURN_IF_ERROR(LogAccess(store_, program_, id, what + ", to " + peer));
  entered_.insert(key);
  return Status::Ok();
}

}  // namespace stratalux::db
