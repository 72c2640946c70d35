// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/access_log.h"

#include <pwd.h>
#include <unistd.h>

#include "db/catalogue/session_index.h"

namespace stratalux::db {

std::string OperatingSystemUser() {
  passwd entry{};
  passwd* found = nullptr;
  std::string buffer(4096, '\0');
  if (getpwuid_r(geteuid(), &entry, buffer.data(), buffer.size(), &found) == 0 && found != nullptr)
    return found->pw_name;
  return "uid " + std::to_string(geteuid());
}

Status LogAccess(const std::filesystem::path& store, const std::string& action, const std::string& session_id,
                 const std::string& detail) {
  // SQLite writes the index and makes files beside it.
  const bool writable =
      access((store / "index.sqlite").c_str(), W_OK) == 0 && access(store.empty() ? "." : store.c_str(), W_OK) == 0;
  if (!writable) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  SLX_ASSIGN_OR_RETURN(auto insert,
                       index.connection().Prepare("INSERT INTO access_log (at_wall_ns, who, action, session_id, detail)"
                                                  " VALUES (?1, ?2, ?3, ?4, ?5)"));
  insert.Bind(1, WallNow().ns).Bind(2, OperatingSystemUser()).Bind(3, action).Bind(4, session_id).Bind(5, detail);
  SLX_RETURN_IF_ERROR(insert.Run().WithContext("access log (what leaves the store is logged first)"));
  // Into the index itself: the caller's read-only connection, which closes last, could not.
  return index.connection().QueryInteger("PRAGMA wal_checkpoint(PASSIVE)").status();
}

Result<std::vector<AccessEntry>> ListAccess(const std::filesystem::path& store, const std::string& session_prefix) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select,
                       index.connection().Prepare("SELECT at_wall_ns, who, action, session_id, detail FROM access_log"
                                                  " WHERE substr(session_id, 1, length(?1)) = ?1 ORDER BY number"));
  select.Bind(1, session_prefix);
  std::vector<AccessEntry> entries;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return entries;
    entries.push_back({{select.Integer(0)}, select.Text(1), select.Text(2), select.Text(3), select.Text(4)});
  }
}

}  // namespace stratalux::db
