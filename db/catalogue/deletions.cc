// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/deletions.h"

#include <map>

#include "db/catalogue/session_index.h"
#include "db/ledger/ledger.h"

namespace stratalux::db {

namespace fs = std::filesystem;

Result<bool> IsForgotten(const fs::path& store, const std::string& session_id) {
  if (session_id.empty() || session_id.find('/') != std::string::npos) return false;
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  if (ledger.IsForgotten(session_id)) return true;
  std::error_code error;
  if (!fs::exists(store / "index.sqlite", error)) return false;
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT 1 FROM deletions WHERE session_id = ?1"));
  select.Bind(1, session_id);
  return select.Step();
}

Status RefuseForgotten(const fs::path& store, const std::string& session_id) {
  SLX_ASSIGN_OR_RETURN(const bool forgotten, IsForgotten(store, session_id));
  if (!forgotten) return Status::Ok();
  return Status::Usage("session " + session_id + " was forgotten and cannot return (" + (store / "ledger").string() +
                       "; `stratalux-db deletions` shows its certificate)");
}

Result<std::vector<Deletion>> ListDeletions(const fs::path& store) {
  std::map<std::string, std::string> found;
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select, index.connection().Prepare("SELECT session_id, certificate_json FROM deletions"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) break;
    found[select.Text(0)] = select.Text(1);
  }
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  for (const auto& [session, certificate] : ledger.forgotten())
    if (std::string& known = found[session]; !certificate.empty()) known = certificate;
  std::vector<Deletion> deletions;
  for (auto& [session, certificate] : found) deletions.push_back({session, certificate});
  return deletions;
}

Result<std::string> FindForgotten(const fs::path& store, const std::string& selector) {
  if (selector.empty()) return std::string();
  SLX_ASSIGN_OR_RETURN(const auto deletions, ListDeletions(store));
  std::string found;
  for (const Deletion& deletion : deletions) {
    if (deletion.session == selector) return selector;
    if (!deletion.session.starts_with(selector)) continue;
    if (!found.empty()) return std::string();
    found = deletion.session;
  }
  return found;
}

}  // namespace stratalux::db
