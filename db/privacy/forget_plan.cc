// SPDX-License-Identifier: Apache-2.0
// What a forget would do.
#include "db/care/incoming.h"
#include "db/privacy/forget.h"
#include "db/privacy/forget_intent.h"

namespace stratalux::db {

namespace fs = std::filesystem;

ForgottenExport PlanExport(const std::string& place, const std::string& session_id) {
  const auto folder = LocalFolder(place);
  if (!folder) return {place, ExportState::kElsewhere};
  const auto there = IsExportThere(*folder, session_id);
  if (!there.ok()) return {place, ExportState::kKept};
  return {place, *there ? ExportState::kDeleted : StateWithoutMarker(*folder)};
}

Result<ForgetReport> PlanForget(const fs::path& store, const ForgetRequest& request) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto intents, CollectIntents(index, store, request.sessions, IntentHashes::kLeftOut));
  ForgetReport report;
  for (const ForgetIntent& intent : intents) {
    ForgottenSession session = SessionOf(intent);
    for (const std::string& place : intent.exports) session.exports.push_back(PlanExport(place, intent.session));
    report.sessions.push_back(std::move(session));
  }
  std::vector<std::string> ids = request.sessions;
  ids.insert(ids.end(), request.leftovers.begin(), request.leftovers.end());
  for (const fs::path& folder : IncomingPlaces(store, ids, request.visitors))
    report.incoming.push_back(folder.lexically_relative(store).string());
  return report;
}

Result<std::map<std::string, std::vector<std::string>>> LoggedExports(const fs::path& store) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  std::map<std::string, std::vector<std::string>> places;
  SLX_RETURN_IF_ERROR(VisitExports(index.connection(), [&places](const std::string& session, const std::string& place) {
    places[session].push_back(place);
  }));
  return places;
}

}  // namespace stratalux::db
